r"""Requests inside a motion past corners.

For a hold, the fastest motion to rest is sought (:mod:`cnc.planner.kernels.corner_hold`). For an
override the curve stays, and its clock changes: with r(u) the motion as planned, the motion is
r(u(t)), with

    velocity r' u',   acceleration r'' u'^2 + r' u'',   jerk r''' u'^3 + 3 r'' u' u'' + r' u'''

in each axis, and likewise along the path with the speed for r'. So the clock u is a coordinate
along a path with these derivatives, and the plan so far is a motion along it:

     u' |----.                   as planned
        |     `.      ,--.    ,--   raised, where the limits leave room and the feed is higher
        |       `----'    `--'      a slower copy, which keeps all feeds
        +-----------------------

The clock slows as that of the window's plan does (:mod:`cnc.planner.kernels.slowed_clock`), to a
copy that keeps the feeds of all legs. The copy is slower than need be on most of the path. So the
clock is planned anew behind the ramp, as motion along a path is: for parts of each timed piece it
has the rate at which the motion keeps the feed of its leg, and bounds for the change of that rate.
Where the motion is at its limits they leave no room, and the clock keeps its rate.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_eval
from cnc.planner.corners import empty_path, new_chunk, numbered, path_arrays
from cnc.planner.finished import ChainLeft
from cnc.planner.kernels.arrays import PHASE, LimitArrays, Phases
from cnc.planner.kernels.corner_hold import Chained, stop_within
from cnc.planner.kernels.corner_legs import LEG_STEPS, MOST_STEPS
from cnc.planner.kernels.corner_pieces import steps_size
from cnc.planner.kernels.intervals import LEVELS, SAMPLES, Intervals
from cnc.planner.kernels.lookahead import PLANNED, plan_window
from cnc.planner.kernels.slowed_clock import pace_wanted
from cnc.planner.kernels.timed import timed_motion
from cnc.planner.known_path import between, joined
from cnc.planner.limits import Limits
from cnc.planner.phases import cut_at_length, end_of, steady_from
from cnc.planner.plan import PlanChunk, empty_plan, first_piece
from cnc.planner.slowing import KEPT, copy_by_clock

Floats = NDArray[np.float64]

PARTS = 8
"""Equal parts of a timed piece with bounds of their own: the speed along a piece varies."""

USED = 0.9
"""Part of the fastest even rate that a clock reaches: the rest is for the change of its rate."""

INSIDE = 1.0 - 1e-3
"""Part of feeds and limits that a raised clock uses."""

WORTHWHILE = 0.01
"""A clock that saves a smaller part of the time stays as it is."""

HALVINGS = 40
"""Of an interval, until a rate is exact."""

CROSSED = 1e-3
"""Part of the rest of a chain: for so long behind it the clock keeps its rate."""

NEAR_END = 1.5e-9
"""mm; a phase that ends so near to the end of a timed piece ends there. The audit compares the
motion on both sides of a place so near to it.
"""


class CornerStop(NamedTuple):
    """A motion to rest on a leg.

    Attributes:
        plan: the motion.
        leg: the leg, counted from the first one of the chain.
        place: from the start of that leg, mm.
    """

    plan: PlanChunk
    leg: int
    place: float


def stop_inside(left: ChainLeft, legs: PathChunk, limits: Limits) -> CornerStop | None:
    """Return the fastest motion to rest that is found; None for none.

    Args:
        left: the rest of a motion past a chain of corners.
        legs: the legs of that chain.
        limits: of the machine.
    """
    path, axes = numbered(legs), len(legs.axes)
    out = empty_path(MOST_STEPS, len(legs.data) + steps_size(MOST_STEPS + 1, axes))
    out_plan = empty_plan(MOST_STEPS, MOST_STEPS)
    chained = Chained(
        path,
        limits.feeds(legs),
        limits.arrays,
        limits.travel,
        path_arrays(left.plan.path),
        left.plan.arrays,
        left.leg,
    )
    count, numbers, leg, place = stop_within(chained, out, out_plan)
    if leg < 0:
        return None
    passed = legs.part(0, leg + 1)
    if passed.commands is not None:
        # What takes effect at the start of the leg that is under way has done so.
        commands = passed.commands.copy()
        commands[: left.leg + 1] = None
        passed = replace(passed, commands=commands)
    plan = PlanChunk(
        path=new_chunk(passed, out, count, numbers),
        piece_s=out_plan.piece_s[: count + 1],
        t0=left.plan.t0,
        s0=left.plan.s0 + float(left.plan.phase_s[0]),
        phase_t=out_plan.t[: count + 1],
        phase_s=out_plan.s[: count + 1],
        phase_v=out_plan.v[: count + 1],
        phase_a=out_plan.a[: count + 1],
        phase_j=out_plan.j[:count],
    )
    return CornerStop(plan, leg, place)


class OtherClock(NamedTuple):
    """The rest of a motion past corners under another clock.

    Attributes:
        plan: the motion.
        pace: its speed at the end as a part of the one before.
    """

    plan: PlanChunk
    pace: float


def under_clock(left: ChainLeft, legs: PathChunk, limits: Limits) -> OtherClock | None:
    """Return the motion under a clock with which it keeps the feeds; None for none.

    There is none where the clock is right as it is, and where another one would take effect later
    than the end of the chain.

    Args:
        left: the rest of a motion past a chain of corners.
        legs: the legs of that chain, as programmed.
        limits: of the machine, with the override.
    """
    plan = left.plan
    timed = _timed(plan)
    piece = np.searchsorted(timed.ends[1:-1], timed.known.sampled[:, 0], side="right")
    leg = left.legs - -(-(len(plan.path) - piece) // LEG_STEPS)
    speed = timed.known.samples[:, :, 0, -1].max(axis=1)
    known, machine, clock = timed.known, _with_path(limits), timed.clock
    with np.errstate(divide="ignore"):
        with_feeds = known._replace(top=limits.feeds(legs)[leg] / speed)
    wanted, count = pace_wanted(clock, with_feeds), 0
    if wanted < KEPT:
        v = float(speed[0] * clock[0]["v"])
        # On a straight ramp to rest the mean speed is half of that at the start.
        ramp = 2.0 * limits.stopping_distance(v, any_direction=True) / v if v > 0.0 else inf
        # Another beginning is tried with the next slice.
        if not ramp < plan.duration:
            return None
        slower = copy_by_clock(clock, ramp, known, machine, wanted, later=())
        if slower is None or slower[1]["duration"][: slower[0]].sum() >= plan.duration:
            return None
        count, clock = slower
    first, end_rate = steady_from(clock, count), end_of(timed.clock)[1]
    end = min(end_rate, _end_below(known, float(with_feeds.top[-1] * speed[-1]), limits))
    raised = _raised(clock[first:], with_feeds, machine, end)
    if raised is not None:
        clock = np.concatenate((clock[:first], raised))
    if not count and clock["duration"].sum() > (1.0 - WORTHWHILE) * plan.duration:
        return None
    return OtherClock(_with_clock(plan, timed, clock), end_of(clock)[1] / end_rate)


class _Timed(NamedTuple):
    """A motion past corners as one along a path, of which the coordinate is a time.

    Attributes:
        known: parts of the pieces as intervals of that time, from the start of the plan on. Behind
            the axes, a further column has the speed along the path and its derivatives.
        rate: (pieces,): the plan's coordinate along each piece per unit of that time.
        ends: (pieces + 1,): the time at the ends of the pieces; the first may be negative.
        clock: the plan.
    """

    known: Intervals
    rate: Floats
    ends: Floats
    clock: Phases


def _timed(plan: PlanChunk) -> _Timed:
    """Return a motion past corners along its time; its rate is 1 at the start of the plan.

    The time goes on evenly from one piece to the next, and so does a clock. So the speeds of the
    plan along two pieces, where they meet, show the ratio of their rates.
    """
    path, count = plan.path, len(plan.path)
    rows = np.zeros(len(plan.phase_j), PHASE)
    rows["duration"], rows["j"] = np.diff(plan.phase_t), plan.phase_j
    rows["v"], rows["a"] = plan.phase_v[:-1], plan.phase_a[:-1]
    t = rows["duration"]
    behind = rows["v"] + t * (rows["a"] + 0.5 * t * rows["j"])
    piece = np.array([first_piece(plan, m) for m in range(len(rows))])
    rate = np.ones(count)
    rate[piece[0]] = rows["v"][0]
    for m in range(1, len(rows)):
        if piece[m] != piece[m - 1]:
            rate[piece[m]] = rate[piece[m - 1]] * rows["v"][m] / behind[m - 1]
    span = path.length / rate
    begin = np.cumsum(np.append(0.0, span[:-1])) - plan.phase_s[0] / rate[0]
    rows["s"] = begin[piece] + (plan.phase_s[:-1] - plan.piece_s[piece]) / rate[piece]
    for name in ("v", "a", "j"):
        rows[name] /= rate[piece]
    axes, n = len(path.axes), count * PARTS
    q, samples = np.empty((4, axes)), np.empty((n, SAMPLES, 3, axes + 1))
    for m in range(n):
        k, before = divmod(m, PARTS)
        at = int(path.at[k])
        for point in range(SAMPLES):
            u = float(path.length[k]) * (before + point / (SAMPLES - 1)) / PARTS
            curve_eval(int(path.kind[k]), path.data, at, u, q)
            for order in range(3):
                samples[m, point, order, :axes] = q[order + 1] * rate[k] ** (order + 1)
            samples[m, point, :, axes] = timed_motion(path.data, at, q, rate[k], 0.0, 0.0)[:3]
    ends = begin[:, None] + span[:, None] * np.arange(PARTS + 1) / PARTS
    one, free = np.ones(n), np.full((n, LEVELS), inf)
    known = Intervals(
        end=ends[:, 1:].reshape(-1),
        speed=one,
        top=np.full(n, inf),
        accel=free,
        jerk=free,
        flat=np.zeros(n, np.bool_),
        share=one,
        reliable=np.full(n, inf),
        sampled=np.stack((ends[:, :-1].reshape(-1), ends[:, 1:].reshape(-1)), axis=1),
        samples=samples,
    )
    known = between(known, 0.0, inf)
    return _Timed(known, rate, np.append(begin, begin[-1] + span[-1]), rows)


def _with_path(limits: Limits) -> LimitArrays:
    """Return the limits of the columns of :class:`_Timed`."""
    machine = limits.arrays
    return machine._replace(
        tangential_acceleration=inf,
        tangential_jerk=inf,
        axis_velocity=np.append(machine.axis_velocity, inf),
        axis_acceleration=np.append(machine.axis_acceleration, machine.tangential_acceleration),
        axis_jerk=np.append(machine.axis_jerk, machine.tangential_jerk),
    )


def _raised(clock: Phases, known: Intervals, machine: LimitArrays, end: float) -> Phases | None:
    """Return a clock that is as fast as bounds for each interval allow; None for none.

    Args:
        clock: the clock so far, from a place on at which its rate is constant.
        known: the motion as intervals of time.
        machine: the limits of its columns.
        end: largest rate at the end.
    """
    if not len(clock):
        return None
    start, rate = float(clock[0]["s"]), float(clock[0]["v"])
    ahead = between(known, start, float(known.end[-1]))
    bounded = _bounded(ahead, machine, rate)
    # At its end the clock keeps its rate; it may rest behind.
    last, length = float(ahead.end[-1]), float(ahead.end[-1]) - start
    end = min(end, float(bounded.speed[-1]))
    rest = Intervals._make(array[-1:] for array in bounded)
    crossed = rest._replace(
        end=rest.end + CROSSED * length, speed=np.array([end]), flat=np.ones(1, np.bool_)
    )
    rest = rest._replace(
        end=crossed.end + length,
        speed=np.array([end]),
        accel=np.full((1, LEVELS), 10.0 * end**2 / length),
        jerk=np.full((1, LEVELS), 100.0 * end**3 / length**2),
        flat=np.zeros(1, np.bool_),
    )
    phases = np.empty(8 * (len(bounded.end) + 2) + 16, PHASE)
    whole = joined((bounded, crossed, rest), (0.0, 0.0, 0.0))
    status, written = plan_window(start, whole, rate, phases)
    if status != PLANNED:
        return None
    phases = phases[:written]
    return cut_at_length(phases[phases["duration"] > 0.0], last)[0]


def _end_below(known: Intervals, feed: float, limits: Limits) -> float:
    """Return the largest rate at the end of a motion from which it keeps a feed, mm/s.

    Behind the end it may still speed up. At the rate r it has the speed v r and the acceleration
    a r^2, whose end raises the speed by (a r^2)^2 / (2 J).
    """
    v, a = known.samples[-1, -1, :2, -1].tolist()
    if a <= 0.0 or not 0.0 < feed < inf:
        return inf
    machine, along = limits.arrays, np.abs(known.samples[-1, -1, 0, :-1]) / v
    with np.errstate(divide="ignore"):
        jerk = min(machine.tangential_jerk, float((machine.axis_jerk / along).min()))
    low, high = 0.0, feed / v
    for _ in range(HALVINGS):
        rate = 0.5 * (low + high)
        if v * rate + (a * rate**2) ** 2 / (2.0 * jerk) <= INSIDE * feed:
            low = rate
        else:
            high = rate
    return low


def _bounded(known: Intervals, machine: LimitArrays, rate: float) -> Intervals:
    """Return intervals of time with bounds on the rate of a clock and on its derivatives.

    Half of what the motion at a rate leaves of a limit of jerk is for the second derivative, the
    rest for the third. Where the limits leave no room at ``rate``, it has to stay.
    """
    v, a, j = (np.abs(known.samples[:, :, order]).max(axis=1) for order in range(3))
    most_v, most_a, most_j = (
        INSIDE * limit
        for limit in (machine.axis_velocity, machine.axis_acceleration, machine.axis_jerk)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        even = np.minimum(np.sqrt(most_a / a), np.cbrt(most_j / j)).min(axis=1)
        fastest = np.minimum(USED * even, (most_v / v).min(axis=1))
        feed = np.maximum(INSIDE * known.top, np.minimum(known.top, rate))
        kept = np.minimum(rate, feed)
        flat = fastest <= kept
        speed = np.where(flat, kept, np.minimum(feed, fastest))
        accel, jerk = np.empty((2, len(speed), LEVELS))
        for level in range(LEVELS):
            r = (speed * (1.0 - 0.1 * level))[:, None]
            spare = most_j - j * r**3
            change = np.fmin((most_a - a * r**2) / v, spare / (6.0 * a * r)).min(axis=1)
            sudden = (spare - 3.0 * a * r * change[:, None]) / v
            accel[:, level] = np.where(flat, 0.0, change)
            jerk[:, level] = np.where(flat, 0.0, np.nanmin(sudden, axis=1))
    return known._replace(speed=speed, top=speed, accel=accel, jerk=jerk, flat=flat)


def _with_clock(plan: PlanChunk, timed: _Timed, clock: Phases) -> PlanChunk:
    """Return a motion past corners under another clock."""
    rows = []
    for k in range(len(plan.path)):
        here, clock = clock, clock[:0]
        if k + 1 < len(plan.path):
            end = float(timed.ends[k + 1])
            near = NEAR_END / timed.rate[k]
            first, after = np.searchsorted(here["s"], (end - near, end + near)).tolist()
            if 0 < first < after:
                # The phases between two ends beside that of the piece last no time.
                early, clock = here[first]["s"], here[after - 1 :].copy()
                here = here[:first].copy()
                here[-1]["duration"] += (end - early) / clock[0]["v"]
                clock[0]["duration"] += (clock[0]["s"] - end) / clock[0]["v"]
                clock[0]["s"] = end
            else:
                here, clock = cut_at_length(here, end)
        here = here.copy()
        here["s"] = plan.piece_s[k] + timed.rate[k] * (here["s"] - timed.ends[k])
        for name in ("v", "a", "j"):
            here[name] *= timed.rate[k]
        rows.append(here)
    phases = np.concatenate(rows)
    # The clock ends without a change of its rate.
    return replace(
        plan,
        phase_t=np.cumsum([0.0, *phases["duration"]]),
        phase_s=np.append(phases["s"], plan.phase_s[-1]),
        phase_v=np.append(phases["v"], end_of(phases)[1]),
        phase_a=np.append(phases["a"], 0.0),
        phase_j=phases["j"].copy(),
    )
