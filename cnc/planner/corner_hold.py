r"""Requests inside a motion past corners.

For a hold, the fastest motion to rest is sought (:mod:`cnc.planner.kernels.corner_hold`). For an
override the curve stays, and its clock changes: with r(u) the motion as planned, the motion is
r(u(t)), with

    velocity r' u',   acceleration r'' u'^2 + r' u'',   jerk r''' u'^3 + 3 r'' u' u'' + r' u'''

in each axis, and likewise along the path with the speed for r'. So the clock u is a coordinate
along a path with these derivatives, and the plan so far is u' = 1:

     u' |----.             wanted: the new feed as a part of the largest speed
        |     `.
        |       `-------   a slower copy, to the end of the chain
        +-----------------

The clock slows as that of the window's plan does (:mod:`cnc.planner.kernels.slowed_clock`). At
u' > 1 the limits leave no room at any instant with an axis at its limit. So a motion may be made
faster only as far as all of it stays inside the limits, and behind the ramp up it comes back to
u' = 1 at the end of the chain.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_eval
from cnc.planner.corners import empty_path, new_chunk, numbered, path_arrays
from cnc.planner.finished import ChainLeft
from cnc.planner.kernels.arrays import PHASE, LimitArrays, Phases, phase_at
from cnc.planner.kernels.corner_hold import Chained, stop_within
from cnc.planner.kernels.corner_legs import LEG_STEPS, MOST_STEPS
from cnc.planner.kernels.corner_pieces import steps_size
from cnc.planner.kernels.intervals import LEVELS, SAMPLES, Intervals
from cnc.planner.kernels.timed import timed_motion
from cnc.planner.limits import Limits
from cnc.planner.phases import cut_at_length
from cnc.planner.plan import PlanChunk, empty_plan, first_piece
from cnc.planner.slowing import KEPT, copy_by_clock

Floats = NDArray[np.float64]

GAIN = 1.05
"""A clock that would be faster by less stays as it is."""

USED = 0.9
"""Part of the fastest even clock to which it speeds up: the rest is for the ramp."""

INSIDE = 1.0 - 1e-3
"""Part of the limits that a faster clock uses."""

HALVINGS = 6
"""Number of times that the gain of a faster clock is halved to fit into the rest of a chain."""


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
    changing = np.flatnonzero((plan.phase_a[:-1] != 0.0) | (plan.phase_j != 0.0))
    # A clock that changes goes on to the end of its ramp.
    first = int(changing[-1]) + 1 if len(changing) else 0
    if first == len(plan.phase_j):
        return None
    known, speed = _timed_intervals(plan, first)
    leg = [
        left.legs - ceil((len(plan.path) - first_piece(plan, m)) / LEG_STEPS)
        for m in range(first, len(plan.phase_j))
    ]
    with np.errstate(divide="ignore"):
        wanted = float((limits.feeds(legs)[leg] / speed).min())
    if wanted < KEPT:
        clock = _slower(known, float(speed[0]), wanted, limits)
    else:
        clock = _faster(known, wanted, limits)
    return None if clock is None else _with_clock(plan, first, known, clock)


def _timed_intervals(plan: PlanChunk, first: int) -> tuple[Intervals, Floats]:
    """Return the phases from one on as intervals of time, and the largest speed of each, mm/s.

    Behind the axes, a further column has the speed along the path and its derivatives.
    """
    path, count, axes = plan.path, len(plan.phase_j) - first, len(plan.path.axes)
    t = plan.phase_t[first:] - plan.phase_t[first]
    q, samples = np.empty((4, axes)), np.empty((count, SAMPLES, 3, axes + 1))
    for m in range(count):
        k, v = first_piece(plan, first + m), float(plan.phase_v[first + m])
        at = int(path.at[k])
        for n in range(SAMPLES):
            s = plan.phase_s[first + m] + v * (t[m + 1] - t[m]) * n / (SAMPLES - 1)
            u = min(max(float(s - plan.piece_s[k]), 0.0), float(path.length[k]))
            curve_eval(int(path.kind[k]), path.data, at, u, q)
            for order in range(3):
                samples[m, n, order, :axes] = q[order + 1] * v ** (order + 1)
            samples[m, n, :, axes] = timed_motion(path.data, at, q, v, 0.0, 0.0)[:3]
    one, free = np.ones(count), np.full((count, LEVELS), inf)
    known = Intervals(
        end=t[1:],
        speed=one,
        top=one,
        accel=free,
        jerk=free,
        flat=np.zeros(count, np.bool_),
        share=one,
        reliable=np.full(count, inf),
        sampled=np.stack((t[:-1], t[1:]), axis=1),
        samples=samples,
    )
    return known, samples[:, :, 0, axes].max(axis=1)


def _with_path(limits: Limits) -> LimitArrays:
    """Return the limits of the columns of :func:`_timed_intervals`."""
    machine = limits.arrays
    return machine._replace(
        tangential_acceleration=inf,
        tangential_jerk=inf,
        axis_velocity=np.append(machine.axis_velocity, inf),
        axis_acceleration=np.append(machine.axis_acceleration, machine.tangential_acceleration),
        axis_jerk=np.append(machine.axis_jerk, machine.tangential_jerk),
    )


def _slower(known: Intervals, v: float, wanted: float, limits: Limits) -> Phases | None:
    """Return phases of the clock that slow it to a part of its rate; None for none.

    Args:
        known: the motion as intervals of time.
        v: its speed at the start, mm/s.
        wanted: part of the rate.
        limits: of the machine.
    """
    left = float(known.end[-1])
    # On a straight ramp to rest the mean speed is half of that at the start.
    ramp = 2.0 * limits.stopping_distance(v, any_direction=True) / v if v > 0.0 else inf
    if not ramp < left:
        return None
    begins = np.concatenate(([0.0], known.end[:-1]))
    plan = np.zeros(len(begins), PHASE)
    plan["duration"], plan["s"], plan["v"] = known.end - begins, begins, 1.0
    # Another beginning is tried with the next slice.
    found = copy_by_clock(plan, ramp, known, _with_path(limits), wanted, later=())
    if found is None:
        return None
    count, phases = found
    return phases if float(phases["duration"][:count].sum()) < left else None


def _faster(known: Intervals, wanted: float, limits: Limits) -> Phases | None:
    """Return phases of the clock that raise its rate for a while; None for none.

    The ramps keep to bounds for the largest values of each axis, wherever these are.

    Args:
        known: the motion as intervals of time.
        wanted: the rate.
        limits: of the machine.
    """
    v, a, j = np.abs(known.samples).max(axis=(0, 1))
    machine, moves = _with_path(limits), v > 0.0
    v, a, j = v[moves], a[moves], j[moves]
    most_v, most_a, most_j = (
        INSIDE * each[moves]
        for each in (machine.axis_velocity, machine.axis_acceleration, machine.axis_jerk)
    )
    with np.errstate(divide="ignore"):
        rates = (most_v / v).min(), np.sqrt(most_a / a).min(), np.cbrt(most_j / j).min()
    left, rate = float(known.end[-1]), min(wanted, USED * float(min(rates)))
    if not rate < inf:
        return None
    for _ in range(HALVINGS):
        if rate < GAIN:
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            spare = most_j - j * rate**3
            change = min(((most_a - a * rate**2) / v).min(), (spare / (6.0 * a * rate)).min())
            sudden = ((spare - 3.0 * a * rate * change) / v).min()
        if not sudden > 0.0:
            return None
        gain = rate - 1.0
        if gain >= change**2 / sudden:
            bend, steady = change / sudden, gain / change - change / sudden
        else:
            bend, steady = sqrt(gain / sudden), 0.0
        # Half of both ramps is at either side of their mean rate.
        cruise = left - (2.0 * bend + steady) * (1.0 + rate)
        if cruise > 0.0:
            steps = [(bend, sudden), (steady, 0.0), (bend, -sudden), (cruise / rate, 0.0)]
            steps += [(bend, -sudden), (steady, 0.0), (bend, sudden)]
            rows, state = [], (0.0, 1.0, 0.0)
            for duration, jerk in steps:
                if duration > 0.0:
                    rows.append((duration, *state, jerk))
                    state = phase_at(duration, *state, jerk)
            return np.array(rows, PHASE)
        rate = 1.0 + 0.5 * gain
    return None


def _with_clock(plan: PlanChunk, first: int, known: Intervals, clock: Phases) -> OtherClock:
    """Return a plan of which the phases from one on are under a clock."""
    rows = []
    for m in range(len(known.end)):
        rate, before = float(plan.phase_v[first + m]), float(known.end[m - 1]) if m else 0.0
        here, clock = clock, clock[:0]
        if m + 1 < len(known.end):
            here, clock = cut_at_length(here, float(known.end[m]))
        here = here.copy()
        here["s"] = plan.phase_s[first + m] + rate * (here["s"] - before)
        for name in ("v", "a", "j"):
            here[name] *= rate
        rows.append(here)
    phases = np.concatenate(rows)
    # The clock ends without a change of its rate.
    duration, _, v, a, j = phases[-1].tolist()
    end = v + duration * (a + 0.5 * duration * j)
    return OtherClock(
        replace(
            plan,
            phase_t=np.concatenate(
                (plan.phase_t[:first], plan.phase_t[first] + np.cumsum([0.0, *phases["duration"]]))
            ),
            phase_s=np.concatenate((plan.phase_s[:first], phases["s"], plan.phase_s[-1:])),
            phase_v=np.concatenate((plan.phase_v[:first], phases["v"], [end])),
            phase_a=np.concatenate((plan.phase_a[:first], phases["a"], [0.0])),
            phase_j=np.concatenate((plan.phase_j[:first], phases["j"])),
        ),
        end / float(plan.phase_v[len(plan.phase_j) - 1]),
    )
