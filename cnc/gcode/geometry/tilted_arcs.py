"""Arcs in planes that a rotation tilts, as splines.

An arc of the program is a circle in its plane. A rotation about an axis of that plane takes it out
of the planes of the machine. A rational quadratic spline is an exact circle (Piegl & Tiller, The
NURBS Book, section 7.3), and a rotation of its control points is one of the curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.geometry.arcs import Arc

Floats = NDArray[np.float64]

_STEPS = 4
"""Fewest spans of a turn: the weight of a span of half a turn is 0."""
_ALONG = 1e-5
"""Largest error along the other axes, which move evenly with the angle, mm or degrees."""


def spline_of(
    arc: Arc,
    start: Sequence[float],
    end: Sequence[float],
    plane: tuple[int, int],
    to_machine: Callable[[list[float]], list[float]],
) -> tuple[Floats, Floats, Floats]:
    """Return knots, control points (n, axes) and weights (n,) of an arc.

    Args:
        arc: The arc in program coordinates.
        start: (axes,) program coordinates of the start.
        end: (axes,) program coordinates of the end.
        plane: Columns of the arc's plane.
        to_machine: Conversion of a point in program coordinates.
    """
    i, j = plane
    begin, moved = np.array(start), np.array(end) - start
    moved[[i, j]] = 0.0
    sweep = math.tau * arc.turns
    spans = max(1, math.ceil(_STEPS * abs(arc.turns) - 1e-9))
    # Of a span, the parameter differs from the angle by less than its square over 60.
    rise = float(np.abs(moved).max())
    spans = max(spans, math.ceil((rise * sweep * sweep / (60.0 * _ALONG)) ** (1.0 / 3.0)))
    half = 0.5 * sweep / spans
    first = math.atan2(begin[j] - arc.center[1], begin[i] - arc.center[0])
    # Even points lie on the arc, odd ones where the tangents of their neighbours meet.
    share = np.arange(2 * spans + 1) / (2 * spans)
    angle = first + share * sweep
    radius = arc.radius + share * (arc.end_radius - arc.radius)
    radius[1::2] /= math.cos(half)
    points = begin + share[:, None] * moved
    points[:, i] = arc.center[0] + radius * np.cos(angle)
    points[:, j] = arc.center[1] + radius * np.sin(angle)
    points[0], points[-1] = start, end
    weights = np.ones(len(points))
    weights[1::2] = math.cos(half)
    knots = np.concatenate(([0.0], np.repeat(np.arange(spans + 1.0), 2), [float(spans)]))
    return knots, np.array([to_machine(point) for point in points.tolist()]), weights
