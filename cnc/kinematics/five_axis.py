r"""Machines with two rotary axes: trunnions, swivel heads, and a head above a turntable.

The tip of a tool with the offset o (length and offsets of the tool table) is at -o from the gauge
point of the spindle. The joints J = (X, Y, Z) move the gauge point. The part is fixed to the table.
With H the motion of the tool by the rotary axes of the head, and T that of the part by those of
the table, both the identity at zero angles,

    J + H(-o) = T(p)         p: the tip on the part at zero angles

A program writes w = p + o: at zero angles the coordinates of the tip are the joints. So

    J = T(w - o) - H(-o)     w = T^-1(J + H(-o)) + o

    head:   C turns the fork, A or B tilts in it:     H(v) = turn(tilt(v))
    table:  A or B tilts the cradle, C turns in it:   T(p) = tilt(turn(p))

A rotation by the angle q about a line through the point c turns v into c + R(q) (v - c). The
directions are those of ISO 841: the tool turns counter-clockwise about the positive axis, seen from
the part. So a table turns the other way, and on all machines the tool points along

    A, C:  ( sin C sin A, -cos C sin A, cos A)       B, C:  (cos C sin B, sin C sin B, cos B)

The joints are trigonometric functions of the angles, without a singular pose. Only an orientation
that is given as a vector has one: there C is not defined where A or B is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field

from cnc.kinematics.base import DEGREES, Floats, Kinematics, Point, Table
from cnc.kinematics.series import Series, sine_cosine
from cnc.model.blocks import AxisLetter
from cnc.model.section import as_tuple

Coordinates: TypeAlias = list[Any]
"""Three coordinates: series, or arrays (m,)."""


class Rotation(NamedTuple):
    """A rotary axis.

    Attributes:
        about: column of the linear axis that it turns about.
        point: a point of its axis, mm: machine coordinates on a table, from the gauge point on a
            head.
        on_table: whether it turns the part.
        sign: -1 where its direction is opposite to that of ISO 841.
    """

    about: int
    point: Point
    on_table: bool
    sign: float = 1.0


class Bare(Kinematics):
    """The axes of a five-axis machine without tool-tip control: they are the joints."""

    turning = (False,) * 5
    linear = True
    angular = (False, False, False, True, True)

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the axes."""
        return list(tip)

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the joints."""
        return list(joints)


class TipControl(Kinematics):
    """Three linear axes, a tilting axis (A or B) and a turning axis (C).

    Args:
        tilt: A or B.
        turn: C.
        offset: of the tool, mm.
    """

    turning = (False,) * 5
    angular = (False, False, False, True, True)

    def __init__(self, tilt: Rotation, turn: Rotation, offset: Point) -> None:
        self._tilt, self._turn, self._offset = tilt, turn, offset

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the linear joints (mm), then the angles (degrees)."""
        x, y, z, tilt, turn = tip
        waves = [sine_cosine(angle * (1.0 / DEGREES)) for angle in (tilt, turn)]
        part = [value - shift for value, shift in zip((x, y, z), self._offset, strict=True)]
        linear = self._joints(part, waves[0], waves[1])
        return [*linear, tilt, turn]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip (mm), then the angles (degrees)."""
        *linear, tilt, turn = joints
        waves = [(np.sin(angle / DEGREES), np.cos(angle / DEGREES)) for angle in (tilt, turn)]
        tool = self._tool(waves[0], waves[1])
        place: Coordinates = [joint + v for joint, v in zip(linear, tool, strict=True)]
        for rotation, wave in ((self._tilt, waves[0]), (self._turn, waves[1])):
            if rotation.on_table:
                place = _turned(place, rotation, wave, 1.0)
        tip = [value + shift for value, shift in zip(place, self._offset, strict=True)]
        return [*tip, tilt, turn]

    def _joints(self, part: Coordinates, tilt: Any, turn: Any) -> Coordinates:
        """Return the joints of a point on the part, by sine and cosine of the angles."""
        if self._turn.on_table:
            part = _turned(part, self._turn, turn, -1.0)
        if self._tilt.on_table:
            part = _turned(part, self._tilt, tilt, -1.0)
        return [a - b for a, b in zip(part, self._tool(tilt, turn), strict=True)]

    def _tool(self, tilt: Any, turn: Any) -> Coordinates:
        """Return the tip from the gauge point."""
        tool: Coordinates = [-value for value in self._offset]
        if not self._tilt.on_table:
            tool = _turned(tool, self._tilt, tilt, 1.0)
        if not self._turn.on_table:
            tool = _turned(tool, self._turn, turn, 1.0)
        return tool


def _turned(point: Coordinates, rotation: Rotation, wave: Any, direction: float) -> Coordinates:
    """Return a point that turns about the axis of a rotation, by sine and cosine of the angle."""
    sine, cosine = wave
    sign = direction * rotation.sign
    i, j = ((1, 2), (2, 0), (0, 1))[rotation.about]
    a, b = point[i] - rotation.point[i], point[j] - rotation.point[j]
    turned = list(point)
    turned[i] = cosine * a - sine * (b * sign) + rotation.point[i]
    turned[j] = sine * (a * sign) + cosine * b + rotation.point[j]
    return turned


class FiveAxis(Table):
    """Three linear axes, an axis that tilts (A or B) and one that turns (C)."""

    with_tip_control = True

    type: Literal[
        "xyzac", "xyzbc", "xyzac-head", "xyzbc-head", "xyzac-head-table", "xyzbc-head-table"
    ] = Field(
        description=(
            "A or B, and C: both on the table (a trunnion), both in the head, or A or B in the "
            "head and C on the table."
        )
    )
    tilt_point: Point = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "A point of the axis of A or B, mm: machine coordinates on a table, from the gauge "
            "point of the spindle in a head."
        ),
    )
    turn_point: Point = Field(
        default=(0.0, 0.0, 0.0),
        description="A point of the axis of C, mm, as for tilt_point; at zero angles.",
    )
    reverse: Annotated[tuple[Literal["a", "b", "c"], ...], BeforeValidator(as_tuple)] = Field(
        default=(),
        description="Rotary axes that turn against the direction of ISO 841.",
    )

    @property
    def tilting(self) -> AxisLetter:
        """The axis that tilts."""
        return "a" if self.type.startswith("xyzac") else "b"

    @property
    def tip_axes(self) -> tuple[AxisLetter, ...]:
        """The axes of tool-tip control."""
        return ("x", "y", "z", self.tilting, "c")

    def formulas(self) -> Kinematics:
        """Return the relation without tool-tip control: the axes are the joints."""
        return Bare()

    def with_tool(self, offset: Point) -> Kinematics:
        """Return the relation under tool-tip control.

        Args:
            offset: Of the tool along X, Y and Z, mm.
        """
        head = self.type.endswith("-head")
        sign = {letter: -1.0 if letter in self.reverse else 1.0 for letter in self.tip_axes}
        tilt = Rotation(
            0 if self.tilting == "a" else 1,
            self.tilt_point,
            not head and not self.type.endswith("-head-table"),
            sign[self.tilting],
        )
        return TipControl(tilt, Rotation(2, self.turn_point, not head, sign["c"]), offset)
