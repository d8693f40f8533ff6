"""The smoothest spline inside a tube: a convex quadratic programme with a band matrix.

    minimise  e'He / 2 + f'e   where  -l_i <= g_i'e + d_i <= l_i

A primal-dual interior-point method with Mehrotra's predictor and corrector solves it (S. Mehrotra,
On the implementation of a primal-dual interior point method, 1992; J. Nocedal, S. Wright, Numerical
Optimization, algorithm 16.4). Each iteration factorises one band matrix, so it costs a fixed time
for each move. Every limit yields by YIELDS times its multiplier. So the iteration ends near the
best spline also where none is inside the tube, and the proof of the tolerance finds the place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints
from cnc.kernels.path.fit_band import factorise, solve, times

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
        band: (M, w): H; see :mod:`cnc.kernels.path.fit_band`.
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
