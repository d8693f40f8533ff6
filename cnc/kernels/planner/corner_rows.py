r"""The limits of a motion round a corner, as rows of one inequality each.

The motion is a uniform cubic B-spline in time, so each axis has a constant jerk in each of its
STEPS steps of duration h. Its control points c are in the plane of the two legs, with the corner at
the origin. Step k has the control points k .. k + 3.

        v1, a1                    e2
     o-----o----o----o            |
                       `o         |____ u1
        before the      |  behind the corner
        corner          o
                        o  v2, a2

A row bounds a value x of up to four control points in a row, |x| <= b h^p:

- a difference of order p = 1, 2, 3 in an axis: velocity, acceleration, jerk. Velocity is a convex
  combination of first differences, acceleration of second ones, so the rows hold everywhere.
- the length of a difference: the feed, and the acceleration where it is limited along the path;
- the distance of a Bezier point from its leg, and of the point between the legs from the corner:
  the tolerance, with p = 0. The points within a distance of a leg form a convex set, so the whole
  spline lies within the tolerance. It crosses the plane at right angles to a leg through each of
  its points up to the one nearest to the point between the legs, and the rest of the leg is no
  farther from that than the corner. So no point of the legs lies farther from the spline.
- a control point, where the travel of an axis ends close to the corner: x <= b alone, with p = 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints

STEPS = 16
"""Steps of the motion round a corner."""

POINTS = STEPS + 3
"""Control points. The first three and the last three follow from the motion beside."""

FIXED = 3

LINEAR, TRAVEL, LENGTH, LEG1, LEG2 = range(5)
"""Kinds of rows."""

NONE = (0.0, 0.0, 0.0, 0.0)

ROOM = 4.0
"""An axis counts as close to the end of its travel within so many tolerances."""


class Rows(NamedTuple):
    """The rows of a corner.

    Attributes:
        number: (1,): of rows.
        kind: (m,): LINEAR ... LEG2.
        first: (m,): index of the first control point.
        stencil: (m, 4): weights of the control points.
        offset: (m,): constant part of x, of TRAVEL rows.
        bound: (m,): b, in mm and s.
        power: (m,): p.
        scale: (m,): 1 / (b h^p).
        value: (m,): x.
        gradient: (m, 8): of x, by the two coordinates of four control points.
        bend: (m,): curvature of x across its gradient; 0 for LINEAR and TRAVEL rows.
    """

    number: Ints
    kind: Ints
    first: Ints
    stencil: Floats
    offset: Floats
    bound: Floats
    power: Ints
    scale: Floats
    value: Floats
    gradient: Floats
    bend: Floats


class CornerLimits(NamedTuple):
    """Limits in the plane of a corner; infinite where there are none.

    Attributes:
        axes: (n, 2): components of the plane's two directions in each axis.
        velocity: (n,): mm/s.
        acceleration: (n,): mm/s^2.
        jerk: (n,): mm/s^3.
        travel: (2, n): lowest and highest position, from the corner, mm.
        feed: of the two legs, mm/s.
        pull: largest length of the acceleration, mm/s^2.
        tolerance: mm.
        turn: (2,): cosine and sine of the turn: the direction of the second leg.
    """

    axes: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    travel: Floats
    feed: tuple[float, float]
    pull: float
    tolerance: float
    turn: tuple[float, float]


@njit
def rows_size(axes: int) -> int:
    """Return the largest number of rows."""
    return STEPS * (3 * axes + 5) + 1 + 2 * axes * POINTS


@njit
def new_rows(size: int) -> Rows:
    """Return space for so many rows."""
    return Rows(
        np.zeros(1, np.int64),
        np.zeros(size, np.int64),
        np.zeros(size, np.int64),
        np.zeros((size, 4)),
        np.zeros(size),
        np.zeros(size),
        np.zeros(size, np.int64),
        np.zeros(size),
        np.zeros(size),
        np.zeros((size, 8)),
        np.zeros(size),
    )


@njit
def _add(
    rows: Rows,
    kind: int,
    first: int,
    stencil: tuple[float, float, float, float],
    bound: float,
    power: int,
) -> int:
    """Append a row, and return its index."""
    m = rows.number[0]
    rows.number[0] += 1
    rows.kind[m] = kind
    rows.first[m] = first
    for j in range(4):
        rows.stencil[m, j] = stencil[j]
    rows.offset[m] = 0.0
    rows.bound[m] = bound
    rows.power[m] = power
    rows.bend[m] = 0.0
    return m


@njit
def _add_axis(
    rows: Rows,
    first: int,
    stencil: tuple[float, float, float, float],
    axis: Floats,
    bound: float,
    power: int,
) -> None:
    """Append the row of a difference in an axis with the components ``axis`` (2,)."""
    if bound == math.inf or (axis[0] == 0.0 and axis[1] == 0.0):
        return
    m = _add(rows, LINEAR, first, stencil, bound, power)
    for j in range(4):
        rows.gradient[m, 2 * j] = stencil[j] * axis[0]
        rows.gradient[m, 2 * j + 1] = stencil[j] * axis[1]


@njit
def write_rows(limits: CornerLimits, corner: int, rows: Rows) -> None:
    """Write the rows of a corner that the motion passes at the start of step ``corner``."""
    rows.number[0] = 0
    for k in range(STEPS):
        # A difference counts for the two steps before, too.
        feed = limits.feed[1]
        if k < corner:
            feed = limits.feed[0]
        elif k < corner + 2:
            feed = min(limits.feed[0], limits.feed[1])
        for i in range(len(limits.jerk)):
            axis = limits.axes[i]
            _add_axis(rows, k, (-1.0, 3.0, -3.0, 1.0), axis, limits.jerk[i], 3)
            if k > 0:
                _add_axis(rows, k, (1.0, -2.0, 1.0, 0.0), axis, limits.acceleration[i], 2)
            if k > 1 and limits.velocity[i] < feed * math.hypot(axis[0], axis[1]):
                _add_axis(rows, k, (-1.0, 1.0, 0.0, 0.0), axis, limits.velocity[i], 1)
        if k > 1 and feed < math.inf:
            _add(rows, LENGTH, k, (-1.0, 1.0, 0.0, 0.0), feed, 1)
        if k > 0 and limits.pull < math.inf:
            _add(rows, LENGTH, k, (1.0, -2.0, 1.0, 0.0), limits.pull, 2)
        leg = LEG1 if k < corner else LEG2
        eps = limits.tolerance
        _add(rows, leg, k, (0.0, 2.0 / 3.0, 1.0 / 3.0, 0.0), eps, 0)
        _add(rows, leg, k, (0.0, 1.0 / 3.0, 2.0 / 3.0, 0.0), eps, 0)
        if k > 0:
            _add(rows, leg, k, (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0, 0.0), eps, 0)
        if k == corner:
            _add(rows, LENGTH, k, (1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0, 0.0), eps, 0)
    _add_travel(rows, limits)


@njit
def _add_travel(rows: Rows, limits: CornerLimits) -> None:
    """Append the rows of the free control points where the travel ends close to the corner."""
    eps = limits.tolerance
    for i in range(len(limits.jerk)):
        axis = limits.axes[i]
        wide = math.hypot(axis[0], axis[1])
        for side in range(2):
            room = limits.travel[1, i] if side else -limits.travel[0, i]
            if wide == 0.0 or not room < ROOM * eps * wide:
                continue
            sign = 1.0 if side else -1.0
            for k in range(FIXED, POINTS - FIXED):
                first = min(k, POINTS - 4)
                m = _add(rows, TRAVEL, first, NONE, eps + max(room, 0.0), 0)
                rows.offset[m] = eps
                for j in range(8):
                    rows.gradient[m, j] = 0.0
                rows.gradient[m, 2 * (k - first)] = sign * axis[0]
                rows.gradient[m, 2 * (k - first) + 1] = sign * axis[1]


@njit
def set_step(rows: Rows, h: float) -> None:
    """Set the duration h of a step, s."""
    powers = (1.0, h, h * h, h * h * h)
    for m in range(rows.number[0]):
        rows.scale[m] = 1.0 / (rows.bound[m] * powers[rows.power[m]])


@njit
def evaluate(rows: Rows, limits: CornerLimits, c: Floats) -> None:
    """Write values, gradients and bends of the rows for control points ``c`` (POINTS, 2)."""
    for m in range(rows.number[0]):
        kind, k = rows.kind[m], rows.first[m]
        if kind <= TRAVEL:
            value = rows.offset[m]
            for j in range(4):
                value += rows.gradient[m, 2 * j] * c[k + j, 0]
                value += rows.gradient[m, 2 * j + 1] * c[k + j, 1]
            rows.value[m] = value
            continue
        x = 0.0
        y = 0.0
        for j in range(4):
            x += rows.stencil[m, j] * c[k + j, 0]
            y += rows.stencil[m, j] * c[k + j, 1]
        beside = False
        if kind != LENGTH:
            x, y, beside = _off_leg(x, y, kind == LEG1, limits)
        length = math.sqrt(x * x + y * y)
        rows.value[m] = length
        scale = 1.0 / length if length > 1e-30 else 0.0
        # Along a leg its distance does not change.
        rows.bend[m] = 0.0 if beside else scale
        if kind != LENGTH and scale == 0.0:
            scale = 1.0
        for j in range(4):
            rows.gradient[m, 2 * j] = rows.stencil[m, j] * x * scale
            rows.gradient[m, 2 * j + 1] = rows.stencil[m, j] * y * scale


@njit
def _off_leg(x: float, y: float, first: bool, limits: CornerLimits) -> tuple[float, float, bool]:
    """Return the vector from the nearest point of a leg to a point, and whether it is beside it.

    The leg ends at the corner.
    """
    along_x, along_y = 1.0, 0.0
    if not first:
        along_x, along_y = limits.turn
    on = x * along_x + y * along_y
    inside = min(on, 0.0) if first else max(on, 0.0)
    return x - inside * along_x, y - inside * along_y, on * inside > 0.0
