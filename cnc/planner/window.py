"""The window: path that is known and not yet sent on, with a legal plan to rest.

      sent on ─┤ settled ├───────────┤ plan, to rest ├──┤ known, not planned ├── not read yet
               a          may change                  rests here
               slice      >= 2 stopping distances

Settled phases leave the window slice by slice. A slice may end anywhere, at any speed and
acceleration, because the plan behind it leads to rest: whatever the operator requests between two
slices, there is a legal motion.

Amortised cost: a plan is made when at least as much path has arrived as the last plan left
unsettled, and when the window holds about twice what stays unsettled. So each stretch is planned
about twice. Memory: the window holds a few stopping distances and two chunks of path.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.planner.acceptance import accepted_plan
from cnc.planner.kernels.arrays import Phases
from cnc.planner.kernels.intervals import Intervals
from cnc.planner.kernels.lookahead import PLANNED, START_TOO_FAST
from cnc.planner.known_path import KnownPath, rounding_of
from cnc.planner.limits import Limits
from cnc.planner.phases import (
    NO_PHASES,
    cut_at_length,
    cut_inside,
    cut_steady,
    first_rest,
    first_steady,
    last_bound,
    slice_end,
    steady_from,
)
from cnc.planner.plan import PlanChunk, RunClock
from cnc.planner.slowing import (
    Request,
    SlowedPlan,
    followed_to_rest,
    planned_later,
    rests_soon,
    searched_soon,
    slowed,
    slower_plan,
    time_before,
)
from cnc.planner.work import INTERVAL, Work

# The plan of the window at present.


@dataclass(slots=True)
class CurrentPlan:
    """The plan from where the next slice begins.

    Attributes:
        phases: they lead to rest.
        rest_at: where the motion rests, mm.
        settled: number of phases that may be sent on.
        unsettled: number of intervals behind them, at the time of planning.
        arrived: number of intervals that arrived since.
        follow: where no new plan begins, at least so many phases are followed; twice as many each
            time, since each attempt costs a whole plan.
        slow_from: from here on the limits in effect hold, mm.
        slowing: the limits before.
    """

    phases: Phases
    rest_at: float
    settled: int
    unsettled: int
    arrived: int
    follow: int
    slow_from: float
    slowing: Limits


STOPS_KEPT = 2.0
"""Stopping distances between the settled part and the end of the plan."""

STOPS_KNOWN = 4.0
"""Stopping distances that the window holds when it is planned."""

MANY = 16384
"""So many intervals are planned in any case: their plan shows the real stopping distance."""

MOST = 65536
"""Upper bound on the window, in intervals; half are settled when it is reached. It bounds the
memory where the motion needs a very long distance to stop.
"""

SLICE = 0.1
"""s; about the length of a slice when an operator may change the motion: the latency of a hold or
an override.
"""

LONG = 60.0
"""s; length of a slice when nobody may change the motion. Sums of the durations of phases stay
exact to less than 1e-14 s.
"""

SLICE_LENGTH = 0.01
"""mm; slices of slow motion are not shorter."""

LONGER = 1.1
"""A motion that a search finds may slow for so many times the time of one by the clock: it goes on
faster.
"""

LATEST = 2.4
"""Straight ramps to rest along the slowest axis, within which a lower feed is kept. The promise is
2.46, see ``docs/explanation/planner.md``; a rest is better than to be later.
"""

MORE_SLOWLY = 0.9
"""Part of its speed at which a plan is made again that the audit refused."""


class Window:
    """Path that is known and not sent on, and the plan for it.

    Attributes:
        clock: of the run, up to where the next slice begins.
        unproved: whether phases were settled since the last copy that the audit accepted.
        caution: number of times that the next plan is made slower, because a plan was refused.
        stops_late: whether a stop is wanted, but no plan was found yet that rests before the
            current one does.
    """

    def __init__(
        self, limits: Limits, stops_known: float = STOPS_KNOWN, work: Work | None = None
    ) -> None:
        """Create an empty window.

        ``stops_known``: see STOPS_KNOWN. ``work``: computing time for its searches.
        """
        self._work = Work() if work is None else work
        self.clock = RunClock()
        self.unproved = False
        self.caution = 0
        self._stops_known = stops_known
        self._path = KnownPath(limits)
        self._at = 0.0
        self._plan = CurrentPlan(NO_PHASES.copy(), 0.0, 0, 0, 0, 1, -inf, limits)
        self._stopping = False
        self.stops_late = False

    @property
    def limits(self) -> Limits:
        """The limits of the machine under the override in effect."""
        return self._path.limits

    @property
    def moving(self) -> bool:
        """Whether the machine moves where the next slice begins."""
        phases = self._plan.phases
        return len(phases) > 0 and bool(phases[0]["v"] > 0.0 or phases[0]["a"] != 0.0)

    @property
    def place(self) -> tuple[str, int]:
        """File and line of the motion that begins where the next slice does."""
        return self._path.place(self._at)

    @property
    def length(self) -> float:
        """Path length since the start of the program where the next slice begins, mm."""
        return self._path.length_at(self._at)

    def copy(self) -> Window:
        """Return a window that goes on independently from the same state."""
        other = copy(self)
        other.clock = copy(self.clock)
        other._path = self._path.copy()
        other._plan = copy(self._plan)
        other._plan.phases = self._plan.phases.copy()
        return other

    @property
    def slows_until(self) -> float:
        """Time from which on the motion keeps the feeds in effect, s."""
        return self.clock.seconds + time_before(self._plan.phases, self._plan.slow_from)

    @property
    def settled(self) -> bool:
        """Whether some of the plan may be sent on."""
        return self._plan.settled > 0

    def add(self, path: PathChunk, previous: PathChunk | None, following: PathChunk | None) -> None:
        """Append a chunk of path; None for a neighbour at which the motion rests."""
        if not self._path.sections:
            self._at = 0.0
            self._plan.slow_from, self._plan.slowing = -inf, self.limits
        section = self._path.add(path, previous, following)
        self._plan.arrived += len(section.intervals.end)
        self._work.left -= INTERVAL * len(section.intervals.end)

    def prepared(self) -> bool:
        """Return whether there is something to send on.

        The window is planned further if need be, and if enough of the path is known.

        Raises:
            MotionLimitError: ``plan-failed`` where the limits leave no motion.
        """
        plan = self._plan
        if plan.settled > 0:
            return True
        if self._stopping and not len(plan.phases):
            self._stopping = False
        if len(plan.phases) and plan.phases[0]["a"] != 0.0:
            self._plan_from_copy()
            return True
        goal, rests = self._path.goal(self._at)
        if (
            self._stopping
            or goal <= self._at + rounding_of(self._at)
            or not (rests or self._enough(goal))
        ):
            return False
        self._rebase()
        path = self._path
        if self.caution:
            steps = self.caution - 1 if self.limits.spread else self.caution
            path = path.under(path.limits.slower(MORE_SLOWLY**steps))
        goal, rests = path.goal(self._at)
        v = float(plan.phases[0]["v"]) if len(plan.phases) else 0.0
        self._work.reach(self.clock.seconds)
        # A shaped motion is refused in bends, where the one without refinement is slower.
        work = None if self.limits.spread and self.caution else self._work
        status, phases, intervals = accepted_plan(path, self._at, goal, v, work)
        if status == START_TOO_FAST and len(plan.phases):
            # The last plan is legal to its end: follow it to a point without acceleration, and try
            # again from there.
            plan.settled = min(plan.follow, len(plan.phases)) - 1
            plan.settled += first_steady(plan.phases[plan.settled :])
            plan.follow *= 2
            self.unproved = True
            return True
        if status != PLANNED:
            first = self._path.sections[0].stretch.path
            raise MotionLimitError(
                Diagnostic(
                    "plan-failed",
                    "no motion within the machine's limits was found from here on",
                    first.file,
                    int(first.line[0]),
                )
            )
        self._accept(phases, goal, intervals, rests=rests)
        return self._plan.settled > 0

    def take(self, seconds: float, length: float = SLICE_LENGTH) -> list[PlanChunk]:
        """Return the next slice of about ``seconds``, of the phases that :meth:`prepared` settled.

        It has one plan for each chunk of path that it touches, and covers ``length`` mm at least.
        """
        plan = self._plan
        rows, t = slice_end(plan.phases[: plan.settled], seconds, length)
        if t > 0.0:
            head, tail = cut_inside(plan.phases, rows, t)
        else:
            head, tail = plan.phases[:rows], plan.phases[rows:]
        plan.settled -= rows
        end, v, a = plan.rest_at, 0.0, 0.0
        if len(tail):
            end, v, a = float(tail[0]["s"]), float(tail[0]["v"]), float(tail[0]["a"])
        plan.phases, self._at = tail, end
        chunks = []
        sections = self._path.sections
        while len(head):
            section = sections[0]
            goal = min(end, section.end)
            if float(head[0]["s"]) < plan.slow_from - rounding_of(end):
                goal = min(goal, plan.slow_from)
            if goal >= end - rounding_of(end):
                goal = end
            here, head = (head, head[:0]) if goal == end else cut_at_length(head, goal)
            if len(here):
                v_end, a_end = (float(head[0]["v"]), float(head[0]["a"])) if len(head) else (v, a)
                slows = float(here[0]["s"]) < plan.slow_from - rounding_of(end)
                limits = plan.slowing if slows else self.limits
                chunk = section.plan_chunk(here, (goal, v_end, a_end), limits, self.clock.seconds)
                self.clock.add(chunk)
                chunks.append(chunk)
            if goal >= section.end - rounding_of(goal) and (
                not len(tail) or plan.rest_at > section.end + rounding_of(goal)
            ):
                sections.popleft()
        return chunks

    def pieces_from_here(self, count: int) -> PathChunk | None:
        """Return so many pieces of path from the one on that is under way; None without them."""
        return self._path.pieces_from(self._at, count) if self._path.sections else None

    def follow_slower(self, pace: float) -> None:
        """Follow the plan at a part of its speed."""
        plan = self._plan.phases
        plan["duration"] /= pace
        plan["v"] *= pace
        plan["a"] *= pace**2
        plan["j"] *= pace**3

    def rest_on(self, piece: int, place: float) -> None:
        """Go on from rest at a place on a piece, to which another motion leads.

        Args:
            piece: the piece, counted from the one that is under way.
            place: from its start, mm.
        """
        plan = self._plan
        self._at = plan.rest_at = self._path.move_to(self._at, piece, place)
        plan.phases, plan.settled, plan.unsettled = plan.phases[:0], 0, 0
        self._stopping, self.stops_late, self.unproved = True, False, False

    def runs_at(self, feed_factor: float) -> bool:
        """Return whether the motion is planned with this factor of the feeds already."""
        return feed_factor == self.limits.feed_factor and not self._stopping

    def override(self, feed_factor: float) -> bool:
        """Continue at another factor of the programmed feeds, from the next slice on.

        Returns:
            False if that is not possible before a further slice.
        """
        if self.runs_at(feed_factor):
            return True
        self._work.begin_again()
        self._rebase()
        before = self._path
        self._path = before.under(replace(before.limits, feed_factor=feed_factor))
        if self.moving and not self._redirects():
            self._path = before
            return False
        if not self.moving:
            self._plan.phases = self._plan.phases[:0]
            self._plan.settled = self._plan.unsettled = 0
        self._stopping = False
        return True

    def stop(self) -> None:
        """Come to rest on the path as soon as the limits allow, from the next slice on."""
        if not self.moving or (self._stopping and not self.stops_late):
            return
        self._work.begin_again()
        self._rebase()
        plan = self._plan
        request = Request(self._path, plan.phases, self._at, plan.rest_at, True, True)
        enough = rests_soon(request)
        self.stops_late = not (enough or self._redirect(request))
        if enough or self.stops_late:
            # No rest is earlier than that of the plan: at the next stop of the path, or at the end
            # of the known path.
            self.follow_to_rest()
        self._stopping = True

    def follow_to_rest(self) -> None:
        """Settle the current plan up to its first rest, and leave out what is behind."""
        plan = self._plan
        plan.settled = first_rest(plan.phases)
        if plan.settled < len(plan.phases):
            plan.rest_at = float(plan.phases[plan.settled]["s"])
            plan.phases = plan.phases[: plan.settled]
        self.unproved = True

    def settle_until(self, seconds: float) -> None:
        """Settle the plan up to a point without acceleration after ``seconds``, no farther."""
        plan = self._plan
        count = int(np.searchsorted(np.cumsum(plan.phases["duration"]), seconds)) + 1
        count = steady_from(plan.phases, min(count, len(plan.phases)))
        if count < plan.settled:
            plan.settled = count
            plan.unsettled, plan.arrived = 0, 0

    def _enough(self, goal: float) -> bool:
        """Return whether enough of the path is known to plan it."""
        arrived = self._plan.arrived
        if arrived < self._plan.unsettled:
            return False
        top = max(section.top for section in self._path.sections)
        wanted = self._stops_known * self.limits.stopping_distance(top) + SLICE * top
        return goal - self._at >= wanted or arrived >= MANY * self._stops_known / STOPS_KNOWN

    def _accept(
        self, phases: Phases, goal: float, intervals: Intervals, *, rests: bool, lead: int = 0
    ) -> None:
        """Make a plan the current one.

        Args:
            phases: the plan.
            goal: where it rests, mm.
            intervals: the intervals over which it was made.
            rests: whether the motion will rest there: then all of the plan is settled.
            lead: number of phases that are settled in any case.
        """
        count = len(phases)
        if not rests:
            top = float(phases["v"].max())
            kept = STOPS_KEPT * max(
                goal - last_bound(phases, intervals), self.limits.stopping_distance(top)
            )
            if len(intervals.end) >= MOST:
                kept = min(kept, 0.5 * (goal - self._at))
            phases, count = cut_steady(phases, goal - kept)
        plan = self._plan
        plan.phases, plan.rest_at, plan.settled = phases, goal, max(count, lead)
        plan.arrived, plan.follow = 0, 1
        self.unproved = True
        open_from = float(phases[plan.settled]["s"]) if plan.settled < len(phases) else goal
        plan.unsettled = len(intervals.end) - int(np.searchsorted(intervals.end, open_from))

    def _redirects(self) -> bool:
        """Plan anew to feeds that may be below the speed; return whether there is such a plan.

        A search finds a faster motion. But it may find none, or take long; then the clock of the
        plan so far is slowed, and it is planned anew from the first point without acceleration.
        Where both would be late, the motion is planned anew from a point up to which it keeps the
        feeds; or, if a rest is near, it rests for an instant.
        """
        plan, (goal, rests) = self._plan, self._path.goal(self._at)
        request = Request(self._path, plan.phases, self._at, goal, rests, False)
        sought = slowed(request) if (soon := searched_soon(request)) else None
        time = inf if sought is None else time_before(sought.phases, sought.slow_from)
        by_clock, time_by_clock = None, inf
        # A motion that slows within a straight ramp is soon enough, and a clock takes computing.
        if time > self._ramp():
            clocked = replace(request, goal=plan.rest_at, rests=False)
            by_clock = slower_plan(clocked, plan.slow_from)
        if by_clock is not None:
            time_by_clock = time_before(by_clock.phases, by_clock.slow_from)
        elif not soon:
            sought = slowed(request)
            time = inf if sought is None else time_before(sought.phases, sought.slow_from)
        if (late := min(time, time_by_clock)) > LATEST * self._ramp():
            if (later := planned_later(request)) is not None:
                return self._adopt(later)
            rest = slowed(replace(request, stops=True))
            if rest is not None and time_before(rest.phases, inf) < late:
                return self._adopt(rest)
            followed = followed_to_rest(request)
            if rest is None and time_before(plan.phases, followed.slow_from) < late:
                by_clock, time = followed, inf
        if by_clock is None or time <= LONGER * time_by_clock:
            return self._adopt(sought)
        plan.slow_from, plan.slowing = by_clock.slow_from, by_clock.limits
        plan.phases, plan.settled = by_clock.phases, by_clock.lead
        plan.unsettled, plan.arrived, plan.follow = 0, 0, 1
        self.unproved = True
        return True

    def _ramp(self) -> float:
        """Return the time of the straight ramp to rest along the slowest axis, s."""
        v = float(self._plan.phases[0]["v"])
        return 2.0 * self.limits.stopping_distance(v, any_direction=True) / v if v > 0.0 else 0.0

    def _plan_from_copy(self) -> None:
        """Plan anew behind a ramp to a slower copy of the plan before; settle some of it.

        Where no plan begins there, the copy is followed to a point without acceleration.
        """
        self._rebase()
        plan, (goal, rests) = self._plan, self._path.goal(self._at)
        request = Request(self._path, plan.phases, self._at, goal, rests, False)
        there = goal <= self._at + rounding_of(self._at)
        if there or self.caution or not self._redirect(request):
            plan.settled = first_steady(plan.phases)
        self.unproved = True

    def _redirect(self, request: Request) -> bool:
        """Plan for a request from where the next slice begins; return whether there is a plan."""
        return self._adopt(slowed(request))

    def _adopt(self, slowed: SlowedPlan | None) -> bool:
        """Make a plan that slows the current one; return whether there is one."""
        if slowed is None:
            return False
        self._plan.slow_from, self._plan.slowing = slowed.slow_from, slowed.limits
        self._accept(slowed.phases, slowed.goal, slowed.known, rests=slowed.rests, lead=slowed.lead)
        return True

    def _rebase(self) -> None:
        """Measure arc length from the start of the first section again."""
        shift = self._path.rebase()
        if shift == 0.0:
            return
        self._at -= shift
        self._plan.rest_at -= shift
        self._plan.phases["s"] -= shift
        self._plan.slow_from -= shift
