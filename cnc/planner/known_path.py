"""The path in the planner's window: sections in order, measured by one arc length."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import Pieces
from cnc.planner.kernels.arrays import Phases
from cnc.planner.kernels.intervals import LEVELS, SAMPLES, TOUCH, Intervals
from cnc.planner.kernels.limits import Junction, piece_junction
from cnc.planner.kernels.subdivision import chunk_intervals
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk, joined_paths

# A stretch of path as intervals with constant bounds: made, cut and joined.

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STANDSTILL = Junction(0.0, True, 1.0, 0.0)
"""A junction at which the motion rests."""

ROUNDING = 1e-4
"""Part of TOUCH that is left for rounding."""

REFINED = 2.0
"""The refinement may cross an interval this much faster than the bound that leaves acceleration for
any direction. The interval is cut for that speed. Faster motion is compared with the path itself.
"""


def junction_between(before: PathChunk, after: PathChunk, limits: Limits) -> Junction:
    """Return the junction of two chunks that follow each other."""
    return _junction(before, len(before) - 1, after, 0, limits)


def _junction(before: PathChunk, m: int, after: PathChunk, k: int, limits: Limits) -> Junction:
    """Return the junction of piece ``m`` of a chunk with piece ``k`` of the same or the next."""
    if before.stop_after[m]:
        return STANDSTILL
    return piece_junction(
        Pieces(before.kind, before.at, before.data),
        m,
        limits.feeds(before)[m],
        Pieces(after.kind, after.at, after.data),
        k,
        limits.feeds(after)[k],
        min(before.length[m], after.length[k]),
        limits.arrays,
        np.zeros((2, 4, len(before.axes))),
    )


def intervals_of(
    path: PathChunk,
    limits: Limits,
    before: Junction,
    after: Junction,
    refined: float = REFINED,
    begin: float = 0.0,
) -> Intervals:
    """Cut a chunk into intervals with constant bounds; arc lengths begin with ``begin``, mm.

    The refinement may cross an interval faster than the bound that leaves acceleration for any
    direction. ``refined`` is the ratio for which the intervals are cut. Faster motion is compared
    with the path itself.
    """
    # Six intervals of a move from stop to stop are usual. Space that is not used costs nothing.
    intervals = _space(8 * len(path) + 1024, len(path.axes))
    done = count = 0
    while True:
        cut, more = chunk_intervals(
            Pieces(path.kind[done:], path.at[done:], path.data),
            path.length[done:],
            limits.feeds(path)[done:],
            path.stop_after[done:],
            before,
            after,
            limits.arrays,
            refined,
            begin,
            Intervals._make(array[count:] for array in intervals),
        )
        done, count = done + cut, count + more
        if done == len(path):
            return Intervals._make(array[:count] for array in intervals)
        larger = _space(4 * len(intervals.end), len(path.axes))
        for array, old in zip(larger, intervals, strict=True):
            array[:count] = old[:count]
        intervals = larger
        if done > 0:
            before = _junction(path, done - 1, path, done, limits)
            begin = float(intervals.end[count - 1])


def _space(intervals: int, axes: int) -> Intervals:
    """Return space for so many intervals."""
    return Intervals(
        end=np.empty(intervals),
        speed=np.empty(intervals),
        top=np.empty(intervals),
        accel=np.empty((intervals, LEVELS)),
        jerk=np.empty((intervals, LEVELS)),
        flat=np.empty(intervals, np.bool_),
        share=np.empty(intervals),
        reliable=np.empty(intervals),
        sampled=np.empty((intervals, 2)),
        samples=np.empty((intervals, SAMPLES, 3, axes)),
    )


def between(intervals: Intervals, start: float, stop: float) -> Intervals:
    """Return the intervals from ``start`` to ``stop``, mm; the last one is cut there.

    A stop at ``stop`` is one of them, a stop at ``start`` is not.
    """
    count = len(intervals.end)
    first = int(np.searchsorted(intervals.end, start, side="right"))
    last = int(np.searchsorted(intervals.end, stop, side="right"))
    cut = last < count and (last == 0 or intervals.end[last - 1] < stop) and last >= first
    part = Intervals._make(array[first : last + cut] for array in intervals)
    return part._replace(end=np.minimum(part.end, stop)) if cut else part


def lowered(intervals: Intervals) -> Intervals:
    """Return intervals for a search, which may exceed their speeds by TOUCH.

    A motion at the speeds of ``intervals`` itself is legal over them.
    """
    return intervals._replace(top=intervals.top / (1.0 + (1.0 - ROUNDING) * TOUCH))


def joined(parts: Sequence[Intervals], bases: Sequence[float]) -> Intervals:
    """Return the intervals of stretches that follow each other and begin at ``bases``, mm."""
    moved = [
        part._replace(end=part.end + base, sampled=part.sampled + base)
        for part, base in zip(parts, bases, strict=True)
    ]
    return Intervals._make(np.concatenate(arrays) for arrays in zip(*moved, strict=True))


# Intervals for a motion that will be shaped: a place has the speed of its slowest neighbour.

SPARE = 1.02
"""Part of its reach by which a slow interval counts farther: the shaper is found to a per cent."""
NEARLY = 1.005
"""A bound that is at most this much above another one may be lowered to it."""
SLIVER = 1e-3
"""mm; no interval is cut to a shorter one, and the least reach of a slow interval."""
AT_JOINT = 0.92
"""Part of its speed at which a joint is crossed: the shaped speed is not quite constant there."""
IN_BENDS = 0.5
"""Part of a turn, in rad, by which the sums of acceleration and jerk are off. It is measured, not
derived: with less the audit refuses more plans.
"""


def widened(intervals: Intervals, start: float, limits: Limits) -> Intervals:
    """Return intervals whose speed counts for the path beside them, too.

    A shaped speed at a place is a mean of speeds at places up to the spread times the speed before
    and behind. It keeps to the bound of an interval if all of these do.

    Args:
        intervals: intervals that follow each other.
        start: arc length at the start of the first one, mm.
        limits: with the spread.
    """
    end = intervals.end
    top = np.where(intervals.flat, AT_JOINT * intervals.speed, intervals.top)
    begin = np.append(start, end[:-1])
    moves = top > 0.0
    reach = np.minimum(SPARE * limits.spread * top, end[-1] - start) + SLIVER * moves
    low, high = begin - reach, end + reach
    bound = _least_over(
        top, np.searchsorted(begin, low), np.searchsorted(end, high, side="right"), len(end)
    )
    # An edge inside of a much faster interval cuts it. A stop has no length and no reach.
    edges = np.concatenate((low, high))
    rows = np.minimum(np.searchsorted(end, edges, side="right"), len(end) - 1)
    inside = (edges > begin[rows] + SLIVER) & (edges < end[rows] - SLIVER)
    inside &= bound[rows] > NEARLY * np.tile(top, 2)
    order = np.lexsort((edges[inside], rows[inside]))
    edges, rows = edges[inside][order], rows[inside][order]
    apart = (np.diff(edges, prepend=start - 1.0) > SLIVER) | (np.diff(rows, prepend=-1) > 0)
    rows = np.concatenate((rows[apart], np.arange(len(end))))
    ends = np.concatenate((edges[apart], end))
    order = np.lexsort((ends, rows))
    ends, rows = ends[order], rows[order]
    first = np.searchsorted(ends, low + SLIVER)
    after = np.searchsorted(np.append(start, ends[:-1]), high - SLIVER, side="right")
    bound = _least_over(top[moves], first[moves], after[moves], len(ends))
    cut = Intervals._make(array[rows] for array in intervals)
    bound = np.minimum(bound, cut.top)
    speed = np.minimum(cut.speed, bound)
    accel, jerk = _at_lower_speed(cut, speed)
    cut = cut._replace(end=ends, top=bound, speed=speed, accel=accel, jerk=jerk)
    return _with_room_in_bends(cut, limits)


def _with_room_in_bends(intervals: Intervals, limits: Limits) -> Intervals:
    """Return intervals whose share of the limits leaves room for what a shaper mixes in a bend.

    The direction of the path turns on the way over which the motion is mixed.
    """
    _, bend, change = np.moveaxis(np.abs(intervals.samples), 2, 0)
    turn = limits.spread * intervals.top * np.linalg.norm(bend, axis=2).max(axis=1)
    part = 1.0 / (1.0 + IN_BENDS * turn)
    share = intervals.share * part
    with np.errstate(divide="ignore"):
        by_bend = np.sqrt(share / (bend / limits.axis_acceleration).max(axis=(1, 2)))
        by_change = np.cbrt(share / (change / limits.axis_jerk).max(axis=(1, 2)))
    top = np.minimum(intervals.top, np.minimum(by_bend, by_change))
    accel, jerk = intervals.accel * part[:, None], intervals.jerk * part[:, None]
    # Where only the feed limits the speed there is room enough.
    bent = intervals.speed < intervals.top
    speed = np.minimum(np.where(bent, np.sqrt(part), 1.0) * intervals.speed, top)
    return intervals._replace(top=top, speed=speed, accel=accel, jerk=jerk, share=share)


def _least_over(values: Floats, first: Ints, after: Ints, count: int) -> Floats:
    """Return for each of ``count`` places the least value whose range holds it (count,).

    The range of a value is ``first`` .. ``after - 1``.
    """
    least = np.full(count, inf)
    lengths = np.maximum(after - first, 0)
    starts = np.cumsum(lengths) - lengths
    places = np.arange(int(lengths.sum())) + np.repeat(first - starts, lengths)
    np.minimum.at(least, places, np.repeat(values, lengths))
    return least


def _at_lower_speed(intervals: Intervals, speed: Floats) -> tuple[Floats, Floats]:
    """Return the bounds on acceleration and jerk at levels of lower speeds."""
    part = speed / np.where(intervals.speed > 0.0, intervals.speed, 1.0)
    # The levels fall by a tenth from 1 on.
    level = np.clip(10.0 * (1.0 - part[:, None] * (1.0 - 0.1 * np.arange(LEVELS))), 0.0, LEVELS - 1)
    below = np.minimum(level.astype(np.int64), LEVELS - 2)
    share = level - below
    rows = np.arange(len(speed))[:, None]

    def between(bounds: Floats) -> Floats:
        low: Floats = bounds[rows, below] * (1.0 - share) + bounds[rows, below + 1] * share
        return low

    return between(intervals.accel), between(intervals.jerk)


# A chunk of path in the planner's window, cut into intervals under the limits in effect.

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
        """Return its intervals; see :func:`intervals_of`."""
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
        self.intervals = intervals = stretch.intervals(limits, self._refined)
        stops = np.flatnonzero(intervals.flat & (intervals.speed == 0.0))
        opens = np.flatnonzero(~intervals.flat)
        self.last_stop = float(intervals.end[stops[-1]]) if len(stops) else -inf
        self.last_open = float(intervals.end[opens[-1]]) if len(opens) else -inf
        self.top = float(intervals.speed.max())

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
        path = KnownPath(limits)
        path.sections.extend(
            Section(section.stretch, limits, section.base, section.travelled)
            for section in self.sections
        )
        path._travelled = self._travelled
        return path

    def copy(self) -> KnownPath:
        """Return the same path, for another window."""
        path = KnownPath(self.limits)
        path.sections.extend(copy(section) for section in self.sections)
        path._travelled = self._travelled
        return path

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
        pieces: PathChunk | None = None
        first = self._piece_at(s)
        for section in self.sections:
            path = section.stretch.path
            wanted = first + count - (0 if pieces is None else len(pieces))
            piece = path.part(first, min(wanted, len(path)))
            pieces = piece if pieces is None else joined_paths(pieces, piece)
            first = 0
            if len(pieces) == count:
                return pieces
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
        beside = 0.0
        if limits.spread > 0.0:
            fastest = max(section.top for section in self.sections)
            beside = SPARE * limits.spread * fastest + SLIVER
        begin, end = start - beside, stop + beside
        wanted = [
            section for section in self.sections if section.end > begin and section.base < end
        ]
        near = rounding_of(stop)
        parts = [
            section.intervals
            if limits is self.limits
            else section.intervals_near(
                limits, begin - section.base - near, end - section.base + near
            )
            for section in wanted
        ]
        whole = joined(parts, [section.base for section in wanted])
        if beside:
            whole = widened(whole, wanted[0].base, limits)
        return between(whole, start + rounding_of(start), stop)

    def place(self, s: float) -> tuple[str, int]:
        """Return file and line of the motion that begins at ``s``, in the first section."""
        path = self.sections[0].stretch.path
        return path.file, int(path.line[self._piece_at(s)])
