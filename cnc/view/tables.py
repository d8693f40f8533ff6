"""Tables of bounded size over a motion of any length: when one is full its rows are made half as
many, and coarser.

The picture of a short program is exact; that of a long one says how far it is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.view.thinning import KEPT, RAPID, STATE, A, J, S, T, X, Z, thin, thin_end

Floats = NDArray[np.float64]

FINEST = 0.0005
"""mm: the first tolerance of the path."""
OPEN = -1.0
"""Last line of a row until the next row is known."""


@dataclass(frozen=True, slots=True)
class Strokes:
    """The path as straight strokes between points, each at a steady speed: at any time within
    ``tolerance`` mm of the plan.

    t (n,) s; position (n, 3) mm, x y z. Of the stroke that begins at each point (the last has
    none): feed mm/s, accel mm/s^2 and jerk mm/s^3, the greatest with its sign; rapid.
    """

    t: Floats
    position: Floats
    feed: Floats
    accel: Floats
    jerk: Floats
    rapid: NDArray[np.bool_]
    tolerance: float


class StrokeTable:
    """Thins points as they come; with more than ``most`` of them it goes over all once more with
    twice the tolerance.
    """

    def __init__(self, most: int, finest: float = FINEST) -> None:
        self.most = max(most, 32)
        self.tolerance = finest
        self.error = 2.0 * finest
        self._rows = np.empty((self.most + 2, KEPT))
        self._count = 0
        self._state = np.zeros(STATE)

    @property
    def fine(self) -> float:
        """mm: how near the chords between the points have to be that come."""
        return 0.5 * self.tolerance

    def add(self, points: Floats) -> None:
        """Points of the kind that :func:`~cnc.kernels.view.thinning.follow` makes."""
        # Few at a time: what comes after the table was thinned has to be thinned by the same
        # tolerance.
        some = self.most // 8
        for first in range(0, len(points), some):
            room = self._rows[self._count :]
            self._count += thin(
                points[first : first + some], True, self.tolerance, self._state, room
            )
            self._make_room()

    def strokes(self, start: Floats) -> Strokes:
        """What was drawn; nothing may be added after it. Without any motion, the point ``start``
        (3,).
        """
        self._count += thin_end(self._state, self._rows[self._count :])
        self._make_room()
        rows = self._rows[: self._count]
        if not len(rows):
            rows = np.zeros((1, KEPT))
            rows[0, X : Z + 1] = start
        step = np.diff(rows[:, T])
        feed = np.append(np.diff(rows[:, S]) / np.where(step > 0.0, step, 1.0), 0.0)[: len(rows)]
        return Strokes(
            rows[:, T],
            rows[:, X : Z + 1],
            feed,
            rows[:, A],
            rows[:, J],
            rows[:, RAPID] != 0.0,
            self.error,
        )

    def _make_room(self) -> None:
        while self._count > self.most - self.most // 8:
            self._coarsen()

    def _coarsen(self) -> None:
        """Half as many points, or nearly: what was within the error is within that and the new
        tolerance now.
        """
        self.tolerance *= 2.0
        self.error += self.tolerance
        state = np.zeros(STATE)
        kept = np.empty((self._count + 2, KEPT))
        count = thin(self._rows[: self._count], False, self.tolerance, state, kept)
        count += thin_end(state, kept[count:])
        self._rows[:count] = kept[:count]
        # The last row stands for the stroke from there to what is still to come.
        self._rows[count - 1] = self._rows[self._count - 1]
        self._count = count


@dataclass(frozen=True, slots=True)
class Curves:
    """Feed, acceleration and jerk over time. t (n + 1,): ends of the rows.

    Exact where ``within`` is 0: ``start`` (3, n) are the values where each row begins (mm/s,
    mm/s^2, mm/s^3), the jerk is constant within it. Else ``low`` and ``high`` (3, n) are the least
    and the greatest values in each row: a phase, or some that take up to ``within`` s.
    """

    t: Floats
    within: float
    start: Floats
    low: Floats
    high: Floats


class CurveTable:
    """Phases of constant jerk as they come; with more than ``most`` of them, least and greatest
    values of short ones taken together.
    """

    def __init__(self, most: int) -> None:
        self.most = max(most, 4)
        self._width = 0.0
        self._rows = np.empty((0, 4))
        self._new: list[Floats] = []
        self._waiting = 0
        self._ranges = np.empty((0, 7))

    def add(self, phases: Floats) -> None:
        """Rows (n, 4): time at which a phase begins, and feed, acceleration and jerk there."""
        self._new.append(phases)
        self._waiting += len(phases)
        if self._waiting > self.most:
            self._take_in()

    def curves(self, end: float) -> Curves:
        """What was added, up to the time ``end``; nothing may be added after it."""
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
        """Move what waits into the table, but for the last phase of a table of ranges: it has no
        end yet.
        """
        rows = np.concatenate([self._rows, *self._new])
        self._new, self._waiting = [], 0
        # Of rows at one time the last counts.
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
    """Time, and least and greatest feed, acceleration and jerk of each phase but the last (n - 1,
    7).
    """
    t, v, a, j = rows[:-1].T
    span = np.diff(rows[:, 0])
    v_end, a_end = v + span * (a + 0.5 * span * j), a + span * j
    # Inside a phase the feed turns where the acceleration is zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(a * a_end < 0.0, v - 0.5 * a * a / j, v)
    feeds, accels = np.stack((v, v_end, turn)), np.stack((a, a_end))
    return np.stack(
        (t, feeds.min(axis=0), feeds.max(axis=0), accels.min(axis=0), accels.max(axis=0), j, j),
        axis=1,
    )


def _together(ranges: Floats, width: float, end: float) -> Floats:
    """Rows that begin in the same interval of ``width`` s as one, but for those that are longer: a
    cruise keeps its own values.
    """
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
    """Which source line is at work when. t (n,): from then on it is a line of ``file`` between
    ``first`` and ``last``.
    """

    t: Floats
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    file: NDArray[np.int64]


class OriginTable:
    """Rows of time, line and file as they come; with more than ``most`` of them two become one,
    unless they are of two files.
    """

    def __init__(self, most: int, program: str) -> None:
        self.most = max(most, 4)
        self.moves = 1
        self._rows = np.empty((0, 4))
        self._new: list[Floats] = []
        self._waiting = 0
        self._files = [program]

    def add(self, t: Floats, line: NDArray[Any], file: str, smooth: NDArray[np.bool_]) -> None:
        """From each of the times on, a line of ``file``; where ``smooth``, that one and those up to
        the next that is added.
        """
        if file not in self._files:
            self._files.append(file)
        index = np.full(len(t), float(self._files.index(file)))
        self._new.append(np.stack((t, line, np.where(smooth, OPEN, line), index), axis=1))
        self._waiting += len(t)
        if self._waiting > self.most // 2:
            self._take_in()

    def origins(self) -> tuple[Origins, list[str]]:
        """What was added, and the files by number."""
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
            # Short moves under G64 become one spline over many lines, each piece of which names its
            # first.
            following = np.where(rows[1:, 3] == rows[:-1, 3], rows[1:, 1] - 1.0, 0.0)
            rows[:-1, 2] = np.where(
                rows[:-1, 2] == OPEN, np.maximum(rows[:-1, 1], following), rows[:-1, 2]
            )
        while len(rows) > self.most:
            self.moves *= 2
            # A pair may be joined where its two are of one file.
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
    """A tolerance in mm, rounded up to two digits."""
    if tolerance <= 0.0:
        return "0"
    digit = 10.0 ** (math.floor(math.log10(tolerance)) - 1)
    return f"{math.ceil(tolerance / digit - 1e-9) * digit:.6g}"
