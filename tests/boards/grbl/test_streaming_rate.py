"""Short lines are streamed as fast as the wire allows, with few wake-ups of this computer."""

from __future__ import annotations

import pytest

from cnc.boards.grbl import line_stream
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import connected
from tests.support.boards.line_board_conformance import ORIGIN, feed

LINES = ["G1 F600", *(f"X{k % 7}.125Y{k % 9}.25Z-{k % 3}.375" for k in range(900))]


def streamed(monkeypatch: pytest.MonkeyPatch, gathering: float) -> tuple[float, int]:
    """Return the seconds of the lines in the board's check mode, and the number of readings."""
    monkeypatch.setattr(line_stream, "GATHERING", gathering)
    simulator = GrblSimulator()
    board = connected(simulator)
    board.check_only = True
    board.start(ORIGIN)
    readings, pump = 0, board.link.pump

    def counted(timeout: float, poll: float = 0.2):
        nonlocal readings
        readings += 1
        return pump(timeout, poll)

    monkeypatch.setattr(board.link, "pump", counted)
    began = simulator.now
    feed(board, *LINES)
    board.stream.drain()
    return simulator.now - began, readings


def test_answers_gather_while_the_wire_stays_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    gathering = line_stream.GATHERING
    seconds, readings = streamed(monkeypatch, 0.0)
    fewer = streamed(monkeypatch, gathering)
    assert fewer[0] < 1.01 * seconds
    assert fewer[1] < 0.6 * readings
