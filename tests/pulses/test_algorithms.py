"""Paths by every algorithm: each row is within half a BLU of the path at its own time, for all
kinds of pieces.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from cnc.model.blocks import Block, NurbsFeed
from cnc.model.choices import Algorithm
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses import reference_pulse
from cnc.pulses.reference_pulse import ALGORITHMS, ReferencePulse
from tests.support.pulses.oracle import segments_of
from tests.support.pulses.plans import (
    FILE,
    arc,
    at_constant_speed,
    cut,
    path_of,
    pieces,
    plan_of,
    polyline,
    state_at,
    trident,
)
from tests.support.soak import share

Floats = NDArray[np.float64]
EVERY = pytest.mark.parametrize("algorithm", [None, *ALGORITHMS])
UNCUT = pytest.mark.parametrize(
    "algorithm", [None, "enclosing-line", "crossings", "point-by-point"]
)
"""Their rows follow from path and grid point alone; the shortest normal is looked for from the
place of the search before, or a cut.
"""


def run(
    plans: Sequence[PlanChunk],
    scale: ArrayLike,
    start: ArrayLike,
    algorithm: Algorithm | None,
    min_ns: float = 0.0,
) -> tuple[PulseChunk, ReferencePulse]:
    """Return all rows in one array, with the last move to the rounded end."""
    interpolator = ReferencePulse(scale, start, min_ns, algorithm=algorithm)
    chunks = [c for plan in plans for c in interpolator.pulses(plan)]
    axes = len(interpolator.origin_steps)
    return PulseChunk(
        np.concatenate([np.empty(0, np.int64), *(c.time_ns for c in chunks)]),
        np.concatenate([np.empty((0, axes), np.int8), *(c.step for c in chunks)]),
        np.concatenate([np.empty(0, np.int32), *(c.line for c in chunks)]),
    ), interpolator


def check(
    blocks: Sequence[Block],
    start: ArrayLike,
    steps_per_mm: ArrayLike,
    algorithm: Algorithm | None,
    *,
    looked_at: int = 150,
) -> PulseChunk:
    """Check the rows of a plan from rest to rest, some of them against an independent evaluation of
    the path.
    """
    origin = np.asarray(start, dtype=np.float64)
    scale = np.array(np.broadcast_to(np.asarray(steps_per_mm, dtype=np.float64), origin.shape))
    path = path_of(blocks, origin)
    plan = plan_of(path)
    rows, interpolator = run([plan], scale, origin, algorithm)
    segments = segments_of(blocks, origin)
    assert (np.abs(rows.step) <= 1).all()
    assert rows.step.any(axis=1).all()
    assert (np.diff(rows.time_ns) >= 0).all()
    assert interpolator.error_blu <= 0.5 + 1e-8
    grid = interpolator.origin_steps + np.cumsum(
        np.vstack((0 * interpolator.origin_steps, rows.step)), axis=0, dtype=np.int64
    )
    np.testing.assert_array_equal(grid[-1], interpolator.position_steps)
    assert (np.abs(grid[-1] - segments[-1].q(np.array(1.0)) * scale) <= 0.5 + 1e-8).all()

    before = np.concatenate(([0.0], np.cumsum([segment.length(1.0) for segment in segments])))
    t = rows.time_ns * 1e-9
    s, v, _ = state_at(plan, np.minimum(t, plan.duration))
    for row in np.unique(np.linspace(0, len(t) - 1, looked_at).astype(int)) if len(t) else ():
        number = min(
            max(int(np.searchsorted(before, s[row], side="right")) - 1, 0), len(segments) - 1
        )
        segment, along = segments[number], float(s[row] - before[number])
        length = before[number + 1] - before[number]
        w = (
            0.0
            if along <= 0.0
            else 1.0
            if along >= length
            else brentq(lambda x, q=segment, y=along: q.length(x) - y, 0.0, 1.0, xtol=1e-14)
        )
        off = np.abs(segment.q(np.array(w)) * scale - grid[row + 1])
        # what an axis goes in the nanosecond to which times are rounded; one that turns may be
        # faster than the path is long
        a, b = max(w - 1e-6, 0.0), min(w + 1e-6, 1.0)
        rate = (
            np.abs(segment.q(np.array(b)) - segment.q(np.array(a)))
            * scale
            / max(segment.length(b) - segment.length(a), 1e-12)
        )
        assert (off <= 0.5 + 1e-6 + v[row] * 1e-9 * rate).all()
    return rows


def random_nurbs(rng: np.random.Generator, start: Floats, degree: int) -> NurbsFeed:
    """Return a rational curve of a degree, from ``start`` on."""
    points = degree + 1 + int(rng.integers(0, 5))
    inner = np.sort(rng.uniform(0.1, 0.9, points - degree - 1))
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    control = np.vstack((start, start + rng.uniform(-1.0, 1.0, (points - 1, len(start)))))
    return NurbsFeed(FILE, 1, degree, knots, control, rng.uniform(0.1, 10.0, points), 10.0)


def random_path(rng: np.random.Generator, axes: int) -> tuple[Floats, list[Block]]:
    """Return lines, arcs and curves, with ends on the grid and off it."""
    start = rng.uniform(-1, 1, axes).round(int(rng.integers(1, 6)))
    p = start
    blocks: list[Block] = []
    for number in range(1, 4):
        match rng.integers(3):
            case 0:
                size = float(rng.choice([0.005, 0.05, 0.5]))
                points = p + np.cumsum(
                    rng.uniform(-size, size, (4, axes)).round(int(rng.integers(2, 5))), axis=0
                )
                blocks.append(polyline(points, line=10 * number))
                p = points[-1]
            case 1:
                center = tuple(float(c) for c in p[:2] + rng.uniform(-0.5, 0.5, 2))
                turns = float(rng.choice([rng.uniform(-1.2, 1.2), 0.5, -1.0]))
                block = arc(p, center, turns, rise=float(rng.uniform(-0.3, 0.3)), line=10 * number)  # type: ignore[arg-type]
                blocks.append(block)
                p = block.end
            case _:
                spline = random_nurbs(rng, p, int(rng.integers(1, 6)))
                blocks.append(spline)
                p = spline.control_points[-1]
    return start, blocks


@EVERY
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(300, 1), deadline=None)
def test_any_path(algorithm: Algorithm | None, seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = int(rng.integers(2, 5))
    start, blocks = random_path(rng, axes)
    check(
        blocks, start, rng.choice([40.0, 50.0, 80.0, 100.0, 333.3], axes), algorithm, looked_at=40
    )


def steps(
    blocks: Sequence[Block], start: ArrayLike, algorithm: Algorithm | None
) -> list[list[int]]:
    """Return the rows at 100 steps/mm."""
    origin = np.asarray(start, dtype=np.float64)
    rows, _ = run(
        [plan_of(path_of(blocks, origin))], np.full(len(origin), 100.0), origin, algorithm
    )
    return [[int(each) for each in row] for row in rows.step]


def test_each_piece_has_its_algorithm() -> None:
    """Lines and arcs use half steps, other curves enclosing lines.

    A named algorithm is used for every piece.
    """
    rng = np.random.default_rng(3)
    flat, space = np.zeros(2), np.zeros(3)
    # the circle of the paper: 56 steps by half steps, 80 by comparing point by point
    circle = [arc([0.1, 0.0], (0.0, 0.0), 1.0)]
    for algorithm, rows in ((None, 56), ("half-step", 56), ("point-by-point", 80)):
        assert len(steps(circle, [0.1, 0.0], algorithm)) == rows
    line = [polyline([[0.3, 0.1, -0.2]])]
    assert len(steps(line, space, None)) == 30 < len(steps(line, space, "crossings"))
    for start in (flat, space):
        curve = [random_nurbs(rng, start, 3)]
        assert (
            steps(curve, start, None)
            == steps(curve, start, "half-step")
            == steps(curve, start, "enclosing-line")
        )
        assert len({str(steps(curve, start, algorithm)) for algorithm in (None, "crossings")}) == 2
    assert steps([polyline([[0.3]])], np.zeros(1), "enclosing-line") == [[1]] * 30


def test_a_leader_steps_evenly_across_the_joints_of_its_path() -> None:
    """The chords end off the grid, and the leading axis has constant speed: no step is early or
    late.
    """
    x = np.cumsum(np.full(50, 0.0377))
    points = np.stack((x, 0.3 * np.sin(x), 0.1 * x), axis=1)
    for k in range(1, len(points)):
        points[k, 1] = points[k - 1, 1] + (points[k, 1] - points[k - 1, 1])
    path = path_of([polyline(points)], np.zeros(3))
    length = np.asarray(path.length)
    speed = length / np.diff(np.concatenate(([0.0], x)))
    ends = np.concatenate(([0.0], np.cumsum(length)))
    t = np.concatenate(([0.0], x))
    plan = PlanChunk(
        path,
        ends,
        0.0,
        0.0,
        t,
        ends,
        np.append(speed, speed[-1]),
        np.zeros(len(t)),
        np.zeros(len(x)),
    )
    rows, _ = run([plan], np.full(3, 100.0), np.zeros(3), None)
    np.testing.assert_allclose(rows.time_ns, 1e7 * np.arange(1, 189), atol=1.0)
    assert (rows.step[:, 0] == 1).all()


def test_rest_is_on_the_rounded_point() -> None:
    """At rest the grid point is the nearest one.

    Where the motion continues, no extra step is made.
    """
    corner = path_of([polyline([[0.0377, 0.0], [0.0377, 0.05]])], [0.0, 0.0])
    first, second = (pieces(corner, k, k) for k in (0, 1))
    whole, _ = run([plan_of(first), plan_of(second, t0=9.0)], [100.0] * 2, [0.0, 0.0], None)
    assert whole.step.tolist() == [[1, 0]] * 4 + [[0, 1]] * 5
    at_once, _ = run([at_constant_speed(corner, 10.0)], [100.0] * 2, [0.0, 0.0], None)
    assert at_once.step.tolist() == [[1, 0]] * 3 + [[1, 1]] + [[0, 1]] * 4


def test_a_step_left_behind_is_made_before_it_is_two() -> None:
    """The second axis lags by 1.4 steps at the end of the first line, and leads on the second."""
    path = path_of([polyline([[0.9, 0.84], [1.0, 2.0]])], [0.0, 0.0])
    rows, _ = run([at_constant_speed(path, 1.0)], [1.0] * 2, [0.0, 0.0], None)
    grid = np.cumsum(rows.step, axis=0)
    assert grid[-1].tolist() == [1, 2]
    assert len(grid) == 2


@UNCUT
def test_a_chunk_may_be_cut_anywhere(algorithm: Algorithm | None) -> None:
    start = np.array([10.0, 10.0])
    blocks = [
        trident(),
        polyline([[10.5, 0.3], [10.7, -1.0]], line=5),
        arc([10.7, -1.0], (11.7, -1.2), -0.8, line=7),
    ]
    plan = plan_of(path_of(blocks, start), t0=3.25)
    whole, first = run([plan], [100.0, 100.0], start, algorithm)
    rng = np.random.default_rng(5)
    for count in (1, 3, 40, 400):
        rows, second = run(
            cut(plan, list(rng.uniform(0.0, plan.duration, count))),
            [100.0, 100.0],
            start,
            algorithm,
        )
        np.testing.assert_array_equal(rows.step, whole.step)
        np.testing.assert_array_equal(rows.line, whole.line)
        assert np.abs(rows.time_ns - whole.time_ns).max() <= 3000  # at the stop 1e-14 mm is as much
        slow = 20
        assert np.abs(rows.time_ns - whole.time_ns)[slow:-slow].max() <= 1
        assert first.position_steps.tolist() == second.position_steps.tolist()


@UNCUT
def test_a_buffer_smaller_than_the_rows(
    algorithm: Algorithm | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = np.array([10.0, 10.0])
    blocks = [
        trident(),
        polyline([[10.0, 0.5], [10.3, 0.8]], line=5),
        arc([10.3, 0.8], (10.3, 1.0), 1.4, line=6),
    ]
    plan = plan_of(path_of(blocks, start))
    whole, _ = run([plan], [50.0, 40.0], start, algorithm)
    for rows_at_once in (1, 7, len(whole.step), len(whole.step) + 1):
        monkeypatch.setattr(reference_pulse, "ROWS", rows_at_once)
        rows, _ = run([plan], [50.0, 40.0], start, algorithm)
        np.testing.assert_array_equal(rows.step, whole.step)
        np.testing.assert_array_equal(rows.line, whole.line)
        assert np.abs(rows.time_ns - whole.time_ns).max() <= 3000


@EVERY
@pytest.mark.parametrize("seed", range(share(60, 2)))
def test_rows_are_never_nearer_than_the_board_takes_them(
    algorithm: Algorithm | None, seed: int
) -> None:
    """Short moves off the grid run at the highest speed that the board allows on one axis."""
    rng = np.random.default_rng(seed)
    start, blocks = random_path(rng, 3)
    min_ns = 20_000.0
    path = path_of(blocks, start)
    plan = at_constant_speed(path, 1e9 / min_ns / 100.0)
    bare, _ = run([plan], [100.0] * 3, start, algorithm)
    rows, interpolator = run([plan], [100.0] * 3, start, algorithm, min_ns)
    assert (np.diff(rows.time_ns) >= min_ns - 1).all()
    # but for grazes the same steps of each axis in the same order, none earlier, and none later
    # than some rows' time
    same = [column[column != 0].tolist() for column in rows.step.T] == [
        column[column != 0].tolist() for column in bare.step.T
    ]
    if same:
        for axis in range(3):
            late = rows.time_ns[rows.step[:, axis] != 0] - bare.time_ns[bare.step[:, axis] != 0]
            assert (late >= 0).all()
            assert (late <= 4 * min_ns).all()
    # the motion has not come to rest
    end = np.asarray(segments_of(blocks, start)[-1].q(np.array(1.0))) * 100.0
    assert (np.abs(interpolator.position_steps - end) <= 1.5).all()
    (last,) = list(interpolator.settle()) or [None]
    assert last is None or last.time_ns[0] - rows.time_ns[-1] >= min_ns - 1
    assert (np.abs(interpolator.position_steps - end) <= 0.5 + 1e-8).all()


def test_times_are_exact_after_hours() -> None:
    path = path_of([polyline([[1.0, 0.3]])], [0.0, 0.0])
    early, _ = run([plan_of(path)], [100.0, 100.0], [0.0, 0.0], "half-step")
    late, _ = run([plan_of(path, t0=1e6)], [100.0, 100.0], [0.0, 0.0], "half-step")
    assert (late.time_ns - early.time_ns == 10**15).all()


def test_half_steps_fall_due_on_the_grid() -> None:
    rows, _ = run(
        [at_constant_speed(path_of([polyline([[10.0, 3.3]])], [0.0, 0.0]), 20.0)],
        [100.0, 100.0],
        [0.0, 0.0],
        "half-step",
    )
    length = np.hypot(10.0, 3.3)
    np.testing.assert_array_equal(
        rows.time_ns, np.rint(np.arange(1, 1001) * length / 1000 / 20.0 * 1e9)
    )
    np.testing.assert_array_equal(
        np.cumsum(rows.step[:, 1]), np.rint(np.arange(1, 1001) * 0.33 - 1e-9)
    )
