"""The smoothest spline inside the tube about a chain.

A control point moves at right angles to the spline only: one unknown in a plane, two in space. A
movement along it changes the speed of the parameter, not the curve. Axes that do not measure the
length are splines of their own.

The programme makes the integral of w |r'''|^2 least. Where the jerk J limits the speed v to
(J / |r'''|)^(1/3), the time is the integral of 1 / v. Its derivative by |r'''|^2 is proportional to
v^5 / J^(5/3): that is w. The speed is estimated from the spacing of knots on vertices, and from how
soon a motion can gain speed between them. So slow and fast places of a chain count alike.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.path.fit_chain import Chain, Flags, Knots, place_of
from cnc.kernels.path.fit_places import limits, places_in, set_normals, to_unit
from cnc.kernels.path.fit_program import smoothest
from cnc.kernels.path.fit_spline import DEGREE, ORDER, Spline, add_energy, set_bezier

SPEED = 1.2
"""Speed in a span, in units of its spacing divided by the cube root of the tolerance: a deviation
of a tolerance over this spacing has a third derivative of about the tolerance by its cube.
"""
NEWTON_STEPS = 4
STILL = 1e-9
"""mm. An axis that moves less than this stands still."""


@njit
def _spacing(knots: Knots, k: int) -> float:
    """Return the distance of the knots about span k that are vertices or beside a line, mm.

    Knots inside a move do not show how fast the chain bends.
    """
    first = k
    while first > 0 and not (knots[first]["on"] or knots[first - 1]["straight"]):
        first -= 1
    last = k + 1
    while last < knots.shape[0] - 1 and not (knots[last]["on"] or knots[last]["straight"]):
        last += 1
    return float(knots[last]["t"] - knots[first]["t"])


@njit
def _speed(knots: Knots, k: int, usual: float) -> float:
    """Return the speed of span k that its spacing and those of the spans about it allow.

    Speeds are v / J^(1/3) in mm^(2/3), with the jerk J. The speed can rise from u0 to u over the
    distance d = (u + u0) sqrt(u - u0). So a slow span limits the speeds about it.

    Args:
        knots: the knots.
        k: the span.
        usual: speed by the spacing of a span.
    """
    half = 0.5 * (knots[k + 1]["t"] - knots[k]["t"])
    u = usual * _spacing(knots, k)
    for way in (-1, 1):
        before = half
        j = k + way
        while 0 <= j < knots.shape[0] - 1 and not knots[j]["straight"]:
            h = knots[j + 1]["t"] - knots[j]["t"]
            far = before + 0.5 * h
            # No ramp that ends at u is longer than 1.09 u^(3/2).
            if h <= 0.0 or far > 1.09 * u * math.sqrt(u):
                break
            slow = usual * _spacing(knots, j)
            if slow < u and (u + slow) * math.sqrt(u - slow) > far:
                # Newton's method for the root of u - slow, from above.
                root = min(math.sqrt(u - slow), far ** (1.0 / 3.0))
                for _ in range(NEWTON_STEPS):
                    excess = (2.0 * slow + root * root) * root - far
                    root -= excess / (2.0 * slow + 3.0 * root * root)
                u = slow + root * root
            before += h
            j += way
    return u


@njit
def _energy(spline: Spline, low: int, high: int, begin: int, size: int, tolerance: float) -> Floats:
    """Return the energy of the spans from ``low`` to before ``high`` as a band matrix (size, 6).

    begin: the control point that has the first row.
    """
    knots = spline.knots
    band = np.zeros((size, ORDER))
    usual = SPEED / tolerance ** (1.0 / 3.0)
    for k in range(low, high):
        if knots[k]["straight"] or knots[k]["polyline"]:
            continue
        h = knots[k + 1]["t"] - knots[k]["t"]
        weight = (_speed(knots, k, usual) / usual) ** DEGREE
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
    band = _energy(spline, low, high, begin, mask.shape[0], tolerance)
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
