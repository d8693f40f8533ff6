"""The joints of a machine as functions of its tool tip, and back.

    tip (x, y, z)  --inverse-->  joints (a, b, ..)      lengths in mm
                   <--forward--                         angles in degrees

A kinematics writes :meth:`Kinematics.inverse` once, as a formula of Taylor series. From it follow
the positions of the joints, their derivatives along a path, and bounds on the derivatives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.series import Series

Floats = NDArray[np.float64]

DEGREES = 180.0 / np.pi


class Kinematics(ABC):
    """A relation of joints and tip.

    Attributes:
        turning: for each joint, whether it comes to the same place after 360 degrees.
        linear: whether the joints are a linear function of the tip.
        angular: for each joint, whether its unit is the degree; empty for those of ``turning``.
    """

    turning: ClassVar[tuple[bool, ...]]
    linear: ClassVar[bool] = False
    angular: ClassVar[tuple[bool, ...]] = ()

    @abstractmethod
    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the joints of a tip.

        A joint is not a number where the tip is out of reach.
        """

    def leaving(self, start: Floats, end: Floats) -> tuple[NDArray[np.bool_], Floats]:
        """Return the straight moves out of a singular pose on which the joints stay linear.

        Args:
            start: Tips at which moves begin (m, axes).
            end: Tips at which they end.

        Returns:
            Whether each move is such a move (m,), and the joints at its start (m, joints).
        """
        return np.zeros(len(start), np.bool_), np.zeros((len(start), len(self.turning)))

    @abstractmethod
    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip of joints; not a number where the joints can't have these positions.

        Args:
            joints: an array (m,) for each joint.

        Returns:
            An array (m,) for each axis that the kinematics takes.
        """
