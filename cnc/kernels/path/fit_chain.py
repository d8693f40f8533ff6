"""Chains of short straight moves, their corners, and the knots of a spline along them.

The moves are a polyline; t is the length along it over its metric axes. Vertices nearer than LEAST
to the one before do not count in t.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints

Flags = NDArray[np.bool_]
Knots = NDArray[np.void]

KNOT = np.dtype(
    [
        ("t", np.float64),
        ("vertex", np.int64),
        ("on", np.bool_),
        ("ends", np.bool_),
        ("straight", np.bool_),
        ("polyline", np.bool_),
        ("refused", np.bool_),
    ],
    align=True,
)
"""A knot: its parameter, the vertex at or before it, whether it is that vertex (on), and whether
the spline is broken there (ends). Of the span behind it: whether it is a straight line, whether it
is left to the polyline, and whether the proof has refused it.
"""
ON_LINE = 1e-9
"""mm. Vertices this near to a line lie on it."""
STEEP = math.radians(80.0)
SHARPEST = math.radians(92.0)
"""See find_corners."""
ROUNDED = 100.0
"""A short leg has so many tolerances, divided by the square of the turn in rad."""
SMOOTH = 10.0
"""Chords of a smooth curve within the tolerance turn by less than so many tolerances, divided by
the shorter leg, in rad.
"""
SLIGHT = math.cos(math.radians(5.0))
STRAIGHT = math.cos(math.radians(0.05))
"""Cosines of turns: a corner that the motion passes turns by more than the first, a vertex on a
straight line by no more than the second.
"""
FAR = 256
"""Most vertices that are searched on either side of a corner."""
LEAST = 0.5
"""Least spacing of knots in parts of the tolerance."""


class Chain(NamedTuple):
    """A polyline of straight moves.

    Attributes:
        x: (m, n): its vertices, mm.
        along: (m,): parameter t of each vertex, mm.
        metric: columns of the metric axes.
        metrics: (n,): whether an axis is a metric one.
    """

    x: Floats
    along: Floats
    metric: Ints
    metrics: Flags


@njit
def distance(x: Floats, metric: Ints, i: int, j: int) -> float:
    """Return the distance of vertices i and j, mm."""
    square = 0.0
    for c in metric:
        square += (x[j, c] - x[i, c]) ** 2
    return math.sqrt(square)


@njit
def _turns(x: Floats, metric: Ints, i: int, cosine: float) -> bool:
    """Return whether the direction turns at vertex i by more than an angle."""
    dot = aa = bb = 0.0
    for c in metric:
        a = x[i, c] - x[i - 1, c]
        b = x[i + 1, c] - x[i, c]
        dot += a * b
        aa += a * a
        bb += b * b
    return dot < cosine * math.sqrt(aa * bb)


@njit
def _leg(
    x: Floats, metric: Ints, i: int, k: int, far: float, cosine: float, straight: bool
) -> float:
    """Return the distance from vertex i to the end of its leg through k; ``far`` is enough, mm.

    The leg ends at the next turn by more than the angle, or if ``straight`` where it leaves a line.
    """
    way = 1 if k > i else -1
    length = distance(x, metric, i, k)
    after = k + way
    while length < far and 0 <= after < x.shape[0] and abs(after - i) < FAR:
        whole = distance(x, metric, i, after)
        off = 0.0
        if straight:
            for c in metric:
                off = max(off, abs(x[k, c] - x[i, c] - length / whole * (x[after, c] - x[i, c])))
        if whole <= length or off > ON_LINE or _turns(x, metric, k, cosine):
            break
        length = whole
        k = after
        after += way
    return length


@njit
def find_corners(x: Floats, metric: Ints, cosine: float, tolerance: float, corner: Flags) -> None:
    """Mark the vertices where the direction turns by more than an angle.

    The direction is taken over three tolerances at least. The first and the last vertex are no
    corners, nor are vertices with no other at that distance. No corner either is a turn that
    chords of a smooth curve within the tolerance have: by less than 8 tolerances over the length
    of the shorter leg. A turn of up to STEEP is none where a leg is short and straight, and one of
    up to SHARPEST where both legs are short: the spline is faster than a blend that fits into the
    leg, or than a stop that is passed.

    Args:
        x: (m, n): vertices, mm.
        metric: columns of the metric axes.
        cosine: cosine of the angle.
        tolerance: mm.
        corner: (m,): takes the marks.
    """
    m = x.shape[0]
    reach = 3.0 * tolerance
    for i in range(m):
        corner[i] = False
    for i in range(1, m - 1):
        if _turns(x, metric, i, cosine):
            # Moves shorter than the reach may turn by their rounding alone.
            before = i - 1
            aa = distance(x, metric, before, i) ** 2
            while aa < reach * reach and before > 0 and i - before < FAR and not corner[before]:
                before -= 1
                aa = distance(x, metric, before, i) ** 2
            after = i + 1
            bb = distance(x, metric, i, after) ** 2
            while bb < reach * reach and after < m - 1 and after - i < FAR:
                after += 1
                bb = distance(x, metric, i, after) ** 2
            dot = 0.0
            for c in metric:
                dot += (x[i, c] - x[before, c]) * (x[after, c] - x[i, c])
            shorter = math.sqrt(min(aa, bb))
            if shorter >= reach and dot < cosine * math.sqrt(aa * bb):
                angle = math.acos(max(dot / math.sqrt(aa * bb), -1.0))
                if angle > SHARPEST:
                    corner[i] = shorter * angle > 8.0 * tolerance
                else:
                    far = ROUNDED * tolerance / (angle * angle)
                    one = angle <= STEEP
                    first = _leg(x, metric, i, before, far, cosine, one)
                    second = _leg(x, metric, i, after, far, cosine, one)
                    corner[i] = (min(first, second) if one else max(first, second)) >= far


@njit
def _kind_of(x: Floats, metric: Ints, i: int, tolerance: float) -> int:
    """Return 0 for a vertex on a line, 1 on a curve, 2 with short legs, 3 for a corner."""
    if not _turns(x, metric, i, STRAIGHT):
        return 0
    before, after = distance(x, metric, i - 1, i), distance(x, metric, i, i + 1)
    shorter = min(before, after)
    if not _turns(x, metric, i, SLIGHT) or shorter < tolerance:
        return 1
    dot = 0.0
    for c in metric:
        dot += (x[i, c] - x[i - 1, c]) * (x[i + 1, c] - x[i, c])
    angle = math.acos(min(max(dot / (before * after), -1.0), 1.0))
    return 3 if shorter * angle > SMOOTH * tolerance else 2


@njit
def find_polygons(x: Floats, metric: Ints, tolerance: float, few: int, corner: Flags) -> None:
    """Mark the vertices of polygons, for motion that passes corners within the tolerance.

    A polygon is a part of the chain from one corner or end to another, without a curve. Its legs
    stay straight. Up to ``few`` vertices with short legs in a row belong to it.

    Args:
        x: (m, n): vertices, mm.
        metric: columns of the metric axes.
        tolerance: mm.
        few: most vertices with short legs in a row.
        corner: (m,): the marks of find_corners, to which those of polygons are added.
    """
    m = x.shape[0]
    first = 0
    curved = False
    short = 0
    for i in range(1, m):
        kind = 3 if i == m - 1 else _kind_of(x, metric, i, tolerance)
        short = short + 1 if kind == 2 else (short if kind == 0 else 0)
        curved = curved or kind == 1 or short > few
        if i < m - 1 and not corner[i]:
            continue
        if not curved:
            for k in range(first + 1, i):
                corner[k] = _turns(x, metric, k, SLIGHT)
        first = i
        curved = False
        short = 0


@njit
def measured(chain: Chain, corner: Flags, tolerance: float) -> Ints:
    """Fill ``chain.along``, and return the vertices that count.

    They are the ends, the corners, and others LEAST apart.
    """
    x, along, metric, _ = chain
    m = x.shape[0]
    counted = np.empty(m, np.int64)
    count = 1
    counted[0] = 0
    along[0] = 0.0
    for i in range(1, m):
        kept = counted[count - 1]
        step = distance(x, metric, kept, i)
        if i == m - 1 or corner[i] or step >= LEAST * tolerance:
            along[i] = along[kept] + step
            counted[count] = i
            count += 1
        else:
            along[i] = along[kept]
    return counted[:count]


@njit
def place_of(ascending: Ints, value: int) -> int:
    """Return the first place in ascending numbers of one that is at least ``value``."""
    low = 0
    high = ascending.shape[0]
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@njit
def points_of(chain: Chain, knots: Knots, p: Floats) -> None:
    """Write the points of the polyline at the knots into p (K, n).

    Behind vertices that do not count, such a point lies on the move of the last of them: a line
    from the first would cut off the others.
    """
    x, along, _, _ = chain
    for k in range(knots.shape[0]):
        i = knots[k]["vertex"]
        for c in range(x.shape[1]):
            p[k, c] = x[i, c]
        if not knots[k]["on"]:
            part = (knots[k]["t"] - along[i]) / (along[i + 1] - along[i])
            for c in range(x.shape[1]):
                p[k, c] = x[i, c] + part * (x[i + 1, c] - x[i, c])
