"""All joints of a machine: those of its kinematics, and the axes that are joints themselves."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import entry_points

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.base import Kinematics
from cnc.kinematics.belts import Belts
from cnc.kinematics.cylinder import Cylinder
from cnc.kinematics.delta import LinearDelta, RotaryDelta
from cnc.kinematics.five_axis import Bare, FiveAxis, Point, Rotation
from cnc.kinematics.polar import Polar
from cnc.kinematics.scara import Scara
from cnc.kinematics.series import Series
from cnc.machine import kinematics as tables
from cnc.machine.kinematics import KinematicsTable
from cnc.machine.models import Machine
from cnc.model.blocks import ROTARY_LETTERS
from cnc.model.diagnostics import Diagnostic, MachineFileError

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
        self.linear = kinematics.linear
        self._table: tables.FiveAxis | None = None
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
        if isinstance(machine.kinematics, tables.FiveAxis):
            return _of_five(machine.kinematics, machine.axis_names, None)
        kinematics = _formula(machine.kinematics)
        if kinematics is None:
            return None
        letters, names = machine.axis_names, tuple(machine.joint_tables)
        moved, joints = machine.kinematics.axes, machine.kinematics.joints
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
        found = self.series([Series([column]) for column in tip.T])
        return np.stack([np.asarray(series.terms[0]) for series in found], axis=-1)

    def leaving(self, start: Floats, end: Floats) -> tuple[NDArray[np.bool_], Floats]:
        """Return the straight moves out of a singular pose on which the joints stay linear.

        Args:
            start: Tips at which moves begin (m, axes).
            end: Tips at which they end.

        Returns:
            Whether each move is such a move (m,), and the joints at its start (m, joints).
        """
        taken = list(self._taken)
        found, own = self._kinematics.leaving(start[:, taken], end[:, taken])
        joints = np.empty((len(start), len(self.names)))
        joints[:, list(self._own)] = own
        joints[:, list(self._rest)] = start[:, list(self._others)]
        return found, joints

    def forward(self, joints: Floats) -> Floats:
        """Return the tips (m, axes) of joints (m, joints)."""
        tip = np.empty((len(joints), len(self._taken) + len(self._others)))
        tip[:, self._others] = joints[:, self._rest]
        own = self._kinematics.forward([joints[:, k] for k in self._own])
        for axis, column in zip(self._taken, own, strict=True):
            tip[:, axis] = column
        return tip


def _of_five(table: tables.FiveAxis, letters: tuple[str, ...], offset: Point | None) -> JointMap:
    """Return the joints of a five-axis machine; without an offset they are the axes."""
    head = table.type.endswith("-head")
    sign = {letter: -1.0 if letter in table.reverse else 1.0 for letter in table.tip_axes}
    tilt = Rotation(
        0 if table.tilting == "a" else 1,
        table.tilt_point,
        not head and not table.type.endswith("-head-table"),
        sign[table.tilting],
    )
    turn = Rotation(2, table.turn_point, not head, sign["c"])
    taken = [letters.index(letter) for letter in table.tip_axes]
    kinematics = Bare() if offset is None else FiveAxis(tilt, turn, offset)
    others = [k for k in range(len(letters)) if k not in taken]
    found = JointMap(kinematics, taken, taken, others, letters)
    found._table, found._letters = table, letters
    return found


def _formula(table: KinematicsTable) -> Kinematics | None:
    """Return the formulas of a kinematics; None where the axes are the joints."""
    match table:
        case tables.CoreXY() | tables.CoreXZ():
            return Belts()
        case tables.Polar():
            return Polar()
        case tables.Scara():
            return Scara(table.arms, left=table.elbow == "left")
        case tables.Delta():
            return LinearDelta(table.radius, table.rod, table.angles)
        case tables.RotaryDelta():
            return RotaryDelta(table.base, table.platform, table.arm, table.rod, table.angles)
        case tables.Cylinder():
            return Cylinder(table.radius)
        case tables.Custom():
            return _registered(table)
        case _:
            return None


GROUP = "cnc.kinematics"
"""Group of the entry points of kinematics."""


def _registered(table: tables.Custom) -> Kinematics:
    """Return the formulas of a class that an installed package registers.

    Raises:
        MachineFileError: ``kinematics-unknown``, ``kinematics-parameters``.
    """
    found = {each.name: each for each in entry_points(group=GROUP)}
    entry = found.get(table.name)
    if entry is None:
        names = ", ".join(sorted(found)) or "none"
        message = f"no installed package has the kinematics {table.name!r}"
        hint = f"registered in the entry point group {GROUP}: {names}"
        raise MachineFileError(Diagnostic("kinematics-unknown", message, hint=hint))
    try:
        kinematics = entry.load()(**table.parameters)
    except Exception as error:  # the code of a user may raise anything
        message = f"the kinematics {table.name!r} does not take its parameters: {error}"
        hint = "correct [kinematics] parameters in the machine file, or the class"
        raise MachineFileError(Diagnostic("kinematics-parameters", message, hint=hint)) from None
    if not isinstance(kinematics, Kinematics) or len(kinematics.turning) != len(table.of_joints):
        message = f"{table.name!r} is not a Kinematics with {len(table.of_joints)} joints"
        hint = "derive the class from cnc.kinematics.base.Kinematics, with its own turning"
        raise MachineFileError(Diagnostic("kinematics-parameters", message, hint=hint))
    return kinematics
