"""Chains of short straight moves to cubic splines within a tolerance: the knots, their refinement,
the proof of both distances.

The moves are a polyline; t is the length along it over its metric axes. Knots t_k with their points
p_k of the polyline are laid as widely as the tolerance permits. The control points follow from
three points each (h, s: spacing and slope before and behind knot k):

    d_k = p_k + (h1^2 s0 - h0^2 s1) / (3 (h0 + h1))      the blossom at (t_k-1, t_k, t_k+1) of the parabola through the three points

This quasi-interpolant reproduces cubics on knots of any spacing, so it errs by h^4; it is C2
whatever the d_k are; it is local (a span knows three knots either side of itself), so it can be
handed out while the polyline goes on, and where the points lie on a straight line it is that line
exactly. An interpolating spline needs half as many knots, but its ripples run along straight
stretches.

                  v       Span k is proved with the vertices v between its knots. To each belongs a parameter, near its foot on the curve
         v--------'---v   and not before the last one's; between two of them curve and polyline go along together, no farther apart
    p_k x       S      x p_k+1    than at the ends and the sagitta there, max |S''| dt^2 / 8. That bounds both distances.

A span that fails is cut in half, at a vertex if there is one near; spans more than RATIO as long as
their neighbour are cut as well, until all hold. A span too short to be cut is left to the polyline:
there, and at corners, the spline is broken and goes through p_k.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints

Flags = NDArray[np.bool_]

T, AT, ON, ENDS, INSIDE, POLYLINE, FRESH = range(7)
COLUMNS = 7
"""Columns of an array of knots: the parameter; the vertex at or before the knot; whether it is that
vertex; whether the spline is broken there; whether it passes inside the vertex (see INWARD; 2: no
more). Of the span behind it: whether it is left to the polyline; whether it has to be proved
(again).
"""
RATIO = 2.6
"""Longest span beside a shorter one; halves of neighbours that are cut at vertices may be this far
apart.
"""
WIDEST = 64
"""Vertices in a span at most."""
FAR = 256
"""Vertices that are looked at to see where a corner is."""
FORWARD = 0.2
"""Least part of a third of its chord that each leg of a span's control polygon advances along the
chord: no cusps, no loops.
"""
USED = 0.8
"""Part of the tolerance that a span may use."""
USED_ONE = 0.98
"""The same for a span that is one move: nothing wider holds there."""
USED_STRAIGHT = 0.25
"""The same for a span beside a part of a segment: what is straight stays so as nearly as smoothness
allows.
"""
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


@njit
def find_corners(x: Floats, metric: Ints, cosine: float, reach: float, corner: Flags) -> None:
    """Mark the vertices x (m, n) where the direction turns by more than the angle of this cosine,
    as seen from ``reach`` away, into corner.

    metric: the columns that count. The first and the last vertex are none, nor are those that
    nothing is that far from.
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
            # moves shorter than the reach may turn by their rounding alone
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
def first_knots(x: Floats, metric: Ints, corner: Flags, tolerance: float, along: Floats) -> Floats:
    """The first knots along the vertices x (m, n), as wide as may be; along (m,) takes t of the
    vertices.

    Vertices nearer than LEAST to the one before add nothing. Beside a corner three spans are laid
    on one segment if it is long enough: the outer one will be straight.
    """
    m = x.shape[0]
    knots = np.zeros((m + 8 * np.count_nonzero(corner), COLUMNS))
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
                if not behind and knots[count - 1, T] < along[kept]:
                    knots[count, T] = along[kept]
                    knots[count, AT] = kept
                    knots[count, ON] = 1.0
                    count += 1
                for k in range(3):
                    a = outer + (k if behind else 2 - k) * width
                    if a < (1.0 - 1e-9) * step:
                        knots[count, T] = along[kept] + (a if behind else step - a)
                        knots[count, AT] = kept
                        count += 1
                since = WIDEST if behind else 0
        along[i] += step
        since += 1
        if edge or since >= WIDEST:
            knots[count, T] = along[i]
            knots[count, AT] = i
            knots[count, ON] = 1.0
            knots[count, ENDS] = 1.0 if edge else 0.0
            count += 1
            since = 0
        kept = i
    knots[:, FRESH] = 1.0
    return knots[:count]


@njit
def _half_sine(x: Floats, metric: Ints, i: int) -> float:
    """Sine of half the turn at vertex i."""
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
def points_of(knots: Floats, x: Floats, along: Floats, p: Floats) -> None:
    """The points of the polyline at the knots into p (K, n)."""
    for k in range(knots.shape[0]):
        i = int(knots[k, AT])
        for c in range(x.shape[1]):
            p[k, c] = x[i, c]
        if knots[k, ON] == 0.0:
            part = (knots[k, T] - along[i]) / (along[i + 1] - along[i])
            for c in range(x.shape[1]):
                p[k, c] += part * (x[i + 1, c] - x[i, c])


@njit
def spans_of(knots: Floats, p: Floats, state: Floats, bezier: Floats) -> None:
    """The Bezier points of each span, bezier (K - 1, 4, n), of the spline through the ends of each
    of its parts.

    state (3, n): position, first and second derivative by t to begin with, or NaN. Spans that are
    left to the polyline are chords.
    """
    last = knots.shape[0] - 1
    n = p.shape[1]
    d = np.empty(
        (last + 1, 2, n)
    )  # blossom at each knot: of the part that ends there, of the part that begins
    k = 0
    while k < last:
        end = k + 1
        while knots[end, ENDS] == 0.0:
            end += 1
        spans = end - k
        h0 = knots[k + 1, T] - knots[k, T]
        hm = knots[end, T] - knots[end - 1, T]
        for c in range(n):
            for j in range(k + 1, end):
                a = knots[j, T] - knots[j - 1, T]
                b = knots[j + 1, T] - knots[j, T]
                s0 = (p[j, c] - p[j - 1, c]) / a
                s1 = (p[j + 1, c] - p[j, c]) / b
                part = INWARD if knots[j, INSIDE] == 1.0 else 1.0
                d[j, 0, c] = d[j, 1, c] = p[j, c] + part * (b * b * s0 - a * a * s1) / (
                    3.0 * (a + b)
                )
            # slopes at the ends: of the parabola or cubic through the nearest points
            s0 = (p[k + 1, c] - p[k, c]) / h0
            sm = (p[end, c] - p[end - 1, c]) / hm
            if spans > 1:
                h1 = knots[k + 2, T] - knots[k + 1, T]
                s1 = (p[k + 2, c] - p[k + 1, c]) / h1
                q0 = (s1 - s0) / (h0 + h1)
                hl = knots[end - 1, T] - knots[end - 2, T]
                sl = (p[end - 1, c] - p[end - 2, c]) / hl
                qm = (sm - sl) / (hm + hl)
                if spans > 2:
                    h2 = knots[k + 3, T] - knots[k + 2, T]
                    s2 = (p[k + 3, c] - p[k + 2, c]) / h2
                    cubic = ((s2 - s1) / (h1 + h2) - q0) / (h0 + h1 + h2)
                    s0 += h0 * (h0 + h1) * cubic
                    hj = knots[end - 2, T] - knots[end - 3, T]
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
                    d[1, 0, c] = d[1, 1, c] = b1 + (b2 - b1) * (h0 + knots[2, T] - knots[1, T]) / h0
                else:
                    d[1, 0, c] = b2
        for j in range(k, end):
            h = knots[j + 1, T] - knots[j, T]
            before = knots[j, T] - knots[j - 1, T] if j > k else 0.0
            after = knots[j + 2, T] - knots[j + 1, T] if j + 1 < end else 0.0
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
    """How far the point x (n,) is from the span at tau, over the metric axes or in one of the
    others; tau, moved to the foot if asked.
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
def _proved(
    knots: Floats, k: int, b: Floats, p: Floats, x: Floats, along: Floats, metric: Ints, metrics: Flags, tolerance: float
) -> bool:  # fmt: skip
    """Whether span k with Bezier points b (4, n) and the polyline between its knots stay within the
    tolerance of each other.
    """
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
    # |S''| by tau, the larger of its values at the ends, over the metric axes or in one of the
    # others
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
    first = int(knots[k, AT]) + 1
    last = int(knots[k + 1, AT]) - int(knots[k + 1, ON])
    allowed = tolerance * USED
    if first > last and k > 0:
        allowed = tolerance * (
            USED_ONE if knots[k, ON] * knots[k + 1, ON] != 0.0 else USED_STRAIGHT
        )
    h = knots[k + 1, T] - knots[k, T]
    here = np.empty(n)
    step = np.empty(n)
    before = 0.0
    gap, tau = span_distance(b, 0.0, p[k], metrics, False)
    i = first
    while good and i <= last + 1:
        if i <= last:
            tau = min(max((along[i] - knots[k, T]) / h, before), 1.0)
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
            # where the curve crosses the move the two don't add up: look at the quarters
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
    knots: Floats, x: Floats, along: Floats, metric: Ints, metrics: Flags, tolerance: float, state: Floats
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Cut the spans until all hold: the knots, their points and the Bezier points (see
    :func:`spans_of`).
    """
    n = x.shape[1]
    while True:
        count = knots.shape[0]
        p = np.empty((count, n))
        bezier = np.empty((count - 1, 4, n))
        points_of(knots, x, along, p)
        spans_of(knots, p, state, bezier)
        cut = np.zeros(count - 1, np.bool_)
        size = np.empty(count - 1)
        again = False
        for k in range(count - 1):
            size[k] = knots[k + 1, T] - knots[k, T]
            if knots[k, FRESH] != 0.0 and knots[k, POLYLINE] == 0.0:
                knots[k, FRESH] = 0.0
                if not _proved(knots, k, bezier[k], p, x, along, metric, metrics, tolerance):
                    one_move = (
                        knots[k, ON] != 0.0
                        and knots[k + 1, ON] != 0.0
                        and knots[k, AT] + 1.0 == knots[k + 1, AT]
                    )
                    if (
                        one_move
                        and max(knots[k, INSIDE], knots[k + 1, INSIDE]) < 2.0
                        and min(knots[k, INSIDE], knots[k + 1, INSIDE]) == 0.0
                    ):
                        # moves as long as this are chords of a curve: halfway to it is as near as
                        # the spline can keep to both
                        knots[k, INSIDE] = knots[k + 1, INSIDE] = 1.0
                        for j in range(max(k - 3, 0), min(k + 4, count - 1)):
                            knots[j, FRESH] = 1.0
                        again = True
                    elif size[k] >= 2.0 * LEAST * tolerance:
                        cut[k] = True
                        size[k] *= 0.5
                        if one_move:
                            knots[k, INSIDE] = knots[k + 1, INSIDE] = 2.0
                            for j in range(max(k - 3, 0), min(k + 4, count - 1)):
                                knots[j, FRESH] = 1.0
                    else:
                        knots[k, POLYLINE] = 1.0
                        knots[k, ENDS] = knots[k + 1, ENDS] = 1.0
                        for j in range(max(k - 3, 0), min(k + 4, count - 1)):
                            knots[j, FRESH] = 1.0
                        again = True
        added = 0
        for k in range(1, count - 1):
            if knots[k, ENDS] == 0.0 and not cut[k] and size[k] > RATIO * size[k - 1]:
                cut[k] = True
                size[k] *= 0.5
        for k in range(count - 2, 0, -1):
            if knots[k, ENDS] == 0.0 and not cut[k - 1] and size[k - 1] > RATIO * size[k]:
                cut[k - 1] = True
                size[k - 1] *= 0.5
        for k in range(count - 1):
            added += cut[k]
        if added == 0 and not again:
            return knots, p, bezier
        finer = np.zeros((count + added, COLUMNS))
        to = 0
        for k in range(count):
            finer[to] = knots[k]
            to += 1
            if k < count - 1 and cut[k]:
                _middle(knots, k, along, finer[to])
                to += 1
        for k in range(to - 1):
            if finer[k, FRESH] == 2.0:
                finer[k, FRESH] = 1.0
                for j in range(max(k - 4, 0), min(k + 4, to)):
                    if finer[j, FRESH] == 0.0:
                        finer[j, FRESH] = 1.0
        knots = finer


@njit
def _middle(knots: Floats, k: int, along: Floats, out: Floats) -> None:
    """A knot that cuts span k: at the vertex nearest to its middle if one is near, else in the
    middle.
    """
    low = knots[k, T]
    high = knots[k + 1, T]
    t = 0.5 * (low + high)
    a = int(knots[k, AT])
    b = int(knots[k + 1, AT]) + (1 if knots[k + 1, ON] == 0.0 else 0)
    while b - a > 1:
        i = (a + b) // 2
        if along[i] <= t:
            a = i
        else:
            b = i
    out[T] = t
    out[AT] = a
    out[ON] = 0.0
    nearest = 0.2 * (high - low)
    for i in range(a, b + 1):
        if abs(along[i] - t) < nearest:
            nearest = abs(along[i] - t)
            out[T] = along[i]
            out[AT] = i
            out[ON] = 1.0
    out[FRESH] = 2.0
