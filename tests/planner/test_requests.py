"""Requests of the operator at random moments take effect within the promised time.

That is a slice of motion, which the board has, and the ramp; where the axes leave no room inside a
motion past corners, the rest of that motion comes before.

The ramp by theory. Its unit is the straight ramp to rest along the slowest axis, 2 sqrt(v / J) at
low speeds. On a bend, an axis may be at its limit of jerk at every instant, against the ramp. Then
the motion follows its plan under a clock of the rate 1 - e, which lowers that jerk by 3 e J, and
may use this for a change of its own: v e'' = 3 J e. So e grows by exp(2 sqrt 3) in each ramp. From
TOUCH, by which a motion may exceed its limits, to 1/2 it takes ln(5000) / (2 sqrt 3) = 2.46 ramps.
At half the speed 7/8 of the jerk are free, and the rest of the way to rest takes sqrt(4 / 7) =
0.76. No motion is locked for so long by one axis: with an acceleration against its speed, an axis
reverses within sqrt 2 ramps. A motion that speeds up on a line needs less: sqrt(1/2) ramps to end
its acceleration, and at most sqrt 2 from the speed there, together 2.12.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Held, PathMode
from cnc.model.operator_control import Control
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import SLICE, Window
from tests.support.planner.motions import lines, machine, path_of
from tests.support.planner.requests import (
    FAMILIES,
    answered,
    feeds_of,
    last_above,
    random_program,
    stop_time,
    stop_time_of_joints,
)
from tests.support.soak import share

RAMPS = 2.5
"""A motion slows within this many ramps: 2.46, see above."""

RAMPS_TO_REST = 4.0
"""It rests within this many: 2.46 + 0.76, and 0.76 for a bend that it may have to cross before."""

BEHIND = 2.0
"""At the new feed the motion loses no more than so many of these ramps, a slice, and the rest of
a motion past corners.
"""

REQUESTS = share(10_000, 20)
EACH = share(25, 2)
"""Requests for one program. They share the plans of the runs with which they are compared."""

PROGRAMS = [
    (family, number) for family in FAMILIES for number in range(REQUESTS // (EACH * len(FAMILIES)))
]

ONCE_LATE = [
    # The motion is slow in a bend, and rests within 0.4 s; it is above the new feed between.
    ("exact NURBS", 68, 2070658700),
    # The feed changes on a leg, at the end of which a corner is passed.
    ("polygons", 1, 3468868244),
    # A stop on a stretch of constant speed that is longer than the way to rest.
    pytest.param("five axes", 3, 2786744923, marks=pytest.mark.soak),
    # The motion past corners is slow at the corners as planned, and need not be at 1 %.
    ("polygons", 0, 2660910373),
    ("corners", 2, 2381464420),
]
"""Programs with requests that were once late."""


@pytest.mark.parametrize(
    ("family", "number", "seed"), [*((*each, None) for each in PROGRAMS), *ONCE_LATE]
)
def test_a_request_takes_effect_within_the_promised_time(
    family: str, number: int, seed: int | None, tmp_path: Path
) -> None:
    """The message has the seed, which is a new one in each run of ``make soak``."""
    if seed is None:
        seed = share(int(np.random.default_rng().integers(2**32)), 4)
    rng = np.random.default_rng([seed, FAMILIES.index(family), number])
    program = random_program(family, rng, tmp_path)
    for trial in range(EACH):
        answer = answered(program, rng)
        if answer is None:
            continue
        message = (seed, family, number, trial, answer)
        ramps = RAMPS if answer.request > 0.0 else RAMPS_TO_REST
        late = SLICE + ramps * answer.ramp
        # A slice of slow motion is longer: it covers 0.01 mm.
        assert answer.delay <= answer.chain + 1.5 * SLICE, message
        assert answer.effect <= answer.chain + late, message
        assert answer.behind <= BEHIND * answer.ramp + answer.chain + SLICE, message


NEAR_A_REST = [
    # The plan comes to rest by itself.
    ("exact NURBS", 0, 29111829, 0),
    # It slows for a bend, and can come to rest in 0.06 s.
    ("exact NURBS", 0, 29111829, 6),
]
"""Programs, and seeds of the moment. A bend locks the motion, but it rests within 0.6 ramps."""


@pytest.mark.parametrize(
    ("family", "number", "seed", "moment", "percent"),
    share(
        [(*each, percent) for each in NEAR_A_REST for percent in (1.0, 20.0)],
        [(*each, percent) for each, percent in zip(NEAR_A_REST, (1.0, 20.0), strict=True)],
    ),
)
def test_a_lower_feed_comes_no_later_than_a_rest(family, number, seed, moment, percent, tmp_path):
    """Where no ramp to the new feed is in time, the motion rests for an instant."""
    rng = np.random.default_rng([seed, FAMILIES.index(family), number])
    program = random_program(family, rng, tmp_path)
    answer = answered(program, np.random.default_rng(moment), (percent,))
    assert answer is not None
    assert answer.effect <= 0.6 * answer.ramp, answer


ONCE_REFUSED = [
    # A cusp turns within 1e-7 mm. There the refinement exceeded a jerk by 1.7 %.
    ("exact NURBS", 10, 282819491, 100.0, 120.0, 1.9133),
    # The ramp to a slower copy of the plan ends within 1e-8 mm of its rest.
    ("exact NURBS", 3, 4277817357, 100.0, 10.0, 1.9905),
    # A plan at a lower feed begins within 1e-13 mm of its rest.
    ("lines, arcs, helices", 14, 29112250, 100.0, 70.0, 0.1162),
    ("finishing in three axes", 19, 29112250, 100.0, 70.0, 1.1173),
]
"""Family, number and seed of a program, override before and request, %, and moment, s. The audit
refused a plan that the request led to.
"""


@pytest.mark.parametrize(("family", "number", "seed", "before", "percent", "moment"), ONCE_REFUSED)
def test_the_audit_accepts_what_follows(family, number, seed, before, percent, moment, tmp_path):
    rng = np.random.default_rng([seed, FAMILIES.index(family), number])
    program = random_program(family, rng, tmp_path)
    control = Control(before)
    ahead, end, last = LookAhead(program.machine, control), 0.0, None
    for last in ahead.plan(program.path):
        assert isinstance(last, PlanChunk)
        end = last.t0 + last.duration
        if end >= moment:
            control.override(percent)
    assert last is not None
    assert last.phase_v[-1] == 0.0
    assert end > moment


def test_a_stop_that_is_not_possible_yet_is_tried_again(tmp_path):
    """Near a pole no ramp to rest is found for 0.2 s. The rest of the plan takes 4.3 s."""
    rng = np.random.default_rng([29112217, FAMILIES.index("five axes"), 1])
    program = random_program("five axes", rng, tmp_path)
    ahead = LookAhead(program.machine, Control(30.0))
    for item in ahead.plan(program.path):
        if isinstance(item, PlanChunk) and item.t0 + item.duration >= 10.0362:
            break
    ramp = stop_time_of_joints(item, program.machine)
    stopped = list(ahead.ramp_down())
    taken = stopped[-1].t0 + stopped[-1].duration - (item.t0 + item.duration)
    assert taken <= SLICE + RAMPS_TO_REST * ramp


def test_a_lower_feed_near_a_pole_is_planned_with_the_next_slice(tmp_path):
    """The ramp to rest is longer there than a search goes at first."""
    rng = np.random.default_rng([29112217, FAMILIES.index("five axes"), 1])
    program = random_program("five axes", rng, tmp_path)
    control = Control(60.0)
    ahead, end, requested, planned = LookAhead(program.machine, control), 0.0, math.nan, math.nan
    for item in ahead.plan(program.path):
        if not isinstance(item, PlanChunk):
            continue
        if not math.isnan(requested) and math.isnan(planned) and ahead.feed_factor == 0.5:
            planned = end
        end = item.t0 + item.duration
        if math.isnan(requested) and end >= 11.6:
            control.override(50.0)
            requested = end
    assert planned - requested <= 1.5 * SLICE


def test_a_hold_of_slow_motion_that_is_refused_is_tried_again_after_a_slice(monkeypatch):
    """Other slices of motion at 0.02 mm/s take half a second: they cover 0.01 mm."""
    tries: list[float] = []
    accepted = LookAhead._accepted

    def refused_at_first(ahead, factor):
        tries.append(ahead._window.clock.seconds)
        return accepted(ahead, factor) and len(tries) > 4

    monkeypatch.setattr(LookAhead, "_accepted", refused_at_first)
    control, end = Control(), 0.0
    for item in LookAhead(machine(), control).plan(path_of([lines([(0.2, 0.0, 0.0)], 0.02)])):
        if isinstance(item, Held):
            break
        end = item.t0 + item.duration
        if end >= 3.0:
            control.hold()
    assert len(tries) >= 5
    assert max(np.diff(tries)) <= 0.5 * SLICE + 1e-9


@pytest.mark.soak
def test_a_hold_of_slow_motion_near_a_pole_is_tried_again_after_a_slice(tmp_path):
    """Other slices of motion at 0.02 mm/s take half a second: they cover 0.01 mm."""
    rng = np.random.default_rng([29112250, FAMILIES.index("five axes"), 39])
    program = random_program("five axes", rng, tmp_path)
    control, end = Control(), 0.0
    for item in LookAhead(program.machine, control).plan(program.path):
        if isinstance(item, Held):
            break
        if isinstance(item, PlanChunk):
            end = item.t0 + item.duration
            if end >= 31.432 and not control.held:
                control.hold()
                requested, ramp = end, stop_time_of_joints(item, program.machine)
    assert end - requested <= SLICE + RAMPS_TO_REST * ramp


@pytest.mark.parametrize(("before", "at", "percent"), [(60.0, 0.35, 1.0), (100.0, 1.45, 10.0)])
def test_a_ramp_that_would_break_a_limit_goes_on_from_a_copy_slowed_by_less(
    tmp_path, before, at, percent
):
    """The plan is at the limits of jerk; where it turns from one to another there is no ramp."""
    rng = np.random.default_rng([30114406, FAMILIES.index("rosettes"), 48])
    program = random_program("rosettes", rng, tmp_path)
    feeds, control = feeds_of(program), Control(before)
    ahead = LookAhead(program.machine, control)
    requested, planned, above, end, ramp = math.nan, math.nan, [], 0.0, 0.0
    for plan in ahead.plan(program.path):
        if not isinstance(plan, PlanChunk):
            continue
        if not math.isnan(requested):
            if math.isnan(planned) and ahead.feed_factor == percent / 100.0:
                planned = end
            if (time := last_above(plan, feeds, percent / 100.0)) is not None:
                above.append(time - requested)
        end = plan.t0 + plan.duration
        if math.isnan(requested) and end >= at:
            control.override(percent)
            requested, ramp = end, stop_time_of_joints(plan, program.machine)
    assert planned - requested <= 1.5 * SLICE
    assert max(above) <= SLICE + RAMPS * ramp


def test_a_window_without_a_legal_result_leaves_work_for_the_next_ones(tmp_path):
    """The rest of the plan would stay as it is for want of work, and be 0.22 s behind."""
    rng = np.random.default_rng([30113001, FAMILIES.index("rosettes"), 39])
    program = random_program("rosettes", rng, tmp_path)
    ahead, end = LookAhead(program.machine, control := Control(30.0)), 0.0
    for plan in ahead.plan(program.path):
        if isinstance(plan, PlanChunk):
            end = plan.t0 + plan.duration
            if end >= 0.4:
                control.override(120.0)
    assert end <= 0.4 + 2.1


def test_a_request_that_waits_is_tried_again_after_half_a_slice(monkeypatch):
    """Near a pole no ramp may be legal at a moment, and one 0.05 s later: it is kept in time."""
    tries: list[float] = []
    override = Window.override

    def refused_at_first(window, feed_factor):
        tries.append(window.clock.seconds)
        return len(tries) > 4 and override(window, feed_factor)

    monkeypatch.setattr(Window, "override", refused_at_first)
    path = path_of([lines([(400.0, 0.0, 0.0)], 50.0)])
    control, end = Control(100.0), 0.0
    for plan in LookAhead(machine(), control).plan(path):
        end = plan.t0 + plan.duration
        if end >= 1.0 and not tries:
            control.override(50.0)
    assert len(tries) == 5
    assert max(np.diff(tries)) <= 0.5 * SLICE + 1e-9


def test_a_lower_feed_is_kept_in_time_near_a_pole(tmp_path):
    """The joints go so far on the short path that the limits along it hide the way of a ramp."""
    percent, moment = 1.0, 10.85
    rng = np.random.default_rng([30110731, FAMILIES.index("five axes"), 26])
    program = random_program("five axes", rng, tmp_path)
    feeds, control = feeds_of(program), Control(60.0)
    requested, above, ramp = math.nan, [], 0.0
    for plan in LookAhead(program.machine, control).plan(program.path):
        if not isinstance(plan, PlanChunk):
            continue
        end = plan.t0 + plan.duration
        if not math.isnan(requested):
            if (time := last_above(plan, feeds, percent / 100.0)) is not None:
                above.append(time - requested)
            if end > requested + 1.0:
                break
        elif end >= moment:
            control.override(percent)
            requested, ramp = end, stop_time_of_joints(plan, program.machine)
    assert max(above) <= SLICE + RAMPS * ramp


def test_a_ramp_that_comes_to_rest_at_the_end_of_the_path_is_followed_to_it(tmp_path):
    """Behind the ramp the copy has one phase, which covers no length."""
    rng = np.random.default_rng([30110731, FAMILIES.index("short segments"), 33])
    program = random_program("short segments", rng, tmp_path)
    answered(program, rng)
    answer = answered(program, rng)
    assert answer is not None
    assert answer.delay <= 1.5 * SLICE


def test_a_slice_that_ends_just_behind_a_rest_is_legal(tmp_path):
    """The two microseconds behind it cover no length, and belong to the next line."""
    rng = np.random.default_rng([30110731, FAMILIES.index("five axes"), 4])
    program = random_program("five axes", rng, tmp_path)
    control, end = Control(60.0), 0.0
    for plan in LookAhead(program.machine, control).plan(program.path):
        if isinstance(plan, PlanChunk):
            end = plan.t0 + plan.duration
            if end >= 4.0:
                break
            if end >= 1.75:
                control.override(200.0)
    assert end >= 4.0


def test_a_motion_that_keeps_the_new_feed_for_a_while_is_planned_from_there(tmp_path):
    """A traverse has no feed, and ends slowly; the lines behind it are above the new feed."""
    rng = np.random.default_rng([30112611, FAMILIES.index("five axes"), 7])
    program = random_program("five axes", rng, tmp_path)
    feeds = feeds_of(program)
    control, above, requested = Control(), [], False
    for plan in LookAhead(program.machine, control).plan(program.path):
        if not isinstance(plan, PlanChunk):
            continue
        if requested:
            above.append(last_above(plan, feeds, 0.9))
        elif plan.t0 + plan.duration >= 1.29:
            control.override(90.0)
            requested = True
    assert len(above) > 5
    assert above == [None] * len(above)


def test_a_lower_feed_is_kept_where_a_motion_past_corners_ends_speeding_up(tmp_path):
    """The clock of the chain is raised to the new feed; behind it the acceleration has to end."""
    rng = np.random.default_rng([30113345, FAMILIES.index("corners"), 6])
    program = random_program("corners", rng, tmp_path)
    feeds, control, above, requested = feeds_of(program), Control(), [], math.nan
    for plan in LookAhead(program.machine, control).plan(program.path):
        if not isinstance(plan, PlanChunk):
            continue
        if math.isnan(requested):
            if plan.t0 + plan.duration >= 0.55:
                control.override(10.0)
                requested = plan.t0 + plan.duration
        elif (time := last_above(plan, feeds, 0.1)) is not None:
            above.append(time - requested)
    assert above
    assert max(above) < 2.0 * SLICE


INSIDE = 0.95
"""Part of the requests inside of long motions past corners for which there is room at once."""


def test_an_override_takes_effect_inside_a_motion_past_corners(tmp_path: Path) -> None:
    """Else it would wait for the end of that motion."""
    late, count = [], 0
    for number in range(share(400, 15)):
        rng = np.random.default_rng([11, number])
        program = random_program("polygons", rng, tmp_path)
        answer = answered(program, rng, (10.0, 25.0, 50.0, 70.0, 90.0), inside=2.0 * SLICE)
        if answer is None:
            continue
        count += 1
        assert answer.effect <= answer.chain + SLICE + RAMPS * answer.ramp, (number, answer)
        if answer.effect > SLICE + RAMPS * answer.ramp:
            late.append((number, answer))
    assert count > share(80, 3)
    assert len(late) <= (1.0 - INSIDE) * count, late


def test_a_second_request_changes_the_clock_of_a_chain_again(tmp_path: Path) -> None:
    """At 1 % the rest of a chain takes half a minute. A higher feed does not wait for its end."""
    rng = np.random.default_rng([2381464420, FAMILIES.index("corners"), 2])
    program = random_program("corners", rng, tmp_path)
    control = Control()
    ahead = LookAhead(program.machine, control)
    end, requested, planned, chain = 0.0, math.nan, math.nan, 0.0
    for item in ahead.plan(program.path):
        assert isinstance(item, PlanChunk)
        if not math.isnan(requested) and math.isnan(planned) and ahead.feed_factor == 1.0:
            planned = end
        end = item.t0 + item.duration
        if control.feed_override == 100.0 and math.isnan(requested) and ahead.chain_left > 0.3:
            control.override(1.0)
        elif ahead.feed_factor == 0.01 and math.isnan(requested):
            requested, chain = end, ahead.chain_left
            control.override(100.0)
    assert chain > 10.0
    assert planned - requested <= 1.5 * SLICE
    assert end < requested + 0.5 * chain


def rosette(petals: int, chords: int) -> np.ndarray:
    """Return points of a rosette of 60 mm, from its first one on."""
    u = np.linspace(0.0, 2.0 * math.pi, chords + 1)
    radius = 20.0 + 10.0 * np.cos(petals * u)
    points = np.stack((radius * np.cos(u), radius * np.sin(u), np.zeros(chords + 1)), axis=1)
    return (points - points[0]).round(3)[1:]


@pytest.mark.parametrize("percent", [50.0, 20.0, 80.0][:: share(1, 3)])
@pytest.mark.parametrize("moment", [0.3, 1.0, 1.7][:: share(1, 2)])
def test_a_lower_feed_is_reached_where_the_axes_are_at_their_limits(percent, moment):
    """Nearly every moment of the motion has an axis at its limit of jerk or acceleration."""
    axis = Axis(steps_per_mm=100.0, max_velocity=300.0, max_acceleration=1000.0, max_jerk=10_000.0)
    mill = Machine(axes=dict.fromkeys("xyz", axis), path=PathLimits(max_feed=300.0))
    path = list(path_of([PathMode("t.nc", 1, "blend", 0.01), lines(rosette(7, 600), 100.0)]))
    control, requested, above, speed = Control(), math.nan, 0.0, 0.0
    for plan in LookAhead(mill, control).plan(path):
        assert isinstance(plan, PlanChunk)
        end = plan.t0 + plan.duration
        if math.isnan(requested) and end >= moment:
            control.override(percent)
            requested, speed = end, float(plan.phase_v.max())
        elif end > requested:
            lines_of = dict.fromkeys(plan.path.line.tolist(), 100.0)
            above = last_above(plan, lines_of, percent / 100.0) or above
    assert speed > 60.0
    assert above - requested <= stop_time(speed, mill)


def test_a_request_that_cannot_be_planned_is_not_reported_as_planned(monkeypatch):
    """As long as the window refuses an override, the factor in effect stays the one before."""
    monkeypatch.setattr("cnc.planner.window.Window.override", lambda window, factor: False)
    control = Control()
    ahead = LookAhead(machine(), control)
    for _ in ahead.plan(path_of([lines([(50.0, 0.0, 0.0)])])):
        control.override(50.0)
        assert ahead.feed_factor == 1.0


@pytest.mark.parametrize("family", FAMILIES)
def test_no_value_exceeds_its_limit(family: str, tmp_path: Path) -> None:
    """The audit allows for rounding; the planner needs none of it."""
    for number in range(share(100, 3)):
        rng = np.random.default_rng([7, FAMILIES.index(family), number])
        program = random_program(family, rng, tmp_path)
        ahead = LookAhead(program.machine)
        plans = [item for item in ahead.plan(program.path) if isinstance(item, PlanChunk)]
        if not plans:
            continue
        shares = ahead.audit.shares(plans[0].path.axes)
        assert max(shares.values()) <= 1.0 + 1e-7, (number, shares)
