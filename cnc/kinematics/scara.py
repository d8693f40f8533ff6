r"""Two arms that turn in a plane (SCARA).

                elbow b        With the arms l1, l2 and k = (x^2 + y^2 - l1^2 - l2^2) / (2 l1 l2):
            l1 ,o
             ,'  \  l2         cos b = k,  sin b = +- sqrt(1 - k^2)
    shoulder o    \            a = atan2(y, x) - atan2(l2 sin b, l1 + l2 cos b)
             a     o tip

The sign is that of the elbow: positive where the tip lies to the left of the first arm. Stretched
and folded arms are singular.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cnc.kinematics.base import DEGREES, Floats, Kinematics
from cnc.kinematics.series import Series, atan2, sqrt


class Scara(Kinematics):
    """Shoulder and elbow.

    Args:
        arms: lengths of the first and the second arm, mm.
        left: whether the tip lies to the left of the first arm.
    """

    turning = (True, True)

    def __init__(self, arms: tuple[float, float], *, left: bool) -> None:
        self._arms = arms
        self._side = 1.0 if left else -1.0

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the angles of shoulder and elbow, degrees."""
        x, y = tip
        first, second = self._arms
        squares = x.square() + y.square()
        cosine = (squares - (first * first + second * second)) * (0.5 / (first * second))
        sine = sqrt(1.0 - cosine.square()) * self._side
        elbow = atan2(sine, cosine)
        shoulder = atan2(y, x) - atan2(sine * second, cosine * second + first)
        return [shoulder * DEGREES, elbow * DEGREES]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        a, b = joints[0] / DEGREES, joints[1] / DEGREES
        first, second = self._arms
        return [
            first * np.cos(a) + second * np.cos(a + b),
            first * np.sin(a) + second * np.sin(a + b),
        ]
