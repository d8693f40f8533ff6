"""The loopback board: the conformance suite, its counters, and failing when told to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.boards.loopback import Loopback
from cnc.model.blocks import Spindle
from cnc.model.diagnostics import BoardError
from tests.support.boards.board_conformance import AXES, MIN_PULSE_NS, PulseBoardConformance, chunk
from tests.support.boards.gantry_board import gantry
from tests.support.session.runs import run_with


class TestLoopback(PulseBoardConformance):
    def make(self, folder: Path) -> Loopback:
        return Loopback(AXES, MIN_PULSE_NS)


def test_steps_are_counted_by_axis_and_direction() -> None:
    board = Loopback(2)
    board.start(np.zeros(2, dtype=np.int64))
    board.send(chunk((0, (1, -1)), (0, (1, 0)), (5, (-1, 0))))
    assert board.steps.tolist() == [3, 1]
    assert board.steps_by_direction.tolist() == [[2, 0], [1, 1]]
    assert board.rows == 3
    assert board.capabilities.max_step_rate == np.inf


def test_commands_are_kept_with_their_times() -> None:
    board = Loopback(1)
    board.start(np.zeros(1, dtype=np.int64))
    block = Spindle("p.nc", 1, "ccw", 500.0)
    board.execute(block, 77)
    assert board.commands == [(77, block)]


@pytest.mark.parametrize("rows", [0, 1, 2, 3])
def test_fail_after_raises_a_fault(rows: int) -> None:
    board = Loopback(1, fail_after=rows)
    board.start(np.zeros(1, dtype=np.int64))

    def play() -> None:
        for k in range(2):
            board.send(chunk((k * 10, (1,)), (k * 10 + 5, (1,)), line=10 * (k + 1)))

    with pytest.raises(BoardError) as caught:
        play()
    assert caught.value.diagnostic.code == "board-fault"
    assert caught.value.diagnostic.line == [10, 11, 20, 21][rows]
    assert caught.value.exit_code == 3
    assert board.position_steps.tolist() == [rows]
    assert board.state == "stopped"


def test_motors_of_a_gantry_make_the_same_steps(tmp_path: Path) -> None:
    known = gantry(0.0, 0.0)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 Y3 F900\nG1 Y1\nM2\n")
    board = Loopback.from_machine(known)
    assert run_with(tmp_path / "p.ngc", known, board=board).ok
    assert board.motor_steps == [[200], [100] * 3, [0]]
