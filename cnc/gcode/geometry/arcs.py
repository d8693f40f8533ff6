"""Geometry of arcs in a plane: centre and swept angle from the words of a program.

Coordinates are the first and second axis of the plane in mm; counter-clockwise turns the first
towards the second. Source: LinuxCNC's G-code reference, G2 and G3. The tolerances belong to the
dialect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cnc.gcode.dialects.rules import ArcTolerance
from cnc.gcode.syntax.words import Word, fault
from cnc.kernels.gcode import arcs as kernel
from cnc.kernels.gcode.arcs import Tolerance, Wanted
from cnc.kernels.jit import interpreted

Point = tuple[float, float]

_arc_of = interpreted(kernel.arc_of)


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
    found = _arc_of(
        Wanted(*start, *end, *center, 0.0, clockwise),
        Tolerance(tolerance.slack, tolerance.relative, tolerance.limit, tolerance.reach),
    )
    if found.status == kernel.NO_RADIUS:
        which = "start" if found.radius == 0 else "end"
        hint = "give I, J, K from the start point to the centre"
        raise fault("arc-radius-zero", f"the centre of the arc is its {which} point", word, hint)
    if found.status == kernel.MISMATCH:
        raise fault(
            "arc-radius-mismatch",
            f"the arc has radius {found.radius:.6g} mm at its start and {found.end_radius:.6g} mm "
            "at its end",
            word,
            "the centre must be as far from the end point as from the start point; "
            "absolute I, J and K need G90.1 (LinuxCNC, Mach3)",
        )
    return _with_turns(found, turns, clockwise=clockwise)


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
    found = _arc_of(
        Wanted(*start, *end, math.nan, math.nan, radius, clockwise),
        Tolerance(tolerance.slack, tolerance.relative, tolerance.limit, tolerance.reach),
    )
    if found.status == kernel.NO_RADIUS:
        raise fault("arc-radius-zero", "the radius of the arc is 0", word)
    if found.status == kernel.NO_CHORD:
        raise fault(
            "arc-radius-no-chord",
            "an arc with R can't end where it starts",
            word,
            "write a full circle with I, J, K, or as two arcs",
        )
    if found.status == kernel.TOO_SMALL:
        message = f"R is {found.radius:.6g} mm, but the end point is {found.end_radius:.6g} mm away"
        raise fault("arc-radius-too-small", message, word, "R must be at least half of that")
    return _with_turns(found, turns, clockwise=clockwise)


def _with_turns(found: kernel.Arc, turns: int, *, clockwise: bool) -> Arc:
    """Return the arc with the full turns that the P word adds."""
    return Arc(
        (found.x, found.y),
        found.radius,
        found.end_radius,
        found.turns + (1 - turns if clockwise else turns - 1),
    )
