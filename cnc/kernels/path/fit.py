"""Cubic splines through chains of short straight moves, with proof of the tolerance.

The moves are a polyline; t is the length along it over its metric axes. Knots t_k with their points
p_k of the polyline are laid as widely as the tolerance permits. The control points follow from
three points each (h, s: spacing and slope before and behind knot k):

    d_k = p_k + (h1^2 s0 - h0^2 s1) / (3 (h0 + h1))

This is the blossom at (t_k-1, t_k, t_k+1) of the parabola through the three points. The
quasi-interpolant reproduces cubics on knots of any spacing, so its error grows with h^4. It is C2
whatever the d_k are. It is local: a span depends on three knots on either side, so it can be issued
while the polyline goes on, and where the points lie on a straight line it is that line exactly. An
interpolating spline needs half as many knots, but it ripples along straight stretches.

                  v            Span k is proved with the vertices v between its knots. Each has a
         v--------'---v        parameter, near its foot on the curve and not before the last one's.
    p_k x       S      x p_k+1 Between two of them curve and polyline run together. Their distance
                               is at most that at the ends plus the sagitta, max |S''| dt^2 / 8.
                               That bounds both distances.

A span that fails is cut in half, at a vertex if there is one near. Spans more than RATIO as long as
their neighbour are cut as well, until all hold. A span too short to be cut is left to the polyline:
there, and at corners, the spline is broken and goes through p_k.
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
        ("inside", np.int64),
        ("fresh", np.int64),
        ("on", np.bool_),
        ("ends", np.bool_),
        ("polyline", np.bool_),
    ],
    align=True,
)
"""A knot: its parameter, the vertex at or before it, whether it is that vertex (on), and whether
the spline is broken there (ends). inside: 1 if the spline passes inside the vertex (see INWARD), 2
if it no longer may. Of the span behind it: whether it is left to the polyline, and whether it has
yet to be proved (fresh; 2: the knot is new).
"""
RATIO = 2.6
"""Longest span beside a shorter one; halves of neighbours that are cut at vertices may be this far
apart.
"""
WIDEST = 64
"""Most vertices in a span."""
FAR = 256
"""Most vertices that are searched on either side of a corner."""
FORWARD = 0.2
"""Least part of a third of its chord that each leg of a span's control polygon advances along the
chord: no cusps, no loops.
"""
USED = 0.8
"""Part of the tolerance that a span may take."""
USED_ONE = 0.98
"""The same for a span that is one move, where no wider span holds."""
USED_STRAIGHT = 0.25
"""The same for a span beside a part of a segment, so that the segment stays nearly straight."""
INWARD = 0.625
"""Part of the step from p_k to d_k with which the spline runs midway between vertices on a circle
and their chords.
"""
LEAST = 0.5
"""Least spacing of knots in parts of the tolerance."""
BESIDE = 4.2
"""A blend that turns by theta within eps of the corner begins 4 eps / sin(theta / 2) before it:
that much stays straight.
"""


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
def find_corners(x: Floats, metric: Ints, cosine: float, reach: float, corner: Flags) -> None:
    """Mark the vertices where the direction turns by more than an angle.

    The first and the last vertex are no corners, nor are vertices with no other at that distance.

    Args:
        x: (m, n): vertices, mm.
        metric: columns of the metric axes.
        cosine: cosine of the angle.
        reach: distance over which the direction is taken, mm.
        corner: (m,): takes the marks.
    """
    m = x.shape[0]
    for i in range(m):
        corner[i] = False
    for i in range(1, m - 1):
        dot = aa = bb = 0.0
        for c in metric:
            a = x[i, c] - x[i - 1, c]
            b = x[i + 1, c] - x[i, c]
            dot += a * b
            aa += a * a
            bb += b * b
        if dot < cosine * math.sqrt(aa * bb):
            # Moves shorter than the reach may turn by their rounding alone.
            before = i - 1
            while aa < reach * reach and before > 0 and i - before < FAR and not corner[before]:
                before -= 1
                aa = 0.0
                for c in metric:
                    aa += (x[i, c] - x[before, c]) ** 2
            after = i + 1
            while bb < reach * reach and after < m - 1 and after - i < FAR:
                after += 1
                bb = 0.0
                for c in metric:
                    bb += (x[after, c] - x[i, c]) ** 2
            dot = 0.0
            for c in metric:
                dot += (x[i, c] - x[before, c]) * (x[after, c] - x[i, c])
            corner[i] = min(aa, bb) >= reach * reach and dot < cosine * math.sqrt(aa * bb)


@njit
def first_knots(chain: Chain, corner: Flags, tolerance: float) -> Knots:
    """Return the first knots, as widely spaced as possible, and fill ``chain.along``.

    Vertices nearer than LEAST to the one before are skipped. Beside a corner three spans are laid
    on one segment if it is long enough: the outer one will be straight.
    """
    x, along, metric, _ = chain
    m = x.shape[0]
    knots = np.zeros(m + 8 * np.count_nonzero(corner), KNOT)
    count = 0
    kept = 0
    since = 0
    for i in range(m):
        step = 0.0
        for c in metric:
            step += (x[i, c] - x[kept, c]) ** 2
        step = math.sqrt(step)
        edge = i == 0 or i == m - 1 or corner[i]
        along[i] = along[kept] if i > 0 else 0.0
        if not edge and step < LEAST * tolerance:
            continue
        behind = i > 0 and corner[i - 1]
        if behind != (corner[i] and i > 0) and i > 0 and kept == i - 1:
            sine = _half_sine(x, metric, i - 1 if behind else i)
            outer = min(BESIDE * tolerance / sine, 0.5 * step)
            width = min(outer, 0.5 * (step - outer))
            if step > 4.0 * LEAST * tolerance:
                if not behind and knots[count - 1]["t"] < along[kept]:
                    knots[count]["t"] = along[kept]
                    knots[count]["vertex"] = kept
                    knots[count]["on"] = True
                    count += 1
                for k in range(3):
                    a = outer + (k if behind else 2 - k) * width
                    if a < (1.0 - 1e-9) * step:
                        knots[count]["t"] = along[kept] + (a if behind else step - a)
                        knots[count]["vertex"] = kept
                        count += 1
                since = WIDEST if behind else 0
        along[i] += step
        since += 1
        if edge or since >= WIDEST:
            knots[count]["t"] = along[i]
            knots[count]["vertex"] = i
            knots[count]["on"] = True
            knots[count]["ends"] = edge
            count += 1
            since = 0
        kept = i
    for k in range(count):
        knots[k]["fresh"] = 1
    return knots[:count]


@njit
def _half_sine(x: Floats, metric: Ints, i: int) -> float:
    """Return the sine of half the turn at vertex i."""
    aa = bb = turn = 0.0
    for c in metric:
        aa += (x[i, c] - x[i - 1, c]) ** 2
        bb += (x[i + 1, c] - x[i, c]) ** 2
    aa = math.sqrt(aa)
    bb = math.sqrt(bb)
    for c in metric:
        turn += ((x[i + 1, c] - x[i, c]) / bb - (x[i, c] - x[i - 1, c]) / aa) ** 2
    return 0.5 * math.sqrt(turn)


@njit
def points_of(chain: Chain, knots: Knots, p: Floats) -> None:
    """Write the points of the polyline at the knots into p (K, n)."""
    x, along, _, _ = chain
    for k in range(knots.shape[0]):
        i = knots[k]["vertex"]
        for c in range(x.shape[1]):
            p[k, c] = x[i, c]
        if not knots[k]["on"]:
            part = (knots[k]["t"] - along[i]) / (along[i + 1] - along[i])
            for c in range(x.shape[1]):
                p[k, c] += part * (x[i + 1, c] - x[i, c])


@njit
def _blossoms(knots: Knots, p: Floats, state: Floats, k: int, end: int, d: Floats) -> None:
    """Write the control points of the part between the knots k and end into d (K, 2, n).

    Each is the blossom at a knot: of the part that ends there (0), and of the part that begins (1).
    """
    n = p.shape[1]
    spans = end - k
    h0 = knots[k + 1]["t"] - knots[k]["t"]
    hm = knots[end]["t"] - knots[end - 1]["t"]
    for c in range(n):
        for j in range(k + 1, end):
            a = knots[j]["t"] - knots[j - 1]["t"]
            b = knots[j + 1]["t"] - knots[j]["t"]
            s0 = (p[j, c] - p[j - 1, c]) / a
            s1 = (p[j + 1, c] - p[j, c]) / b
            part = INWARD if knots[j]["inside"] == 1 else 1.0
            d[j, 0, c] = d[j, 1, c] = p[j, c] + part * (b * b * s0 - a * a * s1) / (3.0 * (a + b))
        # slopes at the ends: of the parabola or cubic through the nearest points
        s0 = (p[k + 1, c] - p[k, c]) / h0
        sm = (p[end, c] - p[end - 1, c]) / hm
        if spans > 1:
            h1 = knots[k + 2]["t"] - knots[k + 1]["t"]
            s1 = (p[k + 2, c] - p[k + 1, c]) / h1
            q0 = (s1 - s0) / (h0 + h1)
            hl = knots[end - 1]["t"] - knots[end - 2]["t"]
            sl = (p[end - 1, c] - p[end - 2, c]) / hl
            qm = (sm - sl) / (hm + hl)
            if spans > 2:
                h2 = knots[k + 3]["t"] - knots[k + 2]["t"]
                s2 = (p[k + 3, c] - p[k + 2, c]) / h2
                cubic = ((s2 - s1) / (h1 + h2) - q0) / (h0 + h1 + h2)
                s0 += h0 * (h0 + h1) * cubic
                hj = knots[end - 2]["t"] - knots[end - 3]["t"]
                sj = (p[end - 2, c] - p[end - 3, c]) / hj
                cubic = (qm - (sl - sj) / (hl + hj)) / (hm + hl + hj)
                sm += hm * (hm + hl) * cubic
            s0 -= h0 * q0
            sm += hm * qm
        d[k, 1, c] = p[k, c] + s0 * h0 / 3.0
        d[end, 0, c] = p[end, c] - sm * hm / 3.0
        if k == 0 and not math.isnan(state[0, c]):
            b1 = state[0, c] + state[1, c] * h0 / 3.0
            b2 = 2.0 * b1 - state[0, c] + h0 * h0 * state[2, c] / 6.0
            d[0, 1, c] = b1
            if spans > 1:
                d[1, 0, c] = d[1, 1, c] = b1 + (b2 - b1) * (h0 + knots[2]["t"] - knots[1]["t"]) / h0
            else:
                d[1, 0, c] = b2


@njit
def spans_of(knots: Knots, p: Floats, state: Floats, bezier: Floats) -> None:
    """Write the Bezier points of each span of the spline.

    The spline goes through both ends of each part without a break. Spans that are left to the
    polyline are chords.

    Args:
        knots: (K,): knots.
        p: (K, n): points of the polyline at the knots, mm.
        state: (3, n): position, first and second derivative by t at the start, or NaN.
        bezier: (K - 1, 4, n): takes the Bezier points, mm.
    """
    last = knots.shape[0] - 1
    n = p.shape[1]
    d = np.empty((last + 1, 2, n))
    k = 0
    while k < last:
        end = k + 1
        while not knots[end]["ends"]:
            end += 1
        _blossoms(knots, p, state, k, end, d)
        for j in range(k, end):
            h = knots[j + 1]["t"] - knots[j]["t"]
            before = knots[j]["t"] - knots[j - 1]["t"] if j > k else 0.0
            after = knots[j + 2]["t"] - knots[j + 1]["t"] if j + 1 < end else 0.0
            whole = before + h + after
            for c in range(n):
                rise = d[j + 1, 0, c] - d[j, 1, c]
                bezier[j, 1, c] = d[j, 1, c] + before / whole * rise
                bezier[j, 2, c] = d[j, 1, c] + (before + h) / whole * rise
                if j > k:
                    bezier[j, 0, c] = (h * bezier[j - 1, 2, c] + before * bezier[j, 1, c]) / (
                        before + h
                    )
                    bezier[j - 1, 3, c] = bezier[j, 0, c]
        for c in range(n):
            bezier[k, 0, c] = state[0, c] if k == 0 and not math.isnan(state[0, c]) else p[k, c]
            bezier[end - 1, 3, c] = p[end, c]
        k = end


@njit
def span_distance(
    b: Floats, tau: float, x: Floats, metrics: Flags, foot: bool
) -> tuple[float, float]:
    """Return the distance of the point x (n,) from a span at tau, and tau.

    The distance (mm) is that over the metric axes, or in one of the others if that is larger. b:
    (4, n): Bezier points of the span. foot: tau is moved to the foot of the point.
    """
    n = x.shape[0]
    left = 1.0 - tau
    w0, w1, w2, w3 = (
        left * left * left,
        3.0 * left * left * tau,
        3.0 * left * tau * tau,
        tau * tau * tau,
    )
    square = 0.0
    other = 0.0
    dot = 0.0
    speed = 0.0
    for c in range(n):
        r = w0 * b[0, c] + w1 * b[1, c] + w2 * b[2, c] + w3 * b[3, c] - x[c]
        if metrics[c]:
            square += r * r
            if foot:
                slope = 3.0 * (
                    left * left * (b[1, c] - b[0, c])
                    + 2.0 * left * tau * (b[2, c] - b[1, c])
                    + tau * tau * (b[3, c] - b[2, c])
                )
                dot += r * slope
                speed += slope * slope
        else:
            other = max(other, abs(r))
    if foot and speed > 0.0:
        tau -= dot / speed
    return max(math.sqrt(square), other), tau


@njit
def _proved(chain: Chain, knots: Knots, k: int, b: Floats, p: Floats, tolerance: float) -> bool:
    """Return whether span k and the polyline between its knots keep within the tolerance.

    b: (4, n): Bezier points of the span. p: (K, n): points of the polyline at the knots.
    """
    x, along, metric, metrics = chain
    n = p.shape[1]
    chord = 0.0
    for c in metric:
        chord += (b[3, c] - b[0, c]) ** 2
    good = chord > 0.0
    for j in range(3):
        advance = 0.0
        for c in metric:
            advance += (b[j + 1, c] - b[j, c]) * (b[3, c] - b[0, c])
        good = good and advance > FORWARD / 3.0 * chord
    # |S''| by tau, over the metric axes or in one of the others: the larger of its values at the
    # ends
    bend = 0.0
    for j in range(2):
        square = 0.0
        for c in range(n):
            second = 6.0 * (b[j + 2, c] - 2.0 * b[j + 1, c] + b[j, c])
            if metrics[c]:
                square += second * second
            else:
                bend = max(bend, abs(second))
        bend = max(bend, math.sqrt(square))
    first = knots[k]["vertex"] + 1
    last = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
    allowed = tolerance * USED
    if first > last and k > 0:
        allowed = tolerance * (USED_ONE if knots[k]["on"] and knots[k + 1]["on"] else USED_STRAIGHT)
    h = knots[k + 1]["t"] - knots[k]["t"]
    here = np.empty(n)
    step = np.empty(n)
    before = 0.0
    gap, tau = span_distance(b, 0.0, p[k], metrics, False)
    i = first
    while good and i <= last + 1:
        if i <= last:
            tau = min(max((along[i] - knots[k]["t"]) / h, before), 1.0)
            there, foot = span_distance(b, tau, x[i], metrics, True)
            if there > 0.1 * allowed:
                tau = min(max(foot, before), 1.0)
                there, foot = span_distance(b, tau, x[i], metrics, False)
        else:
            tau = 1.0
            there, foot = span_distance(b, 1.0, p[k + 1], metrics, False)
        sagitta = 0.125 * bend * (tau - before) ** 2
        good = max(gap, there) + sagitta <= allowed
        if not good and max(gap, there) <= allowed and sagitta <= 3.0 * allowed:
            # Where the curve crosses the move the two bounds do not add up. The quarters decide.
            for c in range(n):
                here[c] = p[k, c] if i == first else x[i - 1, c]
                step[c] = 0.25 * ((p[k + 1, c] if i > last else x[i, c]) - here[c])
            worst = max(gap, there)
            for j in range(1, 4):
                for c in range(n):
                    here[c] += step[c]
                worst = max(
                    worst,
                    span_distance(b, before + 0.25 * j * (tau - before), here, metrics, False)[0],
                )
            good = worst + 0.0625 * sagitta <= allowed
        gap = there
        before = tau
        i += 1
    return good


@njit
def refined(
    chain: Chain, knots: Knots, tolerance: float, state: Floats
) -> tuple[Knots, Floats, Floats]:
    """Cut the spans until all keep within the tolerance.

    state: (3, n): see :func:`spans_of`.

    Returns:
        The knots, their points (K, n), and the Bezier points (K - 1, 4, n).
    """
    n = chain.x.shape[1]
    while True:
        count = knots.shape[0]
        p = np.empty((count, n))
        bezier = np.empty((count - 1, 4, n))
        points_of(chain, knots, p)
        spans_of(knots, p, state, bezier)
        cut = np.zeros(count - 1, np.bool_)
        size = np.empty(count - 1)
        again = False
        for k in range(count - 1):
            size[k] = knots[k + 1]["t"] - knots[k]["t"]
            if knots[k]["fresh"] != 0 and not knots[k]["polyline"]:
                knots[k]["fresh"] = 0
                if not _proved(chain, knots, k, bezier[k], p, tolerance):
                    changed = _give_way(knots, k, size, cut, tolerance)
                    again = again or changed
        added = 0
        for k in range(1, count - 1):
            if not knots[k]["ends"] and not cut[k] and size[k] > RATIO * size[k - 1]:
                cut[k] = True
                size[k] *= 0.5
        for k in range(count - 2, 0, -1):
            if not knots[k]["ends"] and not cut[k - 1] and size[k - 1] > RATIO * size[k]:
                cut[k - 1] = True
                size[k - 1] *= 0.5
        for k in range(count - 1):
            added += cut[k]
        if added == 0 and not again:
            return knots, p, bezier
        knots = _with_cuts(chain, knots, cut, added)


@njit
def _give_way(knots: Knots, k: int, size: Floats, cut: Flags, tolerance: float) -> bool:
    """Change span k, which does not keep within the tolerance: the spline beside it, or a cut.

    Returns:
        Whether the spline has changed without a cut.
    """
    count = knots.shape[0]
    one_move = (
        knots[k]["on"] and knots[k + 1]["on"] and knots[k]["vertex"] + 1 == knots[k + 1]["vertex"]
    )
    if (
        one_move
        and max(knots[k]["inside"], knots[k + 1]["inside"]) < 2
        and min(knots[k]["inside"], knots[k + 1]["inside"]) == 0
    ):
        # Moves as long as this are chords of a curve: midway between both the spline is as near to
        # them as it can be.
        knots[k]["inside"] = knots[k + 1]["inside"] = 1
    elif size[k] >= 2.0 * LEAST * tolerance:
        cut[k] = True
        size[k] *= 0.5
        if not one_move:
            return False
        knots[k]["inside"] = knots[k + 1]["inside"] = 2
    else:
        knots[k]["polyline"] = True
        knots[k]["ends"] = knots[k + 1]["ends"] = True
    for j in range(max(k - 3, 0), min(k + 4, count - 1)):
        knots[j]["fresh"] = 1
    return not cut[k]


@njit
def _with_cuts(chain: Chain, knots: Knots, cut: Flags, added: int) -> Knots:
    """Return the knots with a new one in each span that is to be cut; ``added`` of them."""
    count = knots.shape[0]
    finer = np.zeros(count + added, KNOT)
    to = 0
    for k in range(count):
        finer[to] = knots[k]
        to += 1
        if k < count - 1 and cut[k]:
            _middle(knots, k, chain.along, finer[to])
            to += 1
    for k in range(to - 1):
        if finer[k]["fresh"] == 2:
            finer[k]["fresh"] = 1
            for j in range(max(k - 4, 0), min(k + 4, to)):
                if finer[j]["fresh"] == 0:
                    finer[j]["fresh"] = 1
    return finer


@njit
def _middle(knots: Knots, k: int, along: Floats, out: np.void) -> None:
    """Write a knot that cuts span k into ``out``.

    It is at the vertex nearest to the middle of the span if one is near, else in the middle.
    """
    low = knots[k]["t"]
    high = knots[k + 1]["t"]
    t = 0.5 * (low + high)
    a = knots[k]["vertex"]
    b = knots[k + 1]["vertex"] + (0 if knots[k + 1]["on"] else 1)
    while b - a > 1:
        i = (a + b) // 2
        if along[i] <= t:
            a = i
        else:
            b = i
    out["t"] = t
    out["vertex"] = a
    out["on"] = False
    nearest = 0.2 * (high - low)
    for i in range(a, b + 1):
        if abs(along[i] - t) < nearest:
            nearest = abs(along[i] - t)
            out["t"] = along[i]
            out["vertex"] = i
            out["on"] = True
    out["fresh"] = 2
