"""A turntable under a radial axis.

    r = sqrt(x^2 + y^2)     x = r cos c
    c = atan2(y, x)         y = r sin c

The centre is singular: c is not defined there, and its speed grows without bound towards it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cnc.kinematics.base import DEGREES, Floats, Kinematics
from cnc.kinematics.series import Series, atan2, sqrt


class Polar(Kinematics):
    """Radius and angle."""

    turning = (False, True)

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return radius (mm) and angle (degrees)."""
        x, y = tip
        return [sqrt(x.square() + y.square()), atan2(y, x) * DEGREES]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        r, c = joints
        return [r * np.cos(c / DEGREES), r * np.sin(c / DEGREES)]
