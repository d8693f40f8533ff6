"""Arcs in a plane: centre, radii and signed turns.

Coordinates are the first and second axis of the plane in mm; counter-clockwise turns the first
towards the second. Lengths are square roots of sums of squares, so that compiled and interpreted
code give the same bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.kernels.jit import njit

SAME_POINT = 1e-7
"""mm. An arc that ends this near to its start is a full circle: the distance is rounding."""
OK, NO_RADIUS, MISMATCH, NO_CHORD, TOO_SMALL = 0, 1, 2, 3, 4
"""Status of an arc: OK, or the reason why there is none."""


class Tolerance(NamedTuple):
    """Tolerances of arcs, mm: see :class:`cnc.gcode.dialects.ArcTolerance`."""

    slack: float
    relative: float
    limit: float
    reach: float


class Wanted(NamedTuple):
    """An arc as a program describes it, mm.

    Attributes:
        x0: First coordinate of the start; ``y0`` is the second.
        x1: First coordinate of the end; ``y1`` is the second.
        x: First coordinate of the centre; ``y`` is the second. NaN if the radius is given.
        radius: Radius if the centre is not given; a negative one means more than half a turn.
        clockwise: Direction.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    x: float
    y: float
    radius: float
    clockwise: bool


class Arc(NamedTuple):
    """Status, centre, radius at the start and at the end (mm), and signed turns."""

    status: int
    x: float
    y: float
    radius: float
    end_radius: float
    turns: float


@njit
def arc_of(wanted: Wanted, tolerance: Tolerance) -> Arc:
    """Return the arc of up to one turn. Its radii are those of the message if there is none."""
    # One function without calls: the line-by-line interpreter runs it uncompiled.
    x0, y0, x1, y1, x, y, radius, clockwise = wanted
    dx, dy = x1 - x0, y1 - y0
    chord = math.sqrt(dx * dx + dy * dy)
    given = x != x
    if given:
        half = chord / 2.0
        if radius == 0.0:
            return Arc(NO_RADIUS, x, y, radius, half, 0.0)
        if chord <= SAME_POINT:
            return Arc(NO_CHORD, x, y, radius, half, 0.0)
        if half > abs(radius) + tolerance.reach:
            return Arc(TOO_SMALL, x, y, abs(radius), chord, 0.0)
        # The centre is to the left of the chord for a counter-clockwise arc of less than half a
        # turn.
        offset = math.sqrt(max((abs(radius) - half) * (abs(radius) + half), 0.0))
        left = offset if clockwise == (radius < 0.0) else -offset
        x = (x0 + x1) / 2.0 - left * dy / chord
        y = (y0 + y1) / 2.0 + left * dx / chord
    ax, ay, bx, by = x0 - x, y0 - y, x1 - x, y1 - y
    start, end = math.sqrt(ax * ax + ay * ay), math.sqrt(bx * bx + by * by)
    if not given:
        if start == 0.0 or end == 0.0:
            return Arc(NO_RADIUS, x, y, start, end, 0.0)
        error = abs(start - end)
        if error > tolerance.limit or (
            error > tolerance.slack and error > tolerance.relative * max(start, end)
        ):
            return Arc(MISMATCH, x, y, start, end, 0.0)
    if chord <= SAME_POINT:
        return Arc(OK, x, y, start, end, -1.0 if clockwise else 1.0)
    # For short arcs the angle from cross and dot product is more accurate than a difference of two
    # angles.
    turns = math.atan2(ax * by - ay * bx, ax * bx + ay * by) / math.tau
    if clockwise and turns >= 0.0:
        turns -= 1.0
    elif not clockwise and turns <= 0.0:
        turns += 1.0
    return Arc(OK, x, y, start, end, turns)
