r"""Proof that a fitted spline and the polyline are within the tolerance of each other.

          ___ v ___ S          Each vertex v has a parameter, near its foot on the curve S and not
         /.--' '--. \          before the last one's. Its distance is that of S there. Between two
     ___v          v___        of them S belongs to the move; there may be knots in between.

The distance from a move is convex. So on an interval of length d it is at most the larger of those
at its ends, plus the sagitta max |S''| d^2 / 8. The interval is divided where that does not
suffice. This bounds the distance of the curve from the move. It bounds the other distance too: seen
along the move the curve is continuous, so it passes each point of the move between its ends, and
the rest of the move is as near to an end of the curve as the vertex is.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats
from cnc.path.kernels.fit_spline import DEGREE, Chain, Flags, Spline

FORWARD = 0.2
"""Least part of a fifth of its chord that each leg of a span's control polygon advances along the
chord: no cusps, no loops.
"""
CLOSE = 0.1
"""Part of the tolerance below which the foot of a vertex is not searched."""
FOUND = 1e-4
"""Part of its span by which the foot of a vertex moves in the last step of the search."""

MEASURED = 16
"""Places in a span at which its distance is measured."""


@njit
def span_distance(
    b: Floats, tau: float, x: Floats, metrics: Flags, foot: bool
) -> tuple[float, float]:
    """Return the distance of the point x (n,) from a span at tau, and tau.

    The distance (mm) is that over the metric axes, or in one of the others if that is larger. b:
    (6, n): Bezier points of the span. foot: tau is moved towards the foot of the point.
    """
    left = 1.0 - tau
    a2 = left * left
    t2 = tau * tau
    w0, w1, w2 = a2 * a2 * left, 5.0 * tau * a2 * a2, 10.0 * t2 * a2 * left
    w3, w4, w5 = 10.0 * t2 * tau * a2, 5.0 * t2 * t2 * left, t2 * t2 * tau
    square = 0.0
    other = 0.0
    dot = 0.0
    speed = 0.0
    for c in range(x.shape[0]):
        r = (w0 * b[0, c] + w1 * b[1, c] + w2 * b[2, c]) + (
            w3 * b[3, c] + w4 * b[4, c] + w5 * b[5, c] - x[c]
        )
        if metrics[c]:
            square += r * r
            if foot:
                slope = 5.0 * (
                    a2 * (a2 * (b[1, c] - b[0, c]) + 4.0 * left * tau * (b[2, c] - b[1, c]))
                    + 6.0 * a2 * t2 * (b[3, c] - b[2, c])
                    + t2 * (4.0 * left * tau * (b[4, c] - b[3, c]) + t2 * (b[5, c] - b[4, c]))
                )
                dot += r * slope
                speed += slope * slope
        else:
            other = max(other, abs(r))
    if foot and speed > 0.0:
        tau -= dot / speed
    return max(math.sqrt(square), other), tau


@njit
def _forward(b: Floats, metrics: Flags) -> bool:
    """Return whether each leg of the control polygon advances along the chord."""
    chord = 0.0
    for c in range(b.shape[1]):
        if metrics[c]:
            chord += (b[DEGREE, c] - b[0, c]) ** 2
    good = chord > 0.0
    for j in range(DEGREE):
        advance = 0.0
        for c in range(b.shape[1]):
            if metrics[c]:
                advance += (b[j + 1, c] - b[j, c]) * (b[DEGREE, c] - b[0, c])
        good = good and advance > FORWARD / DEGREE * chord
    return good


@njit
def _bends(b: Floats, metrics: Flags) -> tuple[float, float]:
    """Return bounds of |S''| by tau over the metric axes, and in any of the others."""
    metric_bend = 0.0
    other_bend = 0.0
    for j in range(DEGREE - 1):
        square = 0.0
        for c in range(b.shape[1]):
            second = 20.0 * (b[j + 2, c] - 2.0 * b[j + 1, c] + b[j, c])
            if metrics[c]:
                square += second * second
            else:
                other_bend = max(other_bend, abs(second))
        metric_bend = max(metric_bend, math.sqrt(square))
    return metric_bend, other_bend


@njit
def _from_move(b: Floats, tau: float, x0: Floats, x1: Floats, metrics: Flags) -> float:
    """Return the distance of a span at tau from the move x0 -> x1 (n,), as in span_distance."""
    left = 1.0 - tau
    a2 = left * left
    t2 = tau * tau
    w0, w1, w2 = a2 * a2 * left, 5.0 * tau * a2 * a2, 10.0 * t2 * a2 * left
    w3, w4, w5 = 10.0 * t2 * tau * a2, 5.0 * t2 * t2 * left, t2 * t2 * tau
    dot = along = square = other = 0.0
    for c in range(x0.shape[0]):
        if metrics[c]:
            off = (w0 * b[0, c] + w1 * b[1, c] + w2 * b[2, c]) + (
                w3 * b[3, c] + w4 * b[4, c] + w5 * b[5, c] - x0[c]
            )
            move = x1[c] - x0[c]
            dot += off * move
            along += move * move
    part = min(max(dot / along, 0.0), 1.0) if along > 0.0 else 0.0
    for c in range(x0.shape[0]):
        off = (w0 * b[0, c] + w1 * b[1, c] + w2 * b[2, c]) + (
            w3 * b[3, c] + w4 * b[4, c] + w5 * b[5, c] - x0[c]
        )
        off -= part * (x1[c] - x0[c])
        if metrics[c]:
            square += off * off
        else:
            other = max(other, abs(off))
    return max(math.sqrt(square), other)


@njit
def _near(
    b: Floats,
    before: float,
    after: float,
    apart: float,
    x0: Floats,
    x1: Floats,
    metrics: Flags,
    bends: tuple[float, float],
    allowed: float,
) -> bool:
    """Return whether a span keeps within ``allowed`` of the move x0 -> x1 between two places.

    Args:
        b: (6, n): Bezier points of the span.
        before: the first place, from 0 to 1.
        after: the second.
        apart: largest distance of the curve from the ends of the move there, mm, or infinity. From
            the move it is no farther.
        x0: (n,): start of the move.
        x1: (n,): its end.
        metrics: whether each axis is a metric one.
        bends: of the span, see _bends.
        allowed: mm.
    """
    metric_bend, other_bend = bends
    square = 0.0
    moved = 0.0
    for c in range(x0.shape[0]):
        if metrics[c]:
            square += (x1[c] - x0[c]) ** 2
        else:
            moved = max(moved, abs(x1[c] - x0[c]))
    if moved > 0.0 and square > 0.0:
        # The others are compared where the curve is, seen along the move.
        other_bend += metric_bend * moved / math.sqrt(square)
    sagitta = 0.125 * max(metric_bend, other_bend) * (after - before) ** 2
    # Other axes are compared at another point of the move than its end.
    good = moved == 0.0 and apart + sagitta <= allowed
    count = 1
    while count <= 64 and not good:
        good = sagitta < allowed * count * count
        for j in range(count + 1):
            tau = before + (after - before) * j / count
            if good and _from_move(b, tau, x0, x1, metrics) + sagitta / (count * count) > allowed:
                good = False
        count *= 4
    return good


@njit
def _foot(
    spline: Spline,
    k: int,
    t: float,
    low: float,
    high: float,
    x: Floats,
    metrics: Flags,
    near: float,
) -> tuple[float, int, float]:
    """Search the foot of the point x (n,) on the spline, from t in span k on.

    Args:
        spline: the spline.
        k: a span of the same part.
        t: where the search begins.
        low: least parameter.
        high: largest parameter.
        x: the point.
        metrics: whether each axis is a metric one.
        near: mm. A distance that is smaller ends the search.

    Returns:
        The parameter, its span, and the distance in mm.
    """
    knots = spline.knots
    t = min(max(t, low), high)
    best, best_k, best_t = math.inf, k, t
    for _ in range(5):
        while t > knots[k + 1]["t"] and not knots[k + 1]["ends"]:
            k += 1
        while t < knots[k]["t"] and not knots[k]["ends"]:
            k -= 1
        start = knots[k]["t"]
        h = knots[k + 1]["t"] - start
        distance, tau = span_distance(spline.bezier[k], (t - start) / h, x, metrics, True)
        if distance < best:
            best, best_k, best_t = distance, k, t
        following = min(max(start + tau * h, low), high)
        if distance <= near or abs(following - t) <= FOUND * h:
            break
        t = following
    return best_t, best_k, best


@njit
def _prove_range(
    chain: Chain, spline: Spline, feet: Floats, low: int, high: int, allowed: float, wrong: Flags
) -> None:
    """Prove the spans from ``low`` to before ``high``, which lie in one part; see prove."""
    knots = spline.knots
    metrics = chain.metrics
    k = low
    while k > 0 and not knots[k]["ends"]:
        k -= 1
    last_knot = high
    while not knots[last_knot]["ends"]:
        last_knot += 1
    # It begins and ends at vertices whose feet are known, or at the ends of the part.
    i = knots[low]["vertex"]
    while i > knots[k]["vertex"] and feet[i] > knots[low]["t"]:
        i -= 1
    part_begins = i <= knots[k]["vertex"]
    end = knots[high]["vertex"]
    while end < knots[last_knot]["vertex"] and feet[end] < knots[high]["t"]:
        end += 1
    part_ends = end >= knots[last_knot]["vertex"]
    if part_begins:
        i = knots[k]["vertex"]
    if part_ends:
        end = knots[last_knot]["vertex"] + int(not knots[last_knot]["on"])
    before = knots[k]["t"] if part_begins else feet[i]
    until = knots[last_knot]["t"] if part_ends else feet[end]
    x0 = spline.p[k] if part_begins else chain.x[i]
    while knots[k + 1]["t"] <= before and k + 1 < last_knot:
        k += 1
    wrong[k] = wrong[k] or not _forward(spline.bezier[k], metrics)
    bends = _bends(spline.bezier[k], metrics)
    apart = math.inf
    while i < end:
        i += 1
        ends = i == end
        x1 = spline.p[last_knot] if ends and part_ends else chain.x[i]
        least = until if ends else before
        t, there, distance = _foot(
            spline, k, chain.along[i], least, until, x1, metrics, CLOSE * allowed
        )
        if not (ends and part_ends):
            feet[i] = t
        wrong[there] = wrong[there] or distance > allowed
        while True:
            start = knots[k]["t"]
            h = knots[k + 1]["t"] - start
            stop = min(t, knots[k + 1]["t"])
            if stop > before and not wrong[k]:
                low_tau, high_tau = (before - start) / h, (stop - start) / h
                apart = max(apart, distance if stop == t else math.inf)
                wrong[k] = not _near(
                    spline.bezier[k], low_tau, high_tau, apart, x0, x1, metrics, bends, allowed
                )
            before = max(before, stop)
            apart = math.inf
            if k + 1 == last_knot or t < knots[k + 1]["t"]:
                break
            k += 1
            wrong[k] = wrong[k] or not _forward(spline.bezier[k], metrics)
            bends = _bends(spline.bezier[k], metrics)
        x0 = x1
        # Where the curve is before t, nothing is known of its distance there.
        apart = distance if before == t else math.inf


@njit
def prove(chain: Chain, spline: Spline, feet: Floats, changed: Flags, allowed: float) -> Flags:
    """Return which spans are not proved to be within ``allowed`` mm of the polyline.

    Args:
        chain: the chain.
        spline: the spline.
        feet: (m,): parameters of the vertices; those near the spans that have changed are set.
        changed: (K - 1,): spans that have changed.
        allowed: mm.
    """
    spans = changed.shape[0]
    wrong = np.zeros(spans, np.bool_)
    k = 0
    while k < spans:
        high = k + 1
        if changed[k] and not spline.knots[k]["polyline"]:
            while high < spans and changed[high] and not spline.knots[high]["ends"]:
                high += 1
            _prove_range(chain, spline, feet, k, high, allowed, wrong)
        k = high
    return wrong


@njit
def far_off(chain: Chain, spline: Spline, wrong: Flags, distance: float) -> Flags:
    """Return which of the spans that are wrong leave the polyline by more than a distance, mm.

    wrong: (K - 1,): see prove.
    """
    knots = spline.knots
    far = np.zeros(wrong.shape[0], np.bool_)
    for k in range(wrong.shape[0]):
        if not wrong[k]:
            continue
        first = max(knots[k]["vertex"] - 1, 0)
        last = min(knots[k + 1]["vertex"] + 2, chain.x.shape[0] - 1)
        for j in range(MEASURED):
            nearest = math.inf
            for i in range(first, last):
                off = _from_move(
                    spline.bezier[k],
                    (j + 0.5) / MEASURED,
                    chain.x[i],
                    chain.x[i + 1],
                    chain.metrics,
                )
                nearest = min(nearest, off)
            far[k] = far[k] or nearest > distance
    return far
