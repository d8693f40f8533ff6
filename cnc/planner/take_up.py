r"""Take-up of backlash: the sides of the nuts along a path of the tip.

A nut has play between two flanks of its screw. A motor that pushes it up stands half the backlash
ahead of it, one that pushes it down half the backlash behind:

    motor = place + side * half the backlash        side: +1 pushed up, -1 pushed down

The side changes at a reversal of the axis, smoothly over a window of path:

              extreme
     place   . -- | -- .       The nut stands still from A on, because the flank leaves it, until
           A      |      B     the other flank arrives at B. A and B lie on one level, which is
         /                \   DEVIATION below the extreme. So the nut is off by less, whatever
           └── window ──┘      the side does in between.

Within the window the side is a polynomial of degree 7 of the distance along the path, with three
derivatives 0 at both ends. The limits of the motor then limit the speed there. A longer window than
the motor needs at the programmed feed is shortened from its begin: between the flanks nothing holds
the nut. For the same reason the motion never rests in a window where the program lets it rest.

A reversal that leads back by less than the deviation is none: a fitted curve may waver.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.compensation import Compensation
from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series, sqrt
from cnc.machine.models import Machine
from cnc.path.chunk import PathChunk
from cnc.planner.roots import roots
from cnc.planner.tip_series import Parts, joined, tip_series

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

DEVIATION = 0.4
"""Largest deviation of the nut at a reversal, steps. The rest of a step is for rounding."""
LATER = 0.25
"""Part of the deviation up to which a reversal at the end of a chunk is left to the next one."""
WAVER = 1.0 / 64.0
"""Part of the deviation that is no motion."""
JUMP = 1e-6
"""Distance between the end of a chunk and the start of the next one that is a jump, mm."""
NEAR = 1e-7
"""Distance from a level at which a place is on it, mm."""
ROOM = 1.5
"""Length of a window, in the least that the motor needs at the programmed feed."""


class Play(NamedTuple):
    """The play of an axis.

    Attributes:
        compensation: Of the machine: it gives the place of the axis.
        column: Column of the axis.
        deviation: Largest deviation of the nut at a reversal, mm.
        seconds: Least time in which the motor takes up the play, s.
        largest: The play where it is largest, mm.
    """

    compensation: Compensation
    column: int
    deviation: float
    seconds: float
    largest: float


def least_seconds(play: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Return the least time in which a motor at rest makes the step of a window, s.

    The largest derivatives of the step 35 t^4 - 84 t^5 + 70 t^6 - 20 t^7 are 35/16, 84/5^1.5, 52.5.
    """
    return float(
        max(
            35.0 / 16.0 * play / velocity,
            (84.0 / 5.0**1.5 * play / acceleration) ** 0.5,
            (52.5 * play / jerk) ** (1.0 / 3.0),
        )
    )


class Sides(NamedTuple):
    """The side of a nut on parts of a path.

    Attributes:
        before: Side at the begin of the window of each part, or the side itself (m,).
        after: Side at the end of its window (m,).
        begin: Distance of the start of the part in its window, as a share of the window (m,).
        end: That of its end (m,).
        length: Length of the window, mm; infinite where the side does not change (m,).
    """

    before: Floats
    after: Floats
    begin: Floats
    end: Floats
    length: Floats

    @property
    def changes(self) -> Flags:
        """Whether the side changes on a part."""
        return np.isfinite(self.length)

    def at(self, share: Floats) -> Floats:
        """Return the sides (m,) at shares of the windows."""
        sides: Floats = self.before + (self.after - self.before) * _step(Series([share])).terms[0]
        return sides

    def series(self, tip: Sequence[Series], first: Floats | Interval) -> Series:
        """Return the series of the side.

        Args:
            tip: The series of the tip on the parts.
            first: The share of the window to which it belongs: ``begin``, ``end``, or both.
        """
        order = len(tip[0].terms) - 1
        slopes = [Series([t * float(k) for k, t in enumerate(axis.terms)][1:]) for axis in tip]
        squares = slopes[0].square()
        for slope in slopes[1:]:
            squares = squares + slope.square()
        speed = sqrt(squares) * (1.0 / self.length)
        share = Series([first, *(speed.terms[k] * (1.0 / (k + 1)) for k in range(order))])
        return _step(share) * (self.after - self.before) + self.before

    def of(self, which: Flags | Ints) -> Sides:
        """Return the sides on some of the parts."""
        return Sides(*(column[which] for column in self))


def _step(t: Series) -> Series:
    """Return the step from 0 to 1 on the way of ``t`` from 0 to 1."""
    square = t.square()
    return ((t * (t * (t * -20.0 + 70.0) - 84.0)) + 35.0) * square * square


class Course(NamedTuple):
    """The course of a side over the parts of a path.

    Attributes:
        window: Number of the window in which each part lies; -1 for none (m,).
        side: The side where the part lies in none, else that before the window (m,).
    """

    window: Ints
    side: Floats

    def repeated(self, counts: Ints) -> Course:
        """Return the course over parts of which each is cut into its count."""
        return Course(np.repeat(self.window, counts), np.repeat(self.side, counts))

    def sides(self, lengths: Floats) -> Sides:
        """Return the sides on parts with these lengths (m,)."""
        inside = self.window >= 0
        whole = np.bincount(self.window[inside], lengths[inside])
        done = np.cumsum(np.where(inside, lengths, 0.0))
        opens = np.flatnonzero(inside & (np.diff(self.window, prepend=-1) != 0))
        length = np.full(len(lengths), np.inf)
        begin, end = np.zeros(len(lengths)), np.zeros(len(lengths))
        length[inside] = whole[self.window[inside]]
        origin = (done - lengths)[opens][self.window[inside]]
        end[inside] = (done[inside] - origin) / length[inside]
        begin[inside] = end[inside] - lengths[inside] / length[inside]
        # The windows begin and end to the last bit, and neighbours meet.
        begin[opens] = 0.0
        ends = np.flatnonzero(inside & (np.diff(self.window, append=-1) != 0))
        end[ends] = 1.0
        begin[1:] = np.where(begin[1:] > 0.0, end[:-1], begin[1:])
        after = np.where(inside, -self.side, self.side)
        return Sides(self.side, after, begin, end, length)


class TakeUp:
    """Places the windows of all axes with backlash, chunk by chunk.

    Args:
        plays: The plays by the column of their axis.

    Attributes:
        sides: The side at the end of the path so far, by column; at first +1.
    """

    def __init__(self, plays: Mapping[int, Play]) -> None:
        self._plays = dict(plays)
        self.sides = dict.fromkeys(plays, 1.0)
        self._extreme: dict[int, float] = {}
        self._place: dict[int, float] = {}

    def courses(self, path: PathChunk, parts: Parts) -> tuple[Parts, dict[int, Course]]:
        """Return the parts of a chunk of path, cut at the ends of windows, and the sides there.

        Args:
            path: The chunk.
            parts: Its parts in order.
        """
        parts = _monotone(path, parts, list(self._plays.values()))
        for axis, play in self._plays.items():
            # Each pass cuts a part once; a part has few levels.
            while True:
                walk = self._walked(path, parts, axis, play)
                if not walk.levels:
                    break
                parts = _cut_at_levels(path, parts, play, dict(reversed(walk.levels)))
            parts = _cut_at_begins(path, parts, play, walk.windows)
        courses: dict[int, Course] = {}
        for axis, play in self._plays.items():
            walk = self._walked(path, parts, axis, play)
            self._extreme[axis], self._place[axis] = walk.extreme, walk.place
            course = Course(np.full(len(parts.piece), -1), np.empty(len(parts.piece)))
            side, done = self.sides[axis], 0
            for number, window in enumerate(walk.windows):
                first = _late_begin(path, parts, play, window)[0]
                course.side[done : window.behind] = side
                course.window[first : window.behind] = number
                side, done = -side, window.behind
            course.side[done:] = side
            self.sides[axis], courses[axis] = side, course
        return parts, courses

    def _walked(self, path: PathChunk, parts: Parts, axis: int, play: Play) -> Walk:
        """Return the windows along a chunk, and the levels at which parts must be cut."""
        start, end = _values(path, parts.starts, play), _values(path, parts.ends, play)
        last = np.append(np.diff(parts.piece) != 0, True)
        stops = (last & path.stop_after[parts.piece]).tolist()
        side, allowed = self.sides[axis], play.deviation
        before, begins, ends = float(start[0]), start.tolist(), end.tolist()
        # A probe may have ended elsewhere.
        jumped = abs(self._place.get(axis, before) - before) > JUMP
        extreme = before if jumped else self._extreme.get(axis, before)
        walk = Walk([], [], extreme, ends[-1])
        top = free = stop = 0
        for k, place in enumerate(ends):
            back = side * (extreme - place)
            final = k + 1 == len(ends) and back >= LATER * allowed
            if back <= 0.0:
                extreme, top = place, k + 1
            elif back >= allowed - NEAR or final:
                level = extreme - side * allowed
                if back > allowed + NEAR:
                    walk.levels.append((k, level))
                first = max(top, stop)
                while first > max(free, stop):
                    if side * (extreme - begins[first - 1]) > allowed + NEAR:
                        if side * (extreme - ends[first - 1]) < allowed - NEAR:
                            walk.levels.append((first - 1, level))
                        break
                    first -= 1
                walk.windows.append(Window(first, k + 1))
                side, extreme, top, free = -side, place, k + 1, k + 1
            if stops[k]:
                stop = k + 1
        return walk._replace(extreme=extreme)


def plays_of(machine: Machine) -> dict[int, Play]:
    """Return the plays of a machine, by the column of their axis."""
    if not machine.is_compensated:
        return {}
    compensation, plays = machine.compensation, {}
    for column, axis in enumerate(machine.axes.values()):
        play = compensation.screws[column].play if column in compensation.screws else 0.0
        if play:
            seconds = least_seconds(
                play,
                axis.max_velocity,
                axis.max_acceleration or math.inf,
                axis.max_jerk or math.inf,
            )
            deviation = DEVIATION / axis.steps_per_mm
            plays[column] = Play(compensation, column, deviation, seconds, play)
    return plays


class Window(NamedTuple):
    """Parts of a path on which a side changes: from ``first`` to before ``behind``."""

    first: int
    behind: int


class Walk(NamedTuple):
    """Windows along a chunk.

    Attributes:
        windows: In order.
        levels: Parts, and places of the axis inside them at which windows begin or end.
        extreme: The farthest place on the side at the end of the chunk.
        place: The place of the axis at the end of the chunk.
    """

    windows: list[Window]
    levels: list[tuple[int, float]]
    extreme: float
    place: float


def _place(path: PathChunk, places: Parts, play: Play, order: int) -> Floats:
    """Return a term of the series of an axis at places of a path (m,)."""
    tip = tip_series(path, places, order, bounds=False)
    cells = None
    if play.compensation.has_volume:
        here = np.stack([axis.terms[0] for axis in tip], axis=-1)
        cells = play.compensation.cells_of_volume(here, here, here)
    term: Floats = play.compensation.place(play.column, tip, cells).terms[order]
    return term


def _values(path: PathChunk, places: Parts, play: Play) -> Floats:
    """Return the places of an axis (m,)."""
    return _place(path, places, play, 0)


def _tips(path: PathChunk, places: Parts) -> Floats:
    """Return the tips (m, axes) at places of a path."""
    return np.stack([s.terms[0] for s in tip_series(path, places, 0, bounds=False)], axis=-1)


def _monotone(path: PathChunk, parts: Parts, plays: Sequence[Play]) -> Parts:
    """Return the parts, cut so that each axis with play goes one way on each, but for waver."""
    done: list[Parts] = []
    while len(parts.piece):
        cut = np.full(len(parts.piece), np.nan)
        tip = tip_series(path, parts, 1, bounds=True)
        width = parts.last - parts.first
        cells = None
        if plays[0].compensation.has_volume:
            three = [_tips(path, places) for places in (parts.starts, parts.middles, parts.ends)]
            cells = plays[0].compensation.cells_of_volume(*three)
        for play in plays:
            rate = play.compensation.place(play.column, tip, cells).terms[1]
            if not isinstance(rate, Interval):
                continue
            wavers = np.minimum(-rate.lo, rate.hi) * width > WAVER * play.deviation
            turning = np.flatnonzero(wavers & np.isnan(cut))
            some = parts.of(turning)
            at_start, at_end = (_rates(path, ends, play) for ends in (some.starts, some.ends))
            across = at_start * at_end < 0.0
            middles = 0.5 * (some.first + some.last)
            middles[across] = _roots_of_rates(path, some.of(across), play)
            # A root beside an end divides nothing.
            margin = 1e-3 * (some.last - some.first)
            inside = (middles > some.first + margin) & (middles < some.last - margin)
            cut[turning] = np.where(inside, middles, 0.5 * (some.first + some.last))
        whole = np.isnan(cut)
        done.append(parts.of(whole))
        rest, place = parts.of(~whole), cut[~whole]
        parts = joined(rest._replace(last=place), rest._replace(first=place))
    return joined(*done).in_order


def _rates(path: PathChunk, places: Parts, play: Play) -> Floats:
    """Return the derivatives of an axis by the parameter (m,)."""
    return _place(path, places, play, 1)


def _roots_of_rates(path: PathChunk, parts: Parts, play: Play) -> Floats:
    return roots(lambda u: _rates(path, Parts(parts.piece, u, u), play), parts.first, parts.last)


def _cut_at_levels(path: PathChunk, parts: Parts, play: Play, levels: Mapping[int, float]) -> Parts:
    """Return the parts, some of them cut where the axis is at a level."""
    index = np.array(list(levels), np.int64)
    level, some = np.array(list(levels.values())), parts.of(index)
    place = roots(
        lambda u: _values(path, Parts(some.piece, u, u), play) - level, some.first, some.last
    )
    return _cut_at(parts, index, place)


def _cut_at(parts: Parts, index: Ints, place: Floats) -> Parts:
    """Return the parts, those of ``index`` cut at parameters."""
    whole = np.ones(len(parts.piece), np.bool_)
    whole[index] = False
    some = parts.of(index)
    return joined(parts.of(whole), some._replace(last=place), some._replace(first=place)).in_order


def _late_begin(path: PathChunk, parts: Parts, play: Play, window: Window) -> tuple[int, float]:
    """Return the part in which a window begins that is not longer than needed, and the share.

    The share is that of the part in front of the begin.
    """
    inside = np.arange(window.first, window.behind)
    lengths = part_lengths(path, parts.of(inside))
    feeds = path.feed[parts.piece[inside]]
    if np.isnan(feeds).any():
        return window.first, 0.0
    allowed = ROOM * play.seconds * float(feeds.max())
    left = np.cumsum(lengths[::-1])[::-1]
    fits = np.flatnonzero(left <= allowed * (1.0 + 1e-6))
    if len(fits) == len(inside):
        return window.first, 0.0
    k = int(fits[0]) - 1 if len(fits) else len(inside) - 1
    behind = float(left[k + 1]) if k + 1 < len(inside) else 0.0
    share = 1.0 - (allowed - behind) / float(lengths[k])
    if share > 1.0 - 1e-3 and k + 1 < len(inside):
        return window.first + k + 1, 0.0
    return window.first + k, share


def _cut_at_begins(path: PathChunk, parts: Parts, play: Play, windows: Sequence[Window]) -> Parts:
    """Return the parts, cut where windows begin that are not longer than needed."""
    begins = [_late_begin(path, parts, play, window) for window in windows]
    cuts = [(k, share) for k, share in begins if share > 0.0]
    if not cuts:
        return parts
    index = np.array([k for k, _ in cuts], np.int64)
    some = parts.of(index)
    shares = np.array([share for _, share in cuts])
    return _cut_at(parts, index, some.first + shares * (some.last - some.first))


@cache
def _quadrature() -> tuple[Floats, Floats]:
    """Return places and weights (8,) of Gauss' and Legendre's quadrature on -1 to 1.

    Only machines with backlash need numpy's polynomials.
    """
    return np.polynomial.legendre.leggauss(8)


def part_lengths(path: PathChunk, parts: Parts) -> Floats:
    """Return the lengths of parts of the tip's path (m,)."""
    nodes, weights = _quadrature()
    half = 0.5 * (parts.last - parts.first)
    u = (0.5 * (parts.first + parts.last))[:, None] + half[:, None] * nodes
    piece = np.repeat(parts.piece, len(nodes))
    series = tip_series(path, Parts(piece, u.ravel(), u.ravel()), 1, bounds=False)
    speed = np.sqrt(sum(np.square(axis.terms[1]) for axis in series)).reshape(-1, len(nodes))
    lengths: Floats = half * (speed @ weights)
    return lengths
