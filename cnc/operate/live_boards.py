"""Boards for an operator: simulated ones run in real time, because somebody watches them."""

from __future__ import annotations

from cnc.boards.protocols import LineSink, PulseSink
from cnc.boards.registry import open_board
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.operate.line_machine import LineMachine
from cnc.operate.machines import OperatedMachine
from cnc.operate.pulse_machine import PulseMachine
from cnc.planner.joints import Joints
from cnc.session.program_reader import start_position


def open_live(machine: Machine, kind: str, port: str | None) -> PulseSink | LineSink:
    """Open a board for an operator.

    Raises:
        UsageError: ``no-operation`` for a board that writes a file, or as
            :func:`cnc.boards.registry.open_board`.
        BoardError: The board does not answer.
    """
    start = Joints(machine).at(start_position(machine)).tolist()
    return open_board(machine, kind=kind, port=port, start=start)


def operated(board: PulseSink | LineSink, machine: Machine) -> OperatedMachine:
    """Return the machine behind a board.

    Raises:
        UsageError: ``no-operation`` for a board that takes lines and only runs programs.
    """
    if board.takes == "pulses":
        return PulseMachine(board, machine)
    operation = board.operation
    if operation is None:
        message, hint = "this board cannot be operated", "run programs on it with cncrun PROGRAM"
        raise UsageError(Diagnostic("no-operation", message, hint=hint))
    return LineMachine(board, operation, machine)
