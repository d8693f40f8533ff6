"""Motions past corners: the search against other solvers, the limits by another spline."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.optimize import linprog

from cnc.kernels.planner.corner_motion import GAP, State, fastest_corner, place_ends
from cnc.kernels.planner.corner_rows import (
    FIXED,
    LINEAR,
    POINTS,
    STEPS,
    CornerLimits,
    evaluate,
    new_rows,
    rows_size,
    write_rows,
)
from cnc.kernels.planner.corner_search import new_known
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.lookahead import LookAhead
from tests.support.planner.corners import PER_AXIS, SQUARE, duration, planned
from tests.support.planner.motions import AXES, lines, sampled
from tests.support.soak import share


def corner(rng, travel=math.inf):
    """Limits in the plane of a corner of two ramps of constant jerk, and the ramps: durations,
    distances, speeds and accelerations at their far ends.
    """
    turn = math.radians(rng.uniform(20.0, 170.0))
    first = rng.uniform(0.0, 2.0 * math.pi)
    u = np.array([[math.cos(a), math.sin(a)] for a in (first, first + turn)])
    across = (u[1] - math.cos(turn) * u[0]) / math.sin(turn)
    jerk = 10 ** rng.uniform(3.0, 5.0) * 10 ** rng.uniform(-0.5, 0.5, 2)
    seconds = rng.uniform(0.02, 0.08)
    along = [(jerk / np.maximum(np.abs(u[k]), 1e-12)).min() for k in range(2)]
    states = [State(j * seconds**3 / 6.0, j * seconds**2 / 2.0, j * seconds) for j in along]
    before = states[0]._replace(a=-states[0].a)
    most = max(each.v for each in states)
    limits = CornerLimits(
        np.array([[u[0, i], across[i]] for i in range(2)]),
        np.full(2, 2.0 * most),
        np.array([along[k] * abs(u[k]) * seconds for k in range(2)]).max(axis=0) * 1.2 + 1e-3,
        jerk * 1.02,
        np.array([[-travel, -travel], [travel, travel]]),
        (1.1 * states[0].v, 1.1 * states[1].v),
        math.inf,
        10 ** rng.uniform(-3.0, -1.0),
        (math.cos(turn), math.sin(turn)),
    )
    return limits, before, states[1], seconds


def ramps(limits, before, after, seconds, h):
    """Control points near two ramps with a rest between them."""
    c = np.zeros((POINTS, 2))
    turn = np.array(limits.turn)
    for k in range(POINTS):
        t = (k - 1.0) * h - seconds
        jerk = abs(before.a if t < 0.0 else after.a) / seconds
        s = jerk * t**3 / 6.0
        c[k] = [s, 0.0] if t < 0.0 else s * turn
    return c


def sought(limits, before, after, seconds):
    h = 2.0 * seconds / STEPS
    rows = new_rows(rows_size(2))
    write_rows(limits, STEPS // 2, rows)
    c = ramps(limits, before, after, seconds, h)
    return fastest_corner(rows, limits, before, after, c, h), c


@settings(max_examples=share(400, 15), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_a_motion_keeps_all_limits_and_its_ends(seed):
    """By scipy's B-spline, at many times."""
    limits, before, after, seconds = corner(np.random.default_rng(seed))
    step, c = sought(limits, before, after, seconds)
    if step == 0.0:
        return
    assert step < 2.0 * seconds / STEPS
    spline = BSpline(step * (np.arange(POINTS + 4) - 3.0), c, 3)
    times = np.linspace(0.0, STEPS * step, 4001)
    turn = np.array(limits.turn)
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        inside = times[:-1] + 0.5 * step / 250.0
        values = spline(inside, order) @ limits.axes.T
        assert (np.abs(values).max(axis=0) <= bound * (1.0 + 1e-9)).all()
    for time, state, along, sign in (
        (0.0, before, np.array([1.0, 0.0]), -1.0),
        (times[-1], after, turn, 1.0),
    ):
        assert spline(time) == pytest.approx(sign * state.s * along, abs=1e-9)
        assert spline(time, 1) == pytest.approx(state.v * along, abs=1e-7)
        assert spline(time, 2) == pytest.approx(state.a * along, abs=1e-4)
    r = spline(times)
    speed = np.linalg.norm(spline(times, 1), axis=1)
    half = times < STEPS // 2 * step
    assert speed[half].max() <= limits.feed[0] * (1.0 + 1e-9)
    assert speed[~half].max() <= limits.feed[1] * (1.0 + 1e-9)
    off1 = np.hypot(np.maximum(r[:, 0], 0.0), r[:, 1])
    on2 = np.maximum(r @ turn, 0.0)
    off2 = np.linalg.norm(r - on2[:, None] * turn, axis=1)
    assert np.where(half, off1, off2).max() <= limits.tolerance * (1.0 + 1e-9)
    # so no point of the legs is farther from the motion
    assert np.linalg.norm(r, axis=1).min() <= limits.tolerance * (1.0 + 1e-9)


@pytest.mark.parametrize("seed", range(share(100, 8)))
def test_the_duration_is_the_least_of_a_linear_programme(seed):
    """Without tolerance and feed all rows are linear. Then a solver of linear programmes finds a
    motion of the duration that was found, and none that is shorter by more than the gap allows.
    """
    limits, before, after, seconds = corner(np.random.default_rng([seed, 5]))
    limits = limits._replace(tolerance=1e6, feed=(math.inf, math.inf))
    step, _ = sought(limits, before, after, seconds)

    def least(h):
        rows = new_rows(rows_size(2))
        write_rows(limits, STEPS // 2, rows)
        c = np.zeros((POINTS, 2))
        place_ends(c, h, before, after, limits.turn)
        evaluate(rows, limits, c)
        size = 2 * POINTS
        upper, right = [], []
        for m in range(rows.number[0]):
            if rows.kind[m] != LINEAR:
                continue
            row = np.zeros(size + 1)
            at = 2 * rows.first[m]
            row[at : at + 8] = rows.gradient[m] / (rows.bound[m] * h ** rows.power[m])
            for sign in (1.0, -1.0):
                upper.append(np.append(sign * row[:size], -1.0))
                right.append(1.0)
        fixed = np.r_[0 : 2 * FIXED, size - 2 * FIXED : size]
        bounds = [(None, None)] * (size + 1)
        for i in fixed:
            bounds[i] = (c.ravel()[i], c.ravel()[i])
        found = linprog(np.eye(size + 1)[-1], np.array(upper), np.array(right), bounds=bounds)
        assert found.status == 0
        return found.x[-1]

    assert step > 0.0
    assert -2.0 * GAP <= least(step) <= 0.0


def test_no_motion_is_sought_twice():
    stops, ahead = planned(SQUARE, 0.0)
    plans = []
    for chunk in stops:
        chunk.path.tolerance[:] = 0.01
        plans.append(chunk)
    motions = CornerMotions(ahead.limits, Audit(ahead.limits))
    first = [*motions.passed(plans), *motions.flush()]
    known = int(motions._known.next[0])
    assert known > 0
    again = [*motions.passed(plans), *motions.flush()]
    assert int(motions._known.next[0]) == known
    assert duration(again) - again[0].t0 == pytest.approx(duration(first) - first[0].t0, abs=1e-12)
    assert known < len(new_known(3).step)


@pytest.mark.parametrize("percent", [20.0, 60.0, 150.0])
def test_motions_past_corners_keep_to_the_feed_of_the_operator(percent):
    control = Control()
    control.override(percent)
    path = build(
        [PathMode("t.nc", 1, "blend", 0.05), lines([*SQUARE, (0, 10, 0)], 20.0)],
        axes=AXES,
        start=np.zeros(3),
    )
    plans = [p for p in LookAhead(PER_AXIS, control).plan(path) if not isinstance(p, Held)]
    points = sampled(plans, 1e-4)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / 1e-4
    assert speed.max() == pytest.approx(20.0 * percent / 100.0, rel=1e-3)
    near = np.linalg.norm(points - [10, 0, 0], axis=1).min()
    assert 1e-3 < near <= 0.05


@pytest.mark.parametrize("room", [0.0, 0.004])
def test_a_corner_at_the_end_of_the_travel_is_passed_inside_it(room):
    axes = {
        name: Axis(
            steps_per_mm=100.0,
            max_velocity=400.0,
            max_acceleration=2400.0,
            max_jerk=48000.0,
            travel=(-1.0, 10.0 + room),
        )
        for name in AXES
    }
    mill = Machine(axes=axes, path=PathLimits(max_feed=300.0))
    chunks, ahead = planned(SQUARE, 0.01, mill)
    assert not ahead.audit.violations
    assert sampled(chunks, 1e-4).max() <= 10.0 + room
    free, stop = planned(SQUARE, 0.01)[0], planned(SQUARE, 0.0)[0]
    assert duration(free) < duration(chunks) < 0.97 * duration(stop)
