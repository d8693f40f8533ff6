"""Plans over intervals with constant bounds: legal, continuous, fast, at rest at the end."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.planner.kernels import lookahead
from cnc.planner.kernels.arrays import PHASE
from cnc.planner.kernels.intervals import LEVELS, SAMPLES, Intervals
from cnc.planner.kernels.lookahead import PLANNED, START_TOO_FAST
from tests.support.soak import share

A, J = 2400.0, 48000.0


def plan(lengths, speeds, flat=None, v_start=0.0, accel=A, jerk=J):
    n = len(lengths)
    bound_s = np.concatenate(([0.0], np.cumsum(np.asarray(lengths, float))))
    accels = np.broadcast_to(np.reshape(accel, (-1, 1)), (n, LEVELS)).copy()
    jerks = np.broadcast_to(np.reshape(jerk, (-1, 1)), (n, LEVELS)).copy()
    flags = np.zeros(n, bool) if flat is None else np.asarray(flat, bool)
    status, phases = planned(bound_s, np.asarray(speeds, float), accels, jerks, flags, v_start)
    return status, bound_s, phases[phases["duration"] > 0]


def planned(bound_s, speeds, accels, jerks, flat, v_start):
    n = len(speeds)
    known = Intervals(
        end=bound_s[1:].copy(),
        speed=speeds,
        top=speeds,
        accel=accels,
        jerk=jerks,
        flat=flat,
        share=np.ones(n),
        reliable=np.full(n, np.inf),
        sampled=np.zeros((n, 2)),
        samples=np.zeros((n, SAMPLES, 3, 1)),
    )
    phases = np.empty(8 * n + 16, PHASE)
    status, count = lookahead.plan_window(bound_s[0], known, v_start, phases)
    return status, phases[:count]


def assert_legal(bound_s, speeds, phases, accel, jerk, v_start=0.0):
    dt, s, v, a, j = (phases[name] for name in PHASE.names)
    s_end = s + dt * (v + dt * (a / 2 + dt * j / 6))
    v_end = v + dt * (a + dt * j / 2)
    assert v[0] == v_start and a[0] == 0
    assert np.append(s[1:], bound_s[-1]) == pytest.approx(s_end, abs=1e-9 * (1 + bound_s[-1]))
    assert np.append(v[1:], 0.0) == pytest.approx(v_end, abs=1e-6)
    assert np.append(a[1:], 0.0) == pytest.approx(a + dt * j, abs=1e-6 * accel.max())
    for k in range(len(dt)):
        t = np.linspace(0, dt[k], 20)
        here = s[k] + t * (v[k] + t * (a[k] / 2 + t * j[k] / 6))
        n = len(speeds)
        # Within the rounding error of a boundary, the bounds of either side are enough.
        left = np.clip(np.searchsorted(bound_s, here - 1e-9, side="right") - 1, 0, n - 1)
        right = np.clip(np.searchsorted(bound_s, here + 1e-9, side="right") - 1, 0, n - 1)
        assert (
            v[k] + t * (a[k] + t * j[k] / 2)
            <= np.maximum(speeds[left], speeds[right]) * (1 + 1e-6) + 1e-6
        ).all()
        inside = slice(1, -1)
        assert (
            np.abs(a[k] + t[inside] * j[k])
            <= np.maximum(accel[left], accel[right])[inside] * (1 + 1e-9)
        ).all()
        assert (abs(j[k]) <= np.maximum(jerk[left], jerk[right])[inside] * (1 + 1e-9)).all()


def random_window(rng):
    n = int(rng.integers(1, 80))
    lengths = 10 ** rng.uniform(-3, 1.5, n)
    style = rng.integers(3)
    if style == 0:
        speeds = 10 ** rng.uniform(-1, 2.7, n)
    elif style == 1:
        speeds = 100 * np.exp(np.cumsum(rng.normal(0, 0.05, n)))
    else:
        speeds = np.repeat(10 ** rng.uniform(0, 2.7, n), rng.integers(1, 4, n))[:n]
    flat = rng.random(n) < 0.1
    flat[0] = flat[-1] = False
    for k in range(1, n):
        flat[k] &= not flat[k - 1]
    accel = np.full(n, A) if rng.random() < 0.5 else 10 ** rng.uniform(2, 4, n)
    jerk = np.full(n, J) if rng.random() < 0.5 else 10 ** rng.uniform(3, 6, n)
    return lengths, speeds, flat, accel, jerk


@settings(max_examples=share(20_000, 13))
@given(seed=st.integers(0, 2**31))
def test_random_windows_are_planned_legally(seed):
    lengths, speeds, flat, accel, jerk = random_window(np.random.default_rng(seed))
    status, bound_s, phases = plan(lengths, speeds, flat, 0.0, accel, jerk)
    assert status == PLANNED
    assert_legal(bound_s, speeds, phases, accel, jerk)
    ends = np.concatenate((phases["s"], [bound_s[-1]]))
    for k in np.flatnonzero(flat):
        inside = (ends[:-1] >= bound_s[k] - 1e-9) & (ends[1:] <= bound_s[k + 1] + 1e-9)
        assert phases["duration"][inside].sum() > 0
        assert (phases["a"][inside] == 0).all() and (phases["j"][inside] == 0).all()


def test_a_flat_interval_of_no_length_is_a_stop():
    _, _, both = plan([10.0, 0.0, 10.0], [100.0, 0.0, 100.0], [False, True, False])
    _, _, one = plan([10.0], [100.0])
    assert both["duration"].sum() == pytest.approx(2 * one["duration"].sum(), rel=1e-12)


def test_a_start_that_is_too_fast_to_stop_is_reported():
    assert plan([0.5], [100.0], v_start=100.0)[0] == START_TOO_FAST


def test_intervals_of_one_bound_cost_no_time():
    _, _, whole = plan([100.0], [120.0])
    for pieces in (2, 7, 100, 1000):
        _, _, cut = plan([100.0 / pieces] * pieces, [120.0] * pieces)
        assert cut["duration"].sum() == pytest.approx(whole["duration"].sum(), rel=1e-9)


def test_cuts_that_take_each_other_back_come_to_an_end(monkeypatch):
    # A cut of these nine uneven intervals raises the speeds beside it, so that a further place
    # exceeds its bound, and no ramp reaches the cut any more. It was made and taken back again and
    # again, as often as the window has intervals: 47 000 cuts and 24 s in 3 mm of a curve.
    lengths = [0.090221, 0.0147177, 0.0259978, 0.380539, 0.445829, 0.0147152, 0.0123917]
    lengths += [0.0296859, 0.0403539]
    speeds = [3.40905, 4.86874, 1.95975, 0.492358, 1.7301, 2.22812, 7.27105, 8.84843, 3.5916]
    accel = [736.012, 1839.37, 1598.91, 1191.46, 1541.18, 7644.69, 258626.0, 449775.0, 302179.0]
    jerk = [1516.9, 1317.88, 145.681, 51.4958, 76.4141, 165.974, 3610.9, 2076.12, 921.026]
    more = 300
    tried = []
    monkeypatch.setattr(lookahead, "plan_window", lookahead.plan_window.py_func)
    monkeypatch.setattr(
        lookahead, "best_cut", lambda *a, f=lookahead.best_cut: tried.append(a) or f(*a)
    )
    status, _, phases = plan(
        [*lengths, 0.0, *[1.0] * more],
        [*speeds, 0.0, *[100.0] * more],
        [False] * 9 + [True] + [False] * more,
        accel=[*accel, A, *[A] * more],
        jerk=[*jerk, J, *[J] * more],
    )
    assert status == PLANNED
    assert (np.diff(phases["s"]) > 0).all()
    assert len(tried) < 3 * len(lengths)


def test_a_valley_is_crossed_at_its_own_speed_with_full_ramps_on_both_sides():
    # From rest to 200, down to 50 for 1 mm, up to 200 and to rest.
    _, _, phases = plan([60.0, 1.0, 60.0], [200.0, 50.0, 200.0])

    def ramp(v0, v1):
        t = abs(v1 - v0) / A + A / J
        return t, t * (v0 + v1) / 2

    (t1, d1), (t2, d2) = ramp(0, 200), ramp(200, 50)
    expected = 2 * (t1 + t2 + (60.0 - d1 - d2) / 200.0) + 1.0 / 50.0
    assert phases["duration"].sum() == pytest.approx(expected, rel=1e-9)


def test_slower_motion_may_use_more_acceleration():
    # Speed leaves less acceleration here, so that the best top speed is not the highest.
    bound_s = np.array([0.0, 20.0])
    levels = 1 - 0.1 * np.arange(LEVELS)
    accel = (2400 * (1 - 0.97 * levels**2))[None]
    jerk = np.full((1, LEVELS), J)
    status, phases = planned(bound_s, np.array([150.0]), accel, jerk, np.array([False]), 0.0)
    assert status == PLANNED
    fastest = phases["duration"].sum()
    for m in range(LEVELS):
        _, _, fixed = plan([20.0], [150.0 * levels[m]], accel=accel[0, m])
        assert fastest <= fixed["duration"].sum() * (1 + 1e-9)
    assert fastest < 0.8 * plan([20.0], [150.0], accel=accel[0, 0])[2]["duration"].sum()
