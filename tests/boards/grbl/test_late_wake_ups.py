"""A computer that wakes up late now and then: the sender takes few more wake-ups."""

from __future__ import annotations

import pytest

from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.boards.grbl.test_streaming_rate import LONG
from tests.support.boards.grbl_rig import connected
from tests.support.boards.line_board_conformance import ORIGIN, feed

RARELY = 20
"""Sleeps from one late end to the next."""
LATE = 0.004
"""s."""


def streamed(monkeypatch: pytest.MonkeyPatch, every: int) -> tuple[float, int]:
    """Return the seconds of the lines and the number of sleeps; each ``every``-th ends late."""
    simulator = GrblSimulator()
    board = connected(simulator)
    board.check_only = True
    board.start(ORIGIN)
    sleeps, sleep = 0, board.link.clock.sleep

    def late(seconds: float) -> None:
        nonlocal sleeps
        sleeps += 1
        sleep(seconds + (LATE if sleeps % every == 0 else 0.0))

    monkeypatch.setattr(board.link.clock, "sleep", late)
    began = simulator.now
    feed(board, *LONG)
    board.finish()
    return simulator.now - began, sleeps


def test_a_rare_late_wake_up_leaves_the_others_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seconds, sleeps = streamed(monkeypatch, 10**9)
    late = streamed(monkeypatch, RARELY)
    assert late[1] < 1.1 * sleeps
    # No more than each late sleep is lost.
    assert late[0] - seconds < LATE * (late[1] // RARELY + 1)


def test_wake_ups_that_are_always_late_come_earlier(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds, _ = streamed(monkeypatch, 10**9)
    late = streamed(monkeypatch, 1)
    assert late[0] < 1.01 * seconds
