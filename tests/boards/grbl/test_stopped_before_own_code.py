"""A run that is stopped while a code of the board's own waits behind the moves."""

from __future__ import annotations

import math

import pytest

from cnc.model.blocks import BoardCommand
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine, PackedLines
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.boards.grbl.test_stopped_line import FIRST, PROMPT, STEP
from tests.support.boards.grbl_rig import connected
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed

MOVES = 14
"""They all fit into the planner, so that the code behind them is sent at once."""


@pytest.mark.parametrize("after", [0.25, 0.45, 0.65])
def test_the_stopped_line_is_not_that_of_the_code(after: float) -> None:
    simulator, control = GrblSimulator(settings=PROMPT), Control()
    board = connected(simulator)
    when = math.inf

    def stop_in_time() -> None:
        if simulator.now > when:
            control.stop()

    board.connect_operator(control, stop_in_time)
    board.start(ORIGIN)
    when = simulator.now + after
    # At F200, a move takes 75 ms.
    feed(board, PREAMBLE, *(f"G1 X{STEP * k:.2f} F200" for k in range(1, MOVES + 1)))
    # Only the board knows what the code does, so its line carries no effect.
    code = FIRST + MOVES
    board.send_lines(PackedLines.of([GcodeLine("M8", code)]))
    board.execute(BoardCommand("", code, text="M8"), 0)
    board.stop()
    rest = simulator.position[0]
    assert control.stopped
    assert 0.0 < rest < STEP * MOVES
    nearest = math.ceil(rest / STEP), math.ceil((rest - 0.05) / STEP)
    assert board.moving_line - FIRST + 1 in nearest
