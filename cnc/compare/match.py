"""Matching of two tracks: the points that both pass in the same order.

The tracks are compared between matched points. Where nothing lies between them, they are the same.

The beginnings and ends are matched as far as they agree. Of the points between, those are matched
that each track passes exactly once, as many as occur in the same order in both (the longest
increasing subsequence). Text comparison does the same with lines ("patience diff"). O(n log n).
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SAME = 1e-6
"""mm. Points in the same cube of this size are equal."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Hunk:
    """Stretches of two tracks that differ. They begin at the same point.

    Attributes:
        a0: first point of the stretch of the first track.
        a1: its last point, included.
        b0: first point of the stretch of the second track.
        b1: its last point, included.
        closed: whether the stretches also end at the same point.
    """

    a0: int
    a1: int
    b0: int
    b1: int
    closed: bool


def hunks(a: Floats, b: Floats) -> list[Hunk]:
    """Return the stretches in which tracks a (n, axes) and b (m, axes) differ.

    Both tracks must begin at the same point.
    """
    _, both = np.unique(
        np.round(np.concatenate((a, b)) / SAME).astype(np.int64), axis=0, return_inverse=True
    )
    both = both.reshape(-1)
    ids_a, ids_b = both[: len(a)], both[len(a) :]
    shorter = min(len(a), len(b))
    begin = _agreeing(ids_a[:shorter], ids_b[:shorter])
    end = _agreeing(ids_a[::-1][: shorter - begin], ids_b[::-1][: shorter - begin])
    pairs = _in_order(ids_a[begin : len(a) - end], ids_b[begin : len(b) - end])
    i = np.concatenate(([max(begin - 1, 0)], pairs[:, 0] + begin, [len(a) - max(end, 1)]))
    j = np.concatenate(([max(begin - 1, 0)], pairs[:, 1] + begin, [len(b) - max(end, 1)]))
    differing: Ints = np.flatnonzero((np.diff(i) != 1) | (np.diff(j) != 1))
    last = len(i) - 2
    found = [
        Hunk(int(i[k]), int(i[k + 1]), int(j[k]), int(j[k + 1]), k < last or end > 0)
        for k in differing
    ]
    if not end and last not in differing:
        # One move each, to different positions.
        found.append(Hunk(int(i[last]), int(i[-1]), int(j[last]), int(j[-1]), False))
    return [hunk for hunk in found if hunk.a1 > hunk.a0 or hunk.b1 > hunk.b0]


def _agreeing(a: Ints, b: Ints) -> int:
    """Return the number of equal elements from the beginning."""
    different = a != b
    return int(np.argmax(different)) if different.any() else len(a)


def _in_order(a: Ints, b: Ints) -> Ints:
    """Return index pairs (k, 2) of elements that occur once in each, increasing in both."""
    once_a, once_b = _once(a), _once(b)
    common, of_a, of_b = np.intersect1d(
        a[once_a], b[once_b], assume_unique=True, return_indices=True
    )
    if not len(common):
        return np.empty((0, 2), np.int64)
    pairs = np.stack((once_a[of_a], once_b[of_b]), axis=1)
    pairs = pairs[np.argsort(pairs[:, 0])]
    tails: list[int] = []
    ends: list[int] = []
    before = np.full(len(pairs), -1)
    for index, place in enumerate(pairs[:, 1].tolist()):
        rank = bisect_left(tails, place)
        if rank == len(tails):
            tails.append(place)
            ends.append(index)
        else:
            tails[rank], ends[rank] = place, index
        before[index] = ends[rank - 1] if rank else -1
    chosen = []
    index = ends[-1]
    while index >= 0:
        chosen.append(index)
        index = int(before[index])
    return pairs[chosen[::-1]]


def _once(ids: Ints) -> Ints:
    """Return the indices of elements that occur once."""
    _, first, count = np.unique(ids, return_index=True, return_counts=True)
    return np.sort(first[count == 1])
