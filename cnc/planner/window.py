"""The window: path that is known and not yet handed out, with a plan that is legal from where the
motion is to rest.

      handed out ─┤ settled ├───────────┤ plan, to rest ├──┤ known, not planned ├── not read yet
                  a          another kept                 rests here
                  slice      >= 2 stopping distances

What is settled is handed out slice by slice. A slice may end anywhere, in speed and acceleration,
because the plan behind it leads to rest: whatever the operator does between two slices, there is a
legal way on.

Amortised cost: a plan is made when at least as much path has come in as the plan before left open,
and when the window holds about twice what stays open, so each stretch is planned about twice.
Memory: the window holds a few stopping distances and two chunks of path.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.planner.lookahead import PLANNED, START_TOO_FAST
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.planner.limits import Intervals, Limits
from cnc.planner.phases import (
    DURATION,
    A,
    J,
    S,
    V,
    cut_at_length,
    cut_inside,
    cut_steady,
    end_of,
    first_rest,
    first_steady,
    last_bound,
    plan_to_rest,
    release,
    slice_end,
)
from cnc.planner.plan import PlanChunk
from cnc.planner.run_clock import RunClock
from cnc.planner.section import Section, Stretch

Floats = NDArray[np.float64]

STOPS_KEPT = 2.0
"""Stopping distances between what is settled and the end of what is planned."""

STOPS_KNOWN = 4.0
"""Stopping distances that the window holds when it is planned."""

MANY = 16384
"""Intervals that are planned together in any case: their plan tells how far the motion really needs
to stop.
"""

MOST = 65536
"""Intervals of which half are settled in any case: the bound of the memory, where the way to rest
is longer than any that is met.
"""

SLICE = 0.1
"""s; motion is handed out in slices of about this when somebody may want to change it. It is the
latency of a hold or an override.
"""

LONG = 60.0
"""s; slices when nobody wants to change the motion: sums of the times of phases stay exact to less
than 1e-14 s.
"""

SLICE_LENGTH = 0.01
"""mm; a crawl is not sliced finer than this."""

HORIZON = 8.0
"""Stopping distances within which motion is slowed, or not at all."""

ROOM = 1e-8
"""Relative: more than what the bounds on speed keep free for rounding."""

SAME_RAMP = 1e-6
"""Relative: by what rounding may make a ramp from rest with constant jerk another one."""

SAME_PLACE = 1e-7
"""mm: places of the path that differ by less are one; no move is so short."""

HALVINGS = 5
"""Times that the length in which the motion is slowed is halved between too short and long
enough.
"""


class Window:
    """Path that is known and not handed out, from :attr:`at` on.

    ``limits`` are those of the machine under the override in effect. stops_known: see STOPS_KNOWN.
    """

    def __init__(self, limits: Limits, stops_known: float = STOPS_KNOWN) -> None:
        self.limits = limits
        self.clock = RunClock()
        self._stops_known = stops_known
        self._sections: deque[Section] = deque()
        self._travelled = 0.0
        self._at = 0.0
        self._plan = np.empty((0, 5))
        self._settled = 0
        """Phases of the plan that may be handed out."""
        self._rest_at = 0.0
        self._arrived = 0
        """Intervals that came in since the last plan, and those that it left open."""
        self._left = 0
        self._detour = 1
        """Phases that are gone along at least where no new plan begins; twice as many each time, or
        each would cost a whole plan.
        """
        self._stopping = False
        self._stops_late = False
        """Whether no way was found yet to rest sooner than the plan does."""
        self._slowing = -inf, limits
        """Up to where the motion is being slowed, and the limits until there."""
        self._round_first: float | None = None
        """The corner that is gone round before the motion is held."""
        self._at_rest = True
        """Whether nothing was handed out since the motion rested."""

    @property
    def moving(self) -> bool:
        """Whether the motion is under way where the next slice begins."""
        return len(self._plan) > 0 and (self._plan[0, V] > 0.0 or self._plan[0, A] != 0.0)

    @property
    def place(self) -> tuple[str, int]:
        """File and line of the motion that begins where the next slice does."""
        section = self._sections[0]
        path = section.stretch.path
        piece = (
            int(
                np.searchsorted(
                    section.piece_s, self._at - section.base + _rounding(self._at), side="right"
                )
            )
            - 1
        )
        return path.file, int(path.line[min(max(piece, 0), len(path) - 1)])

    def add(self, path: PathChunk, previous: PathChunk | None, following: PathChunk | None) -> None:
        """Take a chunk into the window; None for a neighbour at which the motion rests."""
        if not self._sections:
            self._at, self._slowing = 0.0, (-inf, self.limits)
            self._round_first, self._at_rest = None, True
        base = self._sections[-1].end if self._sections else 0.0
        section = Section(Stretch(path, previous, following), self.limits, base, self._travelled)
        self._sections.append(section)
        self._travelled += float(section.piece_s[-1])
        self._arrived += len(section.intervals)

    def prepared(self) -> bool:
        """Whether there is something to hand out; plans further if need be and if enough of the
        path is known.

        Raises:
            MotionLimitError: ``plan-failed`` where the limits leave no motion.
        """
        if self._settled > 0:
            return True
        if self._stopping and not len(self._plan):
            self._stopping = False
        goal, rests = self._goal()
        if (
            self._stopping
            or goal <= self._at + _rounding(self._at)
            or not (rests or self._enough(goal))
        ):
            return False
        self._rebase()
        goal, _ = self._goal()
        known = self._known(self.limits, self._at, goal)
        status, phases = plan_to_rest(
            self._at, known, float(self._plan[0, V]) if len(self._plan) else 0.0, self.limits
        )
        if status == START_TOO_FAST and len(self._plan):
            # The plan made before the window grew is legal to its end: follow it to a point without
            # acceleration, and try again from there.
            self._settled = min(self._detour, len(self._plan)) - 1
            self._settled += first_steady(self._plan[self._settled :])
            self._detour *= 2
            return True
        if status != PLANNED:
            path = self._sections[0].stretch.path
            raise MotionLimitError(
                Diagnostic(
                    "plan-failed",
                    "no motion within the machine's limits was found from here on",
                    path.file,
                    int(path.line[0]),
                )
            )
        self._follow(phases, goal, rests=rests, known=known)
        return self._settled > 0

    def take(self, seconds: float) -> list[PlanChunk]:
        """The next slice of about ``seconds``, of what :meth:`prepared` found: one plan for each
        chunk of path that it touches.
        """
        self._at_rest = False
        rows, t = slice_end(self._plan[: self._settled], seconds, SLICE_LENGTH)
        if t > 0.0:
            head, tail = cut_inside(self._plan, rows, t)
        else:
            head, tail = self._plan[:rows], self._plan[rows:]
        self._settled -= rows
        if len(tail):
            end, v, a = float(tail[0, S]), float(tail[0, V]), float(tail[0, A])
        else:
            end, v, a = self._rest_at, 0.0, 0.0
        self._plan, self._at = tail, end
        chunks = []
        while len(head):
            section = self._sections[0]
            inside = end <= section.end + _rounding(end)
            here, head = (head, head[:0]) if inside else cut_at_length(head, section.end)
            goal = end if inside else section.end
            if len(here):
                chunks.append(
                    self._plan_chunk(
                        section,
                        here,
                        goal,
                        *((float(head[0, V]), float(head[0, A])) if len(head) else (v, a)),
                    )
                )
            if goal >= section.end - _rounding(goal) and (
                not len(tail) or self._rest_at > section.end + _rounding(goal)
            ):
                self._sections.popleft()
        return chunks

    def override(self, feed_factor: float) -> bool:
        """Go on at another factor of the programmed feeds, from where the next slice begins; False
        where that has to wait for a slice.
        """
        self._round_first = None
        if feed_factor == self.limits.feed_factor and not self._stopping:
            return True
        before, sections = self.limits, self._sections
        self._rebase()
        self.limits = replace(before, feed_factor=feed_factor)
        self._sections = deque(
            Section(each.stretch, self.limits, each.base, each.travelled) for each in sections
        )
        if self.moving and not self._redirect(to_rest=False):
            self.limits, self._sections = before, sections
            return False
        if not self.moving:
            self._plan, self._settled, self._left = self._plan[:0], 0, 0
        self._stopping = False
        return True

    def stop(self, *, resumes: bool = False) -> None:
        """Come to rest on the path as soon as the limits allow, from where the next slice begins.

        resumes: the motion shall then go on along the same way as if it had not rested. Where it
        would rest on a corner that is gone round with overlapping ramps, or so near before one that
        it could not come to it as fast as without the rest, it goes round that corner first. One
        corner and no more: they may follow each other closely.
        """
        if resumes and not self._stopping and self.goes_round:
            return
        if not self.moving or (self._stopping and not self._stops_late):
            return
        self._rebase()
        as_planned = (
            self._plan,
            self._rest_at,
            self._settled,
            self._arrived,
            self._detour,
            self._left,
            self._slowing,
        )
        self._stops_late = not self._redirect(to_rest=True)
        if self._stops_late:
            # From here nothing is sooner than the plan, which rests at the next stop of the path,
            # or at the end of what is known.
            self._settled = first_rest(self._plan)
            if self._settled < len(self._plan):
                self._rest_at = float(self._plan[self._settled, S])
                self._plan = self._plan[: self._settled]
        if resumes and self._round_first is None:
            self._round_first = self._corner_spoilt(as_planned[0])
            if self._round_first is not None:
                self._stops_late = False
                (
                    self._plan,
                    self._rest_at,
                    self._settled,
                    self._arrived,
                    self._detour,
                    self._left,
                    self._slowing,
                ) = as_planned
                return
        self._stopping = True

    @property
    def goes_round(self) -> bool:
        """Whether the motion goes round a corner before it may rest, and has not left that corner
        yet.
        """
        if (
            self._round_first is None
            and not self.moving
            and not self._at_rest
            and self._is_rounded(self._at)
        ):
            self._round_first = self._at
        return self._round_first is not None and self._at <= self._round_first + SAME_PLACE

    def rest(self) -> None:
        """The motion rests where the next slice begins: what was handed out is all that was
        there.
        """
        self._at_rest = True

    def _corner_spoilt(self, as_planned: Floats) -> float | None:
        """The corner ahead that would not be gone round as planned if the motion rested where it is
        to rest now; None if there is none.
        """
        last = first_rest(as_planned)
        if last == len(as_planned):
            return None
        corner = float(as_planned[last, S])
        if not self._is_rounded(corner) or self._rest_at > corner + SAME_PLACE:
            return None
        if self._rest_at < corner - SAME_PLACE:
            again = self._known(self.limits, self._rest_at, corner)
            status, phases = plan_to_rest(self._rest_at, again, 0.0, self.limits)
            ramp = as_planned[last - 1]
            if status == PLANNED and np.allclose(
                phases[-1, [DURATION, J]], ramp[[DURATION, J]], rtol=SAME_RAMP, atol=0.0
            ):
                return None
        return corner

    def _is_rounded(self, s: float) -> bool:
        """Whether there is a corner at ``s`` at which ramps shall overlap."""
        for section in self._sections:
            here = s - section.base
            k = int(np.searchsorted(section.piece_s, here - SAME_PLACE))
            if k == len(section.piece_s) or section.piece_s[k] > here + SAME_PLACE:
                continue
            path = section.stretch.path if k else section.stretch.previous
            return path is not None and bool(
                path.tolerance[k - 1] > 0.0 and not path.stop_after[k - 1]
            )
        return False

    def _goal(self) -> tuple[float, bool]:
        """To where the path can be planned: its last stop that is known, and if that has been
        reached, as far as the motion can rest.
        """
        stop = max((section.base + section.last_stop for section in self._sections), default=-inf)
        if stop > self._at + _rounding(self._at):
            return stop, True
        return max(
            (section.base + section.last_open for section in self._sections), default=-inf
        ), False

    def _enough(self, goal: float) -> bool:
        """Whether enough of the path is known to plan it."""
        if self._arrived < self._left:
            return False
        top = max(section.top for section in self._sections)
        wanted = self._stops_known * self.limits.stopping_distance(top) + SLICE * top
        return goal - self._at >= wanted or self._arrived >= MANY * self._stops_known / STOPS_KNOWN

    def _follow(
        self, phases: Floats, goal: float, *, rests: bool, known: Intervals, lead: int = 0
    ) -> None:
        """Take a plan to rest at ``goal`` for the window's own; its first ``lead`` phases are
        settled in any case.
        """
        count = len(phases)
        if not rests:
            top = float(phases[:, V].max())
            kept = STOPS_KEPT * max(
                goal - last_bound(phases, known), self.limits.stopping_distance(top)
            )
            if len(known) >= MOST:
                kept = min(kept, 0.5 * (goal - self._at))
            phases, count = cut_steady(phases, goal - kept)
        self._plan, self._rest_at, self._settled = phases, goal, max(count, lead)
        self._arrived, self._detour = 0, 1
        open_from = float(phases[self._settled, S]) if self._settled < len(phases) else goal
        self._left = len(known) - int(np.searchsorted(known.end, open_from))

    def _redirect(self, *, to_rest: bool) -> bool:
        """Plan anew from where the next slice begins, to rest or to feeds that may be below its
        speed; False if no way is found.

        The acceleration is let go of first, at once or, where the motion slows, as planned.
        """
        follow = (
            self._plan[: first_steady(self._plan)] if self._plan[0, A] != 0.0 else self._plan[:0]
        )
        leads = [(follow, *self._state(len(follow)))]
        if self._plan[0, A] > 0.0 and (let_go := release(self._plan)) is not None:
            leads.insert(0, (let_go, *end_of(let_go)))
        return any(v > 0.0 and self._slow(lead, s, v, to_rest=to_rest) for lead, s, v in leads)

    def _state(self, count: int) -> tuple[float, float]:
        """Arc length and speed after the first ``count`` phases of the plan."""
        return (
            (float(self._plan[count, S]), float(self._plan[count, V]))
            if count < len(self._plan)
            else (self._rest_at, 0.0)
        )

    def _slow(self, lead: Floats, s: float, v: float, *, to_rest: bool) -> bool:
        """Find the shortest length from ``s`` on within which the motion is slowed from ``v`` to
        what is asked for, and take that plan.

        On that length it may keep its speed, but not rise above it.
        """
        goal, rests = (self._rest_at, True) if to_rest else self._goal()
        if s >= goal - _rounding(goal):
            return False
        slowing = replace(
            self.limits,
            slowing_from=v * (1.0 + ROOM),
            feed_factor=0.0 if to_rest else self.limits.feed_factor,
        )
        stopping = self.limits.stopping_distance(v)
        # Rest only where no junction would want a constant speed at any feed: the motion has to
        # start there again.
        far_off = HORIZON * self.limits.stopping_distance(v, any_direction=True)
        horizon = min(goal, s + far_off)
        near = self._known(slowing, s, horizon)
        faster = replace(slowing, slowing_from=max(v, float(self._plan[0, V])) * (1.0 + ROOM))
        before = [self._known(faster, self._at, s)] if len(lead) else []
        stops = near.end[near.flat & (near.speed == 0.0)]
        horizon = float(stops[0]) if len(stops) else horizon
        level = self._known(replace(self.limits, feed_factor=inf), s, horizon) if to_rest else near
        far = None if to_rest else self._known(self.limits, s, goal)

        def attempt(up_to: float, whole: bool = False) -> Floats | None:
            parts = [*before, near.between(s, up_to)]
            if far is not None:
                end = goal if whole else min(goal, _beyond_flat(far, up_to + far_off))
                parts.append(far.between(up_to, end))
            status, phases = plan_to_rest(
                s, Intervals.joined(parts, [0.0] * len(parts)), v, slowing, lead
            )
            return phases if status == PLANNED else None

        works = failed = _beyond_flat(level, s)
        found = attempt(works) if far is not None and works < horizon else None
        length = stopping if to_rest else stopping / 16.0
        while found is None:
            if works == horizon:
                return False
            failed, works = works, _beyond_flat(level, works + length)
            if works >= horizon:
                if not len(stops):
                    return False
                works = horizon
            found = attempt(works)
            length *= 1.5
        for _ in range(HALVINGS):
            middle = _beyond_flat(level, 0.5 * (failed + works))
            if not failed < middle < works:
                break
            better = attempt(middle)
            if better is None:
                failed = middle
            else:
                works, found = middle, better
        if far is not None:
            found = attempt(works, whole=True)
            if found is None:
                return False
        self._slowing = works, faster
        self._follow(
            found,
            works if to_rest else goal,
            rests=rests,
            known=near if far is None else far,
            lead=first_steady(found) if len(lead) else 0,
        )
        return True

    def _known(self, limits: Limits, start: float, stop: float) -> Intervals:
        """The intervals under some limits from ``start`` to ``stop``, in the window's arc
        length.
        """
        wanted = [
            section for section in self._sections if section.end > start and section.base < stop
        ]
        parts = [
            section.intervals if limits is self.limits else section.stretch.bounds(limits)
            for section in wanted
        ]
        return Intervals.joined(parts, [section.base for section in wanted]).between(
            start + _rounding(start), stop
        )

    def _rebase(self) -> None:
        """Measure arc length from the start of the first section again."""
        shift = self._sections[0].base if self._sections else 0.0
        if shift == 0.0:
            return
        for section in self._sections:
            section.base -= shift
        self._at -= shift
        self._rest_at -= shift
        self._plan[:, S] -= shift
        self._slowing = self._slowing[0] - shift, self._slowing[1]
        if self._round_first is not None:
            self._round_first -= shift

    def _plan_chunk(
        self, section: Section, phases: Floats, end: float, v_end: float, a_end: float
    ) -> PlanChunk:
        """Phases over one section as a plan in that section's own arc length, over the pieces that
        it touches, with the feeds that hold.
        """
        piece_s, path = section.piece_s, section.stretch.path
        local = phases[:, S] - section.base
        local_end = min(end - section.base, float(piece_s[-1]))
        first = min(
            max(int(np.searchsorted(piece_s, local[0], side="right")) - 1, 0), len(path) - 1
        )
        last = max(int(np.searchsorted(piece_s, local_end, side="left")), first + 1)
        zero = float(piece_s[first])
        part = path.part(first, last)
        limits = self._slowing[1] if float(phases[0, S]) < self._slowing[0] else self.limits
        if limits.feed_factor != 1.0 or limits.slowing_from > 0.0:
            part = replace(part, feed=np.where(np.isnan(part.feed), part.feed, limits.feeds(part)))
        t = np.concatenate(([0.0], np.cumsum(phases[:, DURATION])))
        chunk = PlanChunk(
            path=part,
            piece_s=piece_s[first : last + 1] - zero,
            t0=self.clock.seconds,
            s0=section.travelled + zero,
            phase_t=t,
            phase_s=np.append(local, local_end) - zero,
            phase_v=np.append(phases[:, V], v_end),
            phase_a=np.append(phases[:, A], a_end),
            phase_j=phases[:, J].copy(),
        )
        self.clock.add(chunk)
        return chunk


def _beyond_flat(known: Intervals, s: float) -> float:
    """The first place from ``s`` on that is not in or at a stretch of constant speed: there the
    motion may come to rest.
    """
    k = int(np.searchsorted(known.end, s, side="right"))
    if (k < len(known) and known.flat[k]) or (
        0 < k < len(known) and known.flat[k - 1] and known.end[k - 1] == s
    ):
        while k < len(known) and known.flat[k]:
            k += 1
        if k == len(known):
            return inf
        s = 0.5 * float(known.end[k - 1] + known.end[k]) if k > 0 else s
    return s


def _rounding(s: float) -> float:
    """What rounding may do to an arc length in the window: it is rounded anew whenever the window
    moves on.
    """
    return 1e-12 + 8.0 * float(np.spacing(s))
