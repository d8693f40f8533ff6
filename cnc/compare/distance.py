"""How far apart two tracks are, gone in step: the largest distance from a point of one to the way
of the other about the same place.

Between two points that both pass (:mod:`cnc.compare.match`) the tracks are sampled roughly and
aligned by dynamic time warping, the cheapest pairing of samples that never goes back on either.
Then every point of one is measured against the stretch of the other that its neighbours are paired
with, so that a way gone the other way round is not the same. Long stretches are cut at paired
points and measured in parts.

     a  ──o────o────o────o──         A stretch is at most half of its length away from one of its two ends, which both pass: the
          |    |   /    /            longest are measured first, and those that can't be farther apart than what was found are left.
     b  ──o────o──o────o────
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.compare.match import hunks
from cnc.compare.track import Track

FEW, MOST_PAIRED = 4, 64
"""Samples of a stretch that are aligned: as many as it has points, within these."""
LARGE = 600
"""Points of a stretch that is measured in one go."""
DEEPEST = 12
"""Cuts within cuts."""
BETWEEN = 256
"""Parts of a stretch between which its long moves are measured, too."""
ROUNDING = 1e-9
"""Relative, of squares of distances."""
AT_ONCE = 200_000
"""Distances that are computed together."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Apart:
    """Where two tracks are farthest apart: mm, the place on the one (axes,), index of the points
    that the moves end at.
    """

    distance: float
    place: Floats
    a: int
    b: int


@dataclass(frozen=True, slots=True)
class _Way:
    """A stretch of track: points (n, axes), the index of each in the whole, and the way (n,) in mm
    from the first.
    """

    points: Floats
    index: Ints
    s: Floats

    @classmethod
    def of(cls, points: Floats, index: Ints) -> _Way:
        if len(points) == 1:
            # a way of no length is one, too
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
        """Points (k, axes) after s (k,) mm."""
        return np.stack([np.interp(s, self.s, column) for column in self.points.T], axis=1)

    def part(self, begin: float, end: float) -> _Way:
        inside = np.flatnonzero((self.s > begin) & (self.s < end))
        points = np.concatenate(
            (self.at(np.array([begin])), self.points[inside], self.at(np.array([end])))
        )
        last = int(np.searchsorted(self.s, end))
        first = int(np.searchsorted(self.s, begin, side="right"))
        ends = self.index[np.minimum([first, last], len(self.index) - 1)]
        return _Way.of(points, np.concatenate((ends[:1], self.index[inside], ends[1:])))


def farthest(a: Track, b: Track) -> Apart:
    """Where two tracks that begin at the same point are farthest apart."""
    best = Apart(0.0, a.points[0], 0, 0)
    ways = []
    for hunk in hunks(a.points, b.points):
        one, other = _stretch(a, hunk.a0, hunk.a1), _stretch(b, hunk.b0, hunk.b1)
        bound = max(one.length, other.length) / (2.0 if hunk.closed else 1.0)
        ways.append((bound, one, other))
    for bound, one, other in sorted(ways, key=lambda way: -way[0]):
        if bound <= best.distance:
            break
        best = _measured(one, other, best, 0)
    return best


def _stretch(track: Track, first: int, last: int) -> _Way:
    index = np.arange(first, last + 1)
    return _Way.of(track.points[index], index)


def _measured(one: _Way, other: _Way, best: Apart, depth: int) -> Apart:
    """The farther one of what was found before and what these stretches are apart."""
    sizes = len(one.points), len(other.points)
    if min(one.length, other.length) == 0.0:
        # one stays where it is
        anywhere = np.array([[0.0, np.inf]])
        return _farther(best, one, other, anywhere, anywhere)
    count = min(max(*sizes, FEW), MOST_PAIRED)
    s, t = np.linspace(0.0, one.length, count + 1), np.linspace(0.0, other.length, count + 1)
    pairs = _aligned(one.at(s), other.at(t))
    if max(sizes) > LARGE and depth < DEEPEST:
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


def _nearest(way: _Way, point: Floats, t: Floats, j: int) -> float:
    """How far along the way, within a sample of t[j], it is nearest to a point."""
    fine = np.linspace(t[max(j - 1, 0)], t[min(j + 1, len(t) - 1)], 65)
    return float(fine[np.argmin(np.linalg.norm(way.at(fine) - point, axis=1))])


def _aligned(a: Floats, b: Floats) -> list[tuple[int, int]]:
    """Dynamic time warping: pairs of indices from (0, 0) to the last ones, the sum of whose
    distances is least.
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
        ways = [
            (table[p][q], (p, q))
            for p, q in ((i - 1, j - 1), (i - 1, j), (i, j - 1))
            if p >= 0 and q >= 0
        ]
        pairs.append(min(ways, key=lambda way: way[0])[1])
    return pairs[::-1]


def _windows(pairs: list[tuple[int, int]], s: Floats, t: Floats) -> Floats:
    """For each part between samples s (n,) of one way, (n - 1, 2): from where to where on the other
    its points are looked for.
    """
    low, high = np.full(len(s), len(t)), np.zeros(len(s), np.int64)
    for i, j in pairs:
        low[i], high[i] = min(low[i], j), max(high[i], j)
    last = len(t) - 1
    return np.stack((t[np.maximum(low[:-1] - 1, 0)], t[np.minimum(high[1:] + 1, last)]), axis=1)


def _farther(best: Apart, one: _Way, other: _Way, of_one: Floats, of_other: Floats) -> Apart:
    """Each measured against the other; of_one and of_other are the windows of their parts."""
    distance, point, _, p, q = _directed(one, other, of_one)
    if distance > best.distance:
        best = Apart(distance, point, int(one.index[p]), int(other.index[q]))
    distance, _, point, q, p = _directed(other, one, of_other)
    if distance > best.distance:
        best = Apart(distance, point, int(one.index[p]), int(other.index[q]))
    return best


def _directed(way: _Way, other: _Way, windows: Floats) -> tuple[float, Floats, Floats, int, int]:
    """The farthest point of a way: its distance, itself, the nearest point on the other way, and
    the points where the moves there end.
    """
    s = np.sort(np.concatenate((way.s, np.linspace(0.0, way.length, BETWEEN))))
    points = way.at(s)
    part = np.minimum(
        (s * len(windows) / max(way.length, 1e-300)).astype(np.int64), len(windows) - 1
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
        # the first of those that are as far but for rounding
        k = int(np.argmax(least >= least.max() * (1.0 - ROUNDING)))
        if least[k] > worst[0] * (1.0 + ROUNDING):
            q = int(nearest[k])
            worst = float(least[k]), first + k, q, starts[q] + share[k, q] * steps[q]
    square, k, q, foot = worst
    return float(np.sqrt(square)), points[k], foot, int(np.searchsorted(way.s, s[k])), q + 1
