"""Blends where no axis limits the jerk: the speed that the tolerance allows, legal, within it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import PathMode, Polyline
from cnc.path.build import build
from cnc.path.kernels.curve import LINE
from cnc.planner.kernels.corner_bends import (
    OUTSIDE,
    WITHIN,
    Bend,
    Side,
    fastest_blend,
    no_kept_blends,
)
from cnc.planner.kernels.corner_bends import _blend as blend_at
from cnc.planner.kernels.legs import LineBounds
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.pipeline import path_of
from tests.support.planner.corners import assert_legal, distances, duration, planned
from tests.support.planner.motions import AXES, lines, machine, sampled
from tests.support.soak import share

NORMAL, EPS = 1000.0, 0.1


def corner(degrees, first, second, start=20.0):
    """A corner in the plane of x and y."""
    a, b = math.radians(start), math.radians(start + degrees)
    point = np.array([first * math.cos(a), first * math.sin(a), 0.0])
    return [point, point + [second * math.cos(b), second * math.sin(b), 0.0]]


def largest_radius(degrees, out):
    """Of an arc that is tangent to lines at the distance ``out`` outside of both legs, and passes
    the corner inside at the distance EPS. Those lines meet out / c outside of the corner, and the
    arc passes that place at the distance R / c - R.
    """
    c = math.cos(math.radians(degrees) / 2)
    return (EPS + out / c) / (1 / c - 1)


@pytest.mark.parametrize("degrees", [60.0, 90.0, 135.0, 165.0][:: share(1, 2)])
def test_a_corner_is_passed_at_the_speed_that_the_tolerance_allows(degrees):
    # With a radius R the normal acceleration allows sqrt(a R). The chord error allows more here.
    mill = machine(tangential=500.0, normal=NORMAL, jerk=20_000.0, chord_error=0.01)
    inside, fastest = (math.sqrt(NORMAL * largest_radius(degrees, out)) for out in (0.0, EPS))
    for feed in (0.985 * fastest, 1.1 * fastest):
        chunks, ahead = planned(corner(degrees, 40.0, 40.0), EPS, mill, feed)
        assert not ahead.audit.violations
        speed = np.linalg.norm(np.diff(sampled(chunks, 1e-3), axis=0), axis=1) / 1e-3
        passed = np.cumsum(speed) * 1e-3
        least = speed[(passed > 20.0) & (passed < passed[-1] - 20.0)].min()
        assert 1.3 * inside < least < fastest


@pytest.mark.parametrize("growth", [0.3, 1.0, 2.0, 8.0][:: share(1, 2)])
@pytest.mark.parametrize("degrees", [55.0, 100.0, 178.0])
def test_blends_keep_to_the_tolerance_and_the_limits(growth, degrees):
    # The ratio of both accelerations tells by how much the radius changes in a turn.
    mill = machine(tangential=growth * NORMAL, normal=NORMAL, jerk=400_000.0, chord_error=0.01)
    for first, second in ((6.0, 5.0), (2.0, 6.0), (1.0, 0.7)):
        points = corner(degrees, first, second)
        chunks, ahead = planned(points, EPS, mill, 150.0)
        assert not ahead.audit.violations
        assert_legal(chunks, mill, (1e-3, 1e-4))
        off, missed = distances(sampled(chunks, 5e-5), np.vstack((np.zeros(3), points)))
        assert off.max() <= EPS
        assert missed.max() <= EPS * (1.0 + 1e-3)
        assert duration(chunks) < 1.01 * duration(planned(points, 0.0, mill, 150.0)[0])


def test_unequal_legs_use_their_own_acceleration():
    # x accelerates ten times as fast as y, and no axis limits the jerk.
    axes = {
        name: Axis(steps_per_mm=100.0, max_velocity=400.0, max_acceleration=a)
        for name, a in (("x", 4000.0), ("y", 400.0), ("z", 400.0))
    }
    mill = Machine(axes=axes, path=PathLimits(max_feed=300.0, max_jerk=80_000.0))
    points = [(20, 0, 0), (20, 20, 0)]
    chunks, ahead = planned(points, EPS, mill, 100.0)
    assert not ahead.audit.violations
    assert_legal(chunks, mill, (1e-3,))
    assert duration(chunks) < 0.98 * duration(planned(points, 0.0, mill, 100.0)[0])


def test_a_rotary_axis_keeps_to_the_tolerance_too():
    # The table turns by 40 degrees in the first leg and back by 10 in the second.
    axis = Axis(steps_per_mm=100.0, max_velocity=400.0)
    mill = Machine(
        axes=dict.fromkeys(("x", "y", "a"), axis),
        path=PathLimits(max_feed=300.0, max_tangential_acceleration=900.0, max_jerk=40_000.0),
    )
    points = np.array([(10.0, 0.0, 40.0), (14.0, 9.0, 30.0)])
    moves = Polyline("", 1, points, np.full(2, 60.0), np.array([1, 2], np.int32))
    path = build([PathMode("", 1, "blend", EPS), moves], axes=("x", "y", "a"), start=np.zeros(3))
    chunks = [item for item in LookAhead(mill).plan(path) if isinstance(item, PlanChunk)]
    assert (chunks[0].path.kind != LINE).any()
    motion = sampled(chunks, 1e-4)
    corner_at = np.vstack((np.zeros(3), points))
    off, _ = distances(motion * [1, 1, 0], corner_at * [1, 1, 0])
    assert off.max() <= EPS
    # Of the places of the path within the tolerance of each position, one has about its angle.
    places = np.vstack([np.linspace(a, b, 20_001) for a, b in zip(corner_at, points, strict=False)])
    for place in motion[::40]:
        near = np.abs(places[:, :2] - place[:2]).max(axis=1) <= EPS
        assert np.abs(places[near, 2] - place[2]).min() <= EPS


def test_corners_beside_a_leg_without_room_are_passed_together():
    # A leg of 1.7 tolerances has room for blends of a third of the tolerance.
    mill = machine(tangential=2000.0, normal=NORMAL, jerk=300_000.0, chord_error=0.01)
    first, second = corner(135.0, 5.6 * EPS, 1.7 * EPS)
    points = [first, second, second + [2.2 * EPS, 0.0, 0.0]]
    (chunk,) = build([lines(points, 50.0)], axes=("x", "y", "z"), start=np.zeros(3))
    stops, passed = (
        list(LookAhead(mill).plan(iter([replace(chunk, tolerance=np.array(tolerance))])))
        for tolerance in ([0.0, 0.0, 0.0], [EPS, EPS, 0.0])
    )
    assert duration(passed) < 0.7 * duration(stops)


def test_corners_of_short_legs_are_passed_together_where_that_is_faster():
    # Blends take 0.0506 s. The fastest motion within the tolerance takes 0.0448 s: a nonlinear
    # solver, benchmarks/heading_optimum.py.
    mill = machine(tangential=5000.0, normal=8800.0, jerk=826_000.0)
    heading = np.radians([0.0, 160.0, 101.0])
    steps = 0.5 * np.stack((np.cos(heading), np.sin(heading), 0.0 * heading), axis=1)
    blocks = [PathMode("", 1, "blend", 0.135), lines(np.cumsum(steps, axis=0), 257.0)]
    path = path_of(blocks, mill, np.zeros(3))
    chunks = [item for item in LookAhead(mill).plan(path) if isinstance(item, PlanChunk)]
    assert duration(chunks) < 1.05 * 0.0448


def test_a_corner_of_a_short_leg_beside_a_curve_has_a_blend():
    # The ramp to a stop would begin on the curve, so no motion past the stop is possible.
    mill = machine(tangential=3900.0, normal=2900.0, jerk=220_000.0)
    legs = np.array([30.0, 2.5, 30.0]) * EPS
    heading = np.radians([0.0, 90.0, 102.0])
    steps = legs[:, None] * np.stack((np.cos(heading), np.sin(heading), 0.0 * heading), axis=1)
    path = build(
        [PathMode("", 1, "blend", EPS), lines(np.cumsum(steps, axis=0), 100.0)],
        axes=AXES,
        start=np.zeros(3),
        short_legs=0,
    )
    chunks = [item for item in LookAhead(mill).plan(path) if isinstance(item, PlanChunk)]
    assert min(chunk.phase_v[1:-1].min() for chunk in chunks) > 5.0


def random_corner(rng, low, high):
    """Arguments of a search: sine, tolerance, feed, legs of 10**low tolerances on, least radius."""
    tolerance, half_turn = 10 ** rng.uniform(-3.0, -1.0), math.radians(rng.uniform(8.0, 80.0))
    accel = 10 ** rng.uniform(2.3, 4.0)
    line = LineBounds(300.0, accel, accel * 10 ** rng.uniform(0.7, 2.0))
    legs = tolerance * 10 ** rng.uniform(low, high, 2)
    sides = tuple(Side(0.49 * leg, 0.5 * leg, False, line) for leg in legs)
    normal = accel * rng.uniform(0.7, 2.0)
    bend = Bend(1.0 / normal, 0.0, math.inf, 0.0, 0.005 * tolerance, normal, math.radians(15.0))
    return math.sin(half_turn), tolerance, 10 ** rng.uniform(0.7, 2.5), sides, bend


@pytest.mark.parametrize("seed", range(share(200, 12)))
def test_no_speed_at_the_apex_gives_a_faster_blend(seed):
    """All speeds are tried in small steps, where the blend has room at the whole tolerance."""
    corner = random_corner(np.random.default_rng([seed, 5]), 2.0, 2.6)
    sine, tolerance, feed, sides, bend = corner
    best = fastest_blend(*corner, no_kept_blends())
    assert best.inside == WITHIN * tolerance, "the case shows nothing"
    speeds = np.linspace(0.0, feed, 2001)[1:].tolist()
    times = [
        blend_at(v, math.asin(sine), best.inside, OUTSIDE * tolerance, sides, bend).time
        for v in speeds
    ]
    assert best.time <= 1.003 * min(times)


def nudged(corner, k):
    """The same arguments, but one of them larger by a rounding."""
    sine, tolerance, feed, sides, bend = corner
    numbers = [sine, tolerance, feed, *bend]
    numbers += [number for side in sides for number in (side.room, side.length, *side.line)]
    numbers[k] = math.nextafter(numbers[k], math.inf)
    legs = tuple(
        Side(n[0], n[1], side.rests, LineBounds(*n[2:]))
        for side, n in zip(sides, (numbers[10:15], numbers[15:20]), strict=True)
    )
    return (*numbers[:3], legs, Bend(*numbers[3:10]))


def test_a_blend_that_is_kept_is_that_of_a_search():
    """Whatever was asked before, also if it differs by one rounding, or in a rest, alone."""
    rng = np.random.default_rng(20261130)
    kept, shapes = no_kept_blends(), set()
    for _ in range(share(3000, 150)):
        corner = random_corner(rng, -9.0, 2.6)
        sine, tolerance, feed, sides, bend = corner
        resting = (sine, tolerance, feed, (sides[0]._replace(rests=True), sides[1]), bend)
        for asked in (corner, nudged(corner, int(rng.integers(20))), resting, corner):
            blend = fastest_blend(*asked, kept)
            assert blend == fastest_blend(*asked, no_kept_blends())
            shapes.add((blend.time < math.inf, blend.before.turned > 0.0))
    assert len(shapes) == 3, "the cases show too little"
    assert np.isfinite(kept.keys[:, 0]).mean() > share(0.9, 0.2)
