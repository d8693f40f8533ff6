"""Two motors that move two axes through one belt: CoreXY, H-bot and CoreXZ.

    a = x + y      x = (a + b) / 2        The motors of CoreXY and of an H-bot turn alike; the
    b = x - y      y = (a - b) / 2        belts of an H-bot cross the gantry once.

Z takes the place of Y in CoreXZ.
"""

from __future__ import annotations

from collections.abc import Sequence

from cnc.kinematics.base import Floats, Kinematics
from cnc.kinematics.series import Series


class Belts(Kinematics):
    """Sum and difference of two axes."""

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
