"""A chunk of path in the planner's window, cut into intervals under the limits that hold."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from cnc.path.chunk import PathChunk
from cnc.planner.limits import STANDSTILL, Intervals, Limits, intervals, junction_between


@dataclass(frozen=True, slots=True)
class Stretch:
    """A chunk of path and its neighbours, None where the motion rests between them."""

    path: PathChunk
    previous: PathChunk | None
    following: PathChunk | None

    def bounds(self, limits: Limits) -> Intervals:
        """Its intervals, from its start."""
        before = (
            STANDSTILL
            if self.previous is None
            else junction_between(self.previous, self.path, limits)
        )
        after = (
            STANDSTILL
            if self.following is None
            else junction_between(self.path, self.following, limits)
        )
        return intervals(self.path, limits, before, after)


class Section:
    """A stretch in the window. base: the window's arc length at its start; travelled: the path
    length before it.

    last_stop, last_open: where it stops last, and where motion in it may come to rest last (-inf:
    nowhere); top: its largest speed bound.
    """

    def __init__(self, stretch: Stretch, limits: Limits, base: float, travelled: float) -> None:
        self.stretch = stretch
        self.piece_s = np.concatenate(([0.0], np.cumsum(stretch.path.length)))
        self.base = base
        self.travelled = travelled
        self.intervals = known = stretch.bounds(limits)
        stops = np.flatnonzero(known.flat & (known.speed == 0.0))
        opens = np.flatnonzero(~known.flat)
        self.last_stop = float(known.end[stops[-1]]) if len(stops) else -inf
        self.last_open = float(known.end[opens[-1]]) if len(opens) else -inf
        self.top = float(known.speed.max())

    @property
    def end(self) -> float:
        """The window's arc length at its end."""
        return self.base + float(self.piece_s[-1])
