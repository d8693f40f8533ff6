"""A turntable under a radial axis.

    r = sqrt(x^2 + y^2)     x = r cos c
    c = atan2(y, x)         y = r sin c

The centre is singular: c is not defined there, and its speed grows without bound towards it. On a
straight move out of the centre c stands and r grows evenly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.base import DEGREES, Floats, Kinematics
from cnc.kinematics.series import Series, atan2, sqrt

CENTRE = 1e-9
"""Radius of the centre, mm: rounding errors of coordinates."""


class Polar(Kinematics):
    """Radius and angle."""

    turning = (False, True)

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return radius (mm) and angle (degrees)."""
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
