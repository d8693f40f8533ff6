"""The path in the planner's window: sections in order, measured by one arc length."""

from __future__ import annotations

from collections import deque
from copy import copy
from dataclasses import replace
from math import inf

import numpy as np

from cnc.kernels.path.curve import LENGTH, LINE, START
from cnc.kernels.planner.intervals import Intervals
from cnc.kernels.planner.legs import write_line
from cnc.path.chunk import PathChunk
from cnc.planner.intervals import between, joined
from cnc.planner.limits import Limits
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

    def put_before(self, s: float, curve: PathChunk) -> bool:
        """Replace the path before ``s``, in the first section, by a curve that ends there.

        Returns:
            False where ``s`` is inside a curve. Then nothing changes.
        """
        first = self.sections[0] if self.sections else None
        travelled, length = self.length_at(s), float(curve.length.sum())
        following = None
        if first is not None:
            following = _behind(first, s - first.base, curve)
            if following is None:
                return False
            self.sections[0] = Section(
                Stretch(following, curve, first.stretch.following), self.limits, s, travelled
            )
        lead = Stretch(curve, None, following)
        self.sections.appendleft(Section(lead, self.limits, s - length, travelled - length))
        return True

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
        section = self.sections[0]
        path = section.stretch.path
        here = s - section.base + rounding_of(s)
        piece = int(np.searchsorted(section.piece_s, here, side="right")) - 1
        return path.file, int(path.line[min(max(piece, 0), len(path) - 1)])


def _behind(section: Section, s: float, curve: PathChunk) -> PathChunk | None:
    """Return the path of a section behind ``s``, from where a curve ends; None inside a curve."""
    piece = int(np.searchsorted(section.piece_s, s + rounding_of(s), side="right")) - 1
    path = section.stretch.path.part(piece, len(section.stretch.path))
    taken = s - float(section.piece_s[piece])
    if taken <= rounding_of(s):
        return path
    if path.kind[0] != LINE:
        return None
    n, at, end = len(path.axes), len(path.data), int(curve.at[-1]) + START + len(path.axes)
    data = np.concatenate((path.data, np.empty(START + 2 * n)))
    write_line(data, at, int(path.at[0]), taken, 0.0)
    data[at + START : at + START + n] = curve.data[end : end + n]
    places, length = path.at.copy(), path.length.copy()
    places[0], length[0] = at, data[at + LENGTH]
    # What takes effect at the start of the line has done so.
    commands = None if path.commands is None else path.commands.copy()
    if commands is not None:
        commands[0] = None
    return replace(path, data=data, at=places, length=length, commands=commands)
