"""SINUMERIK's programmable frame: shift, rotation, scaling and mirroring of program coordinates.

    point of the work piece = shift + R(angle) F point

F holds a factor for each axis; a negative one mirrors. TRANS, ROT, SCALE and MIRROR replace the
frame; ATRANS, AROT, ASCALE and AMIRROR add to it, in the frame's own axes: the new frame is applied
to a point first. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals",
"Coordinate transformations (frames)".
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from cnc.gcode.geometry.figure import cosine_sine

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ProgramFrame:
    """A frame, in mm along X, Y and Z.

    Attributes:
        shift: Shift of the origin.
        factors: Factor of each axis.
        plane: Axes that the rotation turns, by number, from the first to the second.
        angle: Angle of the rotation, degrees.
    """

    shift: Triple = (0.0, 0.0, 0.0)
    factors: Triple = (1.0, 1.0, 1.0)
    plane: tuple[int, int] = (0, 1)
    angle: float = 0.0

    def moved(self, delta: Triple) -> ProgramFrame:
        """Return the frame with an additional shift."""
        part = [factor * value for factor, value in zip(self.factors, delta, strict=True)]
        first, second = self.plane
        cosine, sine = cosine_sine(self.angle)
        x, y = part[first], part[second]
        part[first], part[second] = cosine * x - sine * y, sine * x + cosine * y
        x, y, z = (a + b for a, b in zip(self.shift, part, strict=True))
        return replace(self, shift=(x, y, z))

    def turned(self, plane: tuple[int, int], angle: float) -> ProgramFrame | None:
        """Return the frame with an additional rotation.

        None if the result is no rotation of one plane, or would distort angles.
        """
        if self.angle and plane != self.plane:
            return None
        first, second = (self.factors[axis] for axis in plane)
        if abs(first) != abs(second):
            return None
        # A mirror image turns in the other direction.
        sign = -1.0 if first * second < 0.0 else 1.0
        return replace(self, plane=plane, angle=self.angle + sign * angle)

    def scaled(self, factors: Triple) -> ProgramFrame:
        """Return the frame with additional factors."""
        x, y, z = (a * b for a, b in zip(self.factors, factors, strict=True))
        return replace(self, factors=(x, y, z))
