"""The smoothest spline inside the tube about a chain.

A control point moves at right angles to the spline only: one unknown in a plane, two in space. A
movement along it changes the speed of the parameter, not the curve. Axes that do not measure the
length are splines of their own.

The programme makes the integral of w |r'''|^2 least. w is the fifth power of the spacing of knots,
smoothed: so slow and fast places of a chain count alike.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.path.fit_chain import Chain, Flags, place_of
from cnc.kernels.path.fit_places import limits, places_in, set_normals, to_unit
from cnc.kernels.path.fit_program import smoothest
from cnc.kernels.path.fit_spline import DEGREE, ORDER, Spline, add_energy, set_bezier

SMOOTHED = 5
"""Spans on either side whose spacing is averaged."""
STILL = 1e-9
"""mm. An axis that moves less than this stands still."""


@njit
def _energy(spline: Spline, low: int, high: int, begin: int, size: int) -> Floats:
    """Return the energy of the spans from ``low`` to before ``high`` as a band matrix (size, 6).

    begin: the control point that has the first row.
    """
    knots = spline.knots
    band = np.zeros((size, ORDER))
    for k in range(low, high):
        if knots[k]["straight"] or knots[k]["polyline"]:
            continue
        total = 0.0
        count = 0
        for way in (-1, 1):
            j = k
            while abs(j - k) <= SMOOTHED and 0 <= j < knots.shape[0] - 1:
                h = knots[j + 1]["t"] - knots[j]["t"]
                if knots[j]["straight"] or h <= 0.0:
                    break
                total += math.log(h)
                count += 1
                j += way
        h = knots[k + 1]["t"] - knots[k]["t"]
        weight = math.exp(DEGREE * total / count)
        add_energy(spline.extract[k], h, weight, spline.first[k] - begin, band)
    return band


@njit
def _directions(spline: Spline, axes: Ints, measured: bool, free: Flags, begin: int) -> Floats:
    """Return the directions (F, q, n) in which control points may move.

    Args:
        spline: the spline.
        axes: columns of the axes that move together.
        measured: whether they measure the length; otherwise it is one axis on its own.
        free: (F,): control points that may move, from number ``begin`` on.
        begin: see free.
    """
    n = spline.points.shape[1]
    out = np.zeros((free.shape[0], axes.shape[0] - 1 if measured else 1, n))
    tangent = np.zeros(n)
    for i in range(free.shape[0]):
        j = begin + i
        if free[i] and measured:
            for c in axes:
                tangent[c] = spline.points[j + 1, c] - spline.points[j - 1, c]
            if not to_unit(tangent):
                tangent[axes[0]] = 1.0
            set_normals(tangent, tangent, axes, out[i])
        elif free[i]:
            out[i, 0, axes[0]] = 1.0
    return out


@njit
def _programme(
    points: Floats, band: Floats, moves: Floats, axes: Ints, begin: int
) -> tuple[Floats, Floats, float]:
    """Return matrix, slope (in mm) and constant (in mm^2) of the programme.

    Args:
        points: (N, n): control points.
        band: (F, 6): energy of those from ``begin`` on.
        moves: (F, q, n): their directions.
        axes: columns of the axes.
        begin: see band.
    """
    count, free, _ = moves.shape
    matrix = np.zeros((count * free, ORDER * free))
    slope = np.zeros(count * free)
    energy = 0.0
    low = max(begin, 0)
    for j in range(count):
        for i in range(min(j, DEGREE) + 1):
            h = band[j - i, i]
            if h == 0.0:
                continue
            for c in axes:
                # Measured from a control point near by, coordinates keep their digits.
                here = points[begin + j, c] - points[low, c]
                there = points[begin + j - i, c] - points[low, c]
                energy += h * here * there * (0.5 if i == 0 else 1.0)
                for a in range(free):
                    slope[j * free + a] += h * moves[j, a, c] * there
                    if i > 0:
                        slope[(j - i) * free + a] += h * moves[j - i, a, c] * here
                    for b in range(free):
                        if i > 0 or a >= b:
                            matrix[(j - i) * free + b, i * free + a - b] += (
                                h * moves[j, a, c] * moves[j - i, b, c]
                            )
    for row in range(count * free):
        if matrix[row, 0] == 0.0:
            matrix[row, 0] = 1.0
    return matrix, slope, energy


@njit
def _improve_run(
    chain: Chain, spline: Spline, free: Flags, first: int, last: int, tolerance: float
) -> None:
    """Make the spline smoothest with the free control points among first .. last - 1.

    free: (N,).
    """
    low = place_of(spline.first, first - DEGREE)
    high = place_of(spline.first, last)
    points = spline.points
    n = points.shape[1]
    begin = first - DEGREE
    mask = np.zeros(last - first + 2 * DEGREE, np.bool_)
    for j in range(first, last):  # slices of two arrays would compile the text of an error
        mask[j - begin] = free[j]
    band = _energy(spline, low, high, begin, mask.shape[0])
    places = places_in(chain, spline, low, high)
    moving = np.empty(n, np.int64)
    count = 0
    # First the axes that measure the length, together, then each of the others.
    for c in range(n):
        reach = 0.0
        for j in range(max(begin, 0), min(last + DEGREE, points.shape[0])):
            reach = max(reach, abs(points[j, c] - points[max(begin, 0), c]))
        if reach > STILL and chain.metrics[c]:
            moving[count] = c
            count += 1
    for group in range(-1, n):
        measured = group < 0
        if (measured and count < 2) or (not measured and chain.metrics[max(group, 0)]):
            continue
        if not measured:
            moving[0] = group
        axes = moving[:count] if measured else moving[:1]
        moves = _directions(spline, axes, measured, mask, begin)
        matrix, slope, energy = _programme(points, band, moves, axes, begin)
        rows = limits(spline, places, axes, moves, begin, tolerance)
        if rows.g.shape[0] > 0:
            for j in range(slope.shape[0]):
                slope[j] /= tolerance
            e = smoothest(matrix, slope, energy / (tolerance * tolerance), rows)
            width = moves.shape[1]
            for j in range(first, last):
                for a in range(width):
                    for axis in axes:
                        change = e[(j - begin) * width + a] * moves[j - begin, a, axis]
                        points[j, axis] += tolerance * change
    for k in range(low, high):
        set_bezier(spline, k)


@njit
def improve(chain: Chain, spline: Spline, free: Flags, tolerance: float) -> None:
    """Make the spline smoothest inside the tube; Bezier points follow.

    free: (N,): control points that may move. Runs of them between as many that stay as a span has,
    or between ends of parts, are programmes of their own.
    """
    size = free.shape[0]
    j = 0
    k = 0
    while j < size:
        if not free[j]:
            j += 1
            continue
        # Behind the last span of this part another one begins.
        while k < spline.first.shape[0] - 1 and spline.first[k] + DEGREE < j:
            k += 1
        while k < spline.first.shape[0] - 1 and not spline.knots[k + 1]["ends"]:
            k += 1
        until = int(spline.first[k]) + ORDER
        end = j + 1
        i = end
        while i < until and i - end < DEGREE:
            i += 1
            if free[i - 1]:
                end = i
        _improve_run(chain, spline, free, j, end, tolerance)
        j = end
