"""Knots and lengths of the splines of a program.

Source: Piegl and Tiller, "The NURBS Book", 2nd edition: clamped knots (2.1), de Boor's algorithm
(A3.1, A4.1), derivatives of a rational curve (4.8).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_TOLERANCE = 1e-11
"""Error of the length of a piece, as a part of the control polygon."""
_HALVINGS = 40


def clamped(intervals: Sequence[float], degree: int) -> Floats:
    """Return clamped knots from 0, (pieces + 2 degree + 1,).

    Args:
        intervals: (pieces,) parameter interval of each piece.
        degree: Degree; both ends have multiplicity degree + 1.
    """
    steps = np.cumsum([0.0, *intervals])
    return np.concatenate([np.zeros(degree), steps, np.full(degree, steps[-1])])


def clamped_uniform(points: int, degree: int) -> Floats:
    """Return knots with equal intervals for a number of control points, (points + degree + 1,)."""
    return clamped([1.0] * (points - degree), degree)


def bezier_knots(degree: int) -> Floats:
    """Return the knots of one piece from 0 to 1, (2 degree + 2,)."""
    return clamped([1.0], degree)


def length(knots: Floats, control_points: Floats, weights: Floats) -> float:
    """Return the length of a NURBS in mm, cusps included.

    Each piece is measured by Gaussian quadrature, and again in halves, until both agree. The error
    is at most 1e-10 of the length of the control polygon.

    Args:
        knots: (points + degree + 1,).
        control_points: (points, axes), mm.
        weights: (points,), more than 0.
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
        return half * float(_WEIGHTS @ _speed(knots, form, degree, span, a + half + half * _NODES))

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
    """|dr/du| of one piece at the parameters u (n,).

    ``form`` (points, axes + 1) holds the weighted control points and the weights.
    """
    d = [np.broadcast_to(row, (len(u), form.shape[1])) for row in form[span - degree : span + 1]]
    slope = np.zeros((len(u), form.shape[1]))
    for level in range(1, degree + 1):
        if level == degree:
            slope = degree * (d[1] - d[0]) / (knots[span + 1] - knots[span])
        following = []
        for at in range(degree - level + 1):
            low, high = knots[span - degree + level + at], knots[span + 1 + at]
            fraction = ((u - low) / (high - low))[:, None]
            following.append((1 - fraction) * d[at] + fraction * d[at + 1])
        d = following
    value = d[0]
    point = value[:, :-1] / value[:, -1:]
    speeds: Floats = np.linalg.norm((slope[:, :-1] - slope[:, -1:] * point) / value[:, -1:], axis=1)
    return speeds
