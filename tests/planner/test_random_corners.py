"""Random corners: legal and within the tolerance, on any machine, wherever plans are cut."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.lookahead import LookAhead
from cnc.pulses.reference_pulse import ReferencePulse
from tests.support.planner.corners import (
    assert_legal,
    distances,
    duration,
    planned,
)
from tests.support.planner.motions import AXES, lines, machine, sampled
from tests.support.pulses.plans import cut
from tests.support.soak import share


def random_chain(rng):
    count = int(rng.integers(2, 12))
    flat = rng.random() < 0.5
    size = 10 ** rng.uniform(-2, 1.7)
    points, here, heading = [], np.zeros(3), np.array([1.0, 0.0, 0.0])
    for _ in range(count):
        across = rng.normal(size=3) * [1, 1, 0 if flat else 1]
        if rng.random() < 0.4:
            # along the axes, as in pockets
            heading = np.zeros(3)
            heading[rng.integers(2 if flat else 3)] = rng.choice((-1, 1))
        else:
            across -= across @ heading * heading
            turn = (
                rng.uniform(0, math.pi)
                if rng.random() < 0.7
                else rng.choice((math.pi / 2, math.pi / 4, math.pi))
            )
            heading = math.cos(turn) * heading + math.sin(turn) * across / np.linalg.norm(across)
        here = here + heading * size * 10 ** rng.uniform(-1, 0.3)
        points.append(here)
    return np.array(points)


def random_mill(rng):
    both = rng.random() < 0.3
    axis = (
        (10 ** rng.uniform(2, 4), 10 ** rng.uniform(3.5, 6)) if both or rng.random() < 0.7 else None
    )
    along = both or axis is None
    return machine(
        axis=axis,
        tangential=10 ** rng.uniform(2, 4) if along else None,
        normal=10 ** rng.uniform(2, 4) if along else None,
        jerk=10 ** rng.uniform(3.5, 6) if along else None,
    )


@settings(max_examples=share(2000, 1), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_random_chains_are_legal_and_within_the_tolerance(seed):
    rng = np.random.default_rng(seed)
    points, mill = random_chain(rng), random_mill(rng)
    tolerance, feed = 10 ** rng.uniform(-3, -0.5), 10 ** rng.uniform(0.7, 2.5)
    stops, _ = planned(points, 0.0, mill, feed)
    chunks, ahead = planned(points, tolerance, mill, feed, chooses=True)
    assert not ahead.audit.violations
    # Where all turns are small the path is a smooth curve, which may take longer than stops.
    assert duration(chunks) <= duration(stops) * 1.05
    assert_legal(chunks, mill, (1e-3,))
    corners = np.concatenate((np.zeros((1, 3)), points))
    fine = sampled(chunks, min(duration(chunks) / 20_000, 2e-4))
    off, missed = distances(fine, corners)
    assert off.max() <= tolerance * (1 + 1e-6)
    # the chord of two samples cuts what lies between
    assert missed.max() <= tolerance * 1.001 + (np.diff(fine, axis=0) ** 2).sum(axis=1).max() / (
        8 * tolerance
    )
    assert fine[-1] == pytest.approx(points[-1], abs=1e-3)
    # the path length is that of the motion
    assert chunks[-1].s0 + chunks[-1].phase_s[-1] == pytest.approx(
        np.linalg.norm(np.diff(fine, axis=0), axis=1).sum(), rel=1e-3
    )

    interpolator = ReferencePulse([100.0] * 3, np.zeros(3))
    pulses = [part for chunk in chunks for part in interpolator.pulses(chunk)] + list(
        interpolator.settle()
    )
    made = sum((part.step.sum(axis=0, dtype=np.int64) for part in pulses), np.zeros(3, np.int64))
    assert made.tolist() == np.rint(points[-1] * 100.0).astype(int).tolist()
    assert interpolator.error_blu <= 0.5 + 1e-6


def any_mill(rng):
    """Return a machine with limits over three decades, of unequal axes, along the path, or both."""
    kind = rng.integers(3)
    along, each = kind > 0, kind != 1
    accel, jerk = 10 ** rng.uniform(1.5, 4.5), 10 ** rng.uniform(3, 6)
    axes = {}
    for name in AXES:
        a, j = 10 ** rng.uniform(-0.7, 0.7, 2) if rng.random() < 0.5 else (1.0, 1.0)
        axes[name] = Axis(
            steps_per_mm=100.0,
            max_velocity=10 ** rng.uniform(1.5, 3),
            max_acceleration=accel * a if each else None,
            max_jerk=jerk * j if each else None,
        )
    path = PathLimits(
        max_feed=10 ** rng.uniform(1, 3),
        max_tangential_acceleration=accel * 10 ** rng.uniform(-0.5, 0.5) if along else None,
        max_normal_acceleration=accel * 10 ** rng.uniform(-0.5, 0.5) if along else None,
        max_jerk=jerk * 10 ** rng.uniform(-0.5, 0.5) if along else None,
    )
    return Machine(axes=axes, path=path)


@settings(max_examples=share(2000, 3), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_corners_are_legal_on_any_machine(seed):
    rng = np.random.default_rng(seed)
    points, mill = random_chain(rng), any_mill(rng)
    tolerance = 10 ** rng.uniform(-3, -0.3)
    chunks, ahead = planned(points, tolerance, mill, 10 ** rng.uniform(0, 2.5))
    assert not ahead.audit.violations
    off, _ = distances(
        sampled(chunks, duration(chunks) / 3000), np.concatenate((np.zeros((1, 3)), points))
    )
    assert off.max() <= tolerance * (1 + 1e-6)


@settings(max_examples=share(500, 3), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_corners_are_the_same_wherever_plans_are_cut(seed):
    rng = np.random.default_rng(seed)
    stops, ahead = planned(
        [(10, 0, 0), (5, 9, 0), (0, 0, 0), (0, -4, 9)], 0.0, feed=10 ** rng.uniform(1, 2.5)
    )
    stops = [
        replace(chunk, path=replace(chunk.path, tolerance=np.full(len(chunk.path), 0.01)))
        for chunk in stops
    ]
    slices = [
        part
        for chunk in stops
        for part in cut(chunk, rng.uniform(0, chunk.duration, int(rng.integers(1, 12))))
    ]

    def after(plans):
        corners = CornerMotions(ahead.limits, Audit(ahead.limits))
        return [part.plan for part in (*corners.passed(plans), *corners.flush())]

    expected, chunks = after(stops), after(slices)
    audit = Audit(ahead.limits)
    for chunk in chunks:
        audit.check(chunk)
    # Rarely the rounding of the input gives another motion of nearly the same duration.
    assert duration(chunks) == pytest.approx(duration(expected), rel=1e-3)
    points, others = sampled(chunks, 1e-3), sampled(expected, 1e-3)
    both = min(len(points), len(others))
    assert points[:both] == pytest.approx(others[:both], abs=0.02)


@pytest.mark.parametrize("seed", range(share(500, 3)))
def test_holds_and_overrides_near_corners_are_legal(seed):
    rng = np.random.default_rng(seed)
    points, mill, tolerance = random_chain(rng), random_mill(rng), 10 ** rng.uniform(-3, -0.5)
    control = Control()
    ahead = LookAhead(mill, control, slice_s=10 ** rng.uniform(-2, -0.5))
    mode = PathMode("t.nc", 1, "blend", tolerance)
    path = build([mode, lines(points, 10 ** rng.uniform(1, 2.5))], axes=AXES, start=np.zeros(3))
    chunks = []
    for item in ahead.plan(path):
        if isinstance(item, Held):
            control.resume()
            continue
        chunks.append(item)
        match rng.integers(6):
            case 0:
                control.hold()
            case 1:
                control.override(float(10 ** rng.uniform(0.5, 2.3)))
    assert not ahead.audit.violations
    assert_legal(chunks, mill, (1e-3,))
    off, _ = distances(
        sampled(chunks, max(1e-3, duration(chunks) / 20_000)),
        np.concatenate((np.zeros((1, 3)), points)),
    )
    assert off.max() <= tolerance * (1 + 1e-6)
    interpolator = ReferencePulse([100.0] * 3, np.zeros(3))
    pulses = [part for chunk in chunks for part in interpolator.pulses(chunk)] + list(
        interpolator.settle()
    )
    made = sum((part.step.sum(axis=0, dtype=np.int64) for part in pulses), np.zeros(3, np.int64))
    assert made.tolist() == np.rint(points[-1] * 100.0).astype(int).tolist()
