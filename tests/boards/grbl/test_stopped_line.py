"""The line at which a run is stopped is that of the place where the machine rests."""

from __future__ import annotations

import math
import random

import pytest

from cnc.model.operator_control import Control
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import connected
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.soak import share

PROMPT = {110: 5000.0, 120: 500.0}
STEP = 0.25
"""mm from line to line: some ten of them between two reports."""
FIRST = 2
"""Line of the first move, to X0.25."""


@pytest.mark.parametrize("seed", share(range(40), range(4)))
def test_the_stopped_line_is_that_of_the_resting_position(seed: int) -> None:
    simulator, control = GrblSimulator(settings=PROMPT), Control()
    board = connected(simulator)
    when = simulator.now + random.Random(seed).uniform(0.5, 2.5)

    def stop_in_time() -> None:
        if simulator.now > when:
            control.stop()

    board.connect_operator(control, stop_in_time)
    board.start(ORIGIN)
    moves = (f"G1 X{STEP * k:.2f} F3000" for k in range(1, 600))
    feed(board, PREAMBLE, *moves, first=FIRST - 1)
    board.stop()
    rest = simulator.position[0]
    assert control.stopped
    assert 5.0 < rest < 140.0
    # The place counts as the earlier line's within the tolerance of a report.
    nearest = math.ceil(rest / STEP), math.ceil((rest - 0.05) / STEP)
    assert board.moving_line - FIRST + 1 in nearest
