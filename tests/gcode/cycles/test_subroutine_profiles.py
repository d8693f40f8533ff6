"""LinuxCNC's G70, G71 and G72 against LinuxCNC's own interpreter, and against their definition.

``linuxcnc_profiles.json`` has programs with random profiles, and the ends (X, Z) of the last cuts
that ``rs274 -g`` of LinuxCNC 2.9 prints for them: of the last pass of G71 along the profile, and of
G70. LinuxCNC refuses some profiles with arcs as not monotonic; those are left out.
"""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from typing import Any

import pytest

from cnc.model.blocks import ArcFeed, Polyline
from cnc.model.motion_commands import apart
from tests.support.gcode.gcode_cases import error_of, rows, run
from tests.support.soak import share

Point = tuple[float, float]
NEAR = 5e-3
"""mm. LinuxCNC prints four digits, and cuts arcs at the rounding of their ends."""
LINUXCNC = Path(__file__).with_name("linuxcnc_profiles.json")
HEAD = "G21 G18 G90 G8 G40\nF200\nG0 X60 Z5\n"


def profile(rng: random.Random) -> tuple[list[str], list[Point]]:
    """A profile that rises from the axis: lines, and quarters of circles outwards."""
    x, z = rng.uniform(5, 15), 0.0
    lines, points = [f"G1 X{x:.3f} Z0"], [(x, z)]
    for _ in range(rng.randint(2, 5)):
        kind = rng.choice(["along", "slope", "round"])
        size = rng.uniform(2, 6)
        if kind == "along":
            z -= size
            lines.append(f"G1 Z{z:.3f}")
        elif kind == "slope":
            x, z = x + rng.uniform(1, 5), z - size
            lines.append(f"G1 X{x:.3f} Z{z:.3f}")
        else:
            x, z = x + size, z - size
            lines.append(f"G3 X{x:.3f} Z{z:.3f} I0 K{-size:.3f}")
        points.append((x, z))
    return lines, points


def program(lines: list[str], *cycles: str) -> str:
    sub = "\n".join(("O100 SUB", *lines, "O100 ENDSUB"))
    return HEAD + sub + "\n" + "\n".join(cycles) + "\nM2\n"


def ours(source: str) -> list[tuple[str, float, float]]:
    """Kind, X and Z of each move."""
    found: list[tuple[str, float, float]] = []
    for block in apart(run(source, dialect="linuxcnc", axes="xyz")):
        if isinstance(block, Polyline):
            for end, feed in zip(block.points.tolist(), block.feeds.tolist(), strict=True):
                found.append(("rapid" if math.isnan(feed) else "line", end[0], end[2]))
        elif isinstance(block, ArcFeed):
            found.append(("line", float(block.end[0]), float(block.end[2])))
    return found


def last_cuts(moves: list[tuple[str, float, float]]) -> list[Point]:
    """The cuts behind the last traverse between cuts; those nearer than the tolerance are one."""
    while moves[-1][0] == "rapid":
        moves = moves[:-1]
    begin = max(index for index, move in enumerate(moves) if move[0] == "rapid") + 1
    found: list[Point] = []
    for _, x, z in moves[begin:]:
        if not found or math.dist(found[-1], (x, z)) > NEAR:
            found.append((x, z))
    return found


@pytest.mark.parametrize("case", json.loads(LINUXCNC.read_text()))
def test_the_last_pass_and_the_finishing_are_those_of_linuxcnc(case: dict[str, Any]) -> None:
    found = last_cuts(ours("\n".join(case["program"]) + "\n"))[-len(case["cuts"]) :]
    assert found == [pytest.approx(each, abs=NEAR) for each in case["cuts"]]


def test_no_pass_is_deeper_than_i_or_nearer_than_d() -> None:
    """Between the axis and the profile lies the part; the tool stays D away from it."""
    for seed in range(share(200, 6)):
        rng = random.Random(f"depth {seed}")
        lines, points = profile(rng)
        depth = round(rng.uniform(0.5, 3), 3)
        moves = ours(program(lines, f"G71 Q100 X55 Z2 D0.3 I{depth:.3f}"))
        levels = sorted({round(x, 6) for kind, x, z in moves if kind == "line" and z > -0.001})
        steps = [b - a for a, b in zip(levels, [*levels[1:], 55.0], strict=True)]
        assert max(steps) <= depth + 1e-6
        for _, x, z in moves:
            assert x >= points[0][0] + 0.3 - 1e-3 or z >= 0.0
        assert (moves[-1][1], moves[-1][2]) == pytest.approx((55.0, points[-1][1]), abs=0.31)


def test_g72_faces_along_x() -> None:
    lines = ["G1 X40 Z-10", "G1 X20 Z-4", "G1 X0"]
    moves = ours(program(lines, "G72 Q100 X50 Z2 D0 I3", "G70 Q100"))
    cuts = [(x, z) for kind, x, z in moves if kind == "line"]
    assert cuts[-2:] == [pytest.approx((20, -4)), pytest.approx((0, -4))]


def test_the_subroutine_moves_nothing_and_changes_nothing() -> None:
    lines = ["M8", "S500 M3", "F7", "G0 X10 Z0", "G1 Z-5", "G91 G1 X5"]
    blocks = run(program(lines, "G71 Q100 X20 Z1 I20", "G1 X30 Z9"), dialect="linuxcnc", axes="xyz")
    found = list(rows(blocks))
    assert {row[0] for row in found} <= {"rapid", "line", "end"}
    assert {round(row[4], 6) for row in found if row[0] == "line"} == {200.0}
    assert found[-2][1:4] == (30.0, 0.0, 9.0)


@pytest.mark.parametrize(
    ("lines", "cycle", "code"),
    [
        (["G1 X10 Z0", "G1 Z-5"], "G71 Q200 X20", "sub-unknown"),
        (["M8"], "G71 Q100 X20", "profile-empty"),
        (["G1 X10 Z0", "G1 Z-5", "G1 Z-3"], "G71 Q100 X20 Z1", "profile-not-monotone"),
        (["G1 X10 Z0", "G1 Z-5"], "G17 G71 Q100 X20", "turning-plane"),
        (["G1 X10 Z0", "G1 Z-5"], "G71 Q100 X20 I-1", "value-out-of-range"),
        (["G1 X10 Z0", "G1 Z-5"], "G71 Q100 X20 Y1", "axis-not-allowed"),
        (["G1 X10 Z0", "G1 Z-5"], "G71 Q100 X20 P5", "word-unused"),
        (["G1 X10 Z0", "G71 Q100", "G1 Z-5"], "G71 Q100 X20", "profile-line"),
        (["G1 X10 Z0", "G2 X12 Z-2 I2 K0"], "G71 Q100 X40 Z1 D5", "allowance-in-pocket"),
    ],
)
def test_faults(lines: list[str], cycle: str, code: str) -> None:
    assert error_of(program(lines, cycle), dialect="linuxcnc", axes="xyz").code == code


POCKET = ["G1 X10 Z0", "Z-5", "X6 Z-9", "Z-12", "X10 Z-16", "X14 Z-18", "Z-22", "X20"]


def test_g71_1_leaves_the_pockets_to_g71_2() -> None:
    moves = ours(program(POCKET, "G71.1 Q100 X20 Z2 I4 R1"))
    cuts = [(x, z) for kind, x, z in moves if kind == "line"]
    # Levels are 4 mm apart; the last pass goes straight over the pocket, from z -5 to z -16.
    assert cuts == [
        (16, 1.2), (16, -22), (16, 1.2), (12, 0.4), (12, -17),
        (10, 0), (10, -5), (10, -16), (14, -18), (14, -22), (20, -22),
    ]  # fmt: skip
    moves = ours(program(POCKET, "G0 X20 Z2\nG71.2 Q100 I2 R1"))
    cuts = [(x, z) for kind, x, z in moves if kind == "line"]
    # The pocket is 4 mm deep: a pass 2 mm deep, and the last one along it.
    assert cuts == [
        (10, -5), (8, -7), (8, -14), (10, -5), (6, -9), (6, -12), (10, -16)
    ]  # fmt: skip
    assert moves[-1] == ("rapid", 20, -16)


def test_a_pocket_without_a_far_wall_ends_with_the_profile() -> None:
    lines = ["G1 X10 Z0", "Z-5", "X6 Z-9", "Z-12"]
    cuts = [
        (x, z) for kind, x, z in ours(program(lines, "G71.1 Q100 X12 Z2 I4 R1")) if kind == "line"
    ]
    assert cuts[-2:] == [(10, -5), (10, -12)]
    cuts = [
        (x, z)
        for kind, x, z in ours(program(lines, "G0 X12 Z2\nG71.2 Q100 I4 R1"))
        if kind == "line"
    ]
    assert cuts[-2:] == [(6, -9), (6, -12)]
    assert min(x for x, _ in cuts) == 6
