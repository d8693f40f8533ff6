"""The parts of the refinement: intervals, cells and their motion."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.optimum_cases import cases
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.planner.kernels.arrays import PHASE, phase_at
from cnc.planner.kernels.cells import OPEN, cell_phases, length_to_rest, possible_gain
from cnc.planner.kernels.intervals import (
    LEVELS,
    SCRATCH,
    Intervals,
    SumLimits,
    derivatives,
    interval_at,
    largest_shares,
)
from cnc.planner.kernels.lookahead import PLANNED
from cnc.planner.known_path import STANDSTILL, intervals_of
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.phases import plan_to_rest
from cnc.planner.plan import PlanChunk
from cnc.planner.work import Work
from tests.support.planner.hairpins import duration
from tests.support.planner.motions import AXES, arc, lines, machine, path_of
from tests.support.soak import share

END = np.array([1.0, 3.0, 3.0, 4.0])  # the third is a stop


@pytest.mark.parametrize("start", range(5))
@pytest.mark.parametrize(
    ("s", "interval"), [(-1.0, 0), (0.0, 0), (1.0, 1), (2.9, 1), (3.0, 3), (4.0, 3), (4.1, 3)]
)
def test_interval_at_finds_the_same_interval_from_every_start_of_the_search(s, interval, start):
    assert interval_at(s, start, END) == interval


def test_phases_of_a_cell_connect_its_cuts():
    x, slope = np.empty(5), np.empty((5, 4))
    cut = np.array([3.0, -10.0, 4.0, 20.0])
    d = 0.3
    assert cell_phases(*cut, d, x, slope)
    h, j1, j2, v, a = x
    assert 3.0 + h * (-10.0 + 0.5 * h * j1) == pytest.approx(v, rel=1e-12)
    assert (v + h * (a + 0.5 * h * j2), a + h * j2) == pytest.approx((4.0, 20.0), rel=1e-12)
    first = h * (3.0 + h * (-5.0 + h * j1 / 6.0))
    assert first + h * (v + h * (0.5 * a + h * j2 / 6.0)) == pytest.approx(d, rel=1e-12)
    other, unused = np.empty(5), np.empty((5, 4))
    for m in range(4):
        step = np.zeros(4)
        step[m] = 1e-6
        cell_phases(*(cut + step), d, other, unused)
        ahead = other.copy()
        cell_phases(*(cut - step), d, other, unused)
        assert (ahead - other) / 2e-6 == pytest.approx(slope[:, m], rel=1e-6, abs=1e-6)


def test_an_open_cell_is_one_phase_to_rest():
    x, slope = np.empty(5), np.empty((5, 4))
    v, a = 40.0, -300.0
    assert cell_phases(v, a, 0.0, 0.0, OPEN, x, slope)
    h, j, same, middle, acceleration = x
    assert j == same
    assert v + 2.0 * h * (a + h * j) == pytest.approx(0.0, abs=1e-9)
    assert a + 2.0 * h * j == pytest.approx(0.0, abs=1e-9)
    assert (v + h * (a + 0.5 * h * j), a + h * j) == pytest.approx((middle, acceleration))
    length = 2.0 * h * (v + 2.0 * h * (0.5 * a + 2.0 * h * j / 6.0))
    assert length_to_rest(v, a) == pytest.approx(length)
    other, unused = np.empty(5), np.empty((5, 4))
    for m, step in enumerate(([1e-5, 0.0], [0.0, 1e-4])):
        cell_phases(v + step[0], a + step[1], 0.0, 0.0, OPEN, other, unused)
        ahead = other.copy()
        cell_phases(v - step[0], a - step[1], 0.0, 0.0, OPEN, other, unused)
        assert (ahead - other) / (2.0 * step[m]) == pytest.approx(slope[:, m], rel=1e-6)
    assert not cell_phases(v, 0.0, 0.0, 0.0, OPEN, x, slope)


def known_with_a_stop() -> Intervals:
    """Return four intervals with a bound of 10 mm/s, of which the third is a stop."""
    top = np.array([10.0, 10.0, 0.0, 10.0])
    return Intervals(
        end=END,
        speed=top,
        top=top,
        accel=np.full((4, LEVELS), 100.0),
        jerk=np.full((4, LEVELS), 100.0),
        flat=top == 0.0,
        share=np.ones(4),
        reliable=np.full(4, np.inf),
        sampled=np.zeros((4, 2)),
        samples=np.zeros((4, 5, 3, 2)),
    )


@pytest.mark.parametrize(("speed", "gains"), [(9.0, True), (9.9, False)])
def test_a_cruise_can_gain_if_it_is_slower_than_its_bound(speed, gains):
    rows = np.array([(0.1, 0.5, speed, 0.0, 0.0)], PHASE)
    limits = np.full(3, 100.0)
    gain = possible_gain(
        rows, 0, 1, known_with_a_stop(), SumLimits(limits, limits, 1.0 / limits, 1.0 / limits)
    )
    assert gain == pytest.approx(0.1 * (1.0 - speed / 10.0) if gains else 0.0)


@pytest.mark.parametrize(
    ("accel", "bend", "possible"),
    [(89.0, 0.0, 100.0), (-89.0, 0.02, 98.0), (89.0, 0.2, None), (98.0, 0.0, None)],
)
def test_an_acceleration_can_gain_if_the_bends_leave_more(accel, bend, possible):
    """The bends take q'' v^2 of 100 mm/s^2; the speed is at most 10 mm/s."""
    known = known_with_a_stop()
    known.samples[:, 2, 0, 0], known.samples[:, 2, 1, 0] = 1.0, bend
    slow = math.sqrt(10.0**2 - 2.0 * 89.0 * 0.25)
    speed, duration = (slow, (10.0 - slow) / 89.0) if accel > 0.0 else (10.0, (10.0 - slow) / 89.0)
    rows = np.array([(duration, 0.5, speed, accel, 0.0)], PHASE)
    limits = np.array([100.0, 1e9, 1e9])
    gain = possible_gain(rows, 0, 1, known, SumLimits(limits, limits, 1.0 / limits, 1.0 / limits))
    wanted = 0.0 if possible is None else duration * (1.0 - math.sqrt(89.0 / possible))
    assert gain == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize(("behind", "gains"), [(4.0, False), (10.0, True)])
def test_a_deceleration_gains_only_if_no_bound_behind_it_is_reached(behind, gains):
    """It ends at 4 mm/s at the start of the second interval; the motion slows again there."""
    known = known_with_a_stop()
    known.top[1] = behind
    end_s, duration, jerk = float(END[0]), 0.1, 100.0
    before = 4.0 + 0.5 * jerk * duration**2
    start = end_s - duration * (before + duration * (-0.5 * 10.0 + duration * jerk / 6.0))
    rows = np.array(
        [
            (duration, start, before, -10.0, jerk),
            (0.05, end_s, 4.0, 0.0, 0.0),
            (0.1, end_s + 0.2, 4.0, 0.0, -100.0),
        ],
        PHASE,
    )
    limits = np.full(3, 100.0)
    sums = SumLimits(limits, limits, 1.0 / limits, 1.0 / limits)
    wanted = 0.1 * (1.0 - 4.0 / 10.0)
    ramp = possible_gain(rows, 0, 3, known, sums) - possible_gain(rows, 1, 3, known, sums)
    assert ramp == pytest.approx(wanted if gains else 0.0)


@pytest.mark.parametrize("direction", [-1.0, 0.0, 1.0])
def test_rounding_at_a_stop_does_not_hide_the_gain_before_it(direction):
    # The ramp to rest ends a little beyond the stop, with a speed that rounding makes negative.
    ramp = np.nextafter(0.5, 0.5 + direction)
    rows = np.array(
        [(0.1, 0.5, 5.0, 0.0, 0.0), (1.0, 3.0 - 1.0 / 6.0 + 1e-12, ramp, -1.0, 1.0)], PHASE
    )
    limits = np.full(3, 1.0)
    gain = possible_gain(
        rows, 0, 2, known_with_a_stop(), SumLimits(limits, limits, 1.0 / limits, 1.0 / limits)
    )
    assert gain == pytest.approx(0.1 * 0.5)


def test_the_examination_of_a_phase_finds_peaks_between_its_points():
    rng = np.random.default_rng(7)
    limits = SumLimits(
        np.full(2, 100.0), np.full(2, 1000.0), np.full(2, 1 / 100.0), np.full(2, 1 / 1000.0)
    )
    scratch = np.empty((SCRATCH, 2))
    for _ in range(share(300, 30)):
        length, duration = 1.0, 0.06
        v, a = rng.uniform(8.0, 10.0), rng.normal(0.0, 10.0)
        j = rng.normal(0.0, 300.0)
        s_end = duration * (v + duration * (0.5 * a + duration * j / 6.0))
        x = np.linspace(0.0, length, 5)
        bend, twist = (
            rng.normal(0.0, size) * np.sin(rng.uniform(1.0, 3.0) * x + rng.uniform(0.0, 6.0))
            for size in (1.0, 1.0)
        )
        known = Intervals(
            end=np.array([length]),
            speed=np.full(1, 20.0),
            top=np.full(1, 20.0),
            accel=np.full((1, LEVELS), 100.0),
            jerk=np.full((1, LEVELS), 100.0),
            flat=np.zeros(1, bool),
            share=np.ones(1),
            reliable=np.full(1, np.inf),
            sampled=np.array([[0.0, length]]),
            samples=np.stack((np.ones(5), bend, twist), axis=1)[None, :, :, None],
        )
        worst, _, _ = largest_shares(duration, 0.0, v, a, j, s_end, 0, known, limits, scratch)
        dense = 0.0
        for t in np.linspace(0.0, duration, 801):
            s, speed, accel = phase_at(t, 0.0, v, a, j)
            derivatives(0, s, known, scratch)
            q = scratch[:3, 0]
            dense = max(
                dense,
                abs(q[0] * accel + q[1] * speed**2) / 100.0,
                abs(q[0] * j + 3.0 * q[1] * speed * accel + q[2] * speed**3) / 1000.0,
                abs(accel) / 100.0,
                abs(j) / 1000.0,
            )
        assert dense * (1.0 - 1e-3) <= worst <= dense * 1.02


def test_samples_at_a_stop_are_those_at_the_end_of_the_path():
    (path,) = path_of([arc((0, 0, 0), (10, 0), -0.25)])
    known = intervals_of(path, Limits.of(machine(axis=(2400.0, 48000.0))), STANDSTILL, STANDSTILL)
    assert known.flat[-1] and known.speed[-1] == 0.0
    assert known.samples[-1] == pytest.approx(
        np.broadcast_to(known.samples[-2, -1], known.samples[-1].shape), abs=1e-12
    )
    assert known.samples[-1, 0, 0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


CHAIN = [
    (-3.921818, -1.181045, -1.661058),
    (-3.986347, -0.972909, -2.932979),
    (-4.007835, -0.987751, -3.797937),
    (-4.019369, -1.015563, -4.229656),
    (-4.032303, -1.053083, -4.660604),
    (-4.408661, -2.000944, -10.188829),
    (-11.928712, -3.220359, 0.0),
]


def test_intervals_are_cut_for_the_speed_that_the_refinement_reaches():
    axes = {
        letter: Axis(steps_per_mm=160.0, max_velocity=v, max_acceleration=a, max_jerk=j)
        for letter, v, a, j in (
            ("x", 11.1, 2744.6, 53368.0),
            ("y", 16.7, 2868.6, 196577.0),
            ("z", 63.4, 386.8, 22151.0),
        )
    }
    mill = Machine(axes=axes, path=PathLimits(max_feed=23.0))
    ahead = LookAhead(mill)
    list(
        ahead.plan(
            build(
                [PathMode("", 1, "blend", 0.01), lines(CHAIN, 86.6)], axes=AXES, start=np.zeros(3)
            )
        )
    )
    assert not ahead.audit.violations


@pytest.mark.parametrize(
    ("seed", "number", "backwards", "fastest"),
    [
        (271302, 161, False, 0.9014),
        pytest.param(271302, 161, True, 0.9014, id="a window that ends at a cusp"),
        pytest.param(271201, 9, False, 1.2104, id="a window that begins before a cusp"),
    ],
)
def test_a_window_without_a_result_is_solved_otherwise(seed, number, backwards, fastest):
    # The fastest motions are those of a nonlinear solver: benchmarks/optimum.py. Where a window
    # kept its first plan, these took 1.10 and 1.19 times as long.
    family = "exact NURBS"
    (case,) = (case for _, k, case in cases(seed, number + 1, [family]) if k == number)
    mode, curve = case.blocks
    if backwards:
        points = curve.control_points
        curve = replace(
            curve,
            knots=curve.knots[0] + curve.knots[-1] - curve.knots[::-1],
            control_points=points[::-1] - points[-1],
            weights=curve.weights[::-1],
        )
    path = build([mode, curve], axes=AXES, start=np.zeros(3))
    chunks = [item for item in LookAhead(case.machine).plan(path) if isinstance(item, PlanChunk)]
    assert chunks[-1].t0 + chunks[-1].duration < 1.02 * fastest


@pytest.mark.parametrize("seed", share(range(20, 420), (20, 392)))
def test_windows_that_begin_at_speed_are_as_fast_as_on_the_way_back(seed):
    # The seams of the windows lie elsewhere on the way back.
    assert duration(seed) == pytest.approx(duration(seed, backwards=True), rel=0.03)


@pytest.mark.parametrize(("legs", "faster"), [(5.0, True), (400.0, False)])
def test_a_turn_is_refined_if_that_shortens_the_motion_noticeably(legs, faster):
    mill = machine(tangential=1000.0, normal=1000.0, jerk=50_000.0)
    around = arc((legs, 0, 0), (legs, 0.15), 0.5, feed=25.0)
    moves = [lines([(legs, 0, 0)], 25.0), around, lines([(0.0, 0.3, 0.0)], 25.0)]
    (path,) = path_of([PathMode("", 1, "exact-path"), *moves])
    limits = Limits.of(mill)
    known = intervals_of(path, limits, STANDSTILL, STANDSTILL)
    times = []
    for refined in (True, False):
        work = Work() if refined else None
        status, phases = plan_to_rest(0.0, known, 0.0, limits, work=work)
        assert status == PLANNED
        times.append(phases["duration"].sum())
    assert (times[0] < (1.0 - 1e-9) * times[1]) == faster
