"""Distance of two tracks that are followed in step.

Between two points that both pass (:mod:`cnc.compare.match`) the tracks are sampled coarsely and
aligned by dynamic time warping: the pairing of samples with the least sum of distances that never
goes backwards on either track. Then each point of one track is measured against the stretch of the
other that its neighbours are paired with. So a contour in the opposite direction is not the same.
Long stretches are cut at paired points and measured in parts.

     a  ──o────o────o────o──     Each point of a stretch is within half of its length of an end, and
          |    |   /    /        both tracks pass the ends. So the longest stretches are measured
     b  ──o────o──o────o────     first, and those that cannot exceed the distance found are skipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.compare.match import hunks
from cnc.compare.track import Track

MIN_SAMPLES, MAX_SAMPLES = 4, 64
"""Limits of the number of aligned samples, which is that of the points of a stretch."""
LARGE = 600
"""Largest number of points of a stretch that is measured as a whole."""
MAX_DEPTH = 12
"""Largest depth of cuts within cuts."""
EXTRA_POINTS = 256
"""Points at equal distances along a stretch that are measured besides its vertices."""
ROUNDING = 1e-9
"""Relative error of squared distances."""
AT_ONCE = 200_000
"""Distances that are computed at a time."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Apart:
    """The largest distance of two tracks.

    Attributes:
        distance: the distance, mm.
        position: (axes,) the point of the first track, mm.
        first: index of the vertex at the end of the move there, on the first track.
        second: the same on the second track.
    """

    distance: float
    position: Floats
    first: int
    second: int


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A stretch of a track.

    Attributes:
        points: (n, axes) vertices, mm.
        index: (n,) their indices in the whole track.
        s: (n,) path length from the first vertex, mm.
    """

    points: Floats
    index: Ints
    s: Floats

    @classmethod
    def of(cls, points: Floats, index: Ints) -> _Stretch:
        if len(points) == 1:
            # A stretch without length gets two vertices.
            points, index = np.repeat(points, 2, axis=0), np.repeat(index, 2)
        return cls(
            points,
            index,
            np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))),
        )

    @property
    def length(self) -> float:
        return float(self.s[-1])

    def at(self, s: Floats) -> Floats:
        """Return the points (k, axes) at path lengths s (k,) mm."""
        return np.stack([np.interp(s, self.s, column) for column in self.points.T], axis=1)

    def part(self, begin: float, end: float) -> _Stretch:
        inside = np.flatnonzero((self.s > begin) & (self.s < end))
        points = np.concatenate(
            (self.at(np.array([begin])), self.points[inside], self.at(np.array([end])))
        )
        last = int(np.searchsorted(self.s, end))
        first = int(np.searchsorted(self.s, begin, side="right"))
        ends = self.index[np.minimum([first, last], len(self.index) - 1)]
        return _Stretch.of(points, np.concatenate((ends[:1], self.index[inside], ends[1:])))


def farthest(a: Track, b: Track) -> Apart:
    """Return the largest distance of two tracks that begin at the same point."""
    best = Apart(0.0, a.points[0], 0, 0)
    stretches = []
    for hunk in hunks(a.points, b.points):
        one, other = _stretch(a, hunk.a0, hunk.a1), _stretch(b, hunk.b0, hunk.b1)
        bound = max(one.length, other.length) / (2.0 if hunk.closed else 1.0)
        stretches.append((bound, one, other))
    for bound, one, other in sorted(stretches, key=lambda each: -each[0]):
        if bound <= best.distance:
            break
        best = _measured(one, other, best, 0)
    return best


def _stretch(track: Track, first: int, last: int) -> _Stretch:
    index = np.arange(first, last + 1)
    return _Stretch.of(track.points[index], index)


def _measured(one: _Stretch, other: _Stretch, best: Apart, depth: int) -> Apart:
    """Return the larger one of ``best`` and the distance of two stretches."""
    sizes = len(one.points), len(other.points)
    if min(one.length, other.length) == 0.0:
        # One of them does not move.
        everything = np.array([[0.0, np.inf]])
        return _farther(best, one, other, everything, everything)
    count = min(max(*sizes, MIN_SAMPLES), MAX_SAMPLES)
    s, t = np.linspace(0.0, one.length, count + 1), np.linspace(0.0, other.length, count + 1)
    pairs = _aligned(one.at(s), other.at(t))
    if max(sizes) > LARGE and depth < MAX_DEPTH:
        begin = (0.0, 0.0)
        for i, j in [*pairs[count // 8 : -1 : count // 8], pairs[-1]]:
            end = (
                (one.length, other.length)
                if (i, j) == pairs[-1]
                else (float(s[i]), _nearest(other, one.at(s[i : i + 1])[0], t, j))
            )
            end = max(end[0], begin[0]), max(end[1], begin[1])
            best = _measured(
                one.part(begin[0], end[0]), other.part(begin[1], end[1]), best, depth + 1
            )
            begin = end
        return best
    return _farther(
        best, one, other, _windows(pairs, s, t), _windows([(j, i) for i, j in pairs], t, s)
    )


def _nearest(stretch: _Stretch, point: Floats, t: Floats, j: int) -> float:
    """Return the path length, within a sample of t[j], nearest to a point."""
    fine = np.linspace(t[max(j - 1, 0)], t[min(j + 1, len(t) - 1)], 65)
    return float(fine[np.argmin(np.linalg.norm(stretch.at(fine) - point, axis=1))])


def _aligned(a: Floats, b: Floats) -> list[tuple[int, int]]:
    """Return index pairs from (0, 0) to the last points, by dynamic time warping.

    The sum of the distances of the pairs is the least possible.
    """
    apart = np.linalg.norm(a[:, None] - b[None], axis=2).tolist()
    n, m = len(a), len(b)
    cost = [apart[0][0]]
    for j in range(1, m):
        cost.append(cost[-1] + apart[0][j])
    table = [cost]
    for i in range(1, n):
        row, above = apart[i], table[-1]
        cost = [above[0] + row[0]]
        for j in range(1, m):
            cost.append(row[j] + min(above[j - 1], above[j], cost[-1]))
        table.append(cost)
    pairs = [(n - 1, m - 1)]
    while pairs[-1] != (0, 0):
        i, j = pairs[-1]
        steps = [
            (table[p][q], (p, q))
            for p, q in ((i - 1, j - 1), (i - 1, j), (i, j - 1))
            if p >= 0 and q >= 0
        ]
        pairs.append(min(steps, key=lambda step: step[0])[1])
    return pairs[::-1]


def _windows(pairs: list[tuple[int, int]], s: Floats, t: Floats) -> Floats:
    """Return the search ranges on the other stretch for the parts of one stretch.

    Args:
        pairs: aligned samples.
        s: (n,) path lengths of the samples of the one stretch, mm.
        t: (m,) path lengths of the samples of the other stretch, mm.

    Returns:
        (n - 1, 2) least and greatest path length on the other stretch, mm.
    """
    low, high = np.full(len(s), len(t)), np.zeros(len(s), np.int64)
    for i, j in pairs:
        low[i], high[i] = min(low[i], j), max(high[i], j)
    last = len(t) - 1
    return np.stack((t[np.maximum(low[:-1] - 1, 0)], t[np.minimum(high[1:] + 1, last)]), axis=1)


def _farther(
    best: Apart, one: _Stretch, other: _Stretch, of_one: Floats, of_other: Floats
) -> Apart:
    """Return the larger one of ``best`` and the distances of each stretch from the other.

    Args:
        best: the largest distance so far.
        one: a stretch of the first track.
        other: a stretch of the second track.
        of_one: search ranges for the parts of ``one``.
        of_other: search ranges for the parts of ``other``.
    """
    distance, point, _, p, q = _directed(one, other, of_one)
    if distance > best.distance:
        best = Apart(distance, point, int(one.index[p]), int(other.index[q]))
    distance, _, point, q, p = _directed(other, one, of_other)
    if distance > best.distance:
        best = Apart(distance, point, int(one.index[p]), int(other.index[q]))
    return best


def _directed(
    stretch: _Stretch, other: _Stretch, windows: Floats
) -> tuple[float, Floats, Floats, int, int]:
    """Find the point of a stretch that is farthest from the other stretch.

    Returns:
        The distance, the point, the nearest point of the other stretch, and the vertices at the
        ends of the moves there, on the stretch and on the other.
    """
    s = np.sort(np.concatenate((stretch.s, np.linspace(0.0, stretch.length, EXTRA_POINTS))))
    points = stretch.at(s)
    part = np.minimum(
        (s * len(windows) / max(stretch.length, 1e-300)).astype(np.int64), len(windows) - 1
    )
    low, high = windows[part].T
    starts, steps = other.points[:-1], np.diff(other.points, axis=0)
    squares = np.maximum((steps * steps).sum(axis=1), 1e-300)
    worst = -1.0, 0, 0, starts[0]
    rows = max(1, AT_ONCE // len(starts))
    for first in range(0, len(points), rows):
        some = slice(first, first + rows)
        behind = points[some, None] - starts
        share = np.clip((behind * steps).sum(axis=2) / squares, 0.0, 1.0)
        away = ((behind - share[:, :, None] * steps) ** 2).sum(axis=2)
        away[(other.s[1:] < low[some, None]) | (other.s[:-1] > high[some, None])] = np.inf
        nearest = away.argmin(axis=1)
        least = away[np.arange(len(nearest)), nearest]
        # The first of the points at the same distance, apart from rounding.
        k = int(np.argmax(least >= least.max() * (1.0 - ROUNDING)))
        if least[k] > worst[0] * (1.0 + ROUNDING):
            q = int(nearest[k])
            worst = float(least[k]), first + k, q, starts[q] + share[k, q] * steps[q]
    square, k, q, foot = worst
    return float(np.sqrt(square)), points[k], foot, int(np.searchsorted(stretch.s, s[k])), q + 1
