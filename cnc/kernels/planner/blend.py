r"""The curve that replaces a corner between two straight moves.

Along it the velocity turns from V u1 to V u2, where u1 and u2 are the directions:

    v(x) = V ((1 - S(x)) u1 + S(x) u2),   x = t / T from 0 to 1,   S' = K,

so that with the corner C, the reach d = V T / 2 and g(x) = 2 (integral of 1 - S from x to 1)

    r(x) = C - d g(x) u1 + d g(1 - x) u2.

Acceleration and jerk are (u2 - u1) V/T K and (u2 - u1) V/T^2 K'. K is symmetrical about 1/2, its
integral is 1, and it is 0 at both ends: there the curvature is 0.

        .                      K >= 0 stays inside the corner. With negative ends the curve swings
    ---._ `.  <- corner        out of the corner first, by up to the tolerance, and may be longer:
         `-.`.                 the turn by as much lets it pass at 1.8 times the speed.
            `.`
              |                distance inside, and outside: 4 d sin(theta/2) E

For K = a z + b z^2 + c z^3 with z = 4 x (1 - x) the least |K'| for a given E is found by a linear
programme. Its solutions between E = 0.087 and 0.02 lie almost on a line, so the curve is a mean of
the two at its ends, with the weight ``swing`` of the second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.bernstein import DEPTH, STRIDE, sign_changes
from cnc.kernels.path.curve import (
    MAX_TURNING_POINTS,
    SPAN_BODY,
    START,
    TABLE,
    U0,
    U1,
    Floats,
)
from cnc.kernels.planner.legs import Turn
from cnc.kernels.planner.limit_arrays import LimitArrays

DEGREE = 8
"""Degree of g."""


def _bernstein(a: float, b: float) -> tuple[float, ...]:
    """Return the Bernstein coefficients of g for K = a z + b z^2 + c z^3, whose integral is 1."""
    c = (1.0 - 2.0 / 3.0 * a - 8.0 / 15.0 * b) * 35.0 / 16.0
    z = np.polynomial.Polynomial([0.0, 4.0, -4.0])
    turned = (a * z + b * z**2 + c * z**3).integ()
    left = (2.0 - 2.0 * turned).integ()
    power = (left(1.0) - left).coef
    return tuple(
        float(sum(math.comb(k, i) / math.comb(DEGREE, i) * power[i] for i in range(k + 1)))
        for k in range(DEGREE + 1)
    )


INSIDE = (1.1, 0.0)
SWINGING = (-4.04, 3.84)
"""a and b without a swing and with the largest."""

G_INSIDE = _bernstein(*INSIDE)
G_SWINGING = _bernstein(*SWINGING)
"""The coefficients of g for both."""

E_INSIDE = 0.08699
E_SWINGING = 0.01998
"""Largest distance from the corner, and from the legs on the outside, as parts of 4 d sin."""

BEND_INSIDE, BEND_SWINGING = 1.684, 3.4
"""Largest K."""

TWIST_INSIDE, TWIST_SWINGING = 4.41, 16.17
"""Largest |K'|."""


class Blend(NamedTuple):
    """A blend.

    Attributes:
        reach: length that it takes off both legs, mm.
        swing: weight of the curve with the largest swing, 0 to 1.
    """

    reach: float
    swing: float


@njit
def largest_reach(eps: float, turn: Turn, swing: float) -> float:
    """Return the reach of the blend of a swing that takes the whole tolerance ``eps``, mm."""
    return 0.25 * eps / (turn.widest * (E_INSIDE + swing * (E_SWINGING - E_INSIDE)))


@njit
def fitted_blend(reach: float, eps: float, turn: Turn) -> Blend:
    """Return the blend of a reach, at most the largest, with the least swing that it needs."""
    e = 0.25 * eps / (turn.widest * reach)
    return Blend(reach, min(1.0, max(0.0, (E_INSIDE - e) / (E_INSIDE - E_SWINGING))))


@njit
def blend_speed(blend: Blend, turn: Turn, u: Floats, limits: LimitArrays) -> float:
    """Return the speed V of a blend at which the limits of each axis and the normal one hold.

    u (2, axes): the directions of the legs.
    """
    length = 2.0 * blend.reach
    bend = BEND_INSIDE + blend.swing * (BEND_SWINGING - BEND_INSIDE)
    twist = TWIST_INSIDE + blend.swing * (TWIST_SWINGING - TWIST_INSIDE)
    axis_a, axis_j = limits.axis_acceleration, limits.axis_jerk
    by_a = (
        2.0
        * turn.sine
        / min(limits.normal_acceleration, 8.0 * limits.chord_error / limits.period**2)
    )
    by_j = 0.0
    for i in range(u.shape[1]):
        change = abs(u[1, i] - u[0, i])
        by_a = max(by_a, change / axis_a[i])
        by_j = max(by_j, change / axis_j[i])
    v = math.sqrt(length / (bend * by_a))
    if by_j > 0.0:
        v = min(v, (length * length / (twist * by_j)) ** (1.0 / 3.0))
    return v


@njit
def write_blend(data: Floats, at: int, like: int, corner: int, u: Floats, blend: Blend) -> int:
    """Write the record of a blend without its arc-length table and turning points.

    Args:
        data: the records.
        at: index of the new record.
        like: index of a record with the same metric axes.
        corner: index in ``data`` of the place of the corner.
        u: (2, axes): the directions of the legs.
        blend: its size and shape.

    Returns:
        The index behind it.
    """
    n = u.shape[1]
    body = at + START + 2 * n
    for k in range(START):
        data[at + k] = data[like + k]
    data[at + U0] = 0.0
    data[at + U1] = 1.0
    data[at + TABLE] = 0.0
    data[body] = DEGREE
    row = body + SPAN_BODY
    for k in range(DEGREE + 1):
        data[row + k] = 1.0
    for i in range(n):
        row += DEGREE + 1
        data[at + START + i] = data[corner + i] - blend.reach * u[0, i]
        data[at + START + n + i] = data[corner + i] + blend.reach * u[1, i]
        for k in range(DEGREE + 1):
            g = G_INSIDE[k] + blend.swing * (G_SWINGING[k] - G_INSIDE[k])
            o = DEGREE - k
            other = G_INSIDE[o] + blend.swing * (G_SWINGING[o] - G_INSIDE[o])
            data[row + k] = blend.reach * ((1.0 - g) * u[0, i] + other * u[1, i])
        data[row] = 0.0
        data[row + DEGREE] = data[at + START + n + i] - data[at + START + i]
    return row + DEGREE + 1


@njit
def write_blend_turns(data: Floats, at: int, to: int) -> int:
    """Write the turning points of a blend's record from index ``to`` on; return that behind."""
    n = int(data[at])
    body = at + START + 2 * n
    extent = data[at + U1] - data[at + U0]
    data[body + 1] = to - at
    f, scratch = np.empty(STRIDE), np.empty(STRIDE)
    stack, roots = np.empty((DEPTH + 4) * STRIDE), np.empty(MAX_TURNING_POINTS)
    after = to + n
    for i in range(n):
        row = body + SPAN_BODY + (i + 1) * (DEGREE + 1)
        largest = 0.0
        for k in range(DEGREE):
            f[k] = data[row + k + 1] - data[row + k]
            largest = max(largest, abs(f[k]))
        count = 0
        if largest > 1e-15 * max(abs(data[at + START + i]), abs(data[at + START + n + i])):
            for k in range(DEGREE):
                if abs(f[k]) <= 1e-15 * largest:
                    f[k] = 0.0
            for k in range(sign_changes(f, DEGREE - 1, stack, scratch, roots)):
                if 1e-12 < roots[k] < 1.0 - 1e-12:
                    data[after] = data[at + U0] + roots[k] * extent
                    after += 1
                    count += 1
        data[to + i] = count
    return after
