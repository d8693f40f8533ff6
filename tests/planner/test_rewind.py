"""A hold in the part of a plan that corners hold back begins where that part begins."""

import numpy as np
import pytest

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead, Rewind
from cnc.planner.phases import INSTANT
from tests.support.planner.corners import PER_AXIS, duration, planned
from tests.support.planner.motions import AXES, lines
from tests.support.planner.operated import assert_legal_under_operator
from tests.support.soak import share


def zigzag(rng):
    """Return the corners of a path of short legs, mm."""
    legs = rng.uniform(0.7, 1.4, (60, 1)) * [[1.0, 0.0, 0.0]]
    legs[1::2] = rng.uniform(0.7, 1.4, (30, 1)) * [[0.2, 1.0, 0.0]]
    legs[1::4] *= [1.0, -1.0, 1.0]
    return np.cumsum(legs, axis=0)


def planning(points, slice_s):
    """Return a planner, its plans of a path within a tolerance, and the operator's control."""
    control = Control()
    ahead = LookAhead(PER_AXIS, control, slice_s=slice_s)
    path = build(
        [PathMode("t.nc", 1, "blend", 0.05), lines(points, 60.0)],
        axes=AXES,
        start=np.zeros(3),
        short_legs=4,
    )
    return ahead, ahead.plan(path), control


def holds(seed):
    """Return the times of random holds from the request to rest, by that of the longest leg."""
    rng = np.random.default_rng(seed)
    points = zigzag(rng)
    whole = np.diff(np.concatenate((np.zeros((1, 3)), points)), axis=0)
    longest = max(duration(planned([leg], 0.0, feed=60.0)[0]) for leg in whole)
    ahead, plans, control = planning(points, 0.5)
    asked, end, took = None, 0.0, []
    for item in plans:
        if isinstance(item, Held):
            if asked is not None:
                took.append(end - asked)
                asked = None
            control.resume()
            continue
        end = item.t0 + item.duration
        if asked is None and rng.random() < 0.3:
            control.hold()
            asked = end
    assert not ahead.audit.violations
    return [each / longest for each in took]


def test_a_hold_between_corners_rests_within_a_leg():
    """But for requests that fall on a plan that the audit refuses to change there."""
    took = np.array([time for seed in range(share(50, 3)) for time in holds(seed)])
    assert len(took) > 8
    assert (took <= 1.1).mean() >= 0.85


def test_copies_and_chunks_are_kept_only_while_they_are_needed():
    rng = np.random.default_rng(1)
    points = np.concatenate([zigzag(rng) + [60.0 * k, 0.0, 0.0] for k in range(share(6, 2))])
    ahead, plans, _ = planning(points, 0.05)
    most = 0
    for _ in plans:
        most = max(most, len(ahead._rewind._copies) + len(ahead._rewind._added))
    assert 0 < most < 40


def test_a_return_to_the_time_of_a_copy_but_for_rounding_takes_nothing():
    ahead, plans, _ = planning([(60.0, 0.0, 0.0)], 0.1)
    next(plans)
    window, rewind = ahead._window, Rewind()
    assert window.settled and window.clock.seconds > 0.0
    rewind.keep(window)
    time = float(np.nextafter(window.clock.seconds, np.inf))
    assert rewind.window_at(time).clock.seconds == window.clock.seconds


def test_a_time_just_beside_the_end_of_a_phase_is_none_to_return_to():
    """The window would be at the end of the phase, and the motion would jump."""
    ahead, plans, _ = planning([(60.0, 0.0, 0.0)], 0.1)
    next(plans)
    window, rewind = ahead._window, Rewind()
    rewind.keep(window)
    end = window.clock.seconds + float(window._plan.phases[0]["duration"])
    assert rewind.window_at(end - 0.3 * INSTANT) is None
    assert rewind.window_at(end).clock.seconds == pytest.approx(end, abs=1e-12)


def test_a_return_follows_the_plan_that_an_override_changed():
    ahead, plans, _ = planning([(60.0, 0.0, 0.0)], 0.1)
    next(plans)
    window, rewind = ahead._window, Rewind()
    rewind.keep(window)
    window.take(0.1)
    window.override(0.3)
    assert window.prepared()
    rewind.keep(window)
    window.take(0.1)
    back = rewind.window_at(window.clock.seconds)
    assert back.clock.seconds == pytest.approx(window.clock.seconds, abs=1e-12)
    assert back.length == pytest.approx(window.length, abs=1e-9)
    assert back._plan.phases[0]["v"] == pytest.approx(window._plan.phases[0]["v"], abs=1e-9)


@pytest.mark.parametrize("seed", share([4, 18, 23], [4]))
def test_overrides_beside_long_motions_past_corners_do_not_move_the_path(seed):
    """Y is much slower than X, so one motion passes all corners."""
    axes = ((600.0, 3800.0, 24600.0), (23.0, 38.0, 640.0), (12.0, 436.0, 2100.0))
    mill = Machine(
        axes={
            letter: Axis(steps_per_mm=100.0, max_velocity=v, max_acceleration=a, max_jerk=j)
            for letter, (v, a, j) in zip(AXES, axes, strict=True)
        },
        path=PathLimits(max_feed=600.0, chord_error=1e-3),
    )
    points = [(2.4, 9.7, 0.0), (-2.5, 18.4, 0.0), (-11.2, 23.4, 0.0), (-20.4, 19.5, 0.0)]
    blocks = [PathMode("t.nc", 1, "blend", 0.005), lines(points, 90.0)]
    assert_legal_under_operator(np.random.default_rng(seed), mill, blocks, True, 1.0, seed)
