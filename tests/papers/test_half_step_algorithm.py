"""Half-step deviation: half a BLU at every row, correct counts and ends, against an independent
evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from cnc.kernels.papers.half_step import circle_by_half_steps
from cnc.kernels.papers.point_by_point import circle_by_points, line_by_points
from cnc.kernels.path.curve import curve_range
from cnc.kernels.pulses.grid_moves import Grid, Moves, Piece
from cnc.kernels.pulses.half_step import half_step_rows
from cnc.kernels.pulses.point_by_point import point_by_point_rows
from cnc.model.blocks import ArcFeed, Block, Polyline
from tests.support.pulses.oracle import segments_of
from tests.support.pulses.plans import FILE, arc, at_rest, path_of, polyline
from tests.support.soak import share

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass
class Run:
    """All rows of a path."""

    origin: Ints
    step: NDArray[np.int8]
    reach: Floats
    error: float
    done: list[int]  # rows up to the end of each piece

    @property
    def points(self) -> Ints:
        """Grid points, with the first one."""
        return self.origin + np.concatenate(
            (
                np.zeros((1, len(self.origin)), np.int64),
                np.cumsum(self.step, axis=0, dtype=np.int64),
            )
        )


def run(
    blocks: Sequence[Block],
    start: ArrayLike,
    scale: ArrayLike,
    *,
    room: int = 50_000,
    cuts: Sequence[float] = (),
    origin: Ints | None = None,
    rows_of: Callable[..., Any] = half_step_rows,
) -> Run:
    """Return the rows of the blocks, in buffers of ``room`` rows.

    Each piece is done in parts that end at ``cuts`` (of 1).
    """
    path = path_of(blocks, start)
    scales = np.broadcast_to(np.asarray(scale, np.float64), (len(path.axes),)).copy()
    point = (
        np.rint(np.asarray(start) * scales).astype(np.int64) if origin is None else origin.copy()
    )
    first = point.copy()
    grid = Grid(scales, point)
    moves = Moves(np.empty((room, len(point)), np.int8), np.empty(room))
    steps, reaches, error, s0 = [], [], 0.0, 0.0
    done = []
    for kind, at, length in zip(
        path.kind.tolist(), path.at.tolist(), path.length.tolist(), strict=True
    ):
        piece = Piece(kind, path.data, at, s0)
        u0, u1 = curve_range(kind, path.data, at)
        u = u0
        for part in (*sorted(cuts), 1.0):
            upto = u1 if part == 1.0 else u0 + part * (u1 - u0)
            while u < upto:
                rows, u, off = rows_of(piece, u, upto, grid, 0, moves)
                assert u == upto or rows == room
                error = max(error, off)
                steps.append(moves.step[:rows].copy())
                reaches.append(moves.s[:rows].copy())
        s0 += length
        done.append(sum(map(len, steps)))
    # where the motion rests
    rows, off = at_rest(path, s0 - length, grid, moves)
    steps.append(moves.step[:rows].copy())
    reaches.append(moves.s[:rows].copy())
    done[-1] += rows
    error = max(error, off)
    return Run(first, np.concatenate(steps), np.concatenate(reaches), error, done)


def check(
    blocks: Sequence[Block],
    start: ArrayLike,
    scale: ArrayLike,
    rows_of: Callable[..., Any] = half_step_rows,
    lag: float = 1.5,
) -> Run:
    """Check the rows of a path: half a BLU in each axis at each row, at most ``lag`` between rows,
    so that no row is missing. With half-step deviation the leader is a step behind before its row,
    the others half a step more.
    """
    origin = np.asarray(start, np.float64)
    scales = np.broadcast_to(np.asarray(scale, np.float64), origin.shape)
    rows = run(blocks, start, scales, rows_of=rows_of)
    points = rows.points
    assert (np.abs(rows.step) <= 1).all() and rows.step.any(axis=1).all()
    assert (np.diff(rows.reach) >= 0.0).all()
    close = 1e-8 + 2e-15 * float(np.abs(points).max())
    assert rows.error <= 0.5 + close
    s0, first = 0.0, 0
    segments = segments_of(blocks, origin)
    # lines are pieces, an arc is one a turn
    for segment, last in zip(
        segments, rows.done if len(segments) > 1 else rows.done[-1:], strict=True
    ):
        length = segment.length(1.0)
        w = _places(segment.length, (rows.reach[first:last] - s0), length)
        assert (w <= 1.0 + 1e-9).all() and (w >= -1e-9).all()
        off = np.abs(points[first + 1 : last + 1] - segment.q(w) * scales)
        assert off.max(initial=0.0) <= 0.5 + close
        before = np.abs(points[first:last] - segment.q(w) * scales)
        assert before.max(initial=0.0) <= lag + 1e-6
        dense = np.linspace(0.0, 1.0, 500)
        held = first + np.searchsorted(w, dense + 1e-12, side="right")
        assert np.abs(points[held] - segment.q(dense) * scales).max() <= lag + 1e-6
        s0, first = s0 + length, last
    assert first == len(rows.step)
    assert (np.abs(points[-1] - segments[-1].q(np.array(1.0)) * scales) <= 0.5 + close).all()
    return rows


def _places(length: Callable[[float], float], s: Floats, whole: float) -> Floats:
    """Return w of the arc lengths, by Newton's method where the length is no multiple of w."""
    if abs(length(0.3) - 0.3 * whole) < 1e-13 * whole:
        return s / whole
    w = s / whole
    table = np.linspace(0.0, 1.0, 65)
    lengths = np.array([length(float(x)) for x in table])
    chebyshev = np.polynomial.Chebyshev.fit(table, lengths, 30)
    slope = chebyshev.deriv()
    for _ in range(5):
        w = w - (chebyshev(w) - s) / slope(w)
    return np.asarray(w)


EXPONENT = st.floats(-3.0, 3.0)


def scales_for(draw: st.DrawFn, axes: int, size: float, most: float) -> Floats:
    """Draw steps/mm from 1 to 10 000 (BLU 1 mm to 1e-4 mm), so that ``size`` mm are at most
    ``most`` steps.
    """
    high = min(10_000.0, most / size)
    low = min(1.0, high)
    exponents = [draw(st.floats(math.log10(low), math.log10(high))) for _ in range(axes)]
    return np.array([round(10.0**e, 3) or 0.001 for e in exponents])


@st.composite
def lines(draw: st.DrawFn) -> tuple[list[Polyline], Floats, Floats]:
    """Draw polylines with moves of 1 um to 1 m, with ends on and off the grid."""
    axes = draw(st.integers(1, 5))
    size = 10.0 ** draw(EXPONENT)
    scale = scales_for(draw, axes, size, 3000.0)
    digits = draw(st.sampled_from([2, 3, 5, 15]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points = np.round(rng.uniform(-size, size, (draw(st.integers(2, 5)), axes)), digits)
    if draw(st.booleans()):
        points = np.rint(points * scale) / scale
    if draw(st.booleans()):
        points[:, : rng.integers(axes) + 1] = np.rint(points[:, :1] * scale[0]) / scale[0]
    assume((np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-8).all())
    return [polyline(points[1:])], points[0], scale


@given(lines())
@settings(max_examples=share(3000, 75), deadline=None)
def test_lines(case: tuple[list[Polyline], Floats, Floats]) -> None:
    blocks, start, scale = case
    ends = np.vstack((start, blocks[0].points))
    rows = check(blocks, start, scale)
    travel = np.abs(np.diff(ends * scale, axis=0)).max(axis=1)
    # where a line's ends are off the grid a row is needed before the first and after the last that
    # the leader makes
    axes = len(start)
    assert len(rows.step) <= (np.floor(travel + 1.0) + 1 + axes).sum()


@st.composite
def arcs(draw: st.DrawFn) -> tuple[list[ArcFeed], Floats, Floats]:
    """Draw arcs in both directions, of up to 2.3 turns, helices and spirals, with centre, radius
    and ends off the grid.
    """
    axes = draw(st.integers(2, 4))
    radius = 10.0 ** draw(EXPONENT)
    scale = scales_for(draw, axes, radius, 400.0)
    if draw(st.booleans()):
        scale[1] = scale[0]
    if draw(st.booleans()):
        radius = max(float(np.rint(radius * scale[0])), 1.0) / scale[0]
    angle = draw(st.floats(0.0, 2 * math.pi))
    center = (draw(st.floats(-2, 2)) * radius, draw(st.floats(-2, 2)) * radius)
    if draw(st.booleans()):
        center = (round(center[0] * scale[0]) / scale[0], round(center[1] * scale[1]) / scale[1])
        angle = draw(st.integers(0, 7)) * math.pi / 4
    start = np.zeros(axes)
    start[:2] = center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle)
    turns = draw(st.floats(0.01, 2.3)) * draw(st.sampled_from([1, -1]))
    block = arc(start, center, turns, rise=draw(st.sampled_from([0.0, 0.1, 3.0, 50.0])) * radius)
    growth = 1.0 + draw(st.sampled_from([0.0, 0.0, 1e-4, -1e-3, 0.2, -0.5]))
    end = block.end.copy()
    end[:2] = np.asarray(center) + growth * (end[:2] - center)
    if axes > 3:
        end[3] = draw(st.floats(-3, 3)) * radius
    return [ArcFeed(FILE, 1, "XY", center, end, radius, turns, 10.0)], start, scale


@given(arcs())
@settings(max_examples=share(2000, 50), deadline=None)
def test_arcs(case: tuple[list[ArcFeed], Floats, Floats]) -> None:
    check(*case)


@given(
    st.floats(1.0, 3.0),
    st.floats(3.0, 4.0),
    st.floats(0.0, 2 * math.pi),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 1e-7]),
)
@settings(max_examples=share(300, 15), deadline=None)
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


def circle(radius: float, turns: float = 1.0) -> tuple[list[ArcFeed], Floats]:
    start = np.array([radius, 0.0])
    return [arc(start, (0.0, 0.0), turns)], start


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
@settings(max_examples=share(500, 36), deadline=None)
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
@settings(max_examples=share(600, 36), deadline=None)
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
@settings(max_examples=share(1000, 36), deadline=None)
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
@settings(max_examples=share(300, 24), deadline=None)
def test_lines_by_points(xe: int, ye: int) -> None:
    steps = np.empty((100, 2), np.int8)
    count = line_by_points(xe, ye, steps)
    walked = np.vstack(([0, 0], np.cumsum(steps[:count], axis=0, dtype=np.int64)))
    assert count == abs(xe) + abs(ye) and walked[-1].tolist() == [xe, ye]
    distance = np.abs(xe * walked[:, 1] - ye * walked[:, 0]) / max(math.hypot(xe, ye), 1.0)
    assert distance.max() <= 1.0
