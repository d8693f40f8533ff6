"""The joints of a machine: their positions, their path, and the columns of a path.

The kinematics is loaded only for a machine whose joints are not its axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.five_axis import FiveAxis
from cnc.machine.models import Machine
from cnc.model.blocks import ROTARY_LETTERS, Block
from cnc.model.diagnostics import Diagnostic, MachineFileError
from cnc.path.chunk import PathChunk
from cnc.planner.limits import Limits

if TYPE_CHECKING:
    from cnc.kinematics.orientation import Swing
    from cnc.planner.joint_map import JointMap

Floats = NDArray[np.float64]

WHERE = "write into [machine] start where the machine stands"
SAME = 1e-3
"""Joints that differ by less are the same pose, mm or degrees."""
SHORT_LEGS = 4
"""So many vertices in a row are no curve, however short their legs are."""


class Joints:
    """The joints of a machine.

    Args:
        machine: The machine.

    Attributes:
        machine: A machine whose axes are the joints, for pulses and boards.
        tip_columns: Number of columns of the tool tip in front of those of the joints in a path; 0
            where the axes are the joints.
        tip_axes: Letters of the axes, which are the columns of a tip.
        linear: Whether the joints are a linear function of the tip.
        short_legs: Most vertices in a row with short legs in a polygon whose legs stay straight;
            None where the ramps beside a stop are not straight. Where the jerk of an axis is
            limited, one motion passes several corners, so it is SHORT_LEGS; else blends need longer
            legs.
        angular: Whether each joint turns: its unit is the degree.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine.of_joints
        self.tip_axes = machine.axis_names
        self._map: JointMap | None = None
        if machine.tip_columns:
            from cnc.planner.joint_map import JointMap

            self._map = JointMap.of(machine)
            self._limits = Limits.of_tip(machine)
        self.tip_columns = machine.tip_columns
        self.linear = self._map is None or self._map.linear
        self.short_legs: int | None = None
        if self.linear:
            by_axis = any(axis.max_jerk is not None for axis in machine.axes.values())
            self.short_legs = SHORT_LEGS if by_axis or machine.path.max_jerk is None else 0
        self.angular = tuple(letter in ROTARY_LETTERS for letter in self.tip_axes)
        if self._map is not None:
            self.angular = self._map.angular

    def at(self, tip: Floats) -> Floats:
        """Return the joints (joints,) at a position of the tip (axes,); mm, degrees.

        Raises:
            MachineFileError: ``start-out-of-reach`` where the joints do not reach it.
        """
        if self._map is None:
            return tip
        if not self.reach(tip):
            each = zip(self.tip_axes, tip.tolist(), strict=True)
            place = " ".join(f"{letter.upper()}{value:g}" for letter, value in each)
            message = f"the joints do not reach the start position {place}"
            hint = f"{WHERE}, or correct [kinematics]"
            raise MachineFileError(Diagnostic("start-out-of-reach", message, hint=hint))
        found: Floats = self._map.inverse(tip[None])[0]
        return found

    def tip_of_start(self, joints: Floats) -> Floats:
        """Return the tip (axes,) at the joints (joints,) of the machine file; mm, degrees.

        Raises:
            MachineFileError: ``start-out-of-reach`` where the machine never has these joints.
        """
        tip = self.tip(joints)
        if not np.allclose(self.at(tip), joints, rtol=0.0, atol=1e-6):
            each = zip(self.machine.axes, joints.tolist(), strict=True)
            place = " ".join(f"{name} = {value:g}" for name, value in each)
            message = f"the joints of the start are no pose of this kinematics: {place}"
            hint = "angles lie within half a turn of 0; an elbow bends to one side only"
            raise MachineFileError(Diagnostic("start-out-of-reach", message, hint=hint))
        return tip

    def determined(self, joints: Floats) -> bool:
        """Return whether the tip determines the joints (joints,): not at the pole of a table."""
        if self._map is None:
            return True
        apart = self.at(self.tip(joints)) - joints
        apart[self._map.turning] = (apart[self._map.turning] + 180.0) % 360.0 - 180.0
        return bool(np.abs(apart).max() < SAME)

    def reach(self, tip: Floats) -> bool:
        """Return whether the joints reach a position of the tip (axes,)."""
        return self._map is None or bool(np.isfinite(self._map.inverse(tip[None])).all())

    def tip(self, joints: Floats) -> Floats:
        """Return the tip (axes,) at a position of the joints (joints,); mm, degrees."""
        found: Floats = self.tips(joints[None])[0]
        return found

    def tips(self, joints: Floats) -> Floats:
        """Return the tips (n, axes) at positions of the joints (n, joints); mm, degrees."""
        return joints if self._map is None else self._map.forward(joints)

    def with_tool(self, offset: tuple[float, float, float] | None) -> Joints:
        """Return the joints under tool-tip control, or without it for None.

        Args:
            offset: Offset of the tool along X, Y and Z, mm.
        """
        other = copy(self)
        other._map = None if self._map is None else self._map.with_tool(offset)
        return other

    def columns(self, tip: Floats) -> Floats:
        """Return a position in the columns of a path: the tip, then the joints if they differ."""
        return tip if self._map is None else np.concatenate((tip, self.at(tip)))

    def path(
        self, stream: Iterator[PathChunk | Block], start: Floats, *, certain: bool = True
    ) -> Iterator[PathChunk | Block]:
        """Yield a path of the tip with the columns of the joints, if they are not the axes.

        Args:
            stream: The path.
            start: The tip before the path (axes,), mm.
            certain: Where the tip leaves a joint free, as at the pole of a table, it stands at 0.

        Raises:
            MotionLimitError: ``out-of-reach`` or ``singular-pose``.
        """
        if self._map is None:
            return stream
        from cnc.planner.joint_path import JointPath

        joints = self.at(start)
        return JointPath(self._map, start, joints, self._limits, leaves=certain).passed(stream)


class ToolTipOf:
    """Positions of joints and tip of a machine with tool-tip control, for the language."""

    def __init__(self, bare: JointMap, table: FiveAxis, letters: tuple[str, ...]) -> None:
        self._bare = bare
        self.rotary = letters.index(table.tilting), letters.index("c")
        signs = [-1.0 if name in table.reverse else 1.0 for name in (table.tilting, "c")]
        self._signs = signs[0], signs[1]
        self._shift = 90.0 if table.tilting == "a" else 0.0
        self.points_missing = tuple(
            name for name in ("tilt_point", "turn_point") if name not in table.model_fields_set
        )

    @classmethod
    def machine(cls, machine: Machine) -> ToolTipOf | None:
        """Return the positions of a machine; None for one without tool-tip control."""
        if not machine.kinematics.with_tip_control:
            return None
        from cnc.planner.joint_map import JointMap

        bare = JointMap.of(machine)
        assert bare is not None
        assert isinstance(machine.kinematics, FiveAxis)
        return cls(bare, machine.kinematics, machine.axis_names)

    def joints(self, tip: list[float], offset: tuple[float, float, float]) -> list[float]:
        """Return the joints (axes,) of a tip (axes,) with a tool offset (X, Y, Z)."""
        found: list[float] = self._bare.with_tool(offset).inverse(np.array([tip]))[0].tolist()
        return found

    def tip(self, joints: list[float], offset: tuple[float, float, float]) -> list[float]:
        """Return the tip (axes,) of joints (axes,) with a tool offset (X, Y, Z)."""
        found: list[float] = self._bare.with_tool(offset).forward(np.array([joints]))[0].tolist()
        return found

    def angles(self, here: list[float], direction: Floats) -> tuple[float, float]:
        """Return tilt and turn of a direction of the tool (3,), from a position (axes,)."""
        from cnc.kinematics.orientation import angles_of

        tilt, turn = angles_of(self._effective(here), direction, self._shift)
        return tilt * self._signs[0], turn * self._signs[1]

    def swing(self, here: list[float], direction: Floats) -> Swing | None:
        """Return the great circle from a position (axes,) to a direction of the tool (3,)."""
        from cnc.kinematics.orientation import swing

        found = swing(self._effective(here), direction, self._shift)
        if found is None:
            return None
        signs = self._signs
        end = found.end[0] * signs[0], found.end[1] * signs[1]
        angles = found.angles if not len(found.angles) else found.angles * np.array(signs)
        return found._replace(end=end, angles=angles)

    def _effective(self, here: list[float]) -> tuple[float, float]:
        """Return tilt and turn of a position (axes,) in the directions of ISO 841."""
        tilt, turn = self.rotary
        return here[tilt] * self._signs[0], here[turn] * self._signs[1]
