"""Scaling, mirroring and rotation of the programmed figure (G51, G51.1, G68).

    point -> shift + centre_r + R (centre_s + f (point - centre_s) - centre_r)

A point is first scaled and mirrored by a factor for each axis, then rotated in one plane, then
shifted (G68.2 without a tilt). Source:
FANUC Series 0i operator's manual, "Scaling", "Programmable mirror image" and "Coordinate system
rotation"; the order is that of "Scaling and coordinate system rotation".
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """A similarity of the program's coordinates, in mm or degrees by column of the axis.

    Attributes:
        factors: (axes,) factor of each axis; a negative one mirrors.
        fixed: (axes,) coordinate that scaling leaves in its place.
        plane: Columns of the axes that the rotation turns, or None.
        centre: Centre of the rotation in these two axes.
        angle: Degrees, from the first axis of the plane to the second.
        shift: (axes,) distance by which the figure moves after the rotation; empty for none.
    """

    factors: tuple[float, ...]
    fixed: tuple[float, ...]
    plane: tuple[int, int] | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    shift: tuple[float, ...] = ()

    @classmethod
    def none(cls, axes: int) -> Figure:
        """Return the figure as it is programmed."""
        return cls((1.0,) * axes, (0.0,) * axes)

    @property
    def changes(self) -> bool:
        """Whether a point may move."""
        return self.plane is not None or any(factor != 1.0 for factor in self.factors)

    def point(self, at: list[float]) -> list[float]:
        """Return the image of a point."""
        found = [
            fixed + factor * (value - fixed)
            for value, factor, fixed in zip(at, self.factors, self.fixed, strict=True)
        ]
        turned = self._turned(found, 1.0, self.centre)
        if not self.shift:
            return turned
        return [value + step for value, step in zip(turned, self.shift, strict=True)]

    def original(self, at: list[float]) -> list[float]:
        """Return the point that a point is the image of."""
        if self.shift:
            at = [value - step for value, step in zip(at, self.shift, strict=True)]
        found = self._turned(at, -1.0, self.centre)
        return [
            fixed + (value - fixed) / factor
            for value, factor, fixed in zip(found, self.factors, self.fixed, strict=True)
        ]

    def vector(self, delta: list[float]) -> list[float]:
        """Return the image of a difference of two points."""
        found = [value * factor for value, factor in zip(delta, self.factors, strict=True)]
        return self._turned(found, 1.0, (0.0, 0.0))

    def mirrors(self, plane: tuple[int, int]) -> bool:
        """Return whether the direction of turns in a plane (two columns) is reversed."""
        return self.factors[plane[0]] * self.factors[plane[1]] < 0.0

    def scale(self, plane: tuple[int, int]) -> float | None:
        """Return the factor of lengths in a plane; None if its axes have different ones."""
        first, second = abs(self.factors[plane[0]]), abs(self.factors[plane[1]])
        return first if first == second else None

    def coupled(self, columns: set[int]) -> set[int]:
        """Return the columns that move with given ones."""
        plane = set(self.plane or ())
        return columns | plane if plane & columns else columns

    def _turned(self, at: list[float], sign: float, centre: tuple[float, float]) -> list[float]:
        if self.plane is None:
            return at
        i, j = self.plane
        cosine, sine = cosine_sine(sign * self.angle)
        x, y = at[i] - centre[0], at[j] - centre[1]
        turned = at.copy()
        turned[i] = centre[0] + cosine * x - sine * y
        turned[j] = centre[1] + sine * x + cosine * y
        return turned


def cosine_sine(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle in degrees; exact at multiples of 90."""
    quarters = angle / 90.0
    if quarters.is_integer():
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarters) % 4]
    radians = math.radians(math.fmod(angle, 360.0))
    return math.cos(radians), math.sin(radians)
