"""Tables of bounded size for a motion of any length. A full table is made coarser.

The picture of a short program is exact. That of a long program states its tolerance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.view.kernels.motion import Points, new_points
from cnc.view.kernels.thinning import new_fan, thin, thin_end

Floats = NDArray[np.float64]

FINEST = 0.0005
"""mm. First tolerance of the path."""
OPEN = -1.0
"""Last line of a row until the next row is known."""


@dataclass(frozen=True, slots=True)
class Strokes:
    """The path as straight strokes at a steady speed.

    Attributes:
        t: (n,) times of the points between the strokes, s.
        position: (n, 3) x, y and z of the points, mm.
        feed: (n,) feed of the stroke that begins at each point, mm/s; the last point has none.
        accel: (n,) acceleration of largest magnitude in it, mm/s^2.
        jerk: (n,) jerk of largest magnitude in it, mm/s^3.
        rapid: (n,) whether it is a traverse.
        tolerance: at every time the tool is drawn within this distance of the plan, mm.
    """

    t: Floats
    position: Floats
    feed: Floats
    accel: Floats
    jerk: Floats
    rapid: NDArray[np.bool_]
    tolerance: float


class StrokeTable:
    """Thins points as they are added.

    With more than ``most`` points it thins all of them again with twice the tolerance.
    """

    def __init__(self, most: int) -> None:
        self.most = max(most, 32)
        self.tolerance = FINEST
        self.error = 2.0 * FINEST
        self._points = new_points(self.most + 2)
        self._count = 0
        self._fan = new_fan()

    @property
    def chord_tolerance(self) -> float:
        """Largest distance of a chord between two added points from the motion, mm."""
        return 0.5 * self.tolerance

    def add(self, points: Points) -> None:
        """Add points in order of time, as :func:`~cnc.view.kernels.motion.follow` makes them."""
        # Few at a time: points that come after a change of the tolerance must be thinned by it.
        step = self.most // 8
        for first in range(0, len(points.t), step):
            self._count += thin(
                points.part(first, first + step),
                True,
                self.tolerance,
                self._fan,
                self._points.part(self._count),
            )
            self._reduce()

    def strokes(self, start: Floats) -> Strokes:
        """Return the strokes. Nothing may be added afterwards.

        Args:
            start: (3,) the only point of a program without motion, mm.
        """
        self._count += thin_end(self._fan, self._points.part(self._count))
        self._reduce()
        points = self._points.part(0, self._count)
        if not self._count:
            none = np.zeros(1)
            points = Points(none, start[None], none, none, none, np.zeros(1, np.bool_))
        step = np.diff(points.t)
        feed = np.append(np.diff(points.s) / np.where(step > 0.0, step, 1.0), 0.0)
        return Strokes(
            points.t,
            points.position,
            feed,
            points.accel,
            points.jerk,
            points.rapid,
            self.error,
        )

    def _reduce(self) -> None:
        while self._count > self.most - self.most // 8:
            self._coarsen()

    def _coarsen(self) -> None:
        """Thin all points with twice the tolerance, which adds to the error so far."""
        self.tolerance *= 2.0
        self.error += self.tolerance
        fan = new_fan()
        kept = new_points(self._count + 2)
        points = self._points.part(0, self._count)
        count = thin(points, False, self.tolerance, fan, kept)
        count += thin_end(fan, kept.part(count))
        last = self._count - 1
        for column, source in zip(self._points, kept, strict=True):
            # The last point belongs to the stroke that is still to come.
            end = column[last].copy()
            column[:count] = source[:count]
            column[count - 1] = end
        self._count = count


@dataclass(frozen=True, slots=True)
class Curves:
    """Feed (mm/s), acceleration (mm/s^2) and jerk (mm/s^3) over time, in rows.

    Attributes:
        t: (n + 1,) ends of the rows, s.
        within: 0 if the curves are exact; else the longest time of a row of several phases, s.
        start: (3, n) values at the start of each row, with constant jerk within it; if exact.
        low: (3, n) least values in each row; if not exact.
        high: (3, n) greatest values in each row; if not exact.
    """

    t: Floats
    within: float
    start: Floats
    low: Floats
    high: Floats


class CurveTable:
    """Collects phases of constant jerk.

    With more than ``most`` of them it keeps the least and greatest values of several phases.
    """

    def __init__(self, most: int) -> None:
        self.most = max(most, 4)
        self._width = 0.0
        self._rows = np.empty((0, 4))
        self._new: list[Floats] = []
        self._waiting = 0
        self._ranges = np.empty((0, 7))

    def add(self, phases: Floats) -> None:
        """Add rows (n, 4): start of a phase (s), and feed, acceleration and jerk there."""
        self._new.append(phases)
        self._waiting += len(phases)
        if self._waiting > self.most:
            self._take_in()

    def curves(self, end: float) -> Curves:
        """Return the curves up to the time ``end`` (s). Nothing may be added afterwards."""
        self.add(np.array([[end, 0.0, 0.0, 0.0]]))
        self._take_in()
        none = np.empty((3, 0))
        if self._width > 0.0:
            ranges = self._ranges
            return Curves(
                np.append(ranges[:, 0], end),
                2.0 * self._width,
                none,
                ranges[:, 1::2].T,
                ranges[:, 2::2].T,
            )
        rows = self._rows[:-1] if len(self._rows) > 1 else self._rows
        return Curves(np.append(rows[:, 0], end), 0.0, rows[:, 1:].T, none, none)

    def _take_in(self) -> None:
        """Move new rows into the table.

        In a table of ranges the last phase stays outside, because its end is not known yet.
        """
        rows = np.concatenate([self._rows, *self._new])
        self._new, self._waiting = [], 0
        # Of several rows at one time the last counts.
        rows = rows[np.append(np.diff(rows[:, 0]) > 0.0, True)]
        self._rows = rows
        if self._width == 0.0 and len(rows) <= self.most:
            return
        self._rows, end = rows[-1:], float(rows[-1, 0])
        self._width = self._width or (end - float(rows[0, 0])) / self.most
        if len(rows) > 1:
            self._ranges = np.concatenate(
                (self._ranges, _together(_ranges(rows), self._width, end))
            )
        while len(self._ranges) > self.most:
            self._width *= 2.0
            self._ranges = _together(self._ranges, self._width, end)


def _ranges(rows: Floats) -> Floats:
    """Return (n - 1, 7): time, then least and greatest feed, acceleration and jerk of phases."""
    t, v, a, j = rows[:-1].T
    span = np.diff(rows[:, 0])
    v_end, a_end = v + span * (a + 0.5 * span * j), a + span * j
    # Inside a phase the feed is extreme where the acceleration is zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(a * a_end < 0.0, v - 0.5 * a * a / j, v)
    feeds, accels = np.stack((v, v_end, turn)), np.stack((a, a_end))
    return np.stack(
        (t, feeds.min(axis=0), feeds.max(axis=0), accels.min(axis=0), accels.max(axis=0), j, j),
        axis=1,
    )


def _together(ranges: Floats, width: float, end: float) -> Floats:
    """Join rows that begin in the same interval of ``width`` s, except longer ones."""
    t = ranges[:, 0]
    long = np.diff(t, append=end) > width
    interval = np.floor(t / width)
    begins = np.append(True, (interval[1:] != interval[:-1]) | long[1:] | long[:-1])
    starts = np.flatnonzero(begins)
    out = np.empty((len(starts), 7))
    out[:, 0] = t[starts]
    for column in range(1, 7):
        reduce: Any = np.minimum if column % 2 else np.maximum
        out[:, column] = reduce.reduceat(ranges[:, column], starts)
    return out


@dataclass(frozen=True, slots=True)
class Origins:
    """Source lines over time.

    Attributes:
        t: (n,) start of each row, s.
        first: (n,) first source line that is active in the row.
        last: (n,) last source line.
        file: (n,) index of the file.
    """

    t: Floats
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    file: NDArray[np.int64]


class OriginTable:
    """Collects rows of time, line and file.

    With more than ``most`` of them it joins pairs of rows of one file.
    """

    def __init__(self, most: int, program: str) -> None:
        self.most = max(most, 4)
        self.moves = 1
        self._rows = np.empty((0, 4))
        self._new: list[Floats] = []
        self._waiting = 0
        self._files = [program]

    def add(self, t: Floats, line: NDArray[Any], file: str, smooth: NDArray[np.bool_]) -> None:
        """Add rows of one file.

        Args:
            t: (n,) times at which lines become active, s.
            line: (n,) the lines.
            file: their file.
            smooth: (n,) whether the row also stands for the lines up to the next row.
        """
        if file not in self._files:
            self._files.append(file)
        index = np.full(len(t), float(self._files.index(file)))
        self._new.append(np.stack((t, line, np.where(smooth, OPEN, line), index), axis=1))
        self._waiting += len(t)
        if self._waiting > self.most // 2:
            self._take_in()

    def origins(self) -> tuple[Origins, list[str]]:
        """Return the rows, and the files by index."""
        self._take_in()
        t, first, last, file = self._rows.T
        last = np.where(last == OPEN, first, last)
        return Origins(
            t, first.astype(np.int64), last.astype(np.int64), file.astype(np.int64)
        ), self._files

    def _take_in(self) -> None:
        rows = np.concatenate([self._rows, *self._new])
        self._new, self._waiting = [], 0
        if len(rows):
            rows = rows[np.append(np.diff(rows[:, 0]) > 0.0, True)]
            same = (np.diff(rows[:, 1:], axis=0) == 0.0).all(axis=1)
            rows = rows[np.append(True, ~same)]
            # Short moves under G64 become one spline over many lines. Each of its pieces has only
            # the first of its lines.
            following = np.where(rows[1:, 3] == rows[:-1, 3], rows[1:, 1] - 1.0, 0.0)
            rows[:-1, 2] = np.where(
                rows[:-1, 2] == OPEN, np.maximum(rows[:-1, 1], following), rows[:-1, 2]
            )
        while len(rows) > self.most:
            self.moves *= 2
            # A pair can be joined if both rows are of one file.
            number = np.arange(len(rows))
            joined = np.append(False, rows[1:, 3] == rows[:-1, 3]) & (number % 2 == 1)
            if not joined.any():
                break
            starts = number[~joined]
            lines = (
                np.minimum.reduceat(rows[:, 1], starts),
                np.maximum.reduceat(np.maximum(rows[:, 1], rows[:, 2]), starts),
            )
            rows = np.stack((rows[starts, 0], *lines, rows[starts, 3]), axis=1)
        self._rows = rows


def tolerance_shown(tolerance: float) -> str:
    """Return a tolerance in mm as text, rounded up to two digits."""
    if tolerance <= 0.0:
        return "0"
    digit = 10.0 ** (math.floor(math.log10(tolerance)) - 1)
    return f"{math.ceil(tolerance / digit - 1e-9) * digit:.6g}"
