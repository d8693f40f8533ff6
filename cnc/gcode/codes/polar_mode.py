"""Polar coordinates by axis words (G15, G16).

Under G16 the word of the plane's first axis is a radius and that of the second an angle in degrees.
Under G90 they count from the zero of the coordinate system; in Mach3 from the position at G16.
Under G91 a radius counts from the present position, and an angle from the last one. Sources: FANUC
Series 0i operator's manual, "Polar coordinate command (G15, G16)"; "Using Mach3Mill", G15 and G16.
"""

from __future__ import annotations

import math

from cnc.gcode.syntax.arithmetic import cosine, sine
from cnc.gcode.syntax.words import Word, fault

Point = tuple[float, float]


class PolarMode:
    """The mode and the last radius and angle.

    Attributes:
        plane: Columns of the plane's axes while the mode is on, or None.
    """

    def __init__(self) -> None:
        self.plane: tuple[int, int] | None = None
        self._origin: Point = (0.0, 0.0)
        self._centre: Point = (0.0, 0.0)
        self._radius = self._angle = 0.0
        self._words: tuple[float | None, float | None] = (None, None)

    def begin(
        self, plane: tuple[int, int], program: list[float], at: Word, *, from_here: bool
    ) -> None:
        """Begin the mode (G16).

        Args:
            plane: Columns of the plane's axes.
            program: (axes,) present position in program coordinates, mm.
            at: Word at which errors are reported.
            from_here: Count from the present position, not from the zero.

        Raises:
            GcodeError: ``polar-active``.
        """
        if self.plane is not None and self.plane != plane:
            raise fault("polar-active", f"{at.written} in another plane", at, "give G15 before")
        x, y = program[plane[0]], program[plane[1]]
        self._origin = (x, y) if from_here else (0.0, 0.0)
        self.plane, self._centre = plane, self._origin
        x, y = x - self._origin[0], y - self._origin[1]
        self._radius, self._angle = math.hypot(x, y), math.degrees(math.atan2(y, x))

    def end(self) -> None:
        """End the mode (G15)."""
        self.plane = None

    def place(
        self, radius: float | None, angle: float | None, here: Point, *, absolute: bool
    ) -> Point:
        """Return the point of a radius (mm) and an angle (degrees), and keep them.

        Args:
            radius: None if the line has none.
            angle: None if the line has none.
            here: Present position in the plane, in program coordinates, mm.
            absolute: Whether G90 is in effect.
        """
        self._words = radius, angle
        if absolute:
            self._centre = self._origin
            self._angle = self._angle if angle is None else angle
        else:
            self._angle += angle or 0.0
            if radius is not None:
                self._centre = here
        self._radius = self._radius if radius is None else radius
        return (
            self._centre[0] + self._radius * cosine(self._angle),
            self._centre[1] + self._radius * sine(self._angle),
        )

    def again(self, here: Point) -> Point:
        """Return the point of the last words once more, counted from ``here`` under G91."""
        return self.place(*self._words, here, absolute=False)
