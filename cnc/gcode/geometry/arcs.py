"""Geometry of arcs in a plane: centre and swept angle from the words of a program.

Coordinates are the first and second axis of the plane in mm; counter-clockwise turns the first
towards the second. Source: LinuxCNC's G-code reference, G2 and G3. The tolerances belong to the
dialect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cnc.gcode.dialects import ArcTolerance
from cnc.gcode.syntax.words import Word, fault

Point = tuple[float, float]

SAME_POINT = 1e-7
"""mm. An arc that ends this near to its start is a full circle: the distance is rounding."""


@dataclass(frozen=True, slots=True)
class Arc:
    """Centre, radius at the start and at the end, and signed full turns."""

    center: Point
    radius: float
    end_radius: float
    turns: float

    def length(self, rise: float) -> float:
        """Return the length in mm with an even ``rise`` along the axis across the plane.

        It is exact except for a change of radius within the tolerance.
        """
        return math.hypot(math.pi * (self.radius + self.end_radius) * self.turns, rise)


def from_center(
    start: Point,
    end: Point,
    center: Point,
    *,
    clockwise: bool,
    turns: int,
    tolerance: ArcTolerance,
    word: Word,
) -> Arc:
    """Return an arc about a known centre.

    Args:
        start: Start, mm.
        end: End, mm.
        center: Centre, mm.
        clockwise: Direction.
        turns: The P word: 1 for up to one turn.
        tolerance: Tolerances of the dialect.
        word: Word at which errors are reported.

    Raises:
        GcodeError: ``arc-radius-zero``, ``arc-radius-mismatch``.
    """
    radius = math.dist(start, center)
    end_radius = math.dist(end, center)
    if radius == 0 or end_radius == 0:
        which = "start" if radius == 0 else "end"
        hint = "give I, J, K from the start point to the centre"
        raise fault("arc-radius-zero", f"the centre of the arc is its {which} point", word, hint)
    error = abs(radius - end_radius)
    if error > tolerance.limit or (
        error > tolerance.slack and error > tolerance.relative * max(radius, end_radius)
    ):
        raise fault(
            "arc-radius-mismatch",
            f"the arc has radius {radius:.6g} mm at its start and {end_radius:.6g} mm at its end",
            word,
            "the centre must be as far from the end point as from the start point",
        )
    return Arc(
        center,
        radius,
        end_radius,
        _turns(start, end, center, clockwise=clockwise) + (1 - turns if clockwise else turns - 1),
    )


def from_radius(
    start: Point,
    end: Point,
    radius: float,
    *,
    clockwise: bool,
    turns: int,
    tolerance: ArcTolerance,
    word: Word,
) -> Arc:
    """Return an arc of a known radius, mm; a negative one means more than half a turn.

    The other arguments are those of :func:`from_center`.

    Raises:
        GcodeError: ``arc-radius-zero``, ``arc-radius-no-chord``, ``arc-radius-too-small``.
    """
    chord = math.dist(start, end)
    if radius == 0:
        raise fault("arc-radius-zero", "the radius of the arc is 0", word)
    if chord <= SAME_POINT:
        raise fault(
            "arc-radius-no-chord",
            "an arc with R can't end where it starts",
            word,
            "write a full circle with I, J, K, or as two arcs",
        )
    half = chord / 2
    if half > abs(radius) + tolerance.reach:
        message = f"R is {abs(radius):.6g} mm, but the end point is {chord:.6g} mm away"
        raise fault("arc-radius-too-small", message, word, "R must be at least half of that")
    # The centre is to the left of the chord for a counter-clockwise arc of less than half a turn.
    offset = math.sqrt(max((abs(radius) - half) * (abs(radius) + half), 0.0))
    left = offset if clockwise == (radius < 0) else -offset
    (x0, y0), (x1, y1) = start, end
    center = ((x0 + x1) / 2 - left * (y1 - y0) / chord, (y0 + y1) / 2 + left * (x1 - x0) / chord)
    swept = _turns(start, end, center, clockwise=clockwise)
    return Arc(
        center,
        math.dist(start, center),
        math.dist(end, center),
        swept + (1 - turns if clockwise else turns - 1),
    )


def _turns(start: Point, end: Point, center: Point, *, clockwise: bool) -> float:
    """The signed turns from start to end: more than 0, up to one."""
    if math.dist(start, end) <= SAME_POINT:
        return -1.0 if clockwise else 1.0
    ax, ay = start[0] - center[0], start[1] - center[1]
    bx, by = end[0] - center[0], end[1] - center[1]
    # For short arcs the angle from cross and dot product is more accurate than a difference of two
    # angles.
    turns = math.atan2(ax * by - ay * bx, ax * bx + ay * by) / math.tau
    if clockwise:
        return turns if turns < 0 else turns - 1.0
    return turns if turns > 0 else turns + 1.0
