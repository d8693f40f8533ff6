"""Limits of the distance between a spline and its chain, in places along each span.

The distance is limited at right angles to the move. In space a long rectangle lies in the circle of
the tolerance, with the long side in the direction in which the curve bends. Axes that do not
measure the length are limited each on its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.path.fit_chain import Chain
from cnc.kernels.path.fit_program import Rows
from cnc.kernels.path.fit_spline import ORDER, Spline, bernstein

USED = 0.93
"""Part of the tolerance that the spline may take in places; between them it takes a little more."""
ACROSS = 0.3
"""In space: the same at right angles to the bend."""
PLACES = 3
"""Least number of places in a span."""
MANY = 8
"""In a span of more moves the distance is limited at this many of them, or up to twice as many: at
the vertex, where the curve is inside, and in the middle, where it is outside.
"""
REFUSED = 2
"""Factor of the numbers of places in a span that the proof has refused: between them the spline
left the tolerance.
"""


class Places(NamedTuple):
    """Places along spans where the distance is limited.

    Attributes:
        span: (S,): the span.
        x: (S,): the place in it, from 0 to 1.
        ref: (S, n): the point of the polyline, mm.
        tangent: (S, n): direction of the polyline over the metric axes.
    """

    span: Ints
    x: Floats
    ref: Floats
    tangent: Floats


@njit
def to_unit(a: Floats) -> bool:
    """Scale a vector (n,) to length 1; return whether it has a direction."""
    square = 0.0
    for c in range(a.shape[0]):
        square += a[c] * a[c]
    if square > 0.0:
        size = math.sqrt(square)
        for c in range(a.shape[0]):
            a[c] /= size
    return square > 0.0


@njit
def places_in(chain: Chain, spline: Spline, first: int, last: int) -> Places:
    """Return the places in the spans from ``first`` to before ``last``; none where straight."""
    x, along, _, metrics = chain
    knots = spline.knots
    n = x.shape[1]
    most = 0
    for k in range(first, last):
        moves = knots[k + 1]["vertex"] - knots[k]["vertex"] + 1
        most += REFUSED * (2 * min(moves, 2 * MANY) + PLACES + 1)
    span = np.empty(most, np.int64)
    at = np.empty(most)
    ref = np.empty((most, n))
    tangent = np.empty((most, n))
    count = 0
    a = np.empty(n)
    b = np.empty(n)
    way = np.zeros(n)
    before = np.zeros(n)
    for k in range(first, last):
        if knots[k]["straight"] or knots[k]["polyline"]:
            for c in range(n):
                before[c] = 0.0
            continue
        low = knots[k]["t"]
        h = knots[k + 1]["t"] - low
        inner = knots[k]["vertex"] + 1
        behind = knots[k + 1]["vertex"] - int(knots[k + 1]["on"])
        moves = behind - inner + 2
        times = REFUSED if knots[k]["refused"] else 1
        stride = max(moves // (times * MANY), 1)
        split = max((times * PLACES + moves - 1) // moves, 2)
        for c in range(n):
            a[c] = spline.p[k, c]
        ta = low
        i = inner - 1
        while i <= behind:
            start = i
            i = min(i + stride, behind + 1)
            whole = i > behind
            tb = low + h if whole else along[i]
            for c in range(n):
                b[c] = spline.p[k + 1, c] if whole else x[i, c]
            if tb > ta:
                for c in range(n):
                    way[c] = b[c] - a[c] if metrics[c] else 0.0
                to_unit(way)
            near = start + 1
            for j in range(split):
                share = j / split
                t = ta + share * (tb - ta)
                for c in range(n):
                    ref[count, c] = a[c] + share * (b[c] - a[c])
                    tangent[count, c] = way[c] + (before[c] if j == 0 else 0.0)
                if j > 0 and near < i:
                    # Of several moves the first one is limited in its middle.
                    t = 0.5 * (ta + along[near])
                    for c in range(n):
                        ref[count, c] = 0.5 * (a[c] + x[near, c])
                        tangent[count, c] = x[near, c] - a[c] if metrics[c] else 0.0
                span[count] = k
                at[count] = (t - low) / h
                if to_unit(tangent[count]):
                    count += 1
            for c in range(n):
                before[c] = way[c]
                a[c] = b[c]
            ta = tb
    return Places(span[:count], at[:count], ref[:count], tangent[:count])


@njit
def set_normals(tangent: Floats, bend: Floats, axes: Ints, out: Floats) -> None:
    """Write the unit vectors at right angles to a tangent, over two or three axes, to ``out``.

    Args:
        tangent: (n,): unit vector.
        bend: (n,): in space the first normal is in this direction, as far as it has one.
        axes: columns of the axes.
        out: (axes - 1, n): takes the vectors.
    """
    for a in range(out.shape[0]):
        for c in range(out.shape[1]):
            out[a, c] = 0.0
    if axes.shape[0] == 2:
        out[0, axes[0]] = -tangent[axes[1]]
        out[0, axes[1]] = tangent[axes[0]]
    else:
        dot = square = 0.0
        least = axes[0]
        for c in axes:
            dot += tangent[c] * bend[c]
            square += bend[c] * bend[c]
            if abs(tangent[c]) < abs(tangent[least]):
                least = c
        left = 0.0
        for c in axes:
            out[0, c] = bend[c] - dot * tangent[c]
            left += out[0, c] * out[0, c]
        if left <= 1e-12 * square or left == 0.0:
            for c in axes:
                out[0, c] = (1.0 if c == least else 0.0) - tangent[least] * tangent[c]
        to_unit(out[0])
        i, j, k = axes[0], axes[1], axes[2]
        out[1, i] = tangent[j] * out[0, k] - tangent[k] * out[0, j]
        out[1, j] = tangent[k] * out[0, i] - tangent[i] * out[0, k]
        out[1, k] = tangent[i] * out[0, j] - tangent[j] * out[0, i]


@njit
def limits(
    spline: Spline, places: Places, axes: Ints, moves: Floats, first: int, tolerance: float
) -> Rows:
    """Return the limits of the programme at the places.

    Args:
        spline: the spline.
        places: where it is limited.
        axes: columns of the axes that are limited together.
        moves: (.., q, n): directions of the control points from ``first`` on.
        first: see moves.
        tolerance: mm.
    """
    free = moves.shape[1]
    n = spline.points.shape[1]
    size = places.x.shape[0]
    g = np.zeros((size * free, ORDER * free))
    index = np.empty(size * free, np.int64)
    offset = np.empty(size * free)
    limit = np.empty(size * free)
    weights = np.empty(ORDER)
    phi = np.empty(ORDER)
    off = np.empty(n)
    bend = np.empty(n)
    normals = np.zeros((free, n))
    if axes.shape[0] == 1:
        normals[0, axes[0]] = 1.0
    for m in range(size):
        k = places.span[m]
        bernstein(places.x[m], weights)
        for i in range(ORDER):
            phi[i] = 0.0
            for j in range(ORDER):
                phi[i] += weights[j] * spline.extract[k, j, i]
        for c in axes:
            off[c] = -places.ref[m, c]
            for i in range(ORDER):
                off[c] += phi[i] * spline.points[spline.first[k] + i, c]
        if axes.shape[0] > 1:
            for c in axes:
                bend[c] = 0.0
            if axes.shape[0] == 3:
                _second(spline, k, weights, axes, bend)
            set_normals(places.tangent[m], bend, axes, normals)
        for a in range(free):
            row = m * free + a
            index[row] = (spline.first[k] - first) * free
            offset[row] = 0.0
            limit[row] = USED
            for c in axes:
                offset[row] += off[c] * normals[a, c] / tolerance
            if free == 2:
                limit[row] = math.sqrt(USED * USED - ACROSS * ACROSS) if a == 0 else ACROSS
            for i in range(ORDER):
                for b in range(free):
                    dot = 0.0
                    for c in axes:
                        dot += moves[spline.first[k] + i - first, b, c] * normals[a, c]
                    g[row, i * free + b] = phi[i] * dot
    return Rows(g, index, offset, limit)


@njit
def _second(spline: Spline, k: int, weights: Floats, axes: Ints, out: Floats) -> None:
    """Write about the second derivative of span k into out (n,).

    weights: (6,): Bernstein polynomials at the place.
    """
    # Differences of the Bezier points near the place: the direction alone counts.
    for j in range(4):
        near = weights[j] + weights[j + 1] + weights[j + 2]
        for i in range(ORDER):
            factor = near * (
                spline.extract[k, j, i]
                - 2.0 * spline.extract[k, j + 1, i]
                + spline.extract[k, j + 2, i]
            )
            for c in axes:
                out[c] += factor * spline.points[spline.first[k] + i, c]
