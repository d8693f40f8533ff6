"""A hold inside a motion past corners: it comes to rest there, within the tolerance."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import corners, holds
from cnc.compiled.jit import interpreted
from cnc.model.blocks import AnalogOutput, Held, PathMode
from cnc.model.motion_commands import command_array
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import curve_eval
from cnc.planner.audit import Audit
from cnc.planner.finished import Finished, FinishedPart
from cnc.planner.kernels import timed
from cnc.planner.kernels.arrays import PHASE
from cnc.planner.kernels.corner_legs import LEG_STEPS, STEPS
from cnc.planner.kernels.corner_motion import fastest_motion
from cnc.planner.kernels.corner_rows import new_rows
from cnc.planner.kernels.corner_tube import Tube, set_knots
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.phases import slice_end
from cnc.planner.plan import PlanChunk
from cnc.session.run_pulses import CommandsInMotion
from tests.support.planner.corners import PER_AXIS, assert_legal, distances, duration
from tests.support.planner.motions import AXES, lines, sampled
from tests.support.soak import share

is_timed = interpreted(timed.is_timed)

SLICE = 0.02
ZIGZAG = np.cumsum([(3.0, 0.0, 0.0), (1.0, 3.0, 0.0), (3.0, -1.0, 0.0), (0.0, -3.0, 1.0)], axis=0)
"""Corners that are passed together."""


def planning(points, tolerance=0.05, slice_s=SLICE, feed=60.0):
    """Return a planner, its plans of a path within a tolerance, and the operator's control."""
    control = Control()
    ahead = LookAhead(PER_AXIS, control, slice_s=slice_s)
    blocks = [PathMode("t.nc", 1, "blend", tolerance), lines(points, feed)]
    path = build(blocks, axes=AXES, start=np.zeros(3), short_legs=4)
    return ahead, ahead.plan(path), control


def past_corners(plan):
    """Return whether all of a plan is a motion past corners."""
    path = plan.path
    return all(
        is_timed(int(kind), path.data, int(at)) for kind, at in zip(path.kind, path.at, strict=True)
    )


def motions():
    """Return the slices that pass corners."""
    return [plan for plan in planning(ZIGZAG)[1] if past_corners(plan)]


def test_a_finished_motion_is_handed_out_in_slices():
    whole = [plan.duration for plan in planning(ZIGZAG)[1]]
    assert len(whole) > 10
    assert max(whole) <= SLICE + 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_the_last_slice_ends_at_rest_exactly(seed):
    points = np.cumsum(np.random.default_rng([seed, 44]).uniform(-3.0, 3.0, (6, 3)), axis=0)
    last = list(planning(points)[1])[-1]
    assert (last.phase_v[-1], last.phase_a[-1]) == (0.0, 0.0)


def test_slices_are_the_motion_without_an_operator():
    sliced = list(planning(ZIGZAG)[1])
    blocks = [PathMode("t.nc", 1, "blend", 0.05), lines(ZIGZAG, 60.0)]
    path = build(blocks, axes=AXES, start=np.zeros(3), short_legs=4)
    whole = list(LookAhead(PER_AXIS).plan(path))
    assert duration(sliced) == pytest.approx(duration(whole), abs=1e-9)
    # States at the ends of a motion are rounded, and the plan is cut at other times.
    assert sampled(sliced, 1e-3) == pytest.approx(sampled(whole, 1e-3), abs=1e-7)


def held_in(points, tolerance, moment, feed=60.0, override=100.0):
    """Return the plans up to a hold, those to rest and those behind it, for a hold at a moment.

    The moment counts from the start of the first motion past corners.
    """
    _, plans, control = planning(points, tolerance, feed=feed)
    control.override(override)
    before, stop, after, begin = [], [], [], None
    for item in plans:
        if isinstance(item, Held):
            control.resume()
            continue
        if not control.held:
            (after if stop else before).append(item)
        else:
            stop.append(item)
        if begin is None and past_corners(item):
            begin = item.t0
        if begin is not None and not stop and item.t0 + item.duration > begin + moment:
            control.hold()
    return before, stop, after


def random_corners(seed):
    """Return a random polygon, and its tolerance."""
    rng = np.random.default_rng([seed, 52])
    points = np.cumsum(10 ** rng.uniform(-0.3, 0.7) * rng.normal(size=(6, 3)), axis=0)
    return points, float(10 ** rng.uniform(-2.5, -0.7)), float(rng.uniform(0.0, 0.3))


@pytest.mark.parametrize("seed", range(share(300, 6)))
def test_a_hold_rests_on_a_leg_within_the_tolerance_and_goes_on_to_the_end(seed):
    """By samples of the whole motion, beside the polygon."""
    points, tolerance, moment = random_corners(seed)
    before, stop, after = held_in(points, tolerance, moment)
    corners_ = np.concatenate((np.zeros((1, 3)), points))
    whole = before + stop + after
    assert_legal(whole, PER_AXIS, (1e-3, 1e-4))
    there, back = distances(sampled(whole, 2e-4), corners_)
    assert there.max() <= tolerance
    assert back.max() <= tolerance + 0.02
    assert (after[-1].phase_v[-1], after[-1].phase_a[-1]) == (0.0, 0.0)
    assert position(after[-1], -1) == pytest.approx(points[-1], abs=1e-9)
    if stop:
        assert (stop[-1].phase_v[-1], stop[-1].phase_a[-1]) == (0.0, 0.0)
        rest = position(stop[-1], -1)
        assert distances(rest[None], corners_)[0] == pytest.approx(0.0, abs=1e-9)
        assert position(after[0], 0) == pytest.approx(rest, abs=1e-9)


def test_an_override_without_room_is_pending_until_the_motion_past_corners_ends(monkeypatch):
    monkeypatch.setattr("cnc.planner.lookahead.under_clock", lambda *_: None)
    ahead, plans, control = planning(ZIGZAG)
    begins = []
    for item in plans:
        now = item.t0 + item.duration
        if ahead.feed_factor == 1.0 and control.feed_override == 50.0:
            assert ahead.pending >= max(ahead.chain_left, SLICE)
            begins.append(now + ahead.pending)
        else:
            assert ahead.pending == 0.0
        if past_corners(item):
            control.override(50.0)
    assert len(begins) > 5
    assert begins[:-1] == pytest.approx([begins[0]] * (len(begins) - 1), abs=1e-6)
    assert ahead.feed_factor == 0.5


@pytest.mark.parametrize(
    ("seed", "percent"),
    share(
        [(seed, percent) for seed in range(100) for percent in (10.0, 30.0, 70.0)],
        [(seed, (10.0, 30.0, 70.0)[seed % 3]) for seed in range(3)],
    ),
)
def test_a_hold_and_another_override_follow_an_override_inside_the_same_motion(seed, percent):
    """The hold begins in the ramp of the first override, or behind it."""
    points, tolerance, _ = random_corners(seed)
    _, plans, control = planning(points, tolerance)
    plain = duration(list(planning(points, tolerance)[1]))
    requests = [lambda: control.override(percent), control.hold, lambda: control.override(100.0)]
    whole = []
    for item in plans:
        if isinstance(item, Held):
            control.resume()
            continue
        whole.append(item)
        if requests and past_corners(item) and (len(requests) > 1 or not control.held):
            requests.pop(0)()
    there, back = distances(sampled(whole, 2e-4), np.concatenate((np.zeros((1, 3)), points)))
    assert_legal(whole, PER_AXIS, (1e-3, 1e-4))
    assert there.max() <= tolerance
    assert back.max() <= tolerance + 0.02
    assert position(whole[-1], -1) == pytest.approx(points[-1], abs=1e-9)
    assert (whole[-1].phase_v[-1], whole[-1].phase_a[-1]) == (0.0, 0.0)
    assert not requests or duration(whole) >= plain


def position(plan, phase):
    """Return the position at the start of a phase; -1 for the end of the plan."""
    s, piece = float(plan.phase_s[phase]), int(np.searchsorted(plan.piece_s, plan.phase_s[phase]))
    piece = min(max(piece - (0 if phase == 0 and piece == 0 else 1), 0), len(plan.path) - 1)
    found, path = np.empty((4, 3)), plan.path
    kind, at = int(path.kind[piece]), int(path.at[piece])
    here = s - float(plan.piece_s[piece])
    curve_eval(kind, path.data, at, curve_inv_arclen(kind, path.data, at, here), found)
    return found[0]


def test_a_hold_under_a_feed_override_does_not_wait_either():
    """The feeds are those in effect: the motion is faster than the programmed ones."""
    before, stop, _ = held_in(ZIGZAG, 0.05, 0.08, feed=15.0, override=200.0)
    velocity, _, past = holds.state(before[-1], stop[0].t0)
    assert past
    assert np.linalg.norm(velocity) > 1.05 * 15.0
    assert duration(stop) - stop[0].t0 < 0.08


def test_a_stop_has_the_lines_of_its_legs():
    """Line k of the program is leg k - 1. The motion goes on in the line in which it rests."""
    before, stop, after = held_in(ZIGZAG, 0.05, 0.05)
    named = [int(line) for plan in before + stop + after for line in plan.path.line]
    assert named == sorted(named)
    assert stop[-1].path.line[-1] == after[0].path.line[0]
    assert sum(plan.duration for plan in stop) > 0.0


def test_commands_of_legs_take_effect_once():
    """A hold in the middle of a chain: each leg behind the first changes an output at its start."""
    changes = {k: (AnalogOutput("t.nc", k + 1, 0, float(k), True),) for k in range(len(ZIGZAG))}
    many = replace(lines(ZIGZAG, 60.0), commands=command_array(len(ZIGZAG), changes))
    control, done, held = Control(), [], False
    sender = CommandsInMotion(lambda block, _: done.append(block.value))
    blocks = [PathMode("t.nc", 1, "blend", 0.05), many]
    path = build(blocks, axes=AXES, start=np.zeros(3), short_legs=4)
    for item in LookAhead(PER_AXIS, control, slice_s=SLICE).plan(path):
        if isinstance(item, Held):
            control.resume()
        elif isinstance(item, PlanChunk):
            sender.add(item)
            if past_corners(item) and not held:
                held = True
                control.hold()
    sender.finish()
    assert done == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("seed", range(share(200, 10)))
def test_a_stop_on_a_straight_leg_is_the_shortest_one(seed):
    """The place of the end is free: on one leg the shortest ramp is known, by ruckig."""
    rng = np.random.default_rng([seed, 67])
    tube, rows, c, spans, ramp = straight(rng)
    assert fastest_motion(tube, rows, c, spans)
    set_knots(tube, spans, rows.t)
    took = float(rows.t[-3] - rows.t[2])
    assert ramp * (1.0 - 1e-3) <= took <= 1.02 * ramp
    place = float(spans[-1]) * tube.unit
    assert c[-1] == pytest.approx(tube.start[0] + place * tube.along[0], abs=1e-9)


def straight(rng):
    """Return a leg with a state of motion on it, a slow motion to rest, and the shortest ramp."""
    d = 2
    along = rng.normal(size=(1, d))
    along /= np.linalg.norm(along)
    jerk, pull = 10 ** rng.uniform(3.0, 5.0), 10 ** rng.uniform(2.0, 3.5)
    speed = 10 ** rng.uniform(0.0, 2.0)
    slope = rng.uniform(-0.7, 0.7) * min(pull, math.sqrt(jerk * speed))
    ramp = holds.shortest_ramp(speed, slope, pull, jerk)
    bounds = np.abs(along[0])
    whole = 3.0 * ramp
    ends = np.zeros((2, 3, d))
    ends[0, 1], ends[0, 2] = speed * along[0], slope * along[0]
    tube = Tube(
        np.eye(d),
        np.full(d, math.inf),
        pull * bounds,
        jerk * bounds,
        np.array([[-math.inf] * d, [math.inf] * d]),
        np.array([10.0 * (speed + pull * ramp)]),
        math.inf,
        math.inf,
        math.inf,
        0.01,
        np.zeros((1, d)),
        along,
        np.array([[-math.inf, math.inf]]),
        np.zeros(LEG_STEPS, np.int64),
        np.repeat(np.arange(3), STEPS),
        1.0 / np.repeat(STEPS, STEPS),
        ends,
        speed * ramp,
    )
    spans = np.append(np.log(whole * np.array([0.2, 0.5, 0.3])), 1.5)
    rows = new_rows(LEG_STEPS, d, d)
    set_knots(tube, spans, rows.t)
    c = np.empty((LEG_STEPS + 3, d))
    for k in range(len(c)):
        u = min(max(rows.t[k : k + 3].mean() / whole, 0.0), 1.0)
        c[k] = 1.5 * speed * ramp * (2.0 * u - u * u) * along[0]
    return tube, rows, c, spans, ramp


def rests(seed):
    """Return the time from a hold inside a motion past corners to rest, less that to its end."""
    rng = np.random.default_rng(seed)
    polygon = corners.random_case(corners.FAMILIES[seed % len(corners.FAMILIES)], rng)
    program = holds.Program(holds.POLYGONS, corners.blocks_of(polygon), polygon.machine)
    plain = [item for item in holds.motion(program, Control()) if isinstance(item, PlanChunk)]
    inside = [k for k, plan in enumerate(plain) if past_corners(plan)]
    if not inside:
        return None
    first = inside[int(rng.integers(len(inside)))]
    last = first
    while last + 1 < len(plain) and past_corners(plain[last + 1]):
        last += 1
    control, end = Control(), 0.0
    for number, item in enumerate(holds.motion(program, control)):
        if isinstance(item, Held):
            break
        end = item.t0 + item.duration
        if number == first:
            control.hold()
    asked = plain[first].t0 + plain[first].duration
    return end - asked, duration(plain[: last + 1]) - asked


def test_a_hold_does_not_wait_for_the_end_of_the_motion():
    found = [each for seed in range(share(200, 18)) if (each := rests(seed)) is not None]
    took, left = np.array(found).T
    long = left > 0.15
    assert long.sum() >= 5
    assert (took[long] < left[long]).mean() >= 0.95


@pytest.mark.parametrize("seed", range(share(100, 3)))
def test_a_hold_takes_about_as_long_as_the_shortest_ramp_of_the_axes(seed):
    """No motion is faster than that ramp, and on polygons hardly one is slower by 0.1 of it."""
    rng = np.random.default_rng([seed, 71])
    late = [
        holds.held(program, rng).over
        for program in holds.programs(int(rng.integers(2**31)), 4, [holds.POLYGONS])
    ]
    assert max(late) <= 0.05
    assert np.mean(np.array(late) > 0.01) <= 0.5


def test_a_slice_ends_inside_the_last_phase_that_may_be_sent():
    phases = np.array([(0.5, 0.0, 2.0, 0.0, 0.0), (10.0, 1.0, 2.0, 0.0, 0.0)], PHASE)
    assert slice_end(phases, 0.7, 0.0) == (1, pytest.approx(0.2))
    assert slice_end(phases, 0.3, 3.0) == (1, pytest.approx(1.0))
    assert slice_end(phases, 11.0, 0.0) == (2, 0.0)


@pytest.mark.parametrize("beside", [-1.3e-6, 0.0, 2e-6])
def test_a_slice_does_not_end_so_near_a_rest_that_it_covers_no_length(beside):
    """It would count to the piece on the other side of the rest, whose limits differ."""
    rows = [(1.0, 0.0, 1.0, -1.0, 0.0), (1.0, 0.5, 0.0, 0.0, 3000.0), (1.0, 500.5, 1.5e3, 0.0, 0.0)]
    phases = np.array(rows, PHASE)
    assert slice_end(phases, 1.0 + beside, 0.0) == (1, 0.0)


def test_a_slice_that_is_left_at_the_end_of_the_path_has_a_piece():
    """Within the rounding error of a length, the end of the path is behind its last piece."""
    (whole,) = LookAhead(PER_AXIS).plan(
        build([lines([(3.0, 0.0, 0.0)], 60.0)], axes=AXES, start=np.zeros(3))
    )
    finished = Finished()
    finished.add([FinishedPart(whole, (), 0.0, False, Audit(Limits.of(PER_AXIS)))])
    finished.take(whole.duration - 5e-6)
    rest = finished.take(1.0)
    assert not finished
    assert len(rest.path) == 1
    assert whole.phase_s[-1] - rest.phase_s[0] < 1e-9
