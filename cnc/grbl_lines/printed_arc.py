r"""Points and arcs in the rounded numbers of a line.

An arc is given by its centre (I J K from the start), never by its radius. GRBL takes the radius
from the start and turns towards the end as it reads it. It refuses (error:33) radii that differ by
more than 0.005 mm and 0.1 % (gcode.c). Therefore, for an arc up to half a turn:

              centre         The centre is put on the bisector of the two printed points, so that
               /|\           both radii are equal. The angle that the board computes from the
        start / | \ end      printed numbers is computed before they are sent.

Where rounding would turn a short arc into a full circle, or the reverse, chords are sent instead.

GRBL takes an angle below 5e-7 rad for a full circle (motion_control.c, mc_arc). With 32-bit floats
the angle between the two ends of a full circle is 0 only within 3e-5 mm / radius, at 300 mm from
zero: half of the circles of 10 mm would be left out. So a full circle is sent as two halves.

Along the axis across an arc the board adds a part of the climb at each chord and rounds each sum.
After n chords at height z the error is up to n ulp(z) / 2, until the end point corrects it. So a
helix of many chords far from zero is sent in several parts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cnc.grbl_lines.moves import PlaneArc, Point
from cnc.grbl_lines.number_format import PLANE_COLUMNS, number
from cnc.kernels.grbl_lines.arc_fit import board_chord

TURN = 2.0 * math.pi
SHORTEST_ANGLE = 1e-3
SHORTEST_ARC = 1e-3
"""rad, mm. An arc that turns less or is shorter is sent as a line: the board could take it for a
full circle.
"""
CHORDS = 0.2
"""Part of the tolerance for chords that replace a fitted arc where rounded numbers would spoil
it.
"""
COARSE = 0.8
"""Part of the tolerance that the board's own chords may be from an arc of the program. Beyond it,
chords are sent instead.
"""
DIGITS = 0.02
"""Part of the tolerance for the effect of rounded numbers on the board's chords."""
HELIX_SUM, FITTED_HELIX_SUM = 0.5, 0.04
"""Part of the tolerance that rounding may add up to along a helix of the program, and along one
that is fitted to a path.
"""


class Printed(NamedTuple):
    """A point as a line gives it: a number for each axis of the board, and its text.

    The text of an axis is None where its position is known only roughly.
    """

    values: Point
    texts: tuple[str | None, ...]


@dataclass(frozen=True, slots=True)
class PrintedArc:
    """An arc as a line gives it, mm and rad.

    end: end point. center, texts: centre from the start along the two axes of the plane, as numbers
    and as text. radius: from the start. angle: absolute angle that the board computes from these
    numbers. closed: whether start and end are the same in the plane.
    """

    end: Printed
    center: tuple[float, float]
    texts: tuple[str, str]
    radius: float
    angle: float
    closed: bool


@dataclass(frozen=True)
class ArcPrinter:
    """The rules by which arcs become lines.

    Attributes:
        offset: Work offset that the board adds to the coordinates of a line, mm.
        tolerance: Largest distance of lines from the program, mm.
        chord: Largest distance of the board's own chords from an arc, mm.
    """

    offset: Sequence[float]
    tolerance: float
    chord: float

    @cached_property
    def digits(self) -> int:
        """Decimals of coordinates: four for the usual hundredth of a millimetre.

        Rounding then adds a hundredth of the tolerance.
        """
        return max(3, math.ceil(-math.log10(self.tolerance / 50.0)))

    def printed(self, point: Point) -> Printed:
        """Return the coordinates of a line for a point in machine coordinates."""
        texts = tuple(self.text(value, axis) for axis, value in enumerate(point))
        return Printed(tuple(map(float, texts)), texts)

    def text(self, value: float, axis: int) -> str:
        """Return the number of a line for a machine coordinate of an axis, from 0."""
        return number(value - self.offset[axis], self.digits)

    def chords_of(self, printed: PrintedArc, arc: PlaneArc) -> int:
        """Return the number of chords that replace an arc."""
        off = (CHORDS if arc.fitted else COARSE) * self.tolerance
        radius = printed.radius
        turn = 2.0 * math.acos(max(1.0 - off / radius, 0.5)) if radius > 0.0 else TURN
        return max(1, math.ceil(abs(arc.sweep) / turn))

    def arc_parts(self, here: Printed, end: Printed, arc: PlaneArc) -> int:
        """Return the number of lines for an arc, by its angle and its climb."""
        i, j, across = PLANE_COLUMNS[arc.plane]
        sweep = abs(arc.sweep)
        parts = math.ceil(sweep / (0.5 * TURN)) if sweep > 0.75 * TURN else 1
        if end.texts[across] == here.texts[across]:
            return parts
        height = max(
            abs(values[across] + self.offset[across]) for values in (end.values, here.values)
        )
        center = arc.center[0] - self.offset[i], arc.center[1] - self.offset[j]
        radius = math.dist((here.values[i], here.values[j]), center)
        rounding = 0.5 * float(np.spacing(np.float32(height)))
        share = FITTED_HELIX_SUM if arc.fitted else HELIX_SUM
        most_chords = max(share * self.tolerance / rounding, 1.0)
        half = (
            math.sqrt(self.chord * (2.0 * radius - self.chord))
            if self.chord < 2.0 * radius
            else math.inf
        )
        return max(parts, math.ceil(0.5 * sweep * radius / half / most_chords))

    def printed_arc(self, at: Printed, end: Printed, arc: PlaneArc) -> PrintedArc:
        """Return the numbers of an arc as a line gives them."""
        i, j, _ = PLANE_COLUMNS[arc.plane]
        here = at.values[i], at.values[j]
        there = end.values[i], end.values[j]
        cx, cy = arc.center[0] - self.offset[i], arc.center[1] - self.offset[j]
        radius = math.dist(here, (cx, cy))
        closed = end.texts[i] == at.texts[i] and end.texts[j] == at.texts[j]
        if abs(arc.sweep) <= 0.5 * TURN and not closed:
            # onto the bisector
            tx, ty = there[0] - here[0], there[1] - here[1]
            off = (
                (cx - 0.5 * (here[0] + there[0])) * tx + (cy - 0.5 * (here[1] + there[1])) * ty
            ) / (tx * tx + ty * ty)
            cx, cy = cx - off * tx, cy - off * ty
        texts = number(cx - here[0], self.digits), number(cy - here[1], self.digits)
        center = float(texts[0]), float(texts[1])
        angle = abs(angle_read(here, there, center, arc.sweep > 0.0))
        return PrintedArc(end, center, texts, radius, angle, closed)

    def needs_chords(self, printed: PrintedArc, arc: PlaneArc) -> bool:
        """Return whether chords must be sent in place of an arc."""
        sweep, radius = abs(arc.sweep), printed.radius
        # From the printed numbers the board may make one chord less than from the arc itself.
        inside = board_chord(
            math.hypot(printed.center[0], printed.center[1]), printed.angle, self.chord
        )
        allowed = (
            board_chord(radius, sweep, self.chord) + DIGITS * self.tolerance
            if arc.fitted
            else COARSE * self.tolerance
        )
        return (
            sweep < SHORTEST_ANGLE
            or sweep * radius < SHORTEST_ARC
            or printed.closed
            or inside > allowed
            or abs(printed.angle - sweep) * radius > CHORDS * self.tolerance
        )


def angle_read(
    here: tuple[float, float],
    there: tuple[float, float],
    center: tuple[float, float],
    counterclockwise: bool,
) -> float:
    """Return the signed angle of an arc as GRBL computes it (mc_arc of motion_control.c).

    Args:
        here: Start along the two axes of the plane, mm.
        there: End along them, mm.
        center: Centre from ``here``, mm.
        counterclockwise: Sense of the arc.
    """
    x0, y0 = -center[0], -center[1]
    x1, y1 = there[0] - here[0] + x0, there[1] - here[1] + y0
    angle = math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    if counterclockwise:
        return angle + TURN if angle <= 5e-7 else angle
    return angle - TURN if angle >= -5e-7 else angle
