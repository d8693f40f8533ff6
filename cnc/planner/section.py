"""A chunk of path in the planner's window, cut into intervals under the limits in effect."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from cnc.kernels.planner.intervals import Intervals
from cnc.kernels.planner.phases import Phases
from cnc.path.chunk import PathChunk
from cnc.planner.intervals import REFINED, STANDSTILL, intervals_of, junction_between
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk

FINER = 4.0
"""Factor of the speed for which the intervals are cut again, where a plan exceeds a limit."""

FINEST = 32.0
"""The largest ratio of that speed to the usual bound."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A chunk of path and its neighbours, None where the motion rests between them."""

    path: PathChunk
    previous: PathChunk | None
    following: PathChunk | None

    def intervals(self, limits: Limits, refined: float = REFINED, begin: float = 0.0) -> Intervals:
        """Return its intervals; see :func:`cnc.planner.intervals.intervals_of`."""
        before = after = STANDSTILL
        if self.previous is not None:
            before = junction_between(self.previous, self.path, limits)
        if self.following is not None:
            after = junction_between(self.path, self.following, limits)
        return intervals_of(self.path, limits, before, after, refined, begin)

    def part(self, first: int, last: int) -> Stretch:
        """Return the pieces from ``first`` to before ``last`` as a stretch."""
        path = self.path
        return Stretch(
            path.part(first, last),
            path.part(first - 1, first) if first > 0 else self.previous,
            path.part(last, last + 1) if last < len(path) else self.following,
        )


def with_feeds_in_effect(path: PathChunk, limits: Limits) -> PathChunk:
    """Return a path with the feeds under an override, and those above which the motion slows."""
    if limits.feed_factor == 1.0 and limits.slowing_from == 0.0:
        return path
    return replace(path, feed=np.where(np.isnan(path.feed), path.feed, limits.feeds(path)))


class Section:
    """A stretch in the window.

    Attributes:
        stretch: the chunk of path.
        piece_s: (pieces + 1,): arc length at the ends of the pieces, from its start, mm.
        base: the window's arc length at its start, mm.
        travelled: path length before it, mm.
        intervals: with arc lengths from its start.
        last_stop: where the motion stops last, from its start, mm; -inf if it does not stop.
        last_open: the last place at which the motion may come to rest; -inf if there is none.
        top: its largest speed bound, mm/s.
    """

    def __init__(self, stretch: Stretch, limits: Limits, base: float, travelled: float) -> None:
        self.stretch = stretch
        self.piece_s = np.concatenate(([0.0], np.cumsum(stretch.path.length)))
        self.base = base
        self.travelled = travelled
        self._refined = REFINED
        self.intervals = known = stretch.intervals(limits, self._refined)
        stops = np.flatnonzero(known.flat & (known.speed == 0.0))
        opens = np.flatnonzero(~known.flat)
        self.last_stop = float(known.end[stops[-1]]) if len(stops) else -inf
        self.last_open = float(known.end[opens[-1]]) if len(opens) else -inf
        self.top = float(known.speed.max())

    def cut_finer(self, limits: Limits) -> bool:
        """Cut into intervals for faster motion; return whether they were not the finest yet."""
        if self._refined >= FINEST:
            return False
        self._refined *= FINER
        self.intervals = self.stretch.intervals(limits, self._refined)
        return True

    def intervals_near(self, limits: Limits, start: float, stop: float) -> Intervals:
        """Return the intervals of the pieces between two arc lengths under other limits.

        Arc lengths are measured from the start of the section, mm. The result is a part of that for
        the whole section, to the last digit.
        """
        pieces = len(self.stretch.path)
        first = int(np.searchsorted(self.piece_s, start, side="right")) - 1
        first = min(max(first, 0), pieces - 1)
        last = int(np.searchsorted(self.piece_s, stop, side="left"))
        last = min(max(last, first + 1), pieces)
        begin = float(self.piece_s[first])
        return self.stretch.part(first, last).intervals(limits, begin=begin)

    @property
    def end(self) -> float:
        """The window's arc length at its end, mm."""
        return self.base + float(self.piece_s[-1])

    def plan_chunk(
        self, phases: Phases, end: tuple[float, float, float], limits: Limits, t0: float
    ) -> PlanChunk:
        """Return phases over this section as a plan, with the feeds in effect.

        Args:
            phases: the phases.
            end: the window's arc length at their end, mm, speed and acceleration there.
            limits: those in effect.
            t0: time at their start, s.
        """
        piece_s, path = self.piece_s, self.stretch.path
        local = phases["s"] - self.base
        local_end = min(end[0] - self.base, float(piece_s[-1]))
        first = int(np.searchsorted(piece_s, local[0], side="right")) - 1
        first = min(max(first, 0), len(path) - 1)
        last = max(int(np.searchsorted(piece_s, local_end, side="left")), first + 1)
        zero = float(piece_s[first])
        part = path.part(first, last)
        return PlanChunk(
            path=with_feeds_in_effect(part, limits),
            piece_s=piece_s[first : last + 1] - zero,
            t0=t0,
            s0=self.travelled + zero,
            phase_t=np.concatenate(([0.0], np.cumsum(phases["duration"]))),
            phase_s=np.append(local, local_end) - zero,
            phase_v=np.append(phases["v"], end[1]),
            phase_a=np.append(phases["a"], end[2]),
            phase_j=phases["j"].copy(),
        )
