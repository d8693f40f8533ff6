"""The path in the planner's window: sections in order, measured by one arc length."""

from __future__ import annotations

from collections import deque
from copy import copy
from math import inf

import numpy as np

from cnc.kernels.planner.intervals import Intervals
from cnc.path.chunk import PathChunk
from cnc.planner.intervals import between, joined
from cnc.planner.limits import Limits
from cnc.planner.plan_parts import joined_paths
from cnc.planner.section import Section, Stretch


def rounding_of(s: float) -> float:
    """Return the rounding error of an arc length in the window, mm.

    Arc lengths are rounded again whenever the window is measured from another section.
    """
    return 1e-12 + 8.0 * float(np.spacing(s))


class KnownPath:
    """Sections that follow each other, cut into intervals under the limits in effect."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.sections: deque[Section] = deque()
        self._travelled = 0.0

    def under(self, limits: Limits) -> KnownPath:
        """Return the same path under other limits."""
        other = KnownPath(limits)
        other.sections.extend(
            Section(each.stretch, limits, each.base, each.travelled) for each in self.sections
        )
        other._travelled = self._travelled
        return other

    def copy(self) -> KnownPath:
        """Return the same path, for another window."""
        other = KnownPath(self.limits)
        other.sections.extend(copy(each) for each in self.sections)
        other._travelled = self._travelled
        return other

    def add(
        self, path: PathChunk, previous: PathChunk | None, following: PathChunk | None
    ) -> Section:
        """Append a chunk; None for a neighbour at which the motion rests."""
        base = self.sections[-1].end if self.sections else 0.0
        section = Section(Stretch(path, previous, following), self.limits, base, self._travelled)
        self.sections.append(section)
        self._travelled += float(section.piece_s[-1])
        return section

    def length_at(self, s: float) -> float:
        """Return the path length since the start of the program at ``s``, in the first section."""
        if not self.sections:
            return self._travelled
        return self.sections[0].travelled + (s - self.sections[0].base)

    def pieces_from(self, s: float, count: int) -> PathChunk | None:
        """Return so many pieces of path, the first one under way at ``s``; None if there are fewer.

        ``s`` lies in the first section.
        """
        found: PathChunk | None = None
        first = self._piece_at(s)
        for section in self.sections:
            path = section.stretch.path
            wanted = first + count - (0 if found is None else len(found))
            piece = path.part(first, min(wanted, len(path)))
            found = piece if found is None else joined_paths(found, piece)
            first = 0
            if len(found) == count:
                return found
        return None

    def move_to(self, s: float, piece: int, place: float) -> float:
        """Leave out the sections before a place on a piece, and return the arc length there.

        Args:
            s: a place in the first section.
            piece: number of pieces behind the one that is under way there.
            place: from the start of that piece, mm.
        """
        number = self._piece_at(s) + piece
        while number >= len(self.sections[0].stretch.path):
            number -= len(self.sections.popleft().stretch.path)
        first = self.sections[0]
        return first.base + float(first.piece_s[number]) + place

    def _piece_at(self, s: float) -> int:
        """Return the piece of the first section that is under way at ``s``."""
        first = self.sections[0]
        here = s - first.base + rounding_of(s)
        piece = int(np.searchsorted(first.piece_s, here, side="right")) - 1
        return min(max(piece, 0), len(first.stretch.path) - 1)

    def rebase(self) -> float:
        """Measure arc length from the start of the first section again.

        Returns:
            The length by which all arc lengths become smaller, mm.
        """
        shift = self.sections[0].base if self.sections else 0.0
        for section in self.sections:
            section.base -= shift
        return shift

    def goal(self, at: float) -> tuple[float, bool]:
        """Return the place to which the path behind ``at`` can be planned.

        Returns:
            The last known stop and True, or behind it the last place at which the motion may come
            to rest, and False; -inf if there is none.
        """
        stop = max((section.base + section.last_stop for section in self.sections), default=-inf)
        if stop > at + rounding_of(at):
            return stop, True
        ends = (section.base + section.last_open for section in self.sections)
        return max(ends, default=-inf), False

    def intervals(self, limits: Limits, start: float, stop: float) -> Intervals:
        """Return the intervals under some limits from ``start`` to ``stop``."""
        wanted = [
            section for section in self.sections if section.end > start and section.base < stop
        ]
        near = rounding_of(stop)
        parts = [
            section.intervals
            if limits is self.limits
            else section.intervals_near(
                limits, start - section.base - near, stop - section.base + near
            )
            for section in wanted
        ]
        known = joined(parts, [section.base for section in wanted])
        return between(known, start + rounding_of(start), stop)

    def place(self, s: float) -> tuple[str, int]:
        """Return file and line of the motion that begins at ``s``, in the first section."""
        path = self.sections[0].stretch.path
        return path.file, int(path.line[self._piece_at(s)])
