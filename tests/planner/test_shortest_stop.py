"""The shortest ramp to rest along a path: against the closed form, and on random curves."""

from types import SimpleNamespace

import pytest

from benchmarks.holds import held, programs
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.planner.kernels.stopping import FAR, NEAR_BY, shortest_ramp
from cnc.planner.known_path import KnownPath
from cnc.planner.limits import Limits
from cnc.planner.slowing import ramp_to_rest
from tests.support.planner.motions import lines, path_of

ACCEL, JERK = 1000.0, 20_000.0


def straight(length: float):
    """Return a machine's limits and the intervals of a straight path along x, mm."""
    axes = {
        letter: Axis(steps_per_mm=100.0, max_velocity=300.0, max_acceleration=ACCEL, max_jerk=JERK)
        for letter in "xyz"
    }
    limits = Limits.of(Machine(axes=axes, path=PathLimits(max_feed=300.0)))
    known_path = KnownPath(limits)
    (path,) = path_of([lines([(length, 0.0, 0.0)], feed=300.0)])
    end = known_path.add(path, None, None).end
    return limits, known_path.intervals(limits, 0.0, end), end


CASES = [
    (v, a, share, part)
    for v, a in ((120.0, 0.0), (40.0, 300.0), (90.0, -600.0), (8.0, 0.0))
    for share, part in ((0.3, FAR), (0.6, FAR), (0.95, FAR), (0.95, NEAR_BY))
    if share * ACCEL >= abs(a)
]


@pytest.mark.parametrize(("v", "a", "share", "part"), CASES)
def test_on_a_straight_path_it_is_the_ramp_of_the_closed_form(v, a, share, part):
    """The search begins with a ramp that is more gentle than it has to be."""
    limits, known, end = straight(200.0)
    first = ramp_to_rest(0.0, v, a, share * ACCEL, share * JERK)
    best = ramp_to_rest(0.0, v, a, ACCEL, JERK)
    assert first is not None and best is not None
    length = first[-1]["s"] + first[-1]["duration"] * first[-1]["v"] / 3.0
    legal, ramp, rest = shortest_ramp(first, length, end, part, known, limits.arrays)
    assert legal
    assert ramp["duration"].sum() == pytest.approx(best["duration"].sum(), rel=0.03)
    assert ramp["duration"].sum() >= best["duration"].sum() * (1.0 - 2e-4)
    assert (ramp["v"][0], ramp["a"][0]) == pytest.approx((v, a))
    whole = ramp["duration"] * (
        ramp["v"] + ramp["duration"] * (ramp["a"] / 2.0 + ramp["duration"] * ramp["j"] / 6.0)
    )
    assert whole.sum() == pytest.approx(rest, rel=1e-9)


def test_it_rests_before_a_place():
    limits, known, _ = straight(200.0)
    v, a = 60.0, 700.0
    first = ramp_to_rest(0.0, v, a, 0.95 * ACCEL, 0.95 * JERK)
    best = ramp_to_rest(0.0, v, a, ACCEL, JERK)
    rests = [ramp[-1]["s"] + ramp[-1]["duration"] * ramp[-1]["v"] / 3.0 for ramp in (first, best)]
    before = 1.02 * rests[0]
    legal, _, place = shortest_ramp(first, rests[0], before, FAR, known, limits.arrays)
    assert legal
    assert rests[1] * (1.0 - 1e-3) <= place < before
    assert not shortest_ramp(first, rests[0], 0.8 * rests[1], FAR, known, limits.arrays)[0]


@pytest.mark.parametrize(
    ("seed", "family", "number", "moment", "most"),
    [
        (777123, "exact NURBS", 12, 0.0791, 0.01),
        (50515, "exact NURBS", 46, 0.8319, 0.01),
        (777123, "short segments", 66, 0.3148, 0.12),
        (881122, "exact NURBS", 5, 0.4396, 0.03),
    ],
)
def test_a_hold_on_a_curve_is_hardly_later_than_the_axes_permit(seed, family, number, moment, most):
    """These rested 0.065, 0.063, 0.738 and 0.150 s beyond a slice and 1.1 times that bound.

    Each was at a state from which the motion can only just slow.
    """
    *_, program = programs(seed, number + 1, [family])
    outcome = held(program, SimpleNamespace(uniform=lambda low, high: moment))
    assert outcome.over <= most
