"""The GRBL driver on a simulator behind a wire that changes bytes."""

from __future__ import annotations

from collections.abc import Callable

from cnc.boards.grbl.driver import GrblBoard
from cnc.model.blocks import Dwell
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.model.streams import PackedLines
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.grbl_rig import MACHINE
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.boards.line_reader import lines_with_effects

PROGRAM = [PREAMBLE, *(f"G1 X{k % 3 * 2}.5 Y{k % 5}.25 F400" for k in range(24))]


class Wire:
    """A port that may change bytes: ``heard`` of the board, ``said`` of the driver."""

    def __init__(self, simulator: GrblSimulator) -> None:
        self.port = GrblSimulatorPort(simulator)
        self.clock = self.port.clock
        self.heard: Callable[[bytes], bytes] = lambda data: data
        self.said: Callable[[bytes], bytes] = lambda data: data

    def read(self, timeout: float) -> bytes:
        return self.heard(self.port.read(timeout))

    def write(self, data: bytes) -> None:
        self.port.write(self.said(data))

    def raise_lines(self) -> bool:
        return self.port.raise_lines()

    def close(self) -> None:
        self.port.close()


def connected(simulator: GrblSimulator) -> tuple[GrblBoard, Wire]:
    wire = Wire(simulator)
    board = GrblBoard(wire, MACHINE, wire.clock, "the simulator")
    board.connect()
    return board, wire


def started(simulator: GrblSimulator, control: Control | None = None) -> tuple[GrblBoard, Wire]:
    board, wire = connected(simulator)
    board.connect_operator(control or Control(), lambda: None)
    board.start(ORIGIN)
    return board, wire


def fault(board: GrblBoard, *lines: str) -> BoardError | None:
    """Return the fault in which a program ends."""
    try:
        feed(board, *lines)
        board.finish()
    except BoardError as error:
        return error
    return None


def assert_at_rest(simulator: GrblSimulator) -> bool:
    stands, moved = simulator.position, len(simulator.moves)
    simulator.advance(simulator.now + 10.0)
    return (simulator.position, len(simulator.moves)) == (stands, moved)


def life(simulator: GrblSimulator, lines: list[str]) -> BoardError | None:
    """Connect a board and run lines; the operator resumes two seconds after each pause."""
    control = Control()
    held: list[float] = []

    def operate() -> None:
        if control.held:
            held.append(simulator.now)
            if simulator.now > held[0] + 2.0:
                held.clear()
                control.resume()

    try:
        board, _ = connected(simulator)
        board.connect_operator(control, operate)
        board.start(ORIGIN)
        for line in lines_with_effects(lines):
            board.send_lines(PackedLines.of([line]))
            if line.text.startswith("G38"):
                board.execute(Dwell("p.nc", line.line, 0.0), 0)
        board.finish()
    except BoardError as error:
        return error
    return None
