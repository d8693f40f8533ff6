"""All joints of a machine: those of its kinematics, and the axes that are joints themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.base import Kinematics, Point
from cnc.kinematics.compensation import CellsOfAll, Compensation
from cnc.kinematics.five_axis import FiveAxis
from cnc.kinematics.series import Series
from cnc.machine.models import Machine
from cnc.model.blocks import ROTARY_LETTERS

Floats = NDArray[np.float64]


class JointMap:
    """Joints in the order of :attr:`cnc.machine.models.Machine.joint_tables`.

    Args:
        kinematics: relates the taken axes and the joints ``own``.
        taken: columns of the axes that the kinematics takes.
        own: columns of its joints.
        others: columns of the axes that are joints themselves.
        names: names of all joints.

    Attributes:
        names: of the joints.
        columns: names of the joints' columns in a path.
        turning: (joints,): whether a joint comes to the same place after 360 degrees.
        linear: whether the joints are a linear function of the tip.
        straight: whether they are one along a straight move on which no nut changes its side.
        angular: whether the unit of each joint is the degree.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        taken: Sequence[int],
        own: Sequence[int],
        others: Sequence[int],
        names: Sequence[str],
    ) -> None:
        self._kinematics, self._taken, self._own = kinematics, tuple(taken), tuple(own)
        self._others = tuple(others)
        self._rest = tuple(k for k in range(len(names)) if k not in self._own)
        self.names = tuple(names)
        self.columns = tuple(f"joint {name}" for name in names)
        self.linear = self.straight = kinematics.linear
        self._table: FiveAxis | None = None
        self._letters: tuple[str, ...] = ()
        self.turning = np.zeros(len(names), np.bool_)
        self.turning[list(own)] = kinematics.turning
        turns = dict(zip(own, kinematics.angular or kinematics.turning, strict=True))
        self.angular = tuple(
            turns.get(k, name in ROTARY_LETTERS) for k, name in enumerate(self.names)
        )

    @classmethod
    def of(cls, machine: Machine) -> JointMap | None:
        """Return the joints of a machine; None where they are the axes."""
        table, letters = machine.kinematics, machine.axis_names
        if machine.is_compensated:
            return CompensatedAxes(machine.compensation, letters)
        if isinstance(table, FiveAxis):
            return _of_five(table, letters, None)
        kinematics = table.formulas()
        if kinematics is None:
            return None
        names, moved, joints = tuple(machine.joint_tables), table.axes, table.joints
        return cls(
            kinematics,
            [letters.index(letter) for letter in moved],
            [names.index(name) for name in joints],
            [k for k, letter in enumerate(letters) if letter not in moved],
            names,
        )

    def with_tool(self, offset: Point | None) -> JointMap:
        """Return the joints under tool-tip control with a tool, or of the bare axes for None.

        Args:
            offset: of the tool along X, Y and Z, mm.
        """
        assert self._table is not None
        return _of_five(self._table, self._letters, offset)

    def bound_to(self, start: Floats, middle: Floats, end: Floats) -> JointMap:
        """Return the joints on parts of a path with these tips (m, axes).

        A part that leaves the range of a formula has no bounds; see :meth:`border`.
        """
        return self

    def with_sides(self, sides: Mapping[int, Series | Floats]) -> JointMap:
        """Return the joints where nuts have these sides, by the column of their axis."""
        return self

    def border(self, start: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return the borders of the ranges of formulas that parts of a path cross.

        Args:
            start: Tips at the start of the parts (m, axes).
            end: Tips at their end.

        Returns:
            Weights (m, axes) and numbers (m,): on the border the weighted sum of the tip is the
            number. It is not a number where there is none between start and end.
        """
        return np.zeros_like(start), np.full(len(start), np.nan)

    def series(self, tip: Sequence[Series]) -> list[Series]:
        """Return the series of all joints from those of all axes."""
        own = self._kinematics.inverse([tip[k] for k in self._taken])
        places = dict(zip(self._own, own, strict=True))
        places |= {k: tip[axis] for k, axis in zip(self._rest, self._others, strict=True)}
        return [places[k] for k in range(len(self.names))]

    def inverse(self, tip: Floats) -> Floats:
        """Return the joints (m, joints) of tips (m, axes).

        Values that are out of reach are not numbers. Angles lie within half a turn of 0.
        """
        joints = self.series([Series([column]) for column in tip.T])
        return np.stack([np.asarray(series.terms[0]) for series in joints], axis=-1)

    def leaving(self, start: Floats, end: Floats) -> tuple[NDArray[np.bool_], Floats]:
        """Return the straight moves out of a singular pose on which the joints stay linear.

        Args:
            start: Tips at which moves begin (m, axes).
            end: Tips at which they end.

        Returns:
            Whether each move is such a move (m,), and the joints at its start (m, joints).
        """
        taken = list(self._taken)
        leaves, own = self._kinematics.leaving(start[:, taken], end[:, taken])
        joints = np.empty((len(start), len(self.names)))
        joints[:, list(self._own)] = own
        joints[:, list(self._rest)] = start[:, list(self._others)]
        return leaves, joints

    def forward(self, joints: Floats) -> Floats:
        """Return the tips (m, axes) of joints (m, joints)."""
        tip = np.empty((len(joints), len(self._taken) + len(self._others)))
        tip[:, self._others] = joints[:, self._rest]
        own = self._kinematics.forward([joints[:, k] for k in self._own])
        for axis, column in zip(self._taken, own, strict=True):
            tip[:, axis] = column
        return tip


def _of_five(table: FiveAxis, letters: tuple[str, ...], offset: Point | None) -> JointMap:
    """Return the joints of a five-axis machine; without an offset they are the axes."""
    taken = [letters.index(letter) for letter in table.tip_axes]
    kinematics = table.formulas() if offset is None else table.with_tool(offset)
    others = [k for k in range(len(letters)) if k not in taken]
    joints = JointMap(kinematics, taken, taken, others, letters)
    joints._table, joints._letters = table, letters
    return joints


class CompensatedAxes(JointMap):
    """The motors of a machine that has a motor for each axis, and errors that are compensated.

    Args:
        compensation: The places of the motors.
        names: Letters of the axes.
    """

    def __init__(self, compensation: Compensation, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self.columns = tuple(f"joint {name}" for name in self.names)
        self.turning = np.zeros(len(self.names), np.bool_)
        self.angular = tuple(name in ROTARY_LETTERS for name in self.names)
        self.linear, self.straight = compensation.is_linear, compensation.is_even
        self.compensation = compensation
        self._cells = CellsOfAll({}, None)
        self._sides: Mapping[int, Series | Floats] = {}

    def with_sides(self, sides: Mapping[int, Series | Floats]) -> CompensatedAxes:
        """Return the motors where nuts have these sides, by the column of their axis."""
        other = copy(self)
        other._sides = sides
        return other

    def bound_to(self, start: Floats, middle: Floats, end: Floats) -> JointMap:
        """Return the motors on parts of a path with these tips (m, axes)."""
        bound = copy(self)
        bound._cells = self.compensation.cells(start, middle, end)
        return bound

    def border(self, start: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return the knots of error tables that parts of a path cross."""
        return self.compensation.border(start, end)

    def series(self, tip: Sequence[Series]) -> list[Series]:
        """Return the series of all motors from those of all axes, on the parts of the binding."""
        return self.compensation.motors(tip, self._cells, self._sides)

    def inverse(self, tip: Floats) -> Floats:
        """Return the motors (m, axes) of tips (m, axes)."""
        return self.compensation.motors_at(tip, self._sides)

    def leaving(self, start: Floats, end: Floats) -> tuple[NDArray[np.bool_], Floats]:
        """Return that no pose is singular."""
        return np.zeros(len(start), np.bool_), np.zeros((len(start), len(self.names)))

    def forward(self, joints: Floats) -> Floats:
        """Return the tips (m, axes) of motors (m, axes)."""
        return self.compensation.tips_at(joints, self._sides)
