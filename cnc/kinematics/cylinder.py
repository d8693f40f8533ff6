"""A drawing that is wrapped on a cylinder: a rotary axis moves the circumference.

a = y / r      y = r a         r: radius of the cylinder on which Z is 0
"""

from __future__ import annotations

from collections.abc import Sequence

from cnc.kinematics.base import DEGREES, Floats, Kinematics
from cnc.kinematics.series import Series


class Cylinder(Kinematics):
    """The angle of a length of the circumference. It counts its turns.

    Args:
        radius: of the cylinder, mm.
    """

    turning = (False,)
    angular = (True,)
    linear = True

    def __init__(self, radius: float) -> None:
        self._degrees_per_mm = DEGREES / radius

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the angle, degrees."""
        return [tip[0] * self._degrees_per_mm]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the length along the circumference, mm."""
        return [joints[0] / self._degrees_per_mm]
