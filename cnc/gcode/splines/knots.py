"""Knots and lengths of the splines that a program writes.

Source: Piegl and Tiller, "The NURBS Book", 2nd edition: clamped knots (2.1), de Boor's algorithm
(A3.1, A4.1), derivatives of a rational curve (4.8).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NODES, _SHARES = np.polynomial.legendre.leggauss(12)
_TOLERANCE = 1e-11
"""Part of the control polygon that a piece of a length may be off."""
_HALVINGS = 40


def clamped(intervals: Sequence[float], degree: int) -> Floats:
    """Knots from 0 on: an interval each piece of the curve, (pieces,); both ends stand degree + 1
    times. (pieces + 2 degree + 1,)
    """
    steps = np.cumsum([0.0, *intervals])
    return np.concatenate([np.zeros(degree), steps, np.full(degree, steps[-1])])


def clamped_uniform(points: int, degree: int) -> Floats:
    """Knots of a curve of so many control points whose pieces are all one long. (points + degree +
    1,)
    """
    return clamped([1.0] * (points - degree), degree)


def bezier_knots(degree: int) -> Floats:
    """Knots of a single piece from 0 to 1, (2 degree + 2,)."""
    return clamped([1.0], degree)


def length(knots: Floats, control_points: Floats, weights: Floats) -> float:
    """Length of a NURBS in mm, to 1e-10 of the length of its control polygon or better, cusps
    included.

    knots (points + degree + 1,), control_points (points, axes) in mm, weights (points,) > 0. Each
    piece is measured by Gauss's rule, and again in halves, until both agree.
    """
    degree = len(knots) - len(control_points) - 1
    form = np.column_stack([control_points * weights[:, None], weights])
    polygon = float(np.linalg.norm(np.diff(control_points, axis=0), axis=1).sum())
    total = 0.0
    for span in range(degree, len(control_points)):
        if knots[span] < knots[span + 1]:
            total += _piece(knots, form, degree, span, _TOLERANCE * polygon)
    return total


def _piece(knots: Floats, form: Floats, degree: int, span: int, tolerance: float) -> float:
    """Length of one piece."""

    def measured(a: float, b: float) -> float:
        half = (b - a) / 2
        return half * float(_SHARES @ _speed(knots, form, degree, span, a + half + half * _NODES))

    total = 0.0
    a, b = float(knots[span]), float(knots[span + 1])
    stack = [(a, b, measured(a, b), _HALVINGS)]
    while stack:
        a, b, whole, left = stack.pop()
        middle = (a + b) / 2
        first, second = measured(a, middle), measured(middle, b)
        if abs(first + second - whole) <= tolerance or not left:
            total += first + second
        else:
            stack += [(a, middle, first, left - 1), (middle, b, second, left - 1)]
    return total


def _speed(knots: Floats, form: Floats, degree: int, span: int, u: Floats) -> Floats:
    """|dr/du| at the parameters u (n,) of one piece; form (points, axes + 1) are the weighted
    control points and the weights.
    """
    d = [np.broadcast_to(row, (len(u), form.shape[1])) for row in form[span - degree : span + 1]]
    slope = np.zeros((len(u), form.shape[1]))
    for level in range(1, degree + 1):
        if level == degree:
            slope = degree * (d[1] - d[0]) / (knots[span + 1] - knots[span])
        following = []
        for at in range(degree - level + 1):
            low, high = knots[span - degree + level + at], knots[span + 1 + at]
            share = ((u - low) / (high - low))[:, None]
            following.append((1 - share) * d[at] + share * d[at + 1])
        d = following
    value = d[0]
    point = value[:, :-1] / value[:, -1:]
    speeds: Floats = np.linalg.norm((slope[:, :-1] - slope[:, -1:] * point) / value[:, -1:], axis=1)
    return speeds
