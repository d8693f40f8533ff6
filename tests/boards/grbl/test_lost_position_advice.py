"""Advice after a fault that loses the position, on boards with and without homing."""

from __future__ import annotations

import pytest

from cnc.simulators.grbl.grbl_simulator import Alarm, GrblSimulator
from tests.support.boards.grbl_rig import ROUTER, fails, started
from tests.support.boards.line_board_conformance import PREAMBLE

MOVES = [PREAMBLE, *(f"G1 X{k} F600" for k in range(1, 9))]


@pytest.mark.parametrize("cause", ["limit switch", "restart"])
def test_a_machine_that_does_not_home_can_follow_the_advice(cause: str) -> None:
    simulator = GrblSimulator(settings=ROUTER)
    board = started(simulator)
    when = simulator.now + 1.0
    if cause == "restart":
        simulator.core.at(when, lambda: simulator.power_up())
    else:
        simulator.inject(Alarm(1), time=when)
    found = fails(board, *MOVES).diagnostic
    assert found.code == {"restart": "board-restarted", "limit switch": "board-alarm"}[cause]
    assert "home the machine" in found.hint
    assert "cncrun zero" in found.hint
