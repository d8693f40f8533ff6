"""Positions along the moves that were sent: on the toolpath no fault, beside it always one."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.grbl.position_tracker import TOLERANCE, AxisLimits, PositionTracker
from cnc.boards.grbl.protocol import groups_of
from cnc.model.streams import GcodeLine, PackedLines
from tests.support.boards.line_reader import LineReader, lines_with_effects

OFFSET = (10.0, -20.0, 3.0)
PLANNER = 15
STEPS = 60
Point = tuple[float, float, float]
PLANES = {"G17": (0, 1), "G18": (2, 0), "G19": (1, 2)}


def arc(
    start: Point, plane: str, radius: float, first: float, sweep: float, rise: float
) -> tuple[str, list[Point]]:
    """Return the line of an arc, and its points by definition.

    G3 turns the first axis of the plane towards the second.
    """
    i, j = PLANES[plane]
    across = 3 - i - j
    centre = list(start)
    centre[i] -= radius * math.cos(first)
    centre[j] -= radius * math.sin(first)
    way = []
    for k in range(STEPS + 1):
        point = list(centre)
        angle = first + sweep * k / STEPS
        point[i] += radius * math.cos(angle)
        point[j] += radius * math.sin(angle)
        point[across] = start[across] + rise * k / STEPS
        way.append((point[0], point[1], point[2]))
    end = way[0] if abs(sweep) == math.tau else way[-1]
    words = [f"{'XYZ'[k]}{end[k] if k != across else way[-1][k]:.6f}" for k in range(3)]
    centres = [f"{'IJK'[k]}{centre[k] - start[k]:.6f}" for k in (i, j)]
    return " ".join((plane, "G3" if sweep > 0 else "G2", *words, *centres)), way


# StraightMove moves go to a few places, so that ways cross and go back over themselves.
STRAIGHT = st.tuples(*[st.integers(-2, 2)] * 3)
ROUND = st.tuples(
    st.sampled_from(list(PLANES)),
    st.sampled_from([0.5, 3.0]),
    st.floats(0, 6),
    st.sampled_from([math.tau, -math.tau, 0.7, -0.7, 3.0, -3.0, 5.5, -5.5]),
    st.sampled_from([0.0, 0.0, 1.0]),
)
PROGRAMS = st.lists(STRAIGHT | ROUND, min_size=1, max_size=12)
Program = list[tuple[int, int, int] | tuple[str, float, float, float, float]]


def meant(program: Program) -> list[tuple[str, list[Point]]]:
    """Return lines with their points, in the board's G54."""
    at: Point = (0.0, 0.0, 0.0)
    lines: list[tuple[str, list[Point]]] = []
    for move in program:
        if len(move) == 5:
            lines.append(arc(at, *move))
        elif move != at:
            x, y, z = move
            parts = [k / STEPS for k in range(STEPS + 1)]
            way = [
                (at[0] + (x - at[0]) * t, at[1] + (y - at[1]) * t, at[2] + (z - at[2]) * t)
                for t in parts
            ]
            lines.append((f"G1 X{x} Y{y} Z{z}", way))
        else:
            continue
        at = lines[-1][1][-1]
    return lines


def machine(point: Point) -> Point:
    x, y, z = (a + b for a, b in zip(point, OFFSET, strict=True))
    return x, y, z


@given(PROGRAMS, st.integers(1, 150), st.integers(0, 2**31))
def test_a_board_on_its_toolpath_is_never_assumed_further(
    program: Program, stride: int, seed: int
) -> None:
    rng = random.Random(seed)
    lines = [("", [(0.0, 0.0, 0.0)]), *meant(program)]
    follower = followed(lines)
    way = [(number, point) for number, (_, points) in enumerate(lines) for point in points]
    for number, (x, y, z) in [*way[::stride], way[-1]]:
        a, b, c = (rng.uniform(-0.5, 0.5) * TOLERANCE for _ in range(3))
        assert follower.off(machine((x + a, y + b, z + c)), 0) == 0.0
        at_its_end = math.dist((x, y, z), lines[number][1][-1]) <= 2 * TOLERANCE
        assert not follower.lines or follower.line <= max(number, 1) or at_its_end
    assert follower.arrived(machine(way[-1][1])) == 0.0
    assert follower.seconds == pytest.approx(0.0, abs=1e-6)


@given(PROGRAMS, st.floats(0.5, 3.0), st.floats(0, math.tau), st.floats(0, math.pi))
def test_the_distance_from_the_toolpath_is_correct(
    program: Program, far: float, a: float, b: float
) -> None:
    lines = [("", [(0.0, 0.0, 0.0)]), *meant(program)]
    x, y, z = lines[-1][1][-1]
    lost = (
        x + far * math.cos(a) * math.sin(b),
        y + far * math.sin(a) * math.sin(b),
        z + far * math.cos(b),
    )
    nearest = min(math.dist(lost, point) for _, points in lines for point in points)
    # here the way is known in steps of some hundredths of it
    assert followed(lines).off(machine(lost), 0) == pytest.approx(nearest, abs=0.2)


def sent(follower: PositionTracker, lines: Iterable[GcodeLine]) -> None:
    """Send lines one, two or three at a time, as there is space on a board."""
    for group in groups_of(PackedLines.of(list(lines))):
        follower.prepare(group.rows)
        left, count = len(group), 1
        while left:
            follower.send(min(count, left))
            left, count = left - min(count, left), count % 3 + 1


def followed(lines: list[tuple[str, list[Point]]]) -> PositionTracker:
    follower = PositionTracker(PLANNER, OFFSET, TOLERANCE)
    follower.begin(machine((0.0, 0.0, 0.0)))
    sent(follower, lines_with_effects((f"{text} F600" for text, _ in lines), first=0))
    return follower


@pytest.mark.parametrize(
    ("lines", "seconds"),
    [
        # v = 10 mm/s, a = 20 mm/s^2: from rest to rest 10 mm take 10 / v + v / a
        (["G1 X10 F600"], 1.5),
        # straight on there is no stop between, at a corner there is
        (["G1 X10 F600", "X20"], 2.5),
        (["G1 X10 F600", "Y10"], 3.0),
        # too short for the speed: 2 sqrt(d / a)
        (["G1 X0.8 F600"], 0.4),
        # a traverse is as fast as its axes: 20 mm/s and 40 mm/s^2 along the diagonal of two like
        # axes are each 1 / sqrt 2 of that
        (["G0 X20"], 2.0),
        (["G0 X20 Y20"], 2.0),
        # a quarter of a circle
        (["G1 X10 F600", "G3 X20 Y10 I0 J10"], 1.5 + math.pi / 2),
        (["G4 P100"], 0.0),
    ],
)
def test_the_time_of_the_motion_ahead(lines: list[str], seconds: float) -> None:
    follower = PositionTracker(
        PLANNER, (0.0, 0.0, 0.0), TOLERANCE, AxisLimits((20.0,) * 3, (20.0,) * 3)
    )
    follower.begin((0.0, 0.0, 0.0))
    sent(follower, lines_with_effects(lines, first=0))
    assert follower.seconds == pytest.approx(seconds)


def test_overrides_scale_feeds_and_traverses() -> None:
    follower = PositionTracker(
        PLANNER, (0.0, 0.0, 0.0), TOLERANCE, AxisLimits((20.0,) * 3, (20.0,) * 3)
    )
    follower.begin((0.0, 0.0, 0.0))
    sent(follower, lines_with_effects(["G0 X20", "G1 Y10 F600"], first=0))
    traverse, feed = 2.0, 1.5
    assert follower.seconds_at(100.0, 100.0) == pytest.approx(traverse + feed)
    assert follower.seconds_at(200.0, 25.0) == pytest.approx(4.0 * traverse + 0.5 * feed)
    # at the end of the traverse that is over
    follower.off((20.0, 0.0, 0.0), 0)
    follower.off((20.0, 5.0, 0.0), 0)
    follower.off((20.0, 5.0, 0.0), 0)
    assert follower.seconds_at(50.0, 25.0) == pytest.approx(2.0 * 0.5 * feed)


@pytest.mark.parametrize("line", ["G91", "G1 X1 R2", "G53 G0 X1", "$H", "G20", "X"])
def test_after_an_unknown_line_nothing_is_a_fault(line: str) -> None:
    follower = PositionTracker(PLANNER, (0.0, 0.0, 0.0))
    follower.begin((0.0, 0.0, 0.0))
    reader = LineReader()
    sent(follower, [reader.read("G1 X5 F600", 1)])
    sent(follower, [reader.read(line, 2)])
    assert follower.off((99.0, 0.0, 0.0), 0) == 0.0
    assert follower.arrived((99.0, 0.0, 0.0)) == 0.0
    # The last known place lies before the machine, never ahead of it.
    assert (follower.seconds, follower.line) == (0.0, 1)
    follower.begin((1.0, 0.0, 0.0))
    assert follower.off((2.0, 0.0, 0.0), 0) == 1.0


def test_a_probe_may_end_early_on_its_toolpath() -> None:
    follower = PositionTracker(PLANNER, (0.0, 0.0, 0.0))
    follower.begin((0.0, 0.0, 0.0))
    sent(follower, [LineReader().read("G38.2 Z-10 F100", 1)])
    assert follower.arrived((0.0, 0.0, -4.0)) == 0.0
    assert follower.off((0.0, 0.0, -4.0), 0) == 0.0
    assert follower.off((1.0, 0.0, -4.0), 0) == 1.0
