"""Motions past corners: the search against other solvers, the limits by another spline."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.optimize import linprog

from cnc.api import from_text, plan
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.kernels.corner_motion import fastest_motion
from cnc.planner.kernels.corner_rows import AXIS, new_rows, set_stencils
from cnc.planner.kernels.corner_search import new_solutions
from cnc.planner.kernels.corner_tube import Tube, place_ends, set_knots
from cnc.planner.lookahead import LookAhead
from tests.support.planner.corners import PER_AXIS, SQUARE, duration, planned
from tests.support.planner.motions import AXES, lines, machine, sampled
from tests.support.soak import share

STEPS = (4, 5, 4)


def chain(rng, corners):
    """Return a chain of corners in two or three directions, from rest to rest, with control points
    and durations of a motion that stops on each.
    """
    d = int(rng.integers(2, 4))
    along = rng.normal(size=(corners + 1, d))
    along /= np.linalg.norm(along, axis=1)[:, None]
    length = 10 ** rng.uniform(-0.5, 0.5, corners + 1)
    turns = (along[1:] * along[:-1]).sum(axis=1)
    along[1:][np.abs(turns) > 0.99] = np.roll(along[0], 1)
    ends = np.concatenate((np.zeros((1, d)), np.cumsum(length[:, None] * along, axis=0)))
    jerk = 10 ** rng.uniform(3.0, 5.0) * 10 ** rng.uniform(-0.5, 0.0, d)
    whole = [
        (32.0 * length[k] / (jerk / np.abs(along[k])).min()) ** (1 / 3) for k in range(corners + 1)
    ]
    top = max(2.0 * length[k] / whole[k] for k in range(corners + 1))
    group = np.concatenate(
        [[3 * leg + g] * STEPS[g] for leg in range(corners + 1) for g in range(3)]
    )
    reach = np.stack((np.zeros(corners + 1), length), axis=1)
    states = np.zeros((2, 3, d))
    states[:, 0] = ends[0], ends[-1]
    tube = Tube(
        np.eye(d),
        np.full(d, 1.2 * top),
        np.full(d, 6.0 * top / min(whole)),
        jerk,
        np.array([[-math.inf] * d, [math.inf] * d]),
        top * rng.uniform(0.5, 1.0, corners + 1),
        math.inf,
        math.inf,
        math.inf,
        10 ** rng.uniform(-3.0, -1.0),
        ends[:-1],
        along,
        reach,
        np.repeat(np.arange(corners + 1), sum(STEPS)),
        group,
        1.0 / np.array(STEPS)[group % 3],
        states,
        0.0,
    )
    spans = np.log(np.outer(whole, (0.3, 0.4, 0.3)).ravel() * 1.3)
    rows = new_rows(len(group), d, d)
    set_knots(tube, spans, rows.t)
    c = np.zeros((len(group) + 3, d))
    for k in range(len(c)):
        t = rows.t[k : k + 3].mean()
        leg = min(max(int(np.searchsorted(np.cumsum(whole) * 1.3, t)), 0), corners)
        part = t / 1.3 - sum(whole[:leg])
        x = min(max(part / whole[leg], 0.0), 1.0)
        c[k] = ends[leg] + length[leg] * (3.0 - 2.0 * x) * x * x * along[leg]
    return tube, rows, c, spans


def spline_of(tube, rows, spans, c):
    """Return scipy's spline; its ghost steps are as long as those beside."""
    set_knots(tube, spans, rows.t)
    t = rows.t
    return BSpline(np.concatenate(([2 * t[0] - t[1]], t, [2 * t[-1] - t[-2]])), c, 3)


@settings(max_examples=share(400, 8), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_a_motion_keeps_all_limits_and_its_ends(seed):
    """By scipy's B-spline, at many times."""
    rng = np.random.default_rng(seed)
    tube, rows, c, spans = chain(rng, int(rng.integers(1, 5)))
    assert fastest_motion(tube, rows, c, spans)
    spline = spline_of(tube, rows, spans, c)
    knots = rows.t[2:-2]
    for end, state in ((0, tube.ends[0]), (-1, tube.ends[1])):
        for order in range(3):
            assert spline(knots[end], order) == pytest.approx(state[order], abs=1e-6)
    closest = np.full(len(tube.feed), math.inf)
    for k in range(len(tube.leg)):
        times = np.linspace(knots[k], knots[k + 1], 50)[:-1]
        for order, bound in ((1, tube.velocity), (2, tube.acceleration), (3, tube.jerk)):
            assert (np.abs(spline(times, order)).max(axis=0) <= bound * (1.0 + 1e-9)).all()
        leg = tube.leg[k]
        speed = np.linalg.norm(spline(times, 1), axis=1)
        assert speed.max() <= tube.feed[leg] * (1.0 + 1e-9)
        off = spline(times) - tube.start[leg]
        on = np.clip(off @ tube.along[leg], *tube.reach[leg])
        distance = np.linalg.norm(off - on[:, None] * tube.along[leg], axis=1)
        assert distance.max() <= tube.tolerance * (1.0 + 1e-9)
        closest[leg] = min(closest[leg], np.linalg.norm(off, axis=1).min())
    # so no point of the legs is farther from the motion
    assert (closest[1:] <= tube.tolerance * (1.0 + 1e-9)).all()


def rates(spline, times):
    """Return jerk and acceleration along the path, and the acceleration across it."""
    v, a, j = (spline(times, order) for order in (1, 2, 3))
    speed = np.linalg.norm(v, axis=1)
    pull = (v * a).sum(axis=1) / speed
    jerk = ((a * a).sum(axis=1) + (v * j).sum(axis=1) - pull**2) / speed
    return jerk, pull, np.linalg.norm(a - (pull / speed)[:, None] * v, axis=1)


def times_in(rows, count):
    """Return so many times in each step."""
    knots = rows.t[2:-2]
    shares = np.linspace(0.0, 1.0, count + 2)[1:-1]
    return (knots[:-1, None] + np.diff(knots)[:, None] * shares).ravel()


@pytest.mark.parametrize("seed", range(share(100, 4)))
def test_a_motion_keeps_the_limits_along_the_path(seed):
    """By the derivatives of scipy's B-spline, at many times, beside the other limits."""
    rng = np.random.default_rng([seed, 9])
    found = 0
    for _ in range(4):
        tube, rows, c, spans = chain(rng, int(rng.integers(1, 3)))
        pulls = tube.acceleration.min() * 10 ** rng.uniform(-1.0, 0.3, 2)
        tube = tube._replace(
            along_jerk=tube.jerk.min() * 10 ** rng.uniform(-0.5, 0.5),
            along_pull=pulls[0],
            across_pull=pulls[1] if rng.random() < 0.7 else math.inf,
        )
        if not fastest_motion(tube, rows, c, spans):
            continue
        found += 1
        spline = spline_of(tube, rows, spans, c)
        times = times_in(rows, 200)
        limits = (tube.along_jerk, tube.along_pull, tube.across_pull)
        for values, bound in zip(rates(spline, times), limits, strict=True):
            assert np.abs(values).max() <= bound * (1.0 + 1e-6)
        for order, bound in ((1, tube.velocity), (2, tube.acceleration), (3, tube.jerk)):
            assert (np.abs(spline(times, order)).max(axis=0) <= bound * (1.0 + 1e-9)).all()
    assert found > 0


def test_a_motion_takes_its_accelerations_along_and_across_the_path_together():
    """Where both count, the length of the acceleration exceeds either limit."""
    tube, rows, c, spans = chain(np.random.default_rng(4), 1)
    pull = 0.05 * tube.acceleration.min()
    tube = tube._replace(along_pull=pull, across_pull=pull, tolerance=0.3)
    assert fastest_motion(tube, rows, c, spans)
    spline, times = spline_of(tube, rows, spans, c), times_in(rows, 50)
    _, along, across = rates(spline, times)
    assert np.abs(along).max() <= pull * (1.0 + 1e-6)
    assert across.max() <= pull * (1.0 + 1e-6)
    assert np.linalg.norm(spline(times, 2), axis=1).max() > 1.2 * pull


@pytest.mark.parametrize("seed", range(share(60, 6)))
def test_no_shorter_motion_of_these_proportions_exists(seed):
    """Without tolerance and feed all rows are linear for given durations. A solver of linear
    programmes finds a motion of the durations that were found, and none of durations that are all
    shorter by a hundredth.
    """
    rng = np.random.default_rng([seed, 5])
    tube, rows, c, spans = chain(rng, int(rng.integers(1, 3)))
    tube = tube._replace(tolerance=1e6, feed=np.full(len(tube.feed), math.inf))
    assert fastest_motion(tube, rows, c, spans)

    def least(shorter):
        set_knots(tube, spans + math.log(shorter), rows.t)
        place_ends(tube, rows.t, c)
        set_stencils(rows)
        size, d = c.size, c.shape[1]
        upper = []
        for i in range(rows.number[0]):
            for m in range(rows.first[i], rows.first[i + 1]):
                if rows.row[m] != AXIS:
                    continue
                row = np.zeros(size + 1)
                at = d * rows.step[i]
                for j in np.flatnonzero(rows.stencil[i]):
                    weights = rows.stencil[i, j] * rows.gradient[m] * rows.scale[m]
                    row[at + d * j : at + d * j + d] = weights
                upper += [np.append(sign * row[:size], -1.0) for sign in (1.0, -1.0)]
        bounds = [(None, None)] * (size + 1)
        for i in (*range(3 * d), *range(size - 3 * d, size)):
            bounds[i] = (c.ravel()[i], c.ravel()[i])
        found = linprog(np.eye(size + 1)[-1], np.array(upper), np.ones(len(upper)), bounds=bounds)
        assert found.status == 0
        return found.x[-1]

    assert least(1.0) <= 1e-9
    assert least(0.99) > 0.0


@settings(max_examples=share(60, 4), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_search_ends_alike_from_other_durations(seed):
    """The problem is not convex in the durations, but the same motion is found from others."""
    rng = np.random.default_rng(seed)
    tube, rows, c, spans = chain(rng, 2)
    others, other = c.copy(), spans + rng.uniform(0.0, 0.2, len(spans))
    assert fastest_motion(tube, rows, c, spans)
    assert fastest_motion(tube, rows, others, other)
    times = [(tube.part * np.exp(each[tube.group])).sum() for each in (spans, other)]
    assert times[0] == pytest.approx(times[1], rel=0.02)


def test_no_motion_is_sought_twice():
    stops, ahead = planned(SQUARE, 0.0)
    plans = []
    for chunk in stops:
        chunk.path.tolerance[:] = 0.01
        plans.append(chunk)
    motions = CornerMotions(ahead.limits, Audit(ahead.limits))
    first = [part.plan for part in (*motions.passed(plans), *motions.flush())]
    searches = int(motions._solutions.next[0])
    assert searches > 0
    again = [part.plan for part in (*motions.passed(plans), *motions.flush())]
    assert int(motions._solutions.next[0]) == searches
    assert duration(again) - again[0].t0 == pytest.approx(duration(first) - first[0].t0, abs=1e-12)
    assert searches < len(new_solutions(np.ones(1)).exists)


@pytest.mark.parametrize("percent", [20.0, 60.0, 150.0][share(0, 1) :])
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


def test_corners_of_legs_without_common_directions_are_passed_one_by_one():
    """A rotary axis that turns at another rate on each leg does not depend on the directions."""
    mill = Machine(
        axes={
            name: Axis(
                steps_per_mm=100.0, max_velocity=400.0, max_acceleration=2400.0, max_jerk=48000.0
            )
            for name in ("x", "y", "z", "a")
        },
        path=PathLimits(max_feed=300.0),
    )
    points = [(1, 0, 0, 0.4), (1, 1, 0, 0.1), (2, 1, 0, 0.7), (2, 2, 0, 0.2)]

    def time(tolerance):
        mode = [PathMode("t.nc", 1, "blend", tolerance)] if tolerance else []
        path = build(
            [*mode, lines(points, 60.0)], axes=mill.axis_names, start=np.zeros(4), short_legs=4
        )
        ahead = LookAhead(mill)
        chunks = list(ahead.plan(path))
        assert not ahead.audit.violations
        assert all((chunk.path.length > 0.0).all() for chunk in chunks)
        return duration(chunks)

    assert time(0.05) < 0.9 * time(0.0)


@pytest.mark.parametrize("seed", [None, *range(share(6, 2))])
def test_the_audit_refuses_no_motion_past_corners_of_short_arcs(seed, monkeypatch):
    """Where an arc meets the line that replaces the end of another, velocity and acceleration jump.

    The plan is steady there. A motion past the next corner that began at once exceeded the jerk.
    """
    monkeypatch.setattr(CornerMotions, "_refused", refused)
    if seed is None:
        ends = [(49.9944, 50.0276), (49.9904, 49.9792), (49.9979, 49.9987), (49.9740, 49.9551)]
        radii = [0.243, 0.255, 0.127, 0.249]
    else:
        rng = np.random.default_rng(seed)
        ends = np.round(50.0 + np.cumsum(rng.uniform(-0.05, 0.05, (60, 2)), axis=0), 4).tolist()
        radii = np.round(rng.uniform(0.1, 0.3, 60), 3).tolist()
    moves = [
        f"G{2 + k % 2} X{x:.4f} Y{y:.4f} R{radius:.3f}"
        for k, ((x, y), radius) in enumerate(zip(ends, radii, strict=True))
    ]
    text = "\n".join(["G21 G90 G17 G64 P0.01 F1500", "G0 X50 Y50", *moves, "M2", ""])
    mill = machine(axis=(1000.0, 40_000.0), tangential=None, normal=None, jerk=None)
    assert any(len(chunk.path) > len(moves) for chunk in plan(from_text(text), mill))


def refused(self, plan, cut, origin):
    raise AssertionError(f"refused: the motion at {cut.t0} s")


def test_a_motion_that_rests_just_behind_a_corner_ends_the_search():
    """No limit of the search is finite there, and it did not end."""
    mill = machine(axis=None, tangential=112.8, normal=101.0, jerk=42_000.0)
    leg = (17.2, 0.0, 0.0)
    (tiny,), ahead = planned([leg, (17.2, 5e-8, 0.0)], 0.0, mill, feed=29.0)
    (whole,), _ = planned([leg, (17.2, 14.7, 0.0)], 0.0, mill, feed=29.0)
    path = replace(whole.path, tolerance=np.array([0.0337, 0.0]))
    plan = replace(tiny, path=path, piece_s=whole.piece_s)
    motions = CornerMotions(ahead.limits, Audit(ahead.limits))
    parts = [*motions.passed([plan]), *motions.flush()]
    assert sum(part.plan.duration for part in parts) <= plan.duration + 1e-9
