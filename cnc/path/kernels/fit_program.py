"""The smoothest spline inside a tube: a convex quadratic programme with a band matrix.

    minimise  e'He / 2 + f'e   where  -l_i <= g_i'e + d_i <= l_i

A primal-dual interior-point method with Mehrotra's predictor and corrector solves it (S. Mehrotra,
On the implementation of a primal-dual interior point method, 1992; J. Nocedal, S. Wright, Numerical
Optimization, algorithm 16.4). Each iteration factorises one band matrix, so it costs a fixed time
for each move. Every limit yields by YIELDS times its multiplier. So the iteration ends near the
best spline also where none is inside the tube, and the proof of the tolerance finds the place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.path.kernels.fit_spline import (
    DEGREE,
    ORDER,
    Chain,
    Flags,
    Knots,
    Spline,
    add_energy,
    bernstein,
    place_of,
    set_bezier,
)

# Systems of equations with a positive definite band matrix.
#
# The upper triangle is kept: row i of a matrix (N, w) holds the entries (i, i + j) at [i, j]. Inner
# loops run along rows, so a processor does several entries at a time.

LEAST_PIVOT = 1e-14
"""Part of a diagonal entry below which its pivot is rounding."""


@njit
def factorise(band: Floats) -> None:
    """Replace a matrix by its Cholesky factor U, with U'U the matrix.

    Pivots that are rounding become LEAST_PIVOT.
    """
    size, width = band.shape
    least = np.empty(size)
    for i in range(size):
        least[i] = LEAST_PIVOT * abs(band[i, 0]) + 1e-300
    for i in range(size):
        pivot = math.sqrt(max(band[i, 0], least[i]))
        inverse = 1.0 / pivot
        band[i, 0] = pivot
        reach = min(width, size - i)
        for j in range(1, reach):
            band[i, j] *= inverse
        for j in range(1, reach):
            factor = band[i, j]
            for k in range(width - j):
                band[i + j, k] -= factor * band[i, j + k]


@njit
def solve(factor: Floats, b: Floats) -> None:
    """Solve a system with its Cholesky factor, in place of the right side b (N,)."""
    forward(factor, b)
    backward(factor, b)


@njit
def forward(factor: Floats, b: Floats) -> None:
    """Solve U'y = b with a Cholesky factor U, in place of b (N,)."""
    size, width = factor.shape
    for i in range(size):
        value = b[i] / factor[i, 0]
        b[i] = value
        for j in range(1, min(width, size - i)):
            b[i + j] -= factor[i, j] * value


@njit
def backward(factor: Floats, b: Floats) -> None:
    """Solve U x = b with a Cholesky factor U, in place of b (N,)."""
    size, width = factor.shape
    for i in range(size - 1, -1, -1):
        # Three sums, so that an addition need not wait for the one before.
        reach = min(width, size - i)
        total, second, third = b[i], 0.0, 0.0
        j = 1
        while j + 2 < reach:
            total -= factor[i, j] * b[i + j]
            second += factor[i, j + 1] * b[i + j + 1]
            third += factor[i, j + 2] * b[i + j + 2]
            j += 3
        while j < reach:
            total -= factor[i, j] * b[i + j]
            j += 1
        b[i] = (total - (second + third)) / factor[i, 0]


@njit
def times(band: Floats, e: Floats, out: Floats) -> None:
    """Write the product of a symmetric matrix and e (N,) into out (N,)."""
    size, width = band.shape
    for i in range(size):
        out[i] = 0.0
    for i in range(size):
        total = band[i, 0] * e[i]
        for j in range(1, min(width, size - i)):
            total += band[i, j] * e[i + j]
            out[i + j] += band[i, j] * e[i]
        out[i] += total


ITERATIONS = 30
YIELDS = 1e-3
"""See above; divided by the first multiplier."""
GAP = 3e-3
"""The iteration ends when the duality gap is this part of the energy."""
MISSED = 2e-3
"""Limits may be missed by this, in tolerances, when it ends."""
SHORTENED = 0.95
"""Part of the longest step that is taken."""


class Rows(NamedTuple):
    """Limits of the programme; lengths in tolerances.

    Attributes:
        g: (R, w): coefficients of the unknowns ``first`` to ``first + w - 1``.
        first: (R,): see g.
        offset: (R,): d_i.
        limit: (R,): l_i.
    """

    g: Floats
    first: Ints
    offset: Floats
    limit: Floats


class Sides(NamedTuple):
    """State of the iteration for both sides of each limit, upper first.

    Attributes:
        s: (2, R): slacks.
        z: (2, R): multipliers.
        r: (2, R): residuals of the limits.
        ds: (2, R): step of s.
        dz: (2, R): step of z.
        part: (2, R): weight of each side in the matrix, z / (s + YIELDS z).
        of_z: (2, R): 1 / z.
        y: (R,): g'e.
        dy: (R,): its step.
    """

    s: Floats
    z: Floats
    r: Floats
    ds: Floats
    dz: Floats
    part: Floats
    of_z: Floats
    y: Floats
    dy: Floats


@njit
def _with_weights(band: Floats, rows: Rows, sides: Sides, yields: float, out: Floats) -> None:
    """Write band + G'WG into ``out``, factorised; W are the weights of the limits."""
    size, width = band.shape
    for i in range(size):
        for j in range(width):
            out[i, j] = band[i, j]
    for i in range(rows.g.shape[0]):
        weight = 0.0
        for k in range(2):
            s, z = sides.s[k, i], sides.z[k, i]
            # One division for both: divisions take most of the time.
            inverse = 1.0 / (z * (s + yields * z))
            sides.part[k, i] = z * z * inverse
            sides.of_z[k, i] = (s + yields * z) * inverse
            weight += sides.part[k, i]
        first = rows.first[i]
        for a in range(width):
            scaled = weight * rows.g[i, a]
            for b in range(width - a):
                out[first + a, b] += scaled * rows.g[i, a + b]
    factorise(out)


@njit
def _step(factor: Floats, rows: Rows, sides: Sides, wanted: float, residual: Floats) -> Floats:
    """Return the step of the unknowns (M,), and write those of slacks and multipliers.

    Args:
        factor: of the matrix, see _with_weights.
        rows: the limits.
        sides: state; ds and dz hold the last step, whose product corrects this one. They are zeros
            for the predictor.
        wanted: product of slack and multiplier that is aimed at.
        residual: (M,): He + f + G'(z+ - z-).
    """
    size = residual.shape[0]
    step = np.empty(size)
    for i in range(size):
        step[i] = -residual[i]
    width = rows.g.shape[1]
    for i in range(rows.g.shape[0]):
        push = 0.0
        for k in range(2):
            # The product's residual, divided by z, is kept in ds until the step is known.
            missing = sides.ds[k, i] * sides.dz[k, i] - wanted
            missing = sides.s[k, i] + missing * sides.of_z[k, i]
            sides.ds[k, i] = missing
            part = sides.part[k, i] * (sides.r[k, i] - missing)
            push += part if k == 0 else -part
        first = rows.first[i]
        for a in range(width):
            step[first + a] -= push * rows.g[i, a]
    solve(factor, step)
    for i in range(rows.g.shape[0]):
        first = rows.first[i]
        # The width is a multiple of ORDER. With three sums an addition seldom waits for another.
        dy, second, third = 0.0, 0.0, 0.0
        for a in range(0, width, 3):
            dy += rows.g[i, a] * step[first + a]
            second += rows.g[i, a + 1] * step[first + a + 1]
            third += rows.g[i, a + 2] * step[first + a + 2]
        dy += second + third
        sides.dy[i] = dy
        for k in range(2):
            missing = sides.ds[k, i]
            change = dy if k == 0 else -dy
            dz = sides.part[k, i] * (change + sides.r[k, i] - missing)
            sides.dz[k, i] = dz
            sides.ds[k, i] = -missing - sides.s[k, i] * sides.of_z[k, i] * dz
    return step


@njit
def _longest(sides: Sides) -> float:
    """Return the longest step, at most 1, that leaves slacks and multipliers positive."""
    longest = 1.0
    for k in range(2):
        for i in range(sides.s.shape[1]):
            if sides.s[k, i] + longest * sides.ds[k, i] < 0.0:
                longest = -sides.s[k, i] / sides.ds[k, i]
            if sides.z[k, i] + longest * sides.dz[k, i] < 0.0:
                longest = -sides.z[k, i] / sides.dz[k, i]
    return longest


@njit
def smoothest(band: Floats, slope: Floats, energy: float, rows: Rows) -> Floats:
    """Return the unknowns e (M,) of the programme, in tolerances.

    Args:
        band: (M, w): H; see :mod:`cnc.path.kernels.fit_program`.
        slope: (M,): f.
        energy: value of the programme's function for e = 0 that counts as its size.
        rows: the limits.
    """
    size = slope.shape[0]
    count = rows.g.shape[0]
    width = band.shape[1]
    e = np.zeros(size)
    sides = Sides(
        np.empty((2, count)),
        np.empty((2, count)),
        np.empty((2, count)),
        np.empty((2, count)),
        np.empty((2, count)),
        np.empty((2, count)),
        np.empty((2, count)),
        np.zeros(count),
        np.empty(count),
    )
    first_z = max(energy / count, 1e-3)
    yields = YIELDS / first_z
    for i in range(count):
        for k in range(2):
            room = rows.limit[i] - (rows.offset[i] if k == 0 else -rows.offset[i])
            sides.s[k, i] = max(room, 0.2 * rows.limit[i])
            sides.z[k, i] = first_z
    matrix = np.empty((size, width))
    residual = np.empty(size)
    for _ in range(ITERATIONS):
        times(band, e, residual)
        now = energy
        for i in range(size):
            now += e[i] * (0.5 * residual[i] + slope[i])
            residual[i] += slope[i]
        product = 0.0
        missed = 0.0
        for i in range(count):
            first = rows.first[i]
            pull = sides.z[0, i] - sides.z[1, i]
            for a in range(width):
                residual[first + a] += pull * rows.g[i, a]
            for k in range(2):
                value = rows.offset[i] + sides.y[i]
                value = (value if k == 0 else -value) - rows.limit[i]
                sides.r[k, i] = value - yields * sides.z[k, i] + sides.s[k, i]
                missed = max(missed, abs(sides.r[k, i]))
                product += sides.s[k, i] * sides.z[k, i]
                sides.ds[k, i] = 0.0
                sides.dz[k, i] = 0.0
        if missed <= MISSED and product <= GAP * max(now, 1e-3 * energy):
            break
        mean = product / (2 * count)
        _with_weights(band, rows, sides, yields, matrix)
        _step(matrix, rows, sides, 0.0, residual)
        length = _longest(sides)
        after = 0.0
        for i in range(count):
            for k in range(2):
                after += (sides.s[k, i] + length * sides.ds[k, i]) * (
                    sides.z[k, i] + length * sides.dz[k, i]
                )
        part = after / product
        step = _step(matrix, rows, sides, part * part * part * mean, residual)
        length = min(1.0, SHORTENED * _longest(sides))
        for i in range(size):
            e[i] += length * step[i]
        for i in range(count):
            sides.y[i] += length * sides.dy[i]
            for k in range(2):
                sides.s[k, i] += length * sides.ds[k, i]
                sides.z[k, i] += length * sides.dz[k, i]
    return e


# Limits of the distance between a spline and its chain, in places along each span.
#
# The distance is limited at right angles to the move. In space a long rectangle lies in the circle
# of the tolerance, with the long side in the direction in which the curve bends. Axes that do not
# measure the length are limited each on its own.

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


# The smoothest spline inside the tube about a chain.
#
# A control point moves at right angles to the spline only: one unknown in a plane, two in space. A
# movement along it changes the speed of the parameter, not the curve. Axes that do not measure the
# length are splines of their own.
#
# The programme makes the integral of w |r'''|^2 least. Where the jerk J limits the speed v to (J /
# |r'''|)^(1/3), the time is the integral of 1 / v. Its derivative by |r'''|^2 is proportional to
# v^5 / J^(5/3): that is w. The speed is estimated from the spacing of knots on vertices, and from
# how soon a motion can gain speed between them. So slow and fast places of a chain count alike.

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
