"""Samples: on the path at s(t), without drift or noise, independent of cuts of the plan, at rest
between chunks.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from cnc.model.blocks import NurbsFeed
from cnc.model.streams import SampleChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses import sampled
from cnc.pulses.sampled import Sampled
from tests.support.pulses.oracle import Segment, segments_of
from tests.support.pulses.plans import (
    FILE,
    arc,
    at_constant_speed,
    cut,
    path_of,
    plan_of,
    polyline,
    state_at,
)
from tests.support.soak import share

Floats = NDArray[np.float64]

WAVE = NurbsFeed(
    FILE,
    3,
    3,
    np.array([0, 0, 0, 0, 0.3, 0.5, 0.8, 1, 1, 1, 1]),
    np.array(
        [[10.0, 0, 0], [20, 5, 1], [35, 10, -2], [40, 25, 0], [30, 40, 3], [15, 45, 2], [0, 40, 0]]
    ),
    np.array([1, 2, 1, 0.7, 1, 1.5, 1]),
    50.0,
)
"""A curve without tight bends, 80 mm long."""


def run(
    plans: Sequence[PlanChunk], period: float, start: ArrayLike, end: float | None = None
) -> SampleChunk:
    """Return all rows in one array."""
    interpolator = Sampled(period, start)
    chunks = [c for plan in plans for c in interpolator.samples(plan)]
    chunks += interpolator.finish(plans[-1].t0 + plans[-1].duration if end is None else end)
    for before, after in itertools.pairwise(chunks):
        assert after.first == before.first + len(before.s)
    assert chunks[0].first == 0
    names = ("position", "s", "feed", "accel", "jerk", "step_deviation", "line")
    return SampleChunk(
        0, period, *(np.concatenate([getattr(c, name) for c in chunks]) for name in names)
    )


def place_of(segments: Sequence[Segment], s: float) -> Floats:
    """Return the point at path length s, by quadrature and bisection."""
    for segment in segments:
        length = segment.length(1.0)
        if s <= length or segment is segments[-1]:
            w = (
                1.0
                if s >= length
                else brentq(
                    lambda w, g=segment, s=s: g.length(w) - s, 0.0, 1.0, xtol=1e-15, rtol=1e-14
                )
            )
            return segment.q(np.array(w))
        s -= length
    raise AssertionError


def test_every_row_is_where_and_as_the_plan_says() -> None:
    start = np.array([10.0, 0.0, 0.0])
    blocks = [
        WAVE,
        polyline([[0.0, 38.0, 0.0], [0.5, 36.0, 1.0]], line=5),
        arc([0.5, 36.0, 1.0], (0.5, 33.0), 0.6, rise=2.0, line=7),
    ]
    plan = plan_of(path_of(blocks, start), s0=7.0)
    segments = segments_of(blocks, start)
    rows = run([plan], 1e-3, start)
    t = np.minimum(np.arange(len(rows.s)) * 1e-3, plan.duration)
    assert (len(rows.s) - 1) * 1e-3 >= plan.duration > (len(rows.s) - 2) * 1e-3
    s, v, a = state_at(plan, t)
    np.testing.assert_allclose(rows.s[:-1], 7.0 + s[:-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rows.feed[:-1], v[:-1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(rows.accel[:-1], a[:-1], rtol=0, atol=1e-8)
    phase = np.searchsorted(plan.phase_t, t[:-1], side="right") - 1
    np.testing.assert_array_equal(rows.jerk[:-1], plan.phase_j[phase])
    for k in range(0, len(rows.s), 29):
        np.testing.assert_allclose(
            rows.position[k], place_of(segments, rows.s[k] - 7.0), rtol=0, atol=3e-9
        )
    assert rows.position[-1].tolist() == blocks[-1].end.tolist()  # type: ignore[union-attr]
    assert (rows.feed[-1], rows.accel[-1], rows.jerk[-1]) == (0.0, 0.0, 0.0)
    assert rows.s[-1] == 7.0 + plan.phase_s[-1]
    piece = np.searchsorted(plan.piece_s, s[1:-1], side="left") - 1
    np.testing.assert_array_equal(rows.line[1:-1], plan.path.line[piece])


def noise_of(x: Floats, order: int = 6) -> float:
    """Return the size of independent errors in evenly spaced values of a smooth function, from
    differences of high order.
    """
    gain = np.sqrt(
        np.sum(
            [
                float(np.prod([(order - i) / (i + 1) for i in range(k)])) ** 2
                for k in range(order + 1)
            ]
        )
    )
    return float(np.abs(np.diff(x, order, axis=0)).max() / gain)


def test_third_differences_show_no_noise() -> None:
    """At a period of 0.1 ms, noise of 6e-12 mm is a thousandth of a jerk of 48 000 mm/s^3."""
    start = WAVE.control_points[0]
    path = path_of([WAVE], start)
    # constant speed throughout, so that nothing but the curve is in the differences
    plan = at_constant_speed(path, 100.0)
    rows = run([plan], 1e-4, start)
    ends = np.searchsorted(rows.s, plan.piece_s)
    for first, last in itertools.pairwise(ends):
        assert noise_of(rows.position[first:last]) < 2e-13
    # over the joints too, where the curve is smooth up to the second derivative
    third = np.diff(rows.position, 3, axis=0)
    for joint in ends[1:-1]:
        around = third[joint - 8 : joint + 6] / 1e-12
        assert (
            np.abs(np.diff(around, axis=0)).max()
            < 48.0 + np.abs(np.diff(third[joint - 40 : joint + 40 : 10] / 1e-12, axis=0)).max()
        )


@pytest.mark.parametrize("period", [1e-4, 1e-3, 7e-3])
def test_no_drift_from_s_of_t(period: float) -> None:
    start = WAVE.control_points[0]
    plan = plan_of(path_of([WAVE], start), v=20.0, a=100.0, j=1000.0)
    rows = run([plan], period, start)
    segments = segments_of([WAVE], start)
    for k in np.linspace(1, len(rows.s) - 2, 6).astype(int):
        np.testing.assert_allclose(
            rows.position[k], place_of(segments, rows.s[k]), rtol=0, atol=1e-10
        )


def test_a_chunk_may_be_cut_anywhere() -> None:
    start = WAVE.control_points[0]
    plan = plan_of(path_of([WAVE, polyline([[0.0, 39.0, 0.5]], line=9)], start), t0=2.0)
    whole = run([plan], 1e-3, start)
    rng = np.random.default_rng(1)
    for count in (1, 5, 60):
        parts = run(cut(plan, list(rng.uniform(0, plan.duration, count))), 1e-3, start)
        assert len(parts.s) == len(whole.s)
        np.testing.assert_allclose(parts.position, whole.position, rtol=0, atol=1e-11)
        np.testing.assert_allclose(parts.s, whole.s, rtol=0, atol=1e-12)
        np.testing.assert_allclose(parts.feed, whole.feed, rtol=0, atol=1e-10)
        np.testing.assert_allclose(parts.step_deviation, whole.step_deviation, rtol=0, atol=2e-6)


def test_chunks_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    start = WAVE.control_points[0]
    plan = plan_of(path_of([WAVE], start))
    whole = run([plan], 1e-3, start)
    monkeypatch.setattr(sampled, "ROWS", 10)
    assert max(len(c.s) for c in Sampled(1e-3, start).samples(plan)) == 10
    parts = run([plan], 1e-3, start)
    for name in ("position", "s", "feed", "accel", "jerk", "step_deviation", "line"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_dwells_are_rows_at_rest() -> None:
    first = plan_of(path_of([polyline([[1.0, 0.0]], line=4)], [0.0, 0.0]))
    gap = 0.0505
    second = plan_of(
        path_of([polyline([[1.0, 1.0]], line=6)], [1.0, 0.0]), t0=first.duration + gap, s0=1.0
    )
    end = second.t0 + second.duration
    rows = run([first, second], 1e-3, [0.0, 0.0], end + 0.0101)
    t = np.arange(len(rows.s)) * 1e-3
    rest = (t > first.duration + 1e-9) & (t < second.t0 - 1e-9)
    assert rest.sum() in (50, 51)
    assert (rows.position[rest] == [1.0, 0.0]).all()
    assert (rows.s[rest] == 1.0).all()
    for column in (rows.feed, rows.accel, rows.jerk, rows.step_deviation):
        assert not column[rest].any()
    assert (rows.line[rest] == 4).all()
    assert t[-1] >= end + 0.0101 > t[-2]
    assert (rows.position[t > end] == [1.0, 1.0]).all()
    assert (rows.line[t > end] == 6).all()


def test_an_end_on_a_sample_is_the_last_row() -> None:
    path = path_of([polyline([[1.0]])], [0.0])
    plan = PlanChunk(
        path,
        np.array([0.0, 1.0]),
        0.0,
        0.0,
        np.array([0.0, 0.1]),
        np.array([0.0, 1.0]),
        np.full(2, 10.0),
        np.zeros(2),
        np.zeros(1),
    )
    rows = run([plan], 1e-3, [0.0])
    assert len(rows.s) == 101
    assert rows.position[-1, 0] == 1.0
    np.testing.assert_allclose(np.diff(rows.s), 0.01, rtol=1e-12)


def test_nothing_moves() -> None:
    rows = list(Sampled(1e-3, [1.0, 2.0]).finish(0.0))
    assert len(rows) == 1
    assert rows[0].position.tolist() == [[1.0, 2.0]]
    assert rows[0].feed.tolist() == [0.0]


def test_step_deviation_is_the_bend_of_the_step() -> None:
    """On a circle it is 1 - sin(x) / x, x half the angle of the step.

    On straight lines it is 0, at any corner between them.
    """
    start = np.array([5.0, 0.0])
    path = path_of([arc(start, (0.0, 0.0), 0.9)], start)
    length = float(path.length[0])
    plan = PlanChunk(
        path,
        np.array([0.0, length]),
        0.0,
        0.0,
        np.array([0.0, length / 100.0]),
        np.array([0.0, length]),
        np.full(2, 100.0),
        np.zeros(2),
        np.zeros(1),
    )
    rows = run([plan], 1e-2, start)
    x = 100.0 * 1e-2 / 5.0 / 2
    np.testing.assert_allclose(rows.step_deviation[1:-1], 1 - np.sin(x) / x, rtol=1e-9)
    assert rows.step_deviation[0] == 0.0
    corner = plan_of(path_of([polyline([[1.0, 0.0], [1.0, 1.0], [0.3, 0.2]])], [0.0, 0.0]))
    assert run([corner], 1e-3, [0.0, 0.0]).step_deviation.max() < 1e-7


def test_rotary_axes_alone_are_measured_in_degrees() -> None:
    start = np.zeros(4)
    plan = plan_of(
        path_of([polyline([[0, 0, 0, 30.0], [1.0, 0, 0, 60.0]])], start, axes=("x", "y", "z", "a"))
    )
    rows = run([plan], 1e-3, start)
    assert rows.s[-1] == pytest.approx(31.0)
    assert rows.step_deviation.max() < 1e-7
    assert rows.position[-1].tolist() == [1.0, 0.0, 0.0, 60.0]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(200, 7))
def test_random_curves(seed: int) -> None:
    """Cusps, doubled control points and large ratios of weights: samples are on the path, in order,
    to the exact end.
    """
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 6))
    points = rng.uniform(-5, 5, (degree + 1 + int(rng.integers(0, 3)), 3))
    if len(points) > 2 and rng.random() < 0.3:
        points[1] = points[0]
    inner = np.sort(rng.uniform(0.1, 0.9, len(points) - degree - 1))
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    block = NurbsFeed(FILE, 1, degree, knots, points, rng.uniform(0.1, 10.0, len(points)), 10.0)
    plan = plan_of(path_of([block], points[0]))
    rows = run([plan], float(rng.choice([1e-3, 5e-3])), points[0])
    segments = segments_of([block], points[0])
    for k in rng.integers(1, len(rows.s), 4):
        np.testing.assert_allclose(
            rows.position[k], place_of(segments, rows.s[k]), rtol=0, atol=1e-8
        )
    np.testing.assert_array_equal(rows.position[-1], points[-1])
    assert (np.diff(rows.s) >= 0).all()
