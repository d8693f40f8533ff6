"""All pairs and triples of moves, joints and path modes are planned legally.

Feeds and machines are random. Every run has a new seed, which a failure reports:
``CNC_SEED=... pytest tests/planner/test_joints.py`` runs the same programs again.
"""

import os
import secrets

import pytest

from cnc.api import load_machine
from tests.support.planner.joints import JOINTS, KINDS, MODES, SHAPES, joint_program
from tests.support.planner.legality import examine
from tests.support.soak import share

SEED = int(os.environ.get("CNC_SEED") or secrets.randbelow(10**9))
TOGETHER = share(20, 8)
"""Programs in one test."""

CHANGING = {
    "a feed move and a traverse": "G1 X10 F300\nG0 X20\n",
    "a slow retract": "G1 Z2 F600\nG0 Z12\n",
    "a traverse and a feed move": "G0 X10\nG1 X20 F300\n",
    "feeds 1 : 1000": "G1 X1 F6\nG1 X30 F6000\nG1 X31 F6\n",
}
"""Simple programs in which the speed bound changes in the middle of a straight line."""


@pytest.mark.parametrize("name", CHANGING)
def test_a_speed_bound_that_changes_on_a_straight_line_is_kept(name, tmp_path):
    found = examine(f"G21 G90\n{CHANGING[name]}M30\n", load_machine("default"), tmp_path)
    assert not found.wrong


@pytest.mark.parametrize("first", range(0, share(20_000, TOGETHER), TOGETHER))
def test_consecutive_moves_are_planned_legally(first, tmp_path):
    for number in range(first, first + TOGETHER):
        # The shapes differ from run to run too.
        text, machine = joint_program(number if share(True, False) else SEED + number, SEED)
        assert not examine(text, machine, tmp_path).wrong, (
            f"CNC_SEED={SEED}, program {number}:\n{text}\n{machine!r}"
        )


def test_programs_have_every_shape_and_mode():
    assert len(SHAPES) == len(KINDS) ** 2 * len(JOINTS) + len(KINDS) ** 3 * len(JOINTS) ** 2
    text = "".join(joint_program(number, SEED)[0] for number in range(300))
    for mode in MODES:
        assert f"{mode}" in text
    for code in ("G0 ", "G1 ", "G2 ", "G3 ", "G06.2 "):
        assert code in text
