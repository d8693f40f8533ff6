"""The joints of a machine as functions of its tool tip, and back.

    tip (x, y, z)  --inverse-->  joints (a, b, ..)      lengths in mm
                   <--forward--                         angles in degrees

A kinematics writes :meth:`Kinematics.inverse` once, as a formula of Taylor series. From it follow
the positions of the joints, their derivatives along a path, and bounds on the derivatives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, FiniteFloat

from cnc.kinematics.series import Series
from cnc.model.blocks import AxisLetter
from cnc.model.section import Section, as_tuple

Floats = NDArray[np.float64]

DEGREES = 180.0 / np.pi
LONGEST = 1e6
"""mm; longer than any machine: such a length is a mistake of the unit."""
APART = 1.0
"""Degrees; towers that are nearer to each other leave the tip free to tip over."""

Length = Annotated[FiniteFloat, Field(gt=0, le=LONGEST)]
Coordinate = Annotated[FiniteFloat, Field(ge=-LONGEST, le=LONGEST)]
Pair = Annotated[tuple[Length, Length], BeforeValidator(as_tuple)]


def _different(angles: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse angles of which two are the same direction."""
    for k, angle in enumerate(angles):
        between = (angle - angles[k - 1]) % 360.0
        if min(between, 360.0 - between) < APART:
            raise ValueError("must be three different directions")
    return angles


Angles = Annotated[
    tuple[FiniteFloat, FiniteFloat, FiniteFloat],
    BeforeValidator(as_tuple),
    AfterValidator(_different),
]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(as_tuple)]


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


class Table(Section):
    """The table [kinematics] of a machine file.

    Its joints have tables [joints.NAME] in place of some axes' limits.
    """

    moved: ClassVar[tuple[AxisLetter, ...]] = ()
    """Axes that no motor moves alone."""
    movers: ClassVar[tuple[str, ...]] = ()
    """The joints that move them."""
    with_tip_control: ClassVar[bool] = False
    """Whether the axes are the joints until a program switches tool-tip control on."""

    @property
    def axes(self) -> tuple[AxisLetter, ...]:
        """Axes that no motor moves alone."""
        return self.moved

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that move them."""
        return self.movers

    @classmethod
    def moved_in(cls, table: Mapping[str, object]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the axes and the joints of a table that is not validated yet."""
        return cls.moved, cls.movers

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """Return the values of ``type`` for this kinematics."""
        return get_args(cls.model_fields["type"].annotation)

    def formulas(self) -> Kinematics | None:
        """Return the relation of joints and tip; None where the axes are the joints."""
        return None


class TableWithFormulas(Table, Kinematics):
    """A kinematics whose formulas take the numbers of its table."""

    turning: ClassVar[tuple[bool, ...]]
    linear: ClassVar[bool] = False
    angular: ClassVar[tuple[bool, ...]] = ()

    def formulas(self) -> Kinematics:
        """Return the relation of joints and tip."""
        return self
