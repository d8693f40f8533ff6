"""Half-step deviation: half a BLU at every row, correct counts and ends, against an independent
evaluation.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cnc.model.blocks import ArcFeed, Block, Polyline
from cnc.papers.kernels.half_step import circle_by_half_steps, circle_by_points, line_by_points
from cnc.pulses.kernels.crossings import point_by_point_rows
from tests.support.papers.half_step import (
    Floats,
    arcs,
    check,
    circle,
    lines,
    run,
)
from tests.support.pulses.plans import FILE, arc, polyline
from tests.support.soak import share


@given(lines())
@settings(max_examples=share(3000, 20), deadline=None)
def test_lines(case: tuple[list[Polyline], Floats, Floats]) -> None:
    blocks, start, scale = case
    ends = np.vstack((start, blocks[0].points))
    rows = check(blocks, start, scale)
    travel = np.abs(np.diff(ends * scale, axis=0)).max(axis=1)
    # where a line's ends are off the grid a row is needed before the first and after the last that
    # the leader makes
    axes = len(start)
    assert len(rows.step) <= (np.floor(travel + 1.0) + 1 + axes).sum()


@given(arcs())
@settings(max_examples=share(2000, 14), deadline=None)
def test_arcs(case: tuple[list[ArcFeed], Floats, Floats]) -> None:
    check(*case)


@given(
    st.floats(1.0, 3.0),
    st.floats(3.0, 4.0),
    st.floats(0.0, 2 * math.pi),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 1e-7]),
)
@settings(max_examples=share(300, 8), deadline=None)
def test_arcs_of_ten_million_steps_radius(
    size: float, fine: float, angle: float, way: int, growth: float
) -> None:
    """Radius 10 mm to 1 m at a BLU of 1 to 0.1 um, a few thousand rows: within half a BLU."""
    radius, scale = 10.0**size, round(10.0**fine, 3)
    start = np.array([radius * math.cos(angle), radius * math.sin(angle), 0.3])
    block = arc(start, (0.0, 0.0), way * min(600.0 / (radius * scale), 1.0), rise=0.01)
    end = block.end * [1.0 + growth, 1.0 + growth, 1.0]
    check(
        [ArcFeed(FILE, 1, "XY", (0.0, 0.0), end, radius, block.turns, 10.0)],
        start,
        [scale, 0.7 * scale, scale],
    )


@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_the_circle_of_the_paper(turns: float) -> None:
    rows = check(*circle(10.0, turns), 1.0)
    radii = np.hypot(*rows.points.T)
    assert len(rows.step) == 56
    assert (radii.min(), radii.max()) == (
        pytest.approx(9.849, abs=1e-3),
        pytest.approx(10.440, abs=1e-3),
    )
    assert rows.points[-1].tolist() == [10, 0]


@pytest.mark.parametrize("radius", [1, 2, 3, 5, 7, 12, 29, 50, *range(100, 400, share(7, 60))])
def test_integer_circles(radius: int) -> None:
    """The paper's recursion in integers and the rows of an arc have the same points, except where
    the faster axis changes.
    """
    steps = np.empty((8 * radius + 8, 2), np.int8)
    for turn in (1, -1):
        count = circle_by_half_steps(radius, turn, steps)
        walked = np.array([radius, 0]) + np.cumsum(steps[:count], axis=0, dtype=np.int64)
        assert walked[-1].tolist() == [radius, 0]
        assert np.abs(np.hypot(*walked.T) - radius).max() <= 0.49896
        assert np.abs(steps[:count]).max(axis=1).all()
        rows = run(*circle(float(radius), float(turn)), 1.0)
        off = np.abs(np.hypot(*rows.points.T) - radius)
        assert off.max() <= 0.5
        apart = {*map(tuple, rows.points[1:].tolist())} ^ {*map(tuple, walked.tolist())}
        assert all(abs(abs(x) - abs(y)) <= 2 for x, y in apart)


def test_the_octants_of_the_recursion() -> None:
    """In each octant the recursion takes the nearer of the two points beside the exact circle."""
    radius = 1000
    steps = np.empty((8 * radius, 2), np.int8)
    count = circle_by_half_steps(radius, 1, steps)
    walked = np.array([radius, 0]) + np.cumsum(steps[:count], axis=0, dtype=np.int64)
    small, large = np.sort(np.abs(walked), axis=1).T
    exact = np.sqrt(float(radius) ** 2 - small.astype(np.float64) ** 2)
    np.testing.assert_array_equal(large, np.rint(exact))
    angle = np.unwrap(np.arctan2(walked[:, 1], walked[:, 0]))
    assert (np.diff(angle) > 0.0).all() and angle[-1] == pytest.approx(2 * math.pi, abs=1e-9)


@given(st.integers(-40, 40), st.integers(-40, 40))
@settings(max_examples=share(500, 10), deadline=None)
def test_integer_lines(xe: int, ye: int) -> None:
    """The paper's line from equation 1: the smaller |F| of the two candidates, on a tie the longer
    axis alone.
    """
    if xe == 0 and ye == 0:
        return
    rows = run([polyline([[float(xe), float(ye)]])], [0.0, 0.0], 1.0)
    assert len(rows.step) == max(abs(xe), abs(ye))
    assert rows.error <= 0.5
    x, y = 0, 0
    for step in rows.step.tolist():
        sx, sy = int(np.sign(xe)), int(np.sign(ye))
        single = (sx, 0) if abs(xe) >= abs(ye) else (0, sy)
        both = (sx, sy)
        deviation = [abs(xe * (y + dy) - (x + dx) * ye) for dx, dy in (single, both)]
        chosen = single if deviation[0] <= deviation[1] else both
        assert tuple(step) == chosen
        x, y = x + chosen[0], y + chosen[1]
    assert (x, y) == (xe, ye)


def test_integers_far_out() -> None:
    """Millions of steps are within half a BLU, from the first to the last."""
    count = share(9_999_991, 499_991)
    ends = (count, count * 3 // 4 - 7, -count // 2 + 0.5)
    rows = run([polyline([ends])], np.zeros(3), 1.0)
    assert len(rows.step) == count
    assert rows.error <= 0.5
    x = rows.points[1:, 0]
    for axis in (1, 2):
        assert np.abs(rows.points[1:, axis] - x * (ends[axis] / count)).max() <= 0.5 + 1e-8


@pytest.mark.parametrize("noise", [0.0, 1e-13, -1e-13])
def test_ties_are_quiet(noise: float) -> None:
    blocks = [polyline([[0.1 * k, 0.005 + noise * (-1) ** k] for k in range(1, 9)])]
    rows = run(blocks, [0.0, 0.005], 100.0)
    assert not rows.step[:, 1].any()
    back = run([polyline([[0.005], [0.0], [-0.005], [0.0]])], [0.0], 100.0)
    assert len(back.step) == 0
    top = run([arc([0.005, 0.0], (0.0, 0.0), 1.0)], [0.005, 0.0], 100.0)
    assert not top.step[:, 1].any()


@given(st.one_of(lines(), arcs()), st.integers(1, 9), st.lists(st.floats(0.01, 0.99), max_size=6))
@settings(max_examples=share(600, 10), deadline=None)
def test_the_same_rows_in_any_buffers_and_parts(
    case: tuple[list[Block], Floats, Floats], room: int, cuts: list[float]
) -> None:
    blocks, start, scale = case
    radius = getattr(blocks[0], "radius", math.inf)
    # where a circle is a few steps round, whether it needs one more may depend on where it is cut
    assume(radius * scale.max() > 30.0)
    whole = run(blocks, start, scale)
    small = run(blocks, start, scale, room=room)
    np.testing.assert_array_equal(small.step, whole.step)
    np.testing.assert_allclose(small.reach, whole.reach, atol=1e-9)
    parts = run(blocks, start, scale, cuts=sorted({*cuts}))
    np.testing.assert_array_equal(parts.step, whole.step)
    np.testing.assert_allclose(parts.reach, whole.reach, atol=1e-9)


def test_a_grid_point_a_whole_step_behind_is_set_right_at_once() -> None:
    origin = np.array([1, -1])
    rows = run([polyline([[3.0, 10.0]])], [0.0, 0.0], 1.0, origin=origin)
    assert rows.step[0].tolist() == [-1, 1] and rows.reach[0] == 0.0
    assert rows.points[-1].tolist() == [3, 10]
    rows = run(circle(10.0)[0], [10.0, 0.0], 1.0, origin=np.array([11, 0]))
    assert rows.step[0].tolist() == [-1, 0]
    assert rows.points[-1].tolist() == [10, 0]


@given(st.one_of(lines(), arcs()))
@settings(max_examples=share(1000, 10), deadline=None)
def test_point_by_point(case: tuple[list[Block], Floats, Floats]) -> None:
    """Each row steps one axis, within half a BLU at all times, and the rows are as many as the
    steps of the axes.
    """
    blocks, start, scale = case
    rows = check(blocks, start, scale, point_by_point_rows, lag=0.5 + 1e-3)
    assert (np.abs(rows.step).sum(axis=1) == 1).all()


@pytest.mark.parametrize("room", [1, 2, 5])
def test_point_by_point_in_small_buffers(room: int) -> None:
    """Steps of one time are in different buffers."""
    blocks = [polyline([[10.0, 10.0, -10.0], [4.0, 7.0, 2.0]])]
    whole = run(blocks, np.zeros(3), 1.0, rows_of=point_by_point_rows)
    small = run(blocks, np.zeros(3), 1.0, room=room, rows_of=point_by_point_rows)
    assert len(whole.step) == len(small.step) == 30 + 6 + 3 + 12
    np.testing.assert_allclose(small.reach, whole.reach, atol=1e-8)
    assert small.points[-1].tolist() == [4, 7, 2]
    assert (np.diff(small.reach) >= 0.0).all()


@pytest.mark.parametrize("turn", [1, -1])
def test_point_by_point_as_the_paper_has_it(turn: int) -> None:
    steps = np.empty((200, 2), np.int8)
    for inward, low, high in ((False, 9.055, 10.817), (True, 9.0, 10.770)):
        count = circle_by_points(10, turn, inward, steps)
        walked = np.array([10, 0]) + np.cumsum(steps[:count], axis=0, dtype=np.int64)
        assert count == 80 and walked[-1].tolist() == [10, 0]
        radii = np.hypot(*walked.T)
        assert (radii.min(), radii.max()) == (
            pytest.approx(low, abs=1e-3),
            pytest.approx(high, abs=1e-3),
        )
    moved = run(*circle(10.0, float(turn)), 1.0, rows_of=point_by_point_rows)
    assert len(moved.step) == 80


@given(st.integers(-30, 30), st.integers(-30, 30))
@settings(max_examples=share(300, 7), deadline=None)
def test_lines_by_points(xe: int, ye: int) -> None:
    steps = np.empty((100, 2), np.int8)
    count = line_by_points(xe, ye, steps)
    walked = np.vstack(([0, 0], np.cumsum(steps[:count], axis=0, dtype=np.int64)))
    assert count == abs(xe) + abs(ye) and walked[-1].tolist() == [xe, ye]
    distance = np.abs(xe * walked[:, 1] - ye * walked[:, 0]) / max(math.hypot(xe, ye), 1.0)
    assert distance.max() <= 1.0
