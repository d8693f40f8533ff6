"""Kinematics of two axes: belts (CoreXY, H-bot, CoreXZ), polar table, SCARA, and cylinder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cnc.kinematics.base import DEGREES, Floats, Length, Pair, TableWithFormulas
from cnc.kinematics.series import Series, atan2, sqrt
from cnc.model.blocks import AxisLetter

CENTRE = 1e-9
"""Radius of the centre of a polar table, mm: rounding errors of coordinates."""


class _Belts(TableWithFormulas):
    """Two motors that move two axes through one belt.

        a = x + y      x = (a + b) / 2        The motors of CoreXY and of an H-bot turn alike; the
        b = x - y      y = (a - b) / 2        belts of an H-bot cross the gantry once.

    Z takes the place of Y in CoreXZ.
    """

    movers = ("a", "b")
    turning = (False, False)
    linear = True

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the belts of both motors."""
        first, second = tip
        return [first + second, first - second]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        a, b = joints
        return [0.5 * (a + b), 0.5 * (a - b)]


class CoreXY(_Belts):
    """Two motors move X and Y through belts."""

    moved = ("x", "y")

    type: Literal["corexy", "hbot"] = Field(description="Joints a = X + Y and b = X - Y.")


class CoreXZ(_Belts):
    """Two motors move X and Z through belts."""

    moved = ("x", "z")

    type: Literal["corexz"] = Field(description="Joints a = X + Z and b = X - Z.")


class Polar(TableWithFormulas):
    """A turntable under a radial axis."""

    moved = ("x", "y")
    movers = ("r", "c")
    turning = (False, True)

    type: Literal["polar"] = Field(description="Joints r (radius, mm) and c (angle, degrees).")

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return radius (mm) and angle (degrees).

            r = sqrt(x^2 + y^2)     x = r cos c
            c = atan2(y, x)         y = r sin c

        The centre is singular: c is not defined there, and its speed grows without bound towards
        it. On a straight move out of the centre c stands and r grows evenly.
        """
        x, y = tip
        return [sqrt(x.square() + y.square()), atan2(y, x) * DEGREES]

    def leaving(self, start: Floats, end: Floats) -> tuple[NDArray[np.bool_], Floats]:
        """Return the moves that begin at the centre, with the angles of their ends."""
        joints = np.zeros((len(start), 2))
        joints[:, 1] = np.arctan2(end[:, 1], end[:, 0]) * DEGREES
        return (np.hypot(*start.T) < CENTRE) & (np.hypot(*end.T) > CENTRE), joints

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        r, c = joints
        return [r * np.cos(c / DEGREES), r * np.sin(c / DEGREES)]


class Scara(TableWithFormulas):
    """Two arms that turn in a plane."""

    moved = ("x", "y")
    movers = ("a", "b")
    turning = (True, True)

    type: Literal["scara"] = Field(description="Joints a (shoulder) and b (elbow), degrees.")
    arms: Pair = Field(description="Lengths of the first and of the second arm, mm.")
    elbow: Literal["left", "right"] = Field(
        default="left", description="Side of the first arm on which the tip lies."
    )

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        r"""Return the angles of shoulder and elbow, degrees.

                    elbow b        With the arms l1, l2:  sin b = +- sqrt(1 - k^2)
                l1 ,o
                 ,'  \  l2         cos b = k = (x^2 + y^2 - l1^2 - l2^2) / (2 l1 l2)
        shoulder o    \            a = atan2(y, x) - atan2(l2 sin b, l1 + l2 cos b)
                 a     o tip

        The sign is that of the elbow: positive where the tip lies to the left of the first arm.
        Stretched and folded arms are singular.
        """
        x, y = tip
        first, second = self.arms
        squares = x.square() + y.square()
        cosine = (squares - (first * first + second * second)) * (0.5 / (first * second))
        sine = sqrt(1.0 - cosine.square()) * (1.0 if self.elbow == "left" else -1.0)
        elbow = atan2(sine, cosine)
        shoulder = atan2(y, x) - atan2(sine * second, cosine * second + first)
        return [shoulder * DEGREES, elbow * DEGREES]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        a, b = joints[0] / DEGREES, joints[1] / DEGREES
        first, second = self.arms
        return [
            first * np.cos(a) + second * np.cos(a + b),
            first * np.sin(a) + second * np.sin(a + b),
        ]


class Cylinder(TableWithFormulas):
    """A rotary axis in the place of X or Y: the drawing is wrapped on a cylinder."""

    movers = ("a",)
    turning = (False,)
    angular = (True,)
    linear = True

    type: Literal["cylinder"] = Field(
        description="Joint a (degrees) moves X or Y along the circumference of a cylinder."
    )
    wrapped: Literal["x", "y"] = Field(
        default="y", description="Axis that becomes the circumference."
    )
    radius: Annotated[Length, Field(gt=0.01)] = Field(
        description="Radius of the cylinder on which Z is 0, mm."
    )

    @property
    def axes(self) -> tuple[AxisLetter, ...]:
        """Axes that no motor moves alone."""
        return (self.wrapped,)

    @classmethod
    def moved_in(cls, table: Mapping[str, object]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the axes and the joints of a table that is not validated yet."""
        return (str(table.get("wrapped", "y")),), cls.movers

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the angle, degrees.

        a = y / r      y = r a         r: radius of the cylinder on which Z is 0

        The angle counts its turns.
        """
        return [tip[0] * (DEGREES / self.radius)]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the length along the circumference, mm."""
        return [joints[0] / (DEGREES / self.radius)]
