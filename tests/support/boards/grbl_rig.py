"""The GRBL driver on the GRBL simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.messages import Started
from cnc.boards.grbl.protocol import GrblProtocol
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.line_board_conformance import ORIGIN, feed

MACHINE = load_machine("grbl-uno")
ROUTER = {110: 5000.0, 111: 5000.0, 120: 250.0, 121: 250.0}
"""Settings of a hobby router: moves of some mm take a third of a second, not seconds."""
LATEST = 5.0
"""Longest time from a fault to its report, s."""
WELCOME = b"\r\nGrbl 1.1h ['$' for help]\r\n"


def ready() -> GrblProtocol:
    """Return the protocol of a board that has started."""
    protocol = GrblProtocol()
    assert [type(event) for event in protocol.receive(WELCOME)] == [Started]
    return protocol


def connected(simulator: GrblSimulator, machine: Machine = MACHINE) -> GrblBoard:
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, machine, port.clock, "the simulator")
    board.connect()
    return board


def started(
    simulator: GrblSimulator,
    control: Control | None = None,
    watcher: Callable[[], None] = lambda: None,
) -> GrblBoard:
    board = connected(simulator)
    board.connect_operator(control or Control(), watcher)
    board.start(ORIGIN)
    return board


def outcome(board: GrblBoard, lines: Sequence[str], first: int = 1) -> BoardError | None:
    """Return the fault in which a program ends; None without one."""
    try:
        feed(board, *lines, first=first)
        board.finish()
    except BoardError as error:
        return error
    return None


def fails(board: GrblBoard, *lines: str, first: int = 1) -> BoardError:
    error = outcome(board, lines, first)
    assert error is not None
    return error
