"""A new plan from the middle of a motion that has to slow: for a hold, or for a lower feed.

      v  |-----.  lead
         |      `.         slowing        at the new feeds, or at rest
         |        `.____
         |              `.__________________
         +------|-------|------------------- s
              start   works

The motion first ends its acceleration: at once, or, where it slows already, as planned. Behind that
lead, the speed may be above the new feeds on some length, which a search makes as short as
possible. On that length the motion may keep its speed, but not raise it. It ends where no junction
needs a constant speed, since a motion that stops has to start there again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from cnc.planner.acceptance import accepted_plan, exceeding_sections
from cnc.planner.kernels.arrays import PHASE, LimitArrays, Phases, phase_at
from cnc.planner.kernels.intervals import SAMPLES, Intervals
from cnc.planner.kernels.lookahead import PLANNED
from cnc.planner.kernels.refine import refine
from cnc.planner.kernels.slowed_clock import pace_wanted, slowed_clock, slower_copy
from cnc.planner.kernels.stopping import FAR, NEAR_BY, shortest_ramp
from cnc.planner.known_path import KnownPath, between, joined, lowered, rounding_of
from cnc.planner.limits import Limits
from cnc.planner.phases import (
    BEFORE,
    NO_PHASES,
    end_of,
    first_rest,
    first_steady,
    plan_to_rest,
    release,
    steady_from,
)
from cnc.planner.work import Work

# Ramps to rest: the shortest one on a straight path, and those with which a search begins.
#
#       a |\ a0
#         |  \          t
#       --+---\--------------/----
#         |     \          /
#         |      \________/  -peak
#
# From any acceleration, the jerk -J leads to the largest deceleration, and J from there to rest.
# That is the fastest motion to rest under one bound on acceleration and one on jerk. Where the path
# bends, the search of :mod:`cnc.planner.kernels.stopping` begins with such a ramp, and with the
# plan under a clock that slows.

EVEN = 0.98
"""A bound varies by less than 2 % over the ramp and with the speed; else a search may find a
shorter one.
"""

MORE = 0.01
"""Part by which bounds are raised that leave no ramp from the acceleration at the start."""

SHORT = 1e-12
"""s; shorter phases are left out."""

LATER = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Parts of the time of a ramp with constant bounds for which the plan is followed before, where its
clock can't be slowed at once.
"""

LAST_END = LATER[-1] + 1.0
"""Parts of that time after which the ramp that begins last has ended. Until then it is behind the
plan.
"""

COPIES, MOST_RAMPS = 4, 120
"""Number of copies that are followed in turn, each slower than the one before, and number of ramps
that are tried in all: they take about 0.4 CPU s.
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
    tries = iter(range(MOST_RAMPS))
    # One ramp is best: it rises nowhere.
    for copies, row in product((1, COPIES), _beginnings(plan, time, later)):
        count, phases, wanted, rows = 0, plan, part, [row]
        for _ in range(copies):
            slower = _slower_copy(phases, rows, time, known, machine, wanted, tries)
            if slower is None:
                break
            count, phases, reached = slower
            wanted /= reached
            if wanted >= 1.0:
                return count, phases
            rows = [count + k for k in _beginnings(phases[count:], time, LATER[:5])]
    return None


def _slower_copy(
    plan: Phases,
    rows: Sequence[int],
    time: float,
    known: Intervals,
    machine: LimitArrays,
    wanted: float,
    tries: Iterator[int],
) -> tuple[int, Phases, float] | None:
    """Return the plan up to a copy at a part of its speed, and that copy; None if there is none.

    Args:
        plan: the plan so far.
        rows: the phases at which a ramp may begin, the first one first.
        time: about that of a ramp to rest, s.
        known: the intervals behind the start, farther than any ramp goes.
        machine: the limits.
        wanted: part of the speed that is wanted.
        tries: ends when no more ramps are to be tried.

    Returns:
        The number of phases up to the copy, all phases, and the part of the speed of the copy. It
        is above the wanted one where no ramp from that row leads farther.
    """
    slowest: tuple[int, Phases, float] | None = None
    for row in rows:
        for (steps, use), _ in zip(CLOCKS, tries, strict=False):
            ramp, phases, part = slower_copy(plan[row:], known, machine, time / steps, use, wanted)
            if not ramp:
                continue
            end = phases[ramp]["s"] if ramp < len(phases) else known.end[-1]
            if not _may_slow(known, plan[row]["s"], end):
                continue
            if slowest is None or part < slowest[2]:
                slowest = row + ramp, np.concatenate((plan[:row], phases)), part
            if part <= wanted:
                return slowest
        if slowest is not None:
            break
    return slowest


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


Ramp = tuple[Phases, float]
"""Phases to rest, and the place of rest, mm."""

HORIZON = 8.0
"""Motion is slowed within this many stopping distances, or not at all."""

FAR_HORIZON = 20.0
"""A stop is sought within this many, where there is none within the shorter horizon: near a pole
the joints move at their limits for long.
"""

CROSSING = 10.0
"""The horizon is farther by so many periods at the speed: slow motion rests in a shorter length
than that of a junction, which it has to cross before.
"""

MARGIN = 1e-8
"""Relative: larger than the margin for rounding of the bounds on speed."""

AT_REST = 2.0
"""Where the clock can't be slowed, a plan that rests within this many ramps of constant bounds is
followed to that rest.
"""

FEW = 200
"""Intervals with a bend within the horizon, up to which a search takes less than 0.1 CPU s."""

SHORTEST = 1e-3
"""mm; the bounds where a request begins are those on this length."""

HALVINGS = 5
"""Number of times that the length is halved between too short and long enough."""

KEPT = 1.0 - 1e-6
"""A plan that needs no more than this part of its speed keeps the feeds."""

POINTS = 4
"""Points without acceleration from which a plan is tried that begins later."""

SOON = 1.05
"""Part of the time of a ramp with constant bounds in which a plan rests soon. A ramp that takes
longer is compared with another one.
"""


@dataclass(frozen=True, slots=True)
class Request:
    """A wanted change of the motion.

    Attributes:
        path: the known path, under the new limits.
        plan: the plan so far, from where the change begins.
        at: arc length there, mm.
        goal: where the new plan shall rest, mm; for a stop, at the latest.
        rests: whether the motion will rest at ``goal``, or has only to be able to.
        stops: whether to come to rest as soon as possible.
    """

    path: KnownPath
    plan: Phases
    at: float
    goal: float
    rests: bool
    stops: bool


@dataclass(frozen=True, slots=True)
class SlowedPlan:
    """A plan that slows.

    Attributes:
        phases: the plan.
        goal: where it rests, mm.
        rests: whether the motion will rest there.
        known: intervals over which it was made.
        lead: number of phases at its start that are settled.
        slow_from: from here on the limits in effect hold, mm.
        limits: those before.
    """

    phases: Phases
    goal: float
    rests: bool
    known: Intervals
    lead: int
    slow_from: float
    limits: Limits


def _feed_at(request: Request) -> float:
    """Return the largest speed that the feeds of a request allow where it begins, mm/s."""
    near = _near(request)
    return float(near.top[0]) if len(near.end) else inf


def _jerk_at(request: Request) -> float:
    """Return a jerk that is possible at any speed where a request begins, mm/s^3."""
    near = _near(request)
    return float(near.jerk[0, 0]) if len(near.end) else 0.0


def _near(request: Request) -> Intervals:
    """Return the intervals just behind the place where a request begins."""
    s = request.at
    return request.path.intervals(request.path.limits, s, min(request.goal, s + SHORTEST))


class SlowerPlan(NamedTuple):
    """The plan so far, with a clock that slows.

    Attributes:
        phases: the plan; it rests where it did.
        lead: number of phases up to the first point at which it may be planned anew.
        slow_from: from here on the limits in effect hold, mm.
        limits: those before.
    """

    phases: Phases
    lead: int
    slow_from: float
    limits: Limits


def slowed(request: Request) -> SlowedPlan | None:
    """Return a plan for the request; None if there is none, or if the plan so far rests sooner.

    While it slows, the motion does not end its acceleration early across a place that it has to
    cross at constant speed.
    """
    plan = request.plan
    speed, acceleration = float(plan[0]["v"]), float(plan[0]["a"])
    ramp = None
    if request.stops:
        ramp = _shortest_stop(request, HORIZON) or _shortest_stop(request, FAR_HORIZON)
    if ramp is not None:
        sooner = float(ramp.phases["duration"].sum()) < _time_to_rest(plan)
        return ramp if sooner else None
    lead = plan[: first_steady(plan) if acceleration != 0.0 else 0]
    leads = []
    if not len(lead):
        leads.append((lead, float(plan[0]["s"]), speed))
    elif len(lead) < len(plan):
        leads.append((lead, float(plan[len(lead)]["s"]), float(plan[len(lead)]["v"])))
    # A motion that slows for a stop, or has to slow, goes on slowing.
    slows = acceleration < 0.0 and (request.stops or speed > _feed_at(request))
    if (
        not (acceleration < 0.0 and request.stops)
        and (released := release(plan, _jerk_at(request))) is not None
    ):
        s, v = end_of(released)
        if (
            s < request.goal
            and not request.path.intervals(request.path.limits, request.at, s).flat.any()
        ):
            leads.insert(len(leads) if slows else 0, (released, s, v))
    for phases, s, v in leads:
        if v > 0.0 and s < request.goal - rounding_of(request.goal):
            found = _Search(request, phases, s, v).run()
            if found is not None:
                return found
    return None


def time_before(phases: Phases, place: float) -> float:
    """Return about the time in which phases come to an arc length, s."""
    return float(phases["duration"][: int(np.searchsorted(phases["s"], place))].sum())


def searched_soon(request: Request) -> bool:
    """Return whether the path is so simple that :func:`slowed` takes a short computing time."""
    path, speed = request.path, float(request.plan["v"].max())
    ahead = HORIZON * path.limits.stopping_distance(speed, any_direction=True)
    near = path.intervals(path.limits, request.at, min(request.goal, request.at + ahead))
    bent = near.samples[:, SAMPLES // 2, 1].any(axis=1)
    return int(np.count_nonzero(bent)) <= FEW


def slower_plan(request: Request, slow_from: float) -> SlowerPlan | None:
    """Return the plan so far with a clock that slows until it keeps the feeds of the request.

    It needs no search, so there is one where :func:`slowed` finds none: at the limits of the axes.
    Behind the ramp the motion is slower than need be, until it is planned anew.

    Args:
        request: its goal is that of the plan so far.
        slow_from: where the plan so far begins to keep the feeds before the request, mm.

    Returns:
        None if no ramp is legal.
    """
    path, limits, plan = request.path, request.path.limits, request.plan
    s, v = float(plan[0]["s"]), float(plan[0]["v"])
    fastest = float(plan["v"].max())
    slowing = replace(limits, slowing_from=fastest * (1.0 + MARGIN))
    first = int(np.searchsorted(plan["s"], slow_from))
    part = 1.0
    if first < len(plan):
        ahead = path.intervals(limits, float(plan[first]["s"]), request.goal)
        part = pace_wanted(plan[first:], ahead)
    if part >= KEPT:
        known = path.intervals(limits, s, request.goal)
        work = Work()
        with work.ahead(BEFORE * float(plan["duration"].sum())):
            legal, faster = refine(plan, lowered(known), limits.arrays, False, work.left)
        if legal and not exceeding_sections(path, faster, known):
            plan = faster
        return SlowerPlan(plan, steady_from(plan, 0), slow_from, slowing)
    end = min(request.goal, s + HORIZON * limits.stopping_distance(fastest, any_direction=True))
    near = path.intervals(slowing, s, end)
    here = between(near, s, s + limits.stopping_distance(v, any_direction=True))
    if not len(here.end):
        return None
    firm = firm_ramp(plan, here)
    if firm is None:
        return None
    time = float(firm["duration"].sum())
    # Near a pole the joints go far on a short path: a ramp takes longer than the length tells.
    last = int(np.searchsorted(np.cumsum(plan["duration"]), LAST_END * time)) + 1
    last_end = float(plan[last]["s"]) if last < len(plan) else request.goal
    if last_end > end:
        near = path.intervals(slowing, s, last_end)
    if _time_to_rest(plan) <= SOON * time:
        # No ramp is shorter by much. At the limit of its jerk such a plan has no slower copy.
        return followed_to_rest(request)
    found = copy_by_clock(plan, time, lowered(near), slowing.arrays, part)
    if found is None or exceeding_sections(path, found[1][: found[0]], near):
        if _time_to_rest(plan) > AT_REST * time:
            return None
        # It rests about as soon as a ramp that begins a little later would end.
        return followed_to_rest(request)
    ramp, phases = found
    behind = float(phases[ramp]["s"]) if ramp < len(phases) else request.goal
    return SlowerPlan(phases, ramp, max(slow_from, behind), slowing)


def followed_to_rest(request: Request) -> SlowerPlan:
    """Return the plan so far, which keeps the feeds of the request behind its first rest."""
    plan = request.plan
    count = first_rest(plan)
    rest = float(plan[count]["s"]) if count < len(plan) else request.goal
    slowing = replace(request.path.limits, slowing_from=float(plan["v"].max()) * (1.0 + MARGIN))
    return SlowerPlan(plan, count, rest, slowing)


def planned_later(request: Request) -> SlowedPlan | None:
    """Return the plan so far up to a point without acceleration, and a new plan from there.

    That is in time where the plan so far keeps the feeds of the request up to that point: it may be
    slow there, or no feed holds. None if no such point has a plan.
    """
    path, plan = request.path, request.plan
    behind = path.intervals(path.limits, request.at, request.goal)
    points, before = [], 0
    while (point := steady_from(plan, before + 1)) < len(plan) and plan[point]["v"] > 0.0:
        s = float(plan[point]["s"])
        between_points = between(behind, float(plan[before]["s"]), s)
        if s >= request.goal or (
            len(between_points.end) and pace_wanted(plan[before:point], between_points) < KEPT
        ):
            break
        points.append(point)
        before = point
    # A plan begins most easily where the motion is slow.
    for point in sorted(points, key=lambda k: float(plan[k]["v"]))[:POINTS]:
        s, v = float(plan[point]["s"]), float(plan[point]["v"])
        status, phases, _ = accepted_plan(path, s, request.goal, v, Work())
        if status == PLANNED:
            return SlowedPlan(
                phases=np.concatenate((plan[:point], phases)),
                goal=request.goal,
                rests=request.rests,
                known=behind,
                lead=point,
                slow_from=request.at,
                limits=path.limits,
            )
    return None


def rests_soon(request: Request) -> bool:
    """Return whether the plan so far rests about as soon as any motion could."""
    limits, plan = request.path.limits, request.plan
    s, v = float(plan[0]["s"]), float(plan[0]["v"])
    ahead = limits.stopping_distance(v, any_direction=True)
    slowing = replace(limits, slowing_from=float(plan["v"].max()) * (1.0 + MARGIN))
    near = request.path.intervals(slowing, s, min(request.goal, s + ahead))
    return bool(len(near.end)) and _time_to_rest(plan) <= SOON * fastest_ramp(plan, near)


def _time_to_rest(plan: Phases) -> float:
    """Return the time until a plan rests for the first time, s."""
    return float(plan["duration"][: first_rest(plan)].sum())


def _shortest_stop(request: Request, horizon: float) -> SlowedPlan | None:
    """Return the shortest ramp to rest, where no junction is on the way; else None.

    ``horizon``: how far it is sought, in stopping distances.
    """
    path, limits, plan = request.path, request.path.limits, request.plan
    _, s, v, a, _ = plan[0].tolist()
    fastest = float(plan["v"].max())
    slowing = replace(limits, slowing_from=fastest * (1.0 + MARGIN), feed_factor=0.0)
    ahead = horizon * limits.stopping_distance(fastest, any_direction=True)
    end = min(request.goal, s + ahead)
    near = path.intervals(slowing, s, end)
    level = path.intervals(replace(limits, feed_factor=inf), s, end)

    def stopped(phases: Phases, rest: float) -> SlowedPlan | None:
        inside = rest < request.goal - rounding_of(request.goal)
        if not inside or _beyond_flat(level, rest) != rest:
            return None
        return SlowedPlan(phases, rest, True, near, 0, rest, slowing)

    phases = even_ramp(near, s, v, a)
    if phases is not None and (found := stopped(phases, end_of(phases)[0])) is not None:
        return found
    here = between(near, s, s + limits.stopping_distance(v, any_direction=True))
    if not len(here.end):
        return None
    # The motion rests before the first stretch of constant speed.
    starts = np.concatenate(([s], near.end[:-1]))[near.flat]
    before = float(starts[0]) if len(starts) else end

    def searched(ramp: Ramp, part: float) -> list[Ramp]:
        """Return the shortest ramp that a search finds from another one, if there is any."""
        legal, phases, rest = shortest_ramp(*ramp, before, part, search, slowing.arrays)
        return [(phases, rest)] if legal and not exceeding_sections(path, phases, near) else []

    search = lowered(near)
    ramps: list[Ramp] = []
    if (firm := firm_ramp(plan, here)) is not None:
        ramps = searched((firm, end_of(firm)[0]), FAR)
        for phases, rest in ramps:
            # A ramp that speeds up again may be far from the shortest one.
            rises = (np.diff(phases["v"]) > 0.0).any()
            quick = float(phases["duration"].sum()) <= SOON * float(firm["duration"].sum())
            if quick and not rises and (found := stopped(phases, rest)) is not None:
                return found
    slow = ramp_by_clock(plan, here, search, slowing.arrays)
    if slow is not None:
        if not exceeding_sections(path, slow[0], near):
            ramps.append(slow)
        ramps += searched(slow, FAR)
    ramps.sort(key=_duration)
    ramps += [finer for ramp in ramps[:1] for finer in searched(ramp, NEAR_BY)]
    for phases, rest in sorted(ramps, key=_duration):
        if (found := stopped(phases, rest)) is not None:
            return found
    return None


def _duration(ramp: Ramp) -> float:
    """Return the time of a ramp, s."""
    return float(ramp[0]["duration"].sum())


class _Search:
    """The search for the shortest length on which the motion slows, behind one lead."""

    def __init__(self, request: Request, lead: Phases, s: float, v: float) -> None:
        self.request, self.lead, self.s, self.v = request, lead, s, v
        self._work = Work(inf)
        path, goal, limits = request.path, request.goal, request.path.limits
        self.slowing = replace(
            limits,
            slowing_from=v * (1.0 + MARGIN),
            feed_factor=0.0 if request.stops else limits.feed_factor,
        )
        fastest = max(v, float(request.plan[0]["v"]))
        self.before_limits = replace(self.slowing, slowing_from=fastest * (1.0 + MARGIN))
        self.far_off = HORIZON * limits.stopping_distance(v, any_direction=True)
        self.far_off += CROSSING * limits.period * v
        horizon = min(goal, s + self.far_off)
        self.near = path.intervals(self.slowing, s, horizon)
        self.before = []
        self.kept = NO_PHASES
        if len(lead):
            before = path.intervals(self.before_limits, request.at, s)
            if before.flat.any():
                # At the raised feeds a junction needs a constant speed, but not at the speed of the
                # lead. The lead is legal as it is.
                self.kept, self.lead = lead, NO_PHASES
            else:
                self.before = [before]
        stops = self.near.end[self.near.flat & (self.near.speed == 0.0)]
        self.stop_ahead = len(stops) > 0
        self.horizon = float(stops[0]) if self.stop_ahead else horizon
        # A stop is only where no junction would need a constant speed at any feed.
        self.level = self.near
        if request.stops:
            self.level = path.intervals(replace(limits, feed_factor=inf), s, self.horizon)
        self.far = None if request.stops else path.intervals(limits, s, goal)

    def run(self) -> SlowedPlan | None:
        """Return the plan with the shortest length that the search finds."""
        found = self._first()
        if found is None:
            return None
        works, phases = self._shorter(*found)
        if self.far is not None:
            whole = self._attempt(works, whole=True)
            if whole is None:
                return None
            phases = whole
        request = self.request
        return SlowedPlan(
            phases=phases,
            goal=works if request.stops else request.goal,
            rests=request.stops or request.rests,
            known=self.near if self.far is None else self.far,
            lead=first_steady(phases) if len(self.lead) + len(self.kept) else 0,
            slow_from=works,
            limits=self.before_limits,
        )

    def _attempt(self, up_to: float, whole: bool = False) -> Phases | None:
        """Return a plan that slows up to ``up_to``, and goes on to the goal or a part of it."""
        parts = [*self.before, between(self.near, self.s, up_to)]
        if self.far is not None:
            end = self.request.goal
            if not whole:
                end = min(end, _beyond_flat(self.far, up_to + self.far_off))
            parts.append(between(self.far, up_to, end))
        known = joined(parts, [0.0] * len(parts))
        for refined in (True, False):
            status, phases = plan_to_rest(
                self.s, known, self.v, self.slowing, self.lead, work=self._work if refined else None
            )
            if status != PLANNED:
                return None
            if not exceeding_sections(self.request.path, phases, known):
                break
        return np.concatenate((self.kept, phases))

    def _first(self) -> tuple[float, float, Phases] | None:
        """Return a length that is too short, a longer one that is enough, and the plan for it."""
        stopping = self.request.path.limits.stopping_distance(self.v)
        works = failed = _beyond_flat(self.level, self.s)
        found = None
        if self.far is not None and works < self.horizon:
            found = self._attempt(works)
        length = stopping / 16.0 if self.far is not None else stopping
        while found is None:
            if works == self.horizon:
                return None
            failed, works = works, _beyond_flat(self.level, works + length)
            if works >= self.horizon:
                if not self.stop_ahead:
                    return None
                works = self.horizon
            found = self._attempt(works)
            length *= 1.5
        return failed, works, found

    def _shorter(self, failed: float, works: float, found: Phases) -> tuple[float, Phases]:
        """Halve the difference of the two lengths a few times."""
        for _ in range(HALVINGS):
            middle = _beyond_flat(self.level, 0.5 * (failed + works))
            if not failed < middle < works:
                break
            better = self._attempt(middle)
            if better is None:
                failed = middle
            else:
                works, found = middle, better
        return works, found


def _beyond_flat(known: Intervals, s: float) -> float:
    """Return the first place from ``s`` on at which the motion may come to rest.

    It is not in or at a stretch of constant speed; inf if there is none.
    """
    end, flat, count = known.end, known.flat, len(known.end)
    k = int(np.searchsorted(end, s, side="right"))
    if (k < count and flat[k]) or (0 < k < count and flat[k - 1] and end[k - 1] == s):
        while k < count and flat[k]:
            k += 1
        if k == count:
            return inf
        if k > 0:
            # Just behind it, where a slow motion rests, but by more than rounding.
            behind = float(end[k - 1])
            s = behind + min(0.5 * (float(end[k]) - behind), 4.0 * rounding_of(behind))
    return s
