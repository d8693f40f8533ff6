"""Options and positions that depend on the board, set before a program is read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc.boards.protocols import LineSink, PulseSink
from cnc.boards.serial_port import identity
from cnc.gcode.state.reading_policy import ReadingPolicy
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.report.result import AssumedOffset, Report
from cnc.session.board_offsets import board_parameters, offset_parameters, offsets_in
from cnc.session.context import SessionContext
from cnc.session.kept_offsets import read_offsets
from cnc.session.options import RunOptions
from cnc.session.required_capabilities import takes_lines

Board = PulseSink | LineSink


def reading_policy(options: RunOptions, machine: Machine, board: Board | None) -> ReadingPolicy:
    """Return the user's choices.

    A machine never moves by lengths that nobody gave, and a program that lacks a part of its moves
    is checked, but neither sent nor written as pulses or lines.
    """
    outputs = options.outputs
    is_check = board is None and outputs.lines is None and outputs.pulses is None
    lengths = options.tool_lengths
    if lengths is None:
        moves = board is not None and not board.traits.simulated
        lengths = "table" if moves or outputs.lines is not None else "zero"
    return ReadingPolicy(
        lengths,
        options.unknown_codes,
        "warn" if is_check else "error",
        machine.program.codes,
        options.default_feed,
        options.optional_stop,
    )


def adopt_board(context: SessionContext, board: LineSink) -> None:
    """Let the reader use the travel, offsets and position of the board.

    Raises:
        UsageError: ``no-pulses`` if pulses are to be written.
        BoardError: ``laser-mode-off`` as in ``GrblBoard.limited_to_board``; ``offset-lost`` if the
            zero of G92 is lost.
    """
    if context.options.outputs.pulses is not None:
        message = "a board that plans for itself takes lines, not pulses"
        hint = "leave --pulses out, or check the program without the board"
        raise UsageError(Diagnostic("no-pulses", message, hint=hint))
    context.report.check_only, context.report.planned_by_board = board.check_only, True
    from cnc.session.position_check import refuse_lost_shift

    reader = context.reader
    reader.machine = board.limited_to_board(reader.machine)
    refuse_lost_shift(board, reader.machine)
    homes = context.options.home and not board.check_only
    reader.start = np.array(board.homed_position if homes else board.position)
    reader.homed = board.homed_position
    reader.ceiling = board.ceiling
    reader.saved.adopt(board_parameters(board, reader.machine))


def adopt_kept_offsets(context: SessionContext) -> None:
    """Let the reader use the offsets of the last run on the GRBL board, if they are known."""
    reader = context.reader
    if not takes_lines(reader.machine.board.kind):
        return
    port = reader.machine.board.port
    kept, warnings = (None, []) if port is None else read_offsets(identity(port))
    for warning in warnings:
        context.observer.warn(warning)
    if kept is not None:
        reader.saved.adopt(offset_parameters(kept))
    values = reader.saved.parameters(macro=False).values
    offset = offsets_in(values, reader.machine)["G54"]
    context.report.offset = AssumedOffset(kept is not None, offset)


def assumed_offset(report: Report) -> Iterator[Diagnostic]:
    """Yield a warning if a check failed at the travel with an offset that is only assumed."""
    offset = report.offset
    if offset is None or offset.kept:
        return
    if any(fault.diagnostic.code == "soft-limit" for fault in report.faults):
        g54 = " ".join(f"{axis.upper()}{value:g}" for axis, value in offset.g54.items())
        message = f"G54 is assumed to be {g54}: that of the board is not known"
        hint = "cncrun boards reads the offsets of the board, and keeps them for later checks"
        yield Diagnostic("offset-assumed", message, hint=hint, severity="warning")


def is_attended(context: SessionContext, board: Board | None) -> bool:
    """Whether a pause does not end the program.

    A board that plans for itself waits at a pause, so an operator must continue the program.
    """
    pauses, has_operator = context.options.pauses, context.has_operator
    return pauses == "skip" or (
        pauses == "wait" and (has_operator or board is None or board.takes == "pulses")
    )


def refuse_lines(machine: Machine, options: RunOptions) -> None:
    """Refuse lines for a machine with joints of its own: the board's firmware knows no joints."""
    if takes_lines(machine.board.kind) or options.outputs.lines is not None:
        message = "a board that takes lines has its kinematics in its firmware"
        hint = "leave [kinematics] and [joints] out of the machine file of such a board"
        raise UsageError(Diagnostic("kinematics-on-board", message, hint=hint))
