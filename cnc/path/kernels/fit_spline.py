"""Quintic B-splines over the knots of a fitted chain: control points, extraction, refinement.

The spline is C4 at a knot inside, and broken where a knot ends a part. A knot counts once in the
first case and six times in the second. Span k takes the control points first[k] to first[k] + 5.

The extraction X of a span maps its six control points to its Bezier points: b = X c. Its rows are
polar forms (M. J. Borden et al., Isogeometric finite element data structures based on Bezier
extraction, 2011). With it values, derivatives and integrals are those of Bernstein polynomials.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints

# Chains of short straight moves, their corners, and the knots of a spline along them.
#
# The moves are a polyline; t is the length along it over its metric axes. Vertices nearer than
# LEAST to the one before do not count in t.

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


DEGREE = 5
ORDER = 6


class Spline(NamedTuple):
    """A spline along a chain.

    Attributes:
        knots: (K,): its knots.
        t: (N + 6,): their parameters, as often as they count.
        first: (K - 1,): first control point of each span.
        p: (K, n): points of the polyline at the knots, mm.
        extract: (K - 1, 6, 6): extractions of the spans.
        points: (N, n): control points, mm.
        fixed: (N,): whether a control point keeps its place.
        bezier: (K - 1, 6, n): Bezier points of the spans, mm.
    """

    knots: Knots
    t: Floats
    first: Ints
    p: Floats
    extract: Floats
    points: Floats
    fixed: Flags
    bezier: Floats


@njit
def extraction(t: Floats, at: int, d: Floats, out: Floats) -> None:
    """Write the extraction of a span.

    Row j is the polar form of unit vectors at j times the end of the span and 5 - j times its
    start. Of it point i has the entries i - r to i after r rounds.

    Args:
        t: parameters of the knots.
        at: first control point of the span.
        d: (6, 6): work space.
        out: (6, 6): takes the result.
    """
    low, high = t[at + DEGREE], t[at + ORDER]
    for j in range(ORDER):
        for i in range(ORDER):
            for c in range(ORDER):
                d[i, c] = 1.0 if i == c else 0.0
        for r in range(1, ORDER):
            x = high if r <= j else low
            for i in range(DEGREE, r - 1, -1):
                before = t[at + i]
                part = (x - before) / (t[at + i + ORDER - r] - before)
                for c in range(i - r, i + 1):
                    d[i, c] = (1.0 - part) * d[i - 1, c] + part * d[i, c]
        for c in range(ORDER):
            out[j, c] = d[DEGREE, c]


@njit
def bernstein(x: float, weights: Floats) -> None:
    """Write the Bernstein polynomials of degree 5 at x into weights (6,)."""
    y = 1.0 - x
    x2 = x * x
    y2 = y * y
    weights[0] = y2 * y2 * y
    weights[1] = 5.0 * x * y2 * y2
    weights[2] = 10.0 * x2 * y2 * y
    weights[3] = 10.0 * x2 * x * y2
    weights[4] = 5.0 * x2 * x2 * y
    weights[5] = x2 * x2 * x


@njit
def third_difference(extract: Floats, i: int) -> tuple[float, float, float]:
    """Return the third differences of column i of an extraction (6, 6)."""
    c0, c1, c2 = extract[0, i], extract[1, i], extract[2, i]
    c3, c4, c5 = extract[3, i], extract[4, i], extract[5, i]
    return (
        (c3 - c0) - 3.0 * (c2 - c1),
        (c4 - c1) - 3.0 * (c3 - c2),
        (c5 - c2) - 3.0 * (c4 - c3),
    )


@njit
def add_energy(extract: Floats, h: float, weight: float, first: int, band: Floats) -> None:
    """Add the integral of |r'''|^2 over a span to a band matrix.

    30 times the integrals over [0, 1] of products of the Bernstein polynomials of degree 2 are
    (6, 3, 1), (3, 4, 3), (1, 3, 6).

    Args:
        extract: (6, 6): extraction of the span.
        h: its length, mm.
        weight: a factor.
        first: its first control point.
        band: (N, 6): see :mod:`cnc.path.kernels.fit_program`.
    """
    # r''' = 60 / h^3 times the third differences, as a polynomial of degree 2.
    factor = weight * 120.0 / (h * h * h * h * h)
    for i in range(ORDER):
        a0, a1, a2 = third_difference(extract, i)
        g0 = 6.0 * a0 + 3.0 * a1 + a2
        g1 = 3.0 * a0 + 4.0 * a1 + 3.0 * a2
        g2 = a0 + 3.0 * a1 + 6.0 * a2
        for j in range(i + 1):
            b0, b1, b2 = third_difference(extract, j)
            total = g0 * b0 + g1 * b1 + g2 * b2
            band[first + j, i - j] += factor * total


@njit
def _end_points(t: Floats, state: Floats, way: int, points: Floats, fixed: Flags) -> None:
    """Place and fix the control points that position and derivatives at an end determine.

    The polar form at (t0, .., t0 + x_1, .., t0 + x_i) is the sum of e_k(x) r^(k) (5 - k)! / 5!,
    with e_k the symmetric polynomials.

    Args:
        t: parameters of the knots.
        state: (5, n): position and derivatives 1 to 4 by t at the end.
        way: 1 at the start, -1 at the end.
        points: (N, n): control points.
        fixed: (N,): see Spline.
    """
    size = points.shape[0]
    begin = DEGREE if way > 0 else size
    e = np.zeros(DEGREE)
    e[0] = 1.0
    for i in range(DEGREE):
        if i > 0:
            x = t[begin + way * i] - t[begin]
            for k in range(i, 0, -1):
                e[k] += x * e[k - 1]
        at = i if way > 0 else size - 1 - i
        for c in range(state.shape[1]):
            points[at, c] = 0.0
            factor = 1.0
            for k in range(i + 1):
                points[at, c] += e[k] * factor * state[k, c]
                factor /= DEGREE - k
        fixed[at] = True


@njit
def set_bezier(spline: Spline, k: int) -> None:
    """Compute the Bezier points of span k."""
    first = spline.first[k]
    for c in range(spline.points.shape[1]):
        # The sum of a row is 1: measured from a control point, coordinates keep their digits.
        origin = spline.points[first, c]
        for j in range(ORDER):
            total = 0.0
            for i in range(1, ORDER):
                total += spline.extract[k, j, i] * (spline.points[first + i, c] - origin)
            spline.bezier[k, j, c] = origin + total
        if k > 0 and not spline.knots[k]["ends"]:
            spline.bezier[k - 1, DEGREE, c] = spline.bezier[k, 0, c]


@njit
def new_spline(
    chain: Chain, knots: Knots, states: Floats, old_t: Floats, old_first: Ints, old_extract: Floats
) -> Spline:
    """Return a spline whose control points are not placed but for those that are fixed.

    These are the ends of parts, those of straight spans and of spans left to the polyline, and
    those that the states at start and end determine.

    Args:
        chain: the chain.
        knots: the knots.
        states: (2, 5, n): position and derivatives 1 to 4 by t at start and end, or NaN.
        old_t: parameters of the knots of a spline whose extractions may be used again.
        old_first: (S,): its first control point of each span; none without such a spline.
        old_extract: (S, 6, 6): its extractions.
    """
    spans = knots.shape[0] - 1
    n = states.shape[2]
    breaks = 2
    for k in range(spans + 1):
        breaks += int(knots[k]["ends"])
    t = np.empty(DEGREE * breaks + spans + 1)
    first = np.empty(spans, np.int64)
    to = 0
    for k in range(spans + 1):
        for _ in range(ORDER if k == 0 or k == spans or knots[k]["ends"] else 1):
            t[to] = knots[k]["t"]
            to += 1
        if k < spans:
            first[k] = to - ORDER
    size = to - ORDER
    p = np.empty((spans + 1, n))
    points_of(chain, knots, p)
    extract = np.empty((spans, ORDER, ORDER))
    points = np.zeros((size, n))
    fixed = np.zeros(size, np.bool_)
    work = np.empty((ORDER, ORDER))
    old = 0
    for k in range(spans):
        at = first[k]
        while old < old_first.shape[0] and old_t[old_first[old] + DEGREE] < t[at + DEGREE]:
            old += 1
        same = old < old_first.shape[0]
        if same:
            for i in range(1, 2 * DEGREE + 1):
                same = same and old_t[old_first[old] + i] == t[at + i]
        if same or not t[at + ORDER] > t[at + DEGREE]:
            for j in range(ORDER):
                for i in range(ORDER):
                    unit = 1.0 if i == j else 0.0
                    extract[k, j, i] = old_extract[old, j, i] if same else unit
        else:
            extraction(t, at, work, extract[k])
        if knots[k]["straight"] or knots[k]["polyline"]:
            h = knots[k + 1]["t"] - knots[k]["t"]
            for j in range(at, at + ORDER):
                mean = 0.0
                for i in range(1, ORDER):
                    mean += (t[j + i] - knots[k]["t"]) / DEGREE
                part = mean / h if h > 0.0 else (j - at) / DEGREE
                for c in range(n):
                    points[j, c] = p[k, c] + part * (p[k + 1, c] - p[k, c])
                fixed[j] = True
        if k == 0 or knots[k]["ends"]:
            for c in range(n):
                points[at, c] = p[k, c]
            fixed[at] = True
        if k == spans - 1 or knots[k + 1]["ends"]:
            for c in range(n):
                points[at + DEGREE, c] = p[k + 1, c]
            fixed[at + DEGREE] = True
    if not np.isnan(states[0, 0, 0]) and not knots[0]["polyline"]:
        _end_points(t, states[0], 1, points, fixed)
    if not np.isnan(states[1, 0, 0]) and not knots[spans - 1]["polyline"]:
        _end_points(t, states[1], -1, points, fixed)
    spline = Spline(knots, t[:to], first, p, extract, points, fixed, np.empty((spans, ORDER, n)))
    for k in range(spans):
        set_bezier(spline, k)
    return spline


@njit
def _mean_knot(t: Floats, i: int) -> float:
    """Return five times the mean of the knots of control point i."""
    return t[i + 1] + t[i + 2] + t[i + 3] + t[i + 4] + t[i + 5]


@njit
def transfer(old: Spline, new: Spline) -> None:
    """Place the control points of a spline whose five knots another one has as well.

    Those that are fixed keep their places. Others, near new knots, are left to be placed.
    """
    i = 0
    last = old.points.shape[0] - 1
    for j in range(new.points.shape[0]):
        while i < last and _mean_knot(old.t, i) < _mean_knot(new.t, j):
            i += 1
        same = not new.fixed[j]
        for k in range(1, ORDER):
            same = same and old.t[i + k] == new.t[j + k]
        if same:
            for c in range(new.points.shape[1]):
                new.points[j, c] = old.points[i, c]
    for k in range(new.first.shape[0]):
        set_bezier(new, k)
