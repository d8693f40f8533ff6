"""The time from a hold to rest on circles and helices, compared with an independent optimum.

Machines, curves and feeds are random, and holds come at random moments: also while the motion
speeds up, slows, or changes to another feed.
"""

import math

import numpy as np
import pytest

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.planner.limits import Limits
from cnc.planner.lookahead import SLICE, LookAhead
from cnc.planner.plan import PlanChunk
from tests.support.planner.motions import arc, path_of
from tests.support.planner.stop_optimum import Helix, shortest_time_to_rest
from tests.support.soak import share

LONGER = 1.1
"""The motion rests within a slice and this times the shortest ramp."""


def random_mill(rng: np.random.Generator) -> Machine:
    """Return a machine with limits of each axis, and perhaps along the path too."""
    acceleration = float(10 ** rng.uniform(2.5, 3.9))
    jerk = acceleration * float(10 ** rng.uniform(1.0, 2.0))
    parts = 10 ** rng.uniform(-0.7, 0.0, 3) if rng.random() < 0.5 else np.ones(3)
    axes = {
        letter: Axis(
            steps_per_mm=100.0,
            max_velocity=400.0 * part,
            max_acceleration=acceleration * part,
            max_jerk=jerk * part,
        )
        for letter, part in zip("xyz", parts.tolist(), strict=True)
    }
    path = PathLimits(max_feed=300.0)
    if rng.random() < 0.5:
        path = PathLimits(
            max_feed=300.0,
            max_tangential_acceleration=acceleration,
            max_normal_acceleration=acceleration,
            max_jerk=jerk,
        )
    return Machine(axes=axes, path=path)


CLOCK = 98
"""A case in which only slowing the clock of the plan is fast enough."""

SEEDS = [
    pytest.param(seed, marks=pytest.mark.soak) for seed in range(share(500, 1)) if seed != CLOCK
]


@pytest.mark.parametrize("seed", [*SEEDS, CLOCK])
def test_a_hold_on_a_curve_takes_about_as_long_as_the_shortest_ramp(seed):
    rng = np.random.default_rng([seed, 83])
    mill = random_mill(rng)
    radius = float(10 ** rng.uniform(0.5, 1.8))
    turns = round(float(rng.uniform(0.7, 4.0)), 2)
    rise = float(rng.choice([0.0, 0.3])) * radius * turns
    feed = float(10 ** rng.uniform(1.0, 2.4))
    blocks = [
        PathMode("", 1, "exact-path"),
        arc((0, 0, 0), (radius, 0), turns, feed=feed, rise=rise),
    ]
    whole = sum(
        item.duration for item in LookAhead(mill).plan(path_of(blocks)) if hasattr(item, "duration")
    )
    length = math.hypot(2.0 * math.pi * radius * turns, rise)
    moment = rng.uniform(0.0, whole)
    other_feed = rng.uniform(0.0, moment) if rng.random() < 0.5 else math.inf
    control, end, requested, ramp = Control(), 0.0, 0.0, 0.0
    for item in LookAhead(mill, control).plan(path_of(blocks)):
        if isinstance(item, PlanChunk):
            end = item.t0 + item.duration
            if end >= other_feed:
                control.override(int(rng.choice([30, 60, 150])))
                other_feed = math.inf
            if end >= moment and not control.held:
                control.hold()
                requested = end
                v, a = float(item.phase_v[-1]), float(item.phase_a[-1])
                if v == 0.0:
                    return
                along = (item.s0 + float(item.phase_s[-1])) / length
                helix = Helix(radius, rise / length, math.pi + 2.0 * math.pi * turns * along)
                ramp = shortest_time_to_rest(helix, v, a, Limits.of(mill))
        elif isinstance(item, Held):
            if math.isfinite(ramp):
                assert end - requested <= SLICE + LONGER * ramp
            return


@pytest.mark.parametrize(
    ("radius", "y_part", "jerk", "feed", "longest"),
    [
        (20.0, 0.4, 8000.0, 100.0, 1.05),
        (20.0, 1.0, 10_000.0, 300.0, 1.05),
        (5.0, 1.0, 10_000.0, 300.0, 1.15),
    ][:: share(1, 3)],
)
def test_a_hold_on_a_circle_at_the_limits_takes_the_shortest_ramp(
    radius, y_part, jerk, feed, longest
):
    """Bounds that leave acceleration for any direction took 1.7, 1.3 and 2.3 times as long.

    On the smallest circle the axes are at their jerk: there is only one legal motion for a while.
    """
    axes = {
        letter: Axis(
            steps_per_mm=100.0,
            max_velocity=400.0,
            max_acceleration=1000.0 * part,
            max_jerk=jerk * part,
        )
        for letter, part in (("x", 1.0), ("y", y_part), ("z", 1.0))
    }
    mill = Machine(axes=axes, path=PathLimits(max_feed=300.0))
    blocks = [PathMode("", 1, "exact-path"), arc((0, 0, 0), (radius, 0), 3.3, feed=feed)]
    control, end, requested, ramp = Control(), 0.0, 0.0, 0.0
    for item in LookAhead(mill, control).plan(path_of(blocks)):
        if isinstance(item, Held):
            assert end - requested <= longest * ramp
            return
        if isinstance(item, PlanChunk):
            end = item.t0 + item.duration
            s = item.s0 + float(item.phase_s[-1])
            if s > 10.35 * radius and not control.held:
                control.hold()
                requested, helix = end, Helix(radius, 0.0, math.pi + s / radius)
                v, a = float(item.phase_v[-1]), float(item.phase_a[-1])
                ramp = shortest_time_to_rest(helix, v, a, Limits.of(mill))
    pytest.fail("the motion was not held")


def test_a_hold_follows_the_plan_until_the_axes_leave_it_space():
    """For 0.05 s there is hardly a motion but the plan. The shortest ramp is that of
    :func:`shortest_time_to_rest`; searches that began earlier took 0.53 s.
    """
    given = {"x": (2818.931, 45412.161), "y": (679.570, 10947.668), "z": (1130.122, 18205.936)}
    axes = {
        letter: Axis(steps_per_mm=100.0, max_velocity=80.0, max_acceleration=a, max_jerk=j)
        for letter, (a, j) in given.items()
    }
    mill = Machine(axes=axes, path=PathLimits(max_feed=300.0))
    bow = arc((0, 0, 0), (0.300435, 0), 6.95, feed=37.354807, rise=0.626407)
    control, end, requested, ramp = Control(), 0.0, 0.0, 0.12821
    for item in LookAhead(mill, control).plan(path_of([PathMode("", 1, "exact-path"), bow])):
        if isinstance(item, Held):
            assert end - requested <= SLICE + LONGER * ramp
            return
        if isinstance(item, PlanChunk):
            end = item.t0 + item.duration
            if item.s0 + float(item.phase_s[-1]) > 7.1 and not control.held:
                control.hold()
                requested = end
                assert float(item.phase_v[-1]) == pytest.approx(11.469, abs=0.01)
    pytest.fail("the motion was not held")
