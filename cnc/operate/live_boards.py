"""Boards for an operator: simulated ones run in real time, because somebody watches them."""

from __future__ import annotations

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.paced_loopback import PacedLoopback
from cnc.boards.protocols import LineSink, PulseSink
from cnc.boards.registry import board_factory, open_board
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
    if kind == "file":
        hint = "a file is written by cncrun --board file --port FILE.npz"
        raise UsageError(Diagnostic("no-operation", "a file cannot be operated", hint=hint))
    if port is None and kind == "loopback":
        start = Joints(machine).at(start_position(machine))
        return PacedLoopback(machine.of_joints, start.tolist())
    if port is None and kind == "grbl-sim":
        from cnc.boards.grbl.simulator.board import GrblSimulatorBoard

        board_factory(kind)
        return GrblSimulatorBoard.in_real_time(machine)
    if port is None and kind == "klipper-sim":
        from cnc.boards.klipper.simulator.board import KlipperSimulatorBoard

        board_factory(kind)
        return KlipperSimulatorBoard.in_real_time(machine)
    return open_board(machine, kind=kind, port=port)


def operated(board: PulseSink | LineSink, machine: Machine) -> OperatedMachine:
    """Return the machine behind a board.

    Raises:
        UsageError: ``no-operation`` for a line board of another kind than GRBL.
    """
    if isinstance(board, GrblBoard):
        return LineMachine(board, machine)
    if isinstance(board, PulseSink):
        return PulseMachine(board, machine)
    message, hint = "this board cannot be operated", "run programs on it with cncrun PROGRAM"
    raise UsageError(Diagnostic("no-operation", message, hint=hint))
