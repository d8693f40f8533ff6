r"""Ramps to rest: the shortest one on a straight path, and those with which a search begins.

      a |\ a0
        |  \          t
      --+---\--------------/----
        |     \          /
        |      \________/  -peak

From any acceleration, the jerk -J leads to the largest deceleration, and J from there to rest. That
is the fastest motion to rest under one bound on acceleration and one on jerk. Where the path bends,
the search of :mod:`cnc.kernels.planner.stopping` begins with such a ramp, and with the plan under a
clock that slows.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from cnc.kernels.planner.intervals import Intervals
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.phases import PHASE, Phases, phase_at
from cnc.kernels.planner.slowed_clock import slowed_clock, slower_copy

EVEN = 0.98
"""A bound varies by less than 2 % over the ramp and with the speed; else a search may find a
shorter one.
"""

MORE = 0.01
"""Part by which bounds are raised that leave no ramp from the acceleration at the start."""

SHORT = 1e-12
"""s; shorter phases are left out."""

LATER = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Parts of the time of a ramp with constant bounds for which the plan is followed before, where its
clock can't be slowed at once.
"""

CLOCKS = ((150, 0.97), (300, 0.97), (300, 0.9), (300, 0.8), (300, 0.6))
"""Ways to slow the clock that are tried in turn: steps in the time of a ramp with constant bounds,
and the share of the limits that a slow motion may use. A smaller share leaves more for mistakes.
"""


def ramp_to_rest(s: float, v: float, a: float, accel: float, jerk: float) -> Phases | None:
    """Return the fastest motion to rest from a speed and an acceleration.

    Args:
        s: arc length at the start, mm.
        v: speed there, mm/s.
        a: acceleration there, mm/s^2.
        accel: largest acceleration.
        jerk: largest jerk, mm/s^3.

    Returns:
        The phases; None where the motion would go back, or exceeds the acceleration already.
    """
    if abs(a) > accel or v <= 0.0 or (a < 0.0 and v < 0.5 * a * a / jerk):
        return None
    peak = min(accel, sqrt(jerk * v + 0.5 * a * a))
    cruise = max(v + 0.5 * a * a / jerk - peak * peak / jerk, 0.0) / peak
    steps = [(max(a, 0.0) / jerk, -jerk), ((min(a, 0.0) + peak) / jerk, -jerk)]
    steps += [(cruise, 0.0), (peak / jerk, jerk)]
    rows = []
    for duration, j in steps:
        if duration > SHORT:
            rows.append((duration, s, v, a, j))
            s, v, a = phase_at(duration, s, v, a, j)
    return np.array(rows, PHASE)


def even_ramp(known: Intervals, s: float, v: float, a: float) -> Phases | None:
    """Return the fastest motion to rest over intervals whose bounds hardly vary.

    Args:
        known: the intervals from ``s`` on.
        s: arc length, mm.
        v: speed, mm/s.
        a: acceleration, mm/s^2.

    Returns:
        The phases; None where the bounds vary more, along the path or with the speed, or where a
        junction needs a constant speed.
    """
    count = 1
    while count <= len(known.end):
        accel = float(known.accel[:count, 0].min())
        jerk = float(known.jerk[:count, 0].min())
        phases = ramp_to_rest(s, v, a, accel, jerk)
        if phases is None:
            return None
        needed = int(np.searchsorted(known.end, phase_at(*phases[-1].tolist())[0])) + 1
        if needed <= count:
            break
        count = needed
    else:
        return None
    within = slice(0, count)
    fastest = v + 0.5 * max(a, 0.0) ** 2 / jerk
    even = (
        accel >= EVEN * known.accel[within].max()
        and jerk >= EVEN * known.jerk[within].max()
        and fastest <= known.speed[within].min()
        and not known.flat[within].any()
    )
    return phases if even else None


def firm_ramp(plan: Phases, near: Intervals) -> Phases | None:
    """Return the fastest motion to rest under the least bounds nearby.

    Args:
        plan: the plan so far, from the start of the ramp to rest.
        near: the intervals behind the start, about as far as the ramp goes.

    Returns:
        The phases, which may exceed limits; None if there are none.
    """
    _, s, v, a, _ = plan[0].tolist()
    return _ramp_from(s, v, a, float(near.accel[:, -1].min()), float(near.jerk[:, -1].min()))


def fastest_ramp(plan: Phases, near: Intervals) -> float:
    """Return the time of the fastest motion to rest under the largest bounds nearby, s.

    No motion along the path rests sooner. Arguments as of :func:`firm_ramp`.
    """
    _, s, v, a, _ = plan[0].tolist()
    ramp = _ramp_from(s, v, a, float(near.accel.max()), float(near.jerk.max()))
    return 0.0 if ramp is None else float(ramp["duration"].sum())


def ramp_by_clock(
    plan: Phases,
    near: Intervals,
    known: Intervals,
    machine: LimitArrays,
) -> tuple[Phases, float] | None:
    """Return a ramp to rest by slowing the clock of the plan.

    Args:
        plan: the plan so far, from the start of the ramp to rest.
        near: the intervals behind the start, about as far as the ramp goes.
        known: the intervals behind the start, farther than any ramp goes.
        machine: the limits.

    Returns:
        The phases, and where they come to rest, mm; None if none of them is legal.
    """
    firm = firm_ramp(plan, near)
    if firm is None:
        return None
    time = float(firm["duration"].sum())
    for row in _beginnings(plan, time):
        for steps, use in CLOCKS:
            legal, phases, rest = slowed_clock(plan[row:], known, machine, time / steps, use)
            if legal and _may_slow(known, plan[row]["s"], rest):
                return np.concatenate((plan[:row], phases)), rest
    return None


def copy_by_clock(
    plan: Phases,
    time: float,
    known: Intervals,
    machine: LimitArrays,
    part: float,
    later: Sequence[float] = LATER,
) -> tuple[int, Phases] | None:
    """Return a ramp to a copy of the plan at a part of its speed, and that copy.

    Args:
        plan: the plan so far, from the start of the ramp to rest.
        time: about that of a ramp to rest, s.
        known: the intervals behind the start, farther than any ramp goes.
        machine: the limits.
        part: of the speed; the copy may be a little slower.
        later: see LATER.

    Returns:
        The number of phases of the ramp, and all phases; None if no ramp is legal.
    """
    for row in _beginnings(plan, time, later):
        for steps, use in CLOCKS:
            ramp, phases = slower_copy(plan[row:], known, machine, time / steps, use, part)
            if not ramp:
                continue
            end = phases[ramp]["s"] if ramp < len(phases) else known.end[-1]
            if _may_slow(known, plan[row]["s"], end):
                return row + ramp, np.concatenate((plan[:row], phases))
    return None


def _may_slow(known: Intervals, begin: float, end: float) -> bool:
    """Return whether there is no stretch of constant speed between two places."""
    first = int(np.searchsorted(known.end, begin, side="right"))
    last = int(np.searchsorted(known.end, end, side="left"))
    return not known.flat[first : last + 1].any()


def _beginnings(plan: Phases, time: float, later: Sequence[float] = LATER) -> list[int]:
    """Return the phases of a plan at which a ramp of about ``time`` seconds may begin."""
    begun = np.cumsum(plan["duration"])[:-1]
    rows = np.unique(np.searchsorted(begun, time * np.array(later), side="right") + 1)
    return [0, *rows[rows < len(plan)].tolist()]


def _ramp_from(s: float, v: float, a: float, accel: float, jerk: float) -> Phases | None:
    """Return a ramp to rest as :func:`ramp_to_rest`; the bounds are raised where it needs more."""
    accel = max(accel, abs(a) * (1.0 + MORE))
    if a < 0.0 < v:
        jerk = max(jerk, 0.5 * a * a / v * (1.0 + MORE))
    return ramp_to_rest(s, v, a, accel, jerk)
