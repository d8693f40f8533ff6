"""The number of blocks in the planner of a board, as it reports it."""

from __future__ import annotations

import pytest

from cnc.session.run_lines import board_timing
from cnc.simulators.grbl.firmware_profile import GRBL, NUMBERED_GRBL, FirmwareProfile
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import MACHINE, connected
from tests.support.boards.simulator_bench import Bench


@pytest.mark.parametrize(("profile", "blocks"), [(GRBL, 15), (NUMBERED_GRBL, 14)])
def test_the_planner_of_a_board_with_line_numbers_is_smaller(
    profile: FirmwareProfile, blocks: int
) -> None:
    """GRBL 1.1h, "planner.h": a ring of 16 places, 15 with USE_LINE_NUMBERS, one of them free."""
    bench = Bench(profile)
    moves = "".join(f"G1X{k}F60\n" for k in range(1, 30))
    assert bench.send(moves[: profile.rx_capacity - 1], 0.5).count("ok") <= blocks
    bench.send(moves, 2.0)
    assert len(bench.simulator.core.planner.blocks) == blocks
    board = connected(GrblSimulator(profile))
    assert board.planner_blocks == blocks
    assert board_timing(board, MACHINE).limits.blocks == blocks - 1
