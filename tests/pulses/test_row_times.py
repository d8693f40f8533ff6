"""Times of rows, compared with bisection in extended precision, for close rows and for rows far
apart.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.planner.kernels.arrays import PlanArrays
from cnc.pulses.kernels.grid_moves import Moves
from cnc.pulses.kernels.reference_pulse import Buffers, phase_times, spaced
from tests.support.soak import share

WHOLE = 3_600_000_000_000
"""ns: an hour before the phase."""


def bisected(v: float, a: float, j: float, span: float, ds: np.ndarray) -> np.ndarray:
    """Return t with t (v + t (a / 2 + t j / 6)) = ds, in long doubles."""
    v, a, j, ds = (np.asarray(each, np.longdouble) for each in (v, a, j, ds))  # type: ignore[assignment]
    low, high = np.zeros_like(ds), np.full_like(ds, span)
    for _ in range(70):
        t = (low + high) / 2
        short = t * (v + t * (a / 2 + t * j / 6)) < ds
        low, high = np.where(short, t, low), np.where(short, high, t)
    return low


def check_phase(v: float, a: float, j: float, span: float, ds: np.ndarray) -> None:
    reach = 17.0 + ds
    time_ns = np.zeros(len(ds), np.int64)
    plan = PlanArrays(
        np.zeros(2),
        np.array([0.0, span]),
        np.array([17.0, np.nan]),
        np.array([v, np.nan]),
        np.array([a, np.nan]),
        np.array([j]),
    )
    dt, last = phase_times(plan, 0, WHOLE, 0.25, 0.0, 0, 0, len(ds), reach, time_ns)
    assert last == time_ns[-1]
    assert (np.diff(time_ns) >= 0).all()
    exact = bisected(v, a, j, span, reach - 17.0)
    speed = v + exact * (a + exact * j / 2)
    # half a ns of rounding, a tenth of the series, and what the last digits of the coordinates are
    # worth at that speed
    allowed = 0.6 + 1e9 * np.minimum(
        1e-14 / np.maximum(speed, 1e-30),
        np.cbrt(1e-13 / max(abs(j), 1e-6)) + np.sqrt(1e-13 / max(abs(a), 1e-6)),
    )
    assert (np.abs((time_ns - WHOLE - 250_000_000) - exact * 1e9) <= allowed).all()
    assert abs(dt - float(exact[-1])) <= allowed[-1] * 1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(2000, 20), deadline=None)
def test_times_in_a_phase(seed: int) -> None:
    """Any speed, acceleration and jerk without a reversal in the phase, any distance of rows."""
    rng = np.random.default_rng(seed)
    v = 0.0 if rng.random() < 0.2 else 10.0 ** rng.uniform(-2, 3)
    a = 0.0 if rng.random() < 0.2 else float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-2, 4))
    j = 0.0 if rng.random() < 0.2 else float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-2, 6))
    if v == 0.0:
        a, j = abs(a), abs(j)
    if v == a == j == 0.0:
        v = 1.0
    span = 10.0 ** rng.uniform(-4, 1)
    for _ in range(200):
        # slowest at the ends, or where the acceleration changes its sign
        t = np.array([0.0, span, min(max(-a / j, 0.0), span) if j else 0.0])
        if (v + t * (a + t * j / 2) >= 0.0).all():
            break
        span *= 0.8
    length = span * (v + span * (a / 2 + span * j / 6))
    count = int(10.0 ** rng.uniform(0, 3.5))
    check_phase(
        v,
        a,
        j,
        span,
        np.sort(rng.uniform(0.0, length, count))
        if rng.random() < 0.5
        else np.arange(count) * length / count,
    )


@pytest.mark.parametrize(
    ("v", "a", "j", "span"),
    [(100.0, -1500.0, 0.0, 1 / 15), (50.0, 0.0, -40000.0, 0.05), (0.0, 0.0, 40000.0, 0.05)],
)
def test_ramps_to_and_from_rest(v: float, a: float, j: float, span: float) -> None:
    length = span * (v + span * (a / 2 + span * j / 6))
    check_phase(v, a, j, span, np.arange(0.0, length, 0.001))


def buffers_of(times: list[int], steps: list[list[int]]) -> Buffers:
    """Return full buffers of rows at these times, one source line each."""
    step = np.array(steps, np.int8)
    recent = np.array(
        [np.flatnonzero(column)[-1] if column.any() else -1 for column in step.T], np.int64
    )
    return Buffers(
        Moves(step, np.zeros(len(step))),
        np.array(times, np.int64),
        np.arange(len(times), dtype=np.int32),
        recent,
        np.zeros(step.shape[1], np.int64),
    )


def test_rows_of_different_axes_that_are_too_near_become_one() -> None:
    buffers = buffers_of(
        [0, 100, 104, 200, 203, 207],
        [[1, 1, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]],
    )
    (step, _), time_ns, line, recent, _ = buffers
    assert spaced(6, -(2**62), buffers, 10.0) == 3
    assert time_ns[:3].tolist() == [0, 104, 207]
    assert step[:3].tolist() == [[1, 1, 0], [1, -1, 0], [1, 1, 1]]
    assert line[:3].tolist() == [0, 2, 5]
    assert recent.tolist() == [2, 2, 2]


def test_rows_of_one_axis_that_are_too_near_wait() -> None:
    buffers = buffers_of([0, 6, 14, 40], [[1, 0], [1, 0], [1, 1], [1, 0]])
    (step, _), time_ns, _, _, _ = buffers
    assert spaced(4, -5, buffers, 10.0) == 4
    assert time_ns.tolist() == [5, 15, 25, 40]
    assert step.tolist() == [[1, 0], [1, 0], [1, 1], [1, 0]]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=share(1000, 14), deadline=None)
def test_spacing_keeps_all_steps_in_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, axes = int(rng.integers(1, 60)), int(rng.integers(1, 5))
    steps = rng.integers(-1, 2, (rows, axes))
    steps = steps[steps.any(axis=1)]
    if not len(steps):
        return
    buffers = buffers_of(np.cumsum(rng.integers(0, 15, len(steps))).tolist(), steps.tolist())
    (step, _), time_ns, _, recent, _ = buffers
    before = [column[column != 0].tolist() for column in step.T]
    early = time_ns.copy()
    kept = spaced(len(steps), -100, buffers, 10.0)
    assert [column[column != 0].tolist() for column in step[:kept].T] == before
    assert (np.diff(time_ns[:kept]) >= 10).all()
    assert step[:kept].any(axis=1).all()
    kept_times, kept_steps = time_ns[:kept].copy(), step[:kept].copy()
    assert spaced(kept, -100, buffers, 10.0) == kept
    np.testing.assert_array_equal(time_ns[:kept], kept_times)
    np.testing.assert_array_equal(step[:kept], kept_steps)
    for i in range(axes):
        assert recent[i] < 0 or step[recent[i], i] != 0
        assert (time_ns[:kept][step[:kept, i] != 0] >= early[steps[:, i] != 0]).all()
