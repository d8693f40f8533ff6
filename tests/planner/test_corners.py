"""Corners under a tolerance: the theoretical time, legal, within the tolerance, complete pulses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from cnc.api import Outputs, RunOptions, check
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import PathMode, Polyline
from cnc.path.build import build
from cnc.path.kernels.curve import LINE, SPAN
from cnc.planner.audit import Audit
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.sampled import Sampled
from tests.support.planner.corners import (
    PER_AXIS,
    SQUARE,
    USED,
    assert_legal,
    distances,
    duration,
    planned,
)
from tests.support.planner.motions import AXES, lines, machine, sampled
from tests.support.soak import share

ALONG = machine(tangential=600.0, normal=600.0, jerk=12_000.0)


def test_a_motion_past_a_corner_is_faster_than_ramps_that_overlap():
    # Rest to rest in 10 mm without a cruise takes 4 (D / 2J)^(1/3) a leg. Where two ramps of jerk J
    # are added during their last and first (24 eps / (J sin 60))^(1/3), a turn by 120 degrees saves
    # this time. The machine's axes are such that both legs have the same jerk.
    jerk = 48000.0 * USED
    axes = {
        "x": (2400.0, 48000.0),
        "y": (2400.0 * math.sqrt(0.75), 48000.0 * math.sqrt(0.75)),
        "z": (1.0, 1.0),
    }
    mill = Machine(
        axes={
            name: Axis(steps_per_mm=100.0, max_velocity=400.0, max_acceleration=a, max_jerk=j)
            for name, (a, j) in axes.items()
        },
        path=PathLimits(max_feed=300.0),
    )
    points = [(10, 0, 0), (5, 10 * math.sqrt(0.75), 0)]
    stop = 8.0 * (10.0 / (2.0 * jerk)) ** (1 / 3)
    assert duration(planned(points, 0.0, mill)[0]) == pytest.approx(stop, rel=1e-6)
    saved = (24.0 * 0.01 / (jerk * math.sin(math.pi / 3))) ** (1 / 3)
    chunks, ahead = planned(points, 0.01, mill)
    assert duration(chunks) < stop - saved
    assert not ahead.audit.violations
    motion = sampled(chunks, 1e-4)
    assert motion[-1] == pytest.approx([*points[-1]], abs=1e-3)
    assert np.linalg.norm(motion - [10, 0, 0], axis=1).min() <= 0.01 * (1 + 1e-3)


def overshooting(length, jerk, e):
    """Phases from rest to rest of jerks +J, -J, +J, -J, the last for a time e, without a limit of
    acceleration: durations.
    """

    def states(times):
        s = v = a = 0.0
        for dt, j in zip(times, (jerk, -jerk, jerk, -jerk), strict=True):
            s, v, a = (
                s + dt * (v + dt * (a / 2 + dt * j / 6)),
                v + dt * (a + dt * j / 2),
                a + dt * j,
            )
        return s, v

    def times(t1):
        t2 = brentq(lambda t2: states((t1, t2, t2 - t1 + e, e))[1], t1, 4 * (t1 + e), xtol=1e-16)
        return t1, t2, t2 - t1 + e, e

    return times(brentq(lambda t1: states(times(t1))[0] - length, 1e-3, 1.0, xtol=1e-16))


def test_a_right_angle_of_two_axes_is_faster_than_ramps_that_overshoot():
    # By hand: each ramp runs past the corner as far as the tolerance allows, and comes back. The
    # ramps overlap from the time at which both are eps / sqrt 2 from the corner.
    jerk, eps = 48000.0 * USED, 0.01
    r = 1 + math.sqrt(2)
    e = (0.999 * eps / (1.943 * jerk)) ** (1 / 3)
    assert r**3 / 6 - r**2 / 2 - r / 2 - 1 / 6 == pytest.approx(-1.943, abs=1e-3)
    left = brentq(
        lambda x: jerk * (x**3 / 6 - e * x**2 / 2 - e * e * x / 2 - e**3 / 6) - eps / math.sqrt(2),
        2 * e,
        0.1,
        xtol=1e-16,
    )
    expected = 2 * sum(overshooting(10.0, jerk, e)) - 2 * (left + e)
    chunks, ahead = planned(SQUARE, eps)
    assert not ahead.audit.violations
    assert duration(chunks) < expected
    motion = sampled(chunks, 1e-4)
    assert motion[-1] == pytest.approx([10, 10, 0], abs=1e-3)
    assert np.hypot(motion[:, 0] - 10.0, motion[:, 1]).min() <= eps * (1 + 1e-3)
    assert motion[:, 0].max() <= 10.0 + eps


@pytest.mark.parametrize("ratio", [1.0, 3.0, 20.0][:: share(1, 2)])
def test_unequal_jerks_keep_the_corner_within_the_tolerance(ratio):
    mill = Machine(
        axes={
            name: Axis(steps_per_mm=100.0, max_velocity=400.0, max_acceleration=2400.0, max_jerk=j)
            for name, j in (("x", 48000.0), ("y", 48000.0 / ratio), ("z", 48000.0))
        },
        path=PathLimits(max_feed=300.0),
    )
    points = [(10, 0, 0), (10 + 10 * math.cos(2.0), 10 * math.sin(2.0), 0)]
    chunks, ahead = planned(points, 0.02, mill)
    assert duration(chunks) < duration(planned(points, 0.0, mill)[0])
    assert not ahead.audit.violations
    motion = sampled(chunks, 1e-4)
    off, missed = distances(motion, np.concatenate((np.zeros((1, 3)), points)))
    assert off.max() <= 0.02 * (1 + 1e-6)
    assert missed.max() <= 0.02 * 1.001


@pytest.mark.parametrize(("turn", "first"), [(60.0, 10.0), (90.0, 20.0), (120.0, 30.0)])
def test_a_corner_where_jerks_would_add_up_in_an_axis_is_passed(turn, first):
    # Two ramps that overlap would have a sum of jerks beyond the limit of an axis.
    u1, u2 = (
        np.array([math.cos(angle), math.sin(angle), 0.0])
        for angle in np.radians((first, first + turn))
    )
    assert max(abs(u1) / abs(u1).max() + abs(u2) / abs(u2).max()) > 1.2
    points = [10.0 * u1, 10.0 * (u1 + u2)]
    chunks, ahead = planned(points, 0.01)
    assert not ahead.audit.violations
    assert duration(chunks) < 0.985 * duration(planned(points, 0.0)[0])


@pytest.mark.parametrize("degrees", [140.0, 160.0, 175.0][:: share(1, 2)])
def test_a_corner_is_passed_where_the_motion_nearly_reverses(degrees):
    """Ramps of which the second begins tau early save tau; the motion saves about that or more."""
    eps, angle = 0.01, math.radians(degrees)
    points = [(10, 0, 0), (10 + 10 * math.cos(angle), 10 * math.sin(angle), 0)]
    stop = duration(planned(points, 0.0)[0])
    chunks, ahead = planned(points, eps)
    assert not ahead.audit.violations
    # both ramps have at least the jerk of x, whichever way they go
    tau = (24.0 * eps / (48000.0 * USED * math.sin(angle / 2))) ** (1 / 3)
    assert stop - duration(chunks) > 0.95 * tau
    assert_legal(chunks, PER_AXIS, (1e-3, 1e-4))
    motion = sampled(chunks, 1e-4)
    off, missed = distances(motion, np.concatenate((np.zeros((1, 3)), points)))
    assert off.max() <= eps * (1 + 1e-6)
    assert missed.max() <= eps * 1.001


@pytest.mark.parametrize("degrees", [55.0, 60.0])
def test_a_turn_becomes_a_blend_that_saves_time(degrees):
    """Limits along the path rule out a motion past a stop. A blend saves what a stop takes."""
    angle, first = math.radians(degrees), math.radians(20.0)
    u1, u2 = (np.array([math.cos(a), math.sin(a), 0.0]) for a in (first, first + angle))
    points = [19 * u1, 19 * u1 + 18 * u2]
    chunks, ahead = planned(points, 0.1, ALONG, 40.0)
    assert not ahead.audit.violations
    kinds = list(chunks[0].path.kind)
    assert kinds == [LINE, *[SPAN] * (len(kinds) - 2), LINE]
    assert len(kinds) > 2
    assert duration(chunks) < 0.97 * duration(planned(points, 0.0, ALONG, 40.0)[0])
    assert_legal(chunks, ALONG, (1e-3,))


@pytest.mark.parametrize("feed", [50.0, 100.0])
def test_a_blend_between_a_traverse_and_a_feed_move_keeps_the_feed(feed):
    points = np.array([(9, 3, 0), (14, 9, 0), (30, 12, 0)], float)
    feeds = np.array([np.nan, feed, np.nan])
    moves = Polyline("t.nc", 1, points, feeds, np.arange(1, 4, dtype=np.int32))
    path = build([PathMode("t.nc", 1, "blend", 0.1), moves], axes=AXES, start=np.zeros(3))
    (chunk,) = [c for c in LookAhead(ALONG).plan(path) if isinstance(c, PlanChunk)]
    straight = np.flatnonzero(chunk.path.kind == LINE)
    first, last = chunk.piece_s[straight[0] + 1], chunk.piece_s[straight[-1]]
    assert len(straight) == 3
    inside = (chunk.phase_s >= first) & (chunk.phase_s <= last)
    assert chunk.phase_v[inside].max() <= feed
    assert_legal([chunk], ALONG, (1e-3, 1e-4))


def test_speed_and_acceleration_of_the_trace_agree_with_its_positions():
    for points in (SQUARE, [(10, 0, 0), (4, 8, 0)]):
        chunks, _ = planned(points, 0.01)
        sampler = Sampled(1e-4, np.zeros(3))
        rows = [part for chunk in chunks for part in sampler.samples(chunk)]
        position, s, feed, accel, jerk = (
            np.concatenate([getattr(part, name) for part in rows])
            for name in ("position", "s", "feed", "accel", "jerk")
        )
        near = np.flatnonzero(np.hypot(position[:, 0] - 10.0, position[:, 1]) < 0.05)[2:-2]
        step = np.linalg.norm(np.diff(position, axis=0), axis=1)
        assert np.diff(s)[near] == pytest.approx(step[near], rel=1e-3)
        assert np.gradient(s, 1e-4)[near] == pytest.approx(feed[near], rel=2e-3)
        speed = np.gradient(feed, 1e-4)
        assert speed[near] == pytest.approx(accel[near], rel=2e-2, abs=10.0)
        # where no axis's jerk changes, the tangential one is the difference of the accelerations
        change = np.gradient(accel, 1e-4)
        most = np.abs(jerk[near]).max()
        smooth = [k for k in near if np.ptp(jerk[k - 1 : k + 2]) < 0.1 * most]
        assert len(smooth) > 0.5 * len(near)
        assert change[smooth] == pytest.approx(jerk[smooth], abs=0.05 * most)


def test_at_a_corner_feed_moves_keep_their_feed_beside_a_traverse():
    # Feed moves into a traverse of far more jerk and out of it: no sample of the feed moves' lines
    # is faster than their feed.
    axes = {"x": (2400.0, 5000.0), "y": (8000.0, 500_000.0), "z": (1.0, 1.0)}
    mill = Machine(
        axes={
            name: Axis(steps_per_mm=100.0, max_velocity=400.0, max_acceleration=a, max_jerk=j)
            for name, (a, j) in axes.items()
        },
        path=PathLimits(max_feed=300.0),
    )
    moves = replace(lines([*SQUARE, (0, 10, 0)], 5.0), feeds=np.array([5.0, np.nan, 5.0]))
    plans = list(
        LookAhead(mill).plan(
            build([PathMode("t.nc", 1, "blend", 0.01), moves], axes=AXES, start=np.zeros(3))
        )
    )
    sampler = Sampled(1e-4, np.zeros(3))
    rows = [part for plan in plans if isinstance(plan, PlanChunk) for part in sampler.samples(plan)]
    line, feed = (
        np.concatenate([getattr(part, name) for part in rows]) for name in ("line", "feed")
    )
    assert feed[line != 2].max() <= 5.0 * (1 + 1e-9)
    assert (np.diff(line) >= 0).all()


def test_the_audit_finds_a_jump_at_a_timed_piece():
    chunks, ahead = planned(SQUARE, 0.01)
    chunk = chunks[0]
    timed = int(np.flatnonzero(chunk.path.kind == SPAN)[0])
    k = int(np.searchsorted(chunk.phase_s, chunk.piece_s[timed] + 1e-9)) - 1
    t = chunk.phase_t.copy()
    t[k + 1 :] += 1e-4
    v = chunk.phase_v.copy()
    v[k] *= (chunk.phase_t[k + 1] - chunk.phase_t[k]) / (t[k + 1] - t[k])
    slower = replace(chunk, phase_t=t, phase_v=v)
    found = Audit(ahead.limits)._continuity(slower)
    assert [name for name, _ in found] == ["continuity", "continuity"]
    assert not Audit(ahead.limits)._continuity(chunk)


@pytest.mark.parametrize("room", [0.1, 0.0])
def test_a_motion_past_a_corner_never_leaves_the_travel(tmp_path, room):
    # Both ramps run past a corner between two axes by up to the tolerance. At the end of the travel
    # of either axis they must not.
    jerks = {"x": 244.5, "z": 219.9}
    ends = {"x": (-5.0, 5.0), "z": (-5.0 - room, 5.0)}
    axes = {
        name: Axis(
            steps_per_mm=100.0,
            max_velocity=30.0,
            max_acceleration=200.0,
            max_jerk=jerk,
            travel=ends[name],
        )
        for name, jerk in jerks.items()
    }
    mill = Machine(axes=axes, path=PathLimits(max_feed=20.0))
    program, trace = tmp_path / "part.nc", tmp_path / "part.npz"
    program.write_text("G21 G90 G64 P0.01\nG0 Z-5\nG0 X4\nM2\n", encoding="ascii")
    report = check(program, mill, RunOptions(outputs=Outputs(trace=str(trace))))
    assert report.ok
    lowest = float(np.load(trace)["position"][:, 1].min())
    assert lowest >= ends["z"][0]
    assert (lowest < -5.0) == (room > 0.0)
