"""Least-squares splines through the vertices of a chain, and cuts of spans.

It shows how many knots a chain needs: a span that misses a vertex by more than a part of the
tolerance is cut at a vertex, until none is missed or each span is one move.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.path.kernels.fit_program import factorise, solve
from cnc.path.kernels.fit_spline import (
    DEGREE,
    KNOT,
    ORDER,
    Chain,
    Flags,
    Knots,
    Spline,
    add_energy,
    new_spline,
    set_bezier,
    transfer,
)

NEAR = 8
"""Control points on either side that move again with those of a span that was cut."""
MISSES = 0.35
"""Part of the tolerance by which a span may miss a vertex."""
STIFF = 1e-3
"""Weight of the energy in the least-squares spline: where vertices are few it decides. With
1e-6 the spline bulged by several tolerances between the last vertices of some chains.
"""


@njit
def _influence(extract: Floats, i: int, x: float) -> float:
    """Return the influence of control point i at x of a span whose extraction is given (6, 6)."""
    y = 1.0 - x
    x2, y2 = x * x, y * y
    low = y2 * y2 * y * extract[0, i] + 5.0 * x * y2 * y2 * extract[1, i]
    low += 10.0 * x2 * y2 * y * extract[2, i]
    low += 10.0 * x2 * x * y2 * extract[3, i]
    low += 5.0 * x2 * x2 * y * extract[4, i]
    return low + x2 * x2 * x * extract[5, i]


@njit
def _add_place(
    spline: Spline,
    k: int,
    x: float,
    ref: Floats,
    kept: Flags,
    row: int,
    band: Floats,
    right: Floats,
    phi: Floats,
) -> None:
    """Add the squared distance from ``ref`` (n,) at x of span k to the least-squares system.

    kept: (6,): control points of the span that keep their places. row: row of the first of them in
    the system. phi: (6,) work space.
    """
    extract = spline.extract[k]
    first = spline.first[k]
    for i in range(ORDER):
        phi[i] = _influence(extract, i, x)
    for c in range(ref.shape[0]):
        off = ref[c]
        for i in range(ORDER):
            if kept[i]:
                off -= phi[i] * spline.points[first + i, c]
        for i in range(ORDER):
            right[row + i, c] += phi[i] * off
    for i in range(ORDER):
        for j in range(i + 1):
            band[row + j, i - j] += phi[i] * phi[j]


@njit
def _changes(spline: Spline, keeps: Flags, k: int) -> bool:
    """Return whether a control point of span k does not keep its place."""
    changes = False
    for i in range(ORDER):
        changes = changes or not keeps[spline.first[k] + i]
    return changes


@njit
def least_squares(chain: Chain, spline: Spline, keeps: Flags) -> None:
    """Lay the control points that do not keep their places so that vertices are passed closely.

    Bezier points of all spans that change are set. Spans that follow each other and change are a
    system of their own: between two of these, all control points keep their places.
    """
    spans = spline.knots.shape[0] - 1
    low = 0
    while low < spans:
        high = low
        while high < spans and _changes(spline, keeps, high):
            high += 1
        if high > low:
            _lay(chain, spline, keeps, low, high)
        low = high + 1


@njit
def _lay(chain: Chain, spline: Spline, keeps: Flags, low: int, high: int) -> None:
    """Lay the control points of the spans from ``low`` to before ``high``; see least_squares."""
    knots, _, first, p, extract, points, _, _ = spline
    n = points.shape[1]
    begin = first[low]
    size = first[high - 1] + ORDER - begin
    band = np.zeros((size, ORDER))
    right = np.zeros((size, n))
    phi = np.empty(ORDER)
    for k in range(low, high):
        h = knots[k + 1]["t"] - knots[k]["t"]
        add_energy(extract[k], h, STIFF * h**DEGREE, first[k] - begin, band)
    for j in range(size):
        for i in range(1, min(j, DEGREE) + 1):
            for c in range(n):
                if keeps[begin + j - i]:
                    right[j, c] -= band[j - i, i] * points[begin + j - i, c]
                if keeps[begin + j]:
                    right[j - i, c] -= band[j - i, i] * points[begin + j, c]
    for k in range(low, high):
        start = knots[k]["t"]
        h = knots[k + 1]["t"] - start
        row = first[k] - begin
        kept = keeps[first[k] : first[k] + ORDER]
        _add_place(spline, k, 0.0, p[k], kept, row, band, right, phi)
        for i in range(knots[k]["vertex"] + 1, knots[k + 1]["vertex"]):
            if chain.along[i] > chain.along[i - 1]:
                x = (chain.along[i] - start) / h
                _add_place(spline, k, x, chain.x[i], kept, row, band, right, phi)
    for j in range(size):
        for i in range(min(j, DEGREE) + 1):
            if keeps[begin + j] or keeps[begin + j - i]:
                band[j - i, i] = 1.0 if i == 0 else 0.0
    factorise(band)
    column = np.empty(size)
    for c in range(n):
        for j in range(size):
            column[j] = 0.0 if keeps[begin + j] else right[j, c]
        solve(band, column)
        for j in range(size):
            if not keeps[begin + j]:
                points[begin + j, c] = column[j]
    for k in range(low, high):
        set_bezier(spline, k)


@njit
def _middle_vertex(chain: Chain, knots: Knots, k: int) -> int:
    """Return the vertex inside span k nearest to its middle, or -1. It counts in t."""
    along = chain.along
    low = knots[k]["t"]
    high = knots[k + 1]["t"]
    found = -1
    nearest = 0.5 * (high - low)
    for i in range(knots[k]["vertex"] + 1, knots[k + 1]["vertex"] + 1):
        off = abs(along[i] - 0.5 * (low + high))
        if along[i] > along[i - 1] and off < nearest and low < along[i] < high:
            nearest = off
            found = i
    return found


@njit
def _missed(chain: Chain, spline: Spline, k: int) -> float:
    """Return the largest distance of span k from a vertex that counts, at its parameter, mm."""
    knots = spline.knots
    low = knots[k]["t"]
    h = knots[k + 1]["t"] - low
    worst = 0.0
    b = spline.bezier
    for i in range(knots[k]["vertex"] + int(not knots[k]["on"]), knots[k + 1]["vertex"] + 1):
        t = chain.along[i]
        if (i == 0 or t > chain.along[i - 1]) and low <= t <= low + h:
            x = (t - low) / h
            y = 1.0 - x
            x2, y2 = x * x, y * y
            w0, w1, w2 = y2 * y2 * y, 5.0 * x * y2 * y2, 10.0 * x2 * y2 * y
            w3, w4, w5 = 10.0 * x2 * x * y2, 5.0 * x2 * x2 * y, x2 * x2 * x
            square = 0.0
            for c in range(spline.p.shape[1]):
                off = (w0 * b[k, 0, c] + w1 * b[k, 1, c] + w2 * b[k, 2, c]) + (
                    w3 * b[k, 3, c] + w4 * b[k, 4, c] + w5 * b[k, 5, c] - chain.x[i, c]
                )
                if chain.metrics[c]:
                    square += off * off
                else:
                    worst = max(worst, off * off)
            worst = max(worst, square)
    return math.sqrt(worst)


@njit
def too_wide(chain: Chain, spline: Spline, keeps: Flags, tolerance: float) -> Flags:
    """Return which spans miss a vertex and have one inside, at which they may be cut.

    keeps: (N,): control points that have kept their places. A span that has others is looked at.
    """
    knots = spline.knots
    spans = knots.shape[0] - 1
    wide = np.zeros(spans, np.bool_)
    for k in range(spans):
        looked_at = not knots[k]["straight"] and not knots[k]["polyline"]
        if looked_at and _changes(spline, keeps, k):
            wide[k] = (
                knots[k + 1]["vertex"] - knots[k]["vertex"] > 1
                and _missed(chain, spline, k) > MISSES * tolerance
                and _middle_vertex(chain, knots, k) >= 0
            )
    return wide


@njit
def with_cuts(chain: Chain, knots: Knots, cut: Flags) -> Knots:
    """Return the knots with a new one in each span that is to be cut.

    It is the vertex nearest to the middle, or the middle where there is none.
    """
    count = knots.shape[0]
    for k in range(cut.shape[0]):
        count += int(cut[k])
    finer = np.zeros(count, KNOT)
    to = 0
    for k in range(knots.shape[0]):
        finer[to] = knots[k]
        to += 1
        if k < cut.shape[0] and cut[k]:
            i = _middle_vertex(chain, knots, k)
            if i >= 0:
                finer[to]["t"] = chain.along[i]
                finer[to]["vertex"] = i
                finer[to]["on"] = True
            else:
                finer[to]["t"] = 0.5 * (knots[k]["t"] + knots[k + 1]["t"])
                finer[to]["vertex"] = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
            finer[to]["refused"] = knots[k]["refused"]
            to += 1
    return finer


@njit
def near_spans(spline: Spline, spans: Ints, reach: int) -> Flags:
    """Return the control points of spans and ``reach`` others on either side, if not fixed."""
    size = spline.points.shape[0]
    near = np.zeros(size, np.bool_)
    for k in range(spans.shape[0]):
        first = spline.first[spans[k]]
        for i in range(max(first - reach, 0), min(first + ORDER + reach, size)):
            near[i] = not spline.fixed[i]
    return near


@njit
def cut_spans(
    chain: Chain, spline: Spline, cut: Flags, anew: Flags, states: Floats
) -> tuple[Spline, Flags]:
    """Cut spans.

    Args:
        chain: the chain.
        spline: the spline.
        cut: (K - 1,): the spans that are cut.
        anew: (K - 1,): these, and others that are placed anew.
        states: (2, 5, n): position and derivatives 1 to 4 by t at start and end, or NaN.

    Returns:
        The spline, and the control points near these spans, which are to be placed.
    """
    knots = with_cuts(chain, spline.knots, cut)
    finer = new_spline(chain, knots, states, spline.t, spline.first, spline.extract)
    transfer(spline, finer)
    spans = np.empty(2 * cut.shape[0], np.int64)
    count, to = 0, 0
    for k in range(cut.shape[0]):
        for _ in range(2 if cut[k] else 1):
            if anew[k]:
                spans[count] = to
                count += 1
            to += 1
    return finer, near_spans(finer, spans[:count], NEAR)


@njit
def with_knots(
    chain: Chain, spline: Spline, free: Flags, states: Floats, tolerance: float
) -> Spline:
    """Return a spline whose free control points pass the vertices closely; it has more knots.

    states: see cut_spans.
    """
    while True:
        keeps = ~free
        least_squares(chain, spline, keeps)
        wide = too_wide(chain, spline, keeps, tolerance)
        if not wide.any():
            return spline
        spline, free = cut_spans(chain, spline, wide, wide, states)
