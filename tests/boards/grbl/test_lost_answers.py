"""The GRBL driver with answers that are lost, late, doubled or from before the run."""

from __future__ import annotations

import pytest

from cnc.boards.grbl.driver import GrblBoard
from cnc.model.blocks import Dwell
from cnc.simulators.grbl.grbl_simulator import GrblSimulator, Swallow
from tests.support.boards.grbl_rig import LATEST, MACHINE
from tests.support.boards.grbl_wire import (
    PROGRAM,
    Wire,
    assert_at_rest,
    fault,
    started,
)
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed


def test_a_lost_answer_to_an_offset_is_found() -> None:
    simulator = GrblSimulator()
    board, _ = started(simulator)
    feed(board, PREAMBLE, "G1 X1 F400")
    board.execute(Dwell("p.nc", 2, 0.0), 0)
    struck = simulator.now
    simulator.inject(Swallow())
    error = fault(board, "G10 L2 P2 X5")
    assert error is not None
    assert error.diagnostic.code == "reply-missing"
    assert simulator.now - struck <= LATEST


@pytest.mark.parametrize("arrives", [b"", b"\n", b"$"])
def test_a_lost_homing_command_is_found(arrives: bytes) -> None:
    simulator = GrblSimulator(settings={22: 1})
    board, wire = started(simulator)
    wire.said = lambda data: arrives if data == b"$H\n" else data
    struck = simulator.now
    error = fault(board, "$H")
    assert error is not None
    assert error.diagnostic.code in ("reply-missing", "board-locked")
    assert simulator.now - struck <= LATEST
    assert not simulator.moves


def test_endless_noise_is_not_an_answer() -> None:
    simulator = GrblSimulator()
    board, wire = started(simulator)
    feed(board, *PROGRAM[:4])
    struck = simulator.now
    wire.heard = lambda data: b"\xff\x00x\n" * 20
    error = fault(board, *PROGRAM)
    assert error is not None
    assert error.diagnostic.code == "board-silent"
    assert simulator.now - struck <= LATEST


@pytest.mark.parametrize("text", [b"$I\n", b"$$\n", b"$#\n"])
def test_a_board_that_starts_twice_is_connected(text: bytes) -> None:
    simulator = GrblSimulator()
    wire = Wire(simulator)
    again = [text]

    def restart(data: bytes) -> bytes:
        if data in again:
            again.remove(data)
            simulator.power_up(0.5)
        return data

    wire.said = restart
    board = GrblBoard(wire, MACHINE, wire.clock, "the simulator")
    board.connect()
    assert not again
    assert board.info.rx_bytes == 128
    assert len(board.position) == 3


def test_answers_from_before_are_ignored() -> None:
    simulator = GrblSimulator()
    wire = Wire(simulator)
    extra = [b"ok\r\nok\r\n"]
    wire.heard = lambda data: data + extra.pop() if b"help]" in data and extra else data
    board = GrblBoard(wire, MACHINE, wire.clock, "the simulator")
    board.connect()
    board.start(ORIGIN)
    assert fault(board, *PROGRAM[:3]) is None


def test_an_extra_answer_stops_the_run() -> None:
    simulator = GrblSimulator()
    board, wire = started(simulator)
    feed(board, *PROGRAM[:2])
    extra = [b"ok\r\n"]
    wire.heard = lambda data: data + extra.pop() if data and extra else data
    error = fault(board, *PROGRAM[2:])
    assert error is not None
    assert error.diagnostic.code == "reply-lost"
    assert assert_at_rest(simulator)


@pytest.mark.parametrize("late", [0.05, 0.3])
def test_late_answers_are_not_a_fault(late: float) -> None:
    """A radio link, a hub, or a busy computer."""
    simulator = GrblSimulator()
    board, wire = started(simulator)
    waiting: list[tuple[float, bytes]] = []

    def delayed(data: bytes) -> bytes:
        if data:
            waiting.append((simulator.now + late, data))
        due = [each for each in waiting if each[0] <= simulator.now]
        del waiting[: len(due)]
        return b"".join(each[1] for each in due)

    wire.heard = delayed
    assert fault(board, *PROGRAM) is None
    assert board.position == pytest.approx(simulator.position, abs=0.003)
