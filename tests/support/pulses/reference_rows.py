"""Rows of reference pulses, and their checks by the oracle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from cnc.model.blocks import Block, NurbsFeed
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ReferencePulse
from tests.support.pulses.oracle import crossings, segments_of
from tests.support.pulses.plans import FILE, path_of, plan_of, state_at

Floats = NDArray[np.float64]


def run(
    plans: Sequence[PlanChunk], steps_per_mm: ArrayLike, start: ArrayLike
) -> tuple[PulseChunk, ReferencePulse]:
    """Return all rows in one array."""
    interpolator = ReferencePulse(steps_per_mm, start, algorithm="crossings")
    chunks = [c for plan in plans for c in interpolator.pulses(plan)]
    axes = len(interpolator.origin_steps)
    whole = PulseChunk(
        np.concatenate([np.empty(0, np.int64), *(c.time_ns for c in chunks)]),
        np.concatenate([np.empty((0, axes), np.int8), *(c.step for c in chunks)]),
        np.concatenate([np.empty(0, np.int32), *(c.line for c in chunks)]),
    )
    return whole, interpolator


def check_rows(rows: PulseChunk, interpolator: ReferencePulse, end: ArrayLike) -> None:
    """Check the pulses of a path that ends at ``end``."""
    assert (np.abs(rows.step) <= 1).all()
    assert rows.step.any(axis=1).all()
    assert (np.diff(rows.time_ns) >= 0).all()
    np.testing.assert_array_equal(
        interpolator.origin_steps + rows.step.sum(axis=0, dtype=np.int64),
        interpolator.position_steps,
    )
    off = np.abs(interpolator.position_steps - np.asarray(end) * interpolator.steps_per_mm)
    assert (off <= 0.5 + 1e-9).all()
    assert interpolator.error_blu <= 0.5 + 1e-9


def check(
    blocks: Sequence[Block],
    start: ArrayLike,
    steps_per_mm: ArrayLike,
    *,
    dense: int = 200,
    plan: PlanChunk | None = None,
) -> PulseChunk:
    """Run the blocks and compare every row with the oracle: steps, order, places, and times of the
    plan.
    """
    origin = np.asarray(start, dtype=np.float64)
    scale = np.broadcast_to(np.asarray(steps_per_mm, dtype=np.float64), origin.shape)
    path = path_of(blocks, origin)
    plan = plan_of(path)
    rows, interpolator = run([plan], scale, origin)
    segments = segments_of(blocks, origin)
    check_rows(rows, interpolator, segments[-1].q(np.array(1.0)))

    expected = crossings(segments, scale, interpolator.origin_steps, dense)
    assert len(expected) == int(np.abs(rows.step).sum())
    before = np.cumsum([0.0] + [s.length(1.0) for s in segments])
    assert before[-1] == pytest.approx(plan.phase_s[-1], rel=1e-9)
    grid = interpolator.origin_steps.copy()
    left = list(expected)
    taken = 0
    for k in range(len(rows.step)):
        moved = np.flatnonzero(rows.step[k])
        group = left[taken : taken + len(moved)]
        taken += len(moved)
        assert sorted((c.axis, c.sign) for c in group) == [(i, rows.step[k, i]) for i in moved]
        grid += rows.step[k]
        place = group[0].place
        number = min(int(place), len(segments) - 1)
        off = np.abs(segments[number].q(np.array(place - number)) * scale - grid)
        assert off.max() <= 0.5 + 1e-7  # the oracle's bisection, and rounding of its own
        if k % max(len(rows.step) // 25, 1) == 0:
            s = before[number] + segments[number].length(place - number)
            check_time(plan, s, int(rows.time_ns[k]))
    return rows


def check_time(plan: PlanChunk, s: float, time_ns: int) -> None:
    """Check that the plan is at s at that time: to 1 ns, and to the accuracy of s where the speed
    is small.
    """

    def miss(t: float) -> float:
        return float(state_at(plan, np.array([t]))[0, 0]) - s

    t = time_ns * 1e-9 - plan.t0
    v = float(state_at(plan, np.array([t]))[1, 0])
    if v > 0.1:
        exact = brentq(miss, 0.0, plan.duration, xtol=1e-15, rtol=1e-15)
        assert abs(time_ns - (plan.t0 + exact) * 1e9) <= 1.0 + 2e9 * 1e-9 / v
    else:
        assert abs(miss(min(max(t, 0.0), plan.duration))) <= 3e-9


def random_nurbs(rng: np.random.Generator, axes: int, degree: int, points: int) -> NurbsFeed:
    inner = np.sort(rng.uniform(0.1, 0.9, points - degree - 1))
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    return NurbsFeed(
        FILE,
        1,
        degree,
        knots,
        rng.uniform(-1.0, 1.0, (points, axes)),
        rng.uniform(0.3, 3.0, points),
        10.0,
    )


def spacing(rows: PulseChunk) -> float:
    """Return the least time between two pulses of one axis, ns."""
    return min(
        float(np.diff(rows.time_ns[rows.step[:, i] != 0]).min(initial=10**18))
        for i in range(rows.step.shape[1])
    )
