"""Capabilities that a program requires of a board, pauses, and what the reader takes from it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cnc.boards.protocols import ACTIONS, Action, Capabilities, LineSink, PulseSink
from cnc.boards.registry import BoardFactory, board_factory, joints_on_board
from cnc.boards.serial_port import identity
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.reader.source_text import Text
from cnc.machine.models import Machine
from cnc.model.blocks import (
    AnalogOutput,
    Block,
    BoardCommand,
    Coolant,
    DigitalOutput,
    Orient,
    Probe,
    Spindle,
    SpindleSync,
    TipControl,
    Tool,
    WaitInput,
    pause_reason,
)
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from cnc.report.result import AssumedOffset, Report
from cnc.session.context import SessionContext
from cnc.session.options import RunOptions
from cnc.session.position_check import (
    board_parameters,
    offset_parameters,
    offsets_in,
    read_offsets,
    refuse_lost_shift,
)
from cnc.session.program_reader import ProgramReader

# Pauses of a program for the operator (M0, M6, M60): reason and text.

_COMMENT = re.compile(r"\(([^()]*)\)|;(.*)")
_KEYWORD = re.compile(r"\s*(?:MSG|PRINT|DEBUG|LOG)\s*,", re.IGNORECASE)


def pause_text(block: Block, reader: ProgramReader) -> str:
    """Return the reason of a pause with what the operator should know; empty without a pause.

    For a tool that is its comment in the tool table. Otherwise it is the program's comment in the
    line of the pause, or alone in the line before.
    """
    reason = pause_reason(block)
    if not reason:
        return ""
    if isinstance(block, Tool):
        entry = reader.saved.tools().tool(block.number)
        if entry is not None and entry.comment:
            comment = f"{entry.comment} (tool table)"
            return f"{reason}: {comment}"
    comment = _comment_at(block, reader)
    return f"{reason}: {comment}" if comment else reason


def needs_operator(block: Block) -> GcodeError:
    """Return the fault of a block that waits, if there is no operator."""
    hint = "run it in a terminal and continue with the space bar, or use --yes to skip the pause"
    message = f"{pause_reason(block)}, and there is no terminal to continue from"
    return GcodeError(Diagnostic("needs-operator", message, block.file, block.line, hint=hint))


def _comment_at(block: Block, reader: ProgramReader) -> str:
    """Return the comment in the line of a block, or in the comment line before it."""
    if block.file != reader.name:
        return ""
    text = Text.of_file(reader.path)
    for line in range(block.line, max(block.line - 2, 0), -1):
        window = text.window(line)
        source = window.text(line - window.first) if window else ""
        comments = " ".join(
            _KEYWORD.sub("", first or second).strip() for first, second in _COMMENT.findall(source)
        ).strip()
        if comments and (line == block.line or not _COMMENT.sub("", source).strip()):
            return comments
    return ""


ACTION_NAMES: dict[Action, str] = {
    "spindle": "spindle (M3)",
    "spindle backward": "reversible spindle (M4)",
    "surface speed": "constant surface speed (G96)",
    "orient": "spindle orientation (M19)",
    "flood": "flood (M8)",
    "mist": "mist (M7)",
    "outputs": "outputs (M62 to M68)",
}


def required_actions(block: Block) -> Iterator[Action]:
    """Yield the actions that a block requires of a board."""
    match block:
        case Spindle(state="cw" | "ccw" as state, surface_speed=speed):
            yield "spindle" if state == "cw" else "spindle backward"
            if speed:
                yield "surface speed"
        case Orient():
            yield "orient"
        case Coolant(mist=mist, flood=flood):
            if mist:
                yield "mist"
            if flood:
                yield "flood"
        case DigitalOutput() | AnalogOutput():
            yield "outputs"


@dataclass(frozen=True, slots=True)
class CapabilityCheck:
    """Checks blocks against the capabilities of the board, or of the board in the machine file.

    Attributes:
        board: Name of the board.
        real: Whether the session has a board.
        senses: Whether the board reads probes, inputs and the spindle position.
        probes: Whether it reads probes.
        lines: Whether it accepts lines.
        actions: Actions that it can carry out between moves.
        moves: Whether it moves a machine.
        attended: Whether an operator can continue the program after M0 and M6.
        skips_commands: Whether a command of a GRBL board is only a warning where nothing moves.
    """

    board: str
    real: bool
    senses: bool
    probes: bool
    lines: bool
    actions: frozenset[Action]
    moves: bool
    attended: bool
    skips_commands: bool = False

    @classmethod
    def of(
        cls, board: PulseSink | LineSink | None, name: str | None, machine: Machine, attended: bool
    ) -> CapabilityCheck:
        """Return the check for a board, or for none."""
        kind = machine.board.kind if name is None else name
        can = expected_capabilities(machine) if board is None else board.capabilities
        lines = takes_lines(kind) if board is None else board.takes == "lines"
        if can is None:
            return cls(kind, False, True, True, lines, ACTIONS, False, attended)
        return cls(
            kind,
            board is not None,
            can.senses,
            can.probes,
            lines,
            can.actions,
            lines or can.slice_s > 0.0,
            attended,
        )

    def check(self, block: Block) -> None:
        """Raise GcodeError for a block that the board cannot carry out."""
        if isinstance(block, BoardCommand):
            if not self.lines and not self._skips(block):
                message, hint = (
                    f"{block.text} is for a GRBL board",
                    "remove it, or use a machine file whose board.kind is grbl",
                )
                raise GcodeError(
                    Diagnostic("board-command", message, block.file, block.line, hint=hint)
                )
        elif isinstance(block, TipControl) and self.lines:
            message = f"the board {self.board!r} has no tool-tip control"
            hint = "end it with G49 or M429, or run the program on a board that takes pulses"
            raise GcodeError(Diagnostic("not-on-board", message, block.file, block.line, hint=hint))
        elif isinstance(block, Probe | WaitInput | SpindleSync):
            if not self.senses and not (self.probes and isinstance(block, Probe)):
                kind = {SpindleSync: "the spindle position", Probe: "a probe"}.get(
                    type(block), "an input"
                )
                message = f"the board {self.board!r} cannot read {kind}"
                raise GcodeError(
                    Diagnostic(
                        "board-senseless",
                        message,
                        block.file,
                        block.line,
                        hint="run the program on a board that can",
                    )
                )
        elif self.real and self.moves and not self.attended and pause_reason(block):
            raise needs_operator(block)
        else:
            for action in required_actions(block):
                if action not in self.actions:
                    message = f"the board {self.board!r} has no {ACTION_NAMES[action]}"
                    hint = "remove it, or run the program on a board that has it"
                    raise GcodeError(
                        Diagnostic("not-on-board", message, block.file, block.line, hint=hint)
                    )

    def _skips(self, block: Block) -> bool:
        """Whether a command of a GRBL board is left out, because nothing moves anyway."""
        return (
            isinstance(block, BoardCommand)
            and self.skips_commands
            and not (self.real and self.moves)
        )

    def skipped(self, block: Block) -> Diagnostic | None:
        """Return the warning for a command of a GRBL board that this board does not get."""
        if self.lines or not self._skips(block):
            return None
        assert isinstance(block, BoardCommand)
        message = f"{block.text} is for a GRBL board; here it has no effect"
        return Diagnostic(
            "board-command-skipped", message, block.file, block.line, severity="warning"
        )


def takes_lines(kind: str) -> bool:
    """Whether boards of this kind take lines; False for a kind without a driver."""
    driver = known_driver(kind)
    return driver is not None and driver.takes == "lines"


def known_driver(kind: str) -> BoardFactory | None:
    """Return the driver class of a kind of board, None without one."""
    try:
        return board_factory(kind)
    except UsageError:
        return None


def expected_capabilities(machine: Machine) -> Capabilities | None:
    """Return the capabilities of the board in the machine file; None if its driver cannot tell."""
    driver = known_driver(machine.board.kind)
    if driver is None or driver.takes == "lines":
        return None
    return driver.expected_capabilities(machine)


# Options and positions that depend on the board, set before a program is read.

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
        tool_widths={int(tool[1:]): mm for tool, mm in machine.program.tool_widths.items()},
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
        raise joints_on_board(machine, "a board that takes lines")
