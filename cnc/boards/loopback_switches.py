"""The loopback board with simulated limit switches, which rehearses homing and squaring.

On CoreXY and CoreXZ a switch follows its axis, which both motors move; elsewhere it follows its
motor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from cnc.boards.loopback import Loopback
from cnc.boards.protocols import Capabilities
from cnc.kinematics.planar import CoreXY, CoreXZ
from cnc.machine.models import Homing, Machine, switch_end
from cnc.model.blocks import Block, SwitchMove
from cnc.model.streams import PulseChunk

SwitchPlaces = Mapping[tuple[int, int], tuple[int, float]]
"""Direction and place of the switch of each motor (column, motor), in steps of that motor from its
place when the board is opened; on CoreXY and CoreXZ of each axis (column, 0), in mm.
"""
ROUNDING = 1e-9
"""mm."""


class SwitchedLoopback(Loopback):
    """A loopback board in which each motor of an axis has a limit switch.

    Args:
        machine: The machine.
        places: The switches. Without it the leading axes that have a travel have theirs, and the
            machine stands at zero or at the nearest point of the travel.
    """

    def __init__(self, machine: Machine, places: SwitchPlaces | None = None) -> None:
        joints = machine.of_joints
        super().__init__(
            len(joints.axes),
            1e9 / machine.board.max_step_rate,
            motors=[len(axis.motors) for axis in joints.axes.values()],
        )
        self.places = dict(switch_places(machine) if places is None else places)
        self._moved_by = _moved_by(machine)
        self._scale = joints.steps_per_mm
        self._known: tuple[bool, ...] = (False,) * self.axes
        self._armed: SwitchMove | None = None
        self._cut = False

    @property
    def capabilities(self) -> Capabilities:
        """Those of the loopback board, with limit switches."""
        return replace(super().capabilities, limit_switches=True)

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis; None before it is homed."""
        steps = self.position_steps.tolist()
        return tuple(s if k else None for s, k in zip(steps, self._known, strict=True))

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis that has one is closed, in the order of the motors."""
        return tuple(
            tuple(self._closed(column, motor) for motor in self._motors(column))
            for column in sorted({column for column, _ in self.places})
        )

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Take over which positions are known; no switch ends another axis' motion."""
        self._known = tuple(known)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Record the block; a move to a switch ends where the switch changes."""
        expected = super().execute(block, time_ns)
        if not isinstance(block, SwitchMove):
            return expected
        self._armed, self._cut = block, False
        return None

    def send(self, chunk: PulseChunk) -> None:
        """Check and count grid moves, up to the change of the switch that is armed."""
        if self._cut:
            return
        rows = len(chunk.step) if self._armed is None else self._rows_to_change(self._armed, chunk)
        self._cut = rows < 0
        rows = abs(rows)
        super().send(PulseChunk(chunk.time_ns[:rows], chunk.step[:rows], chunk.line[:rows]))

    def probe_result(self) -> tuple[float, ...] | None:
        """Return whether the last move to a switch reached it, and the position, mm."""
        if self._armed is None:
            return None
        reached, self._armed, self._cut = self._cut, None, False
        return (float(reached), *(self.position_steps / self._scale).tolist())

    def _motors(self, column: int) -> list[int]:
        """Return the motors that have a switch in a column."""
        return sorted(motor for each, motor in self.places if each == column)

    def _closed(self, column: int, motor: int, ahead: float = 0.0) -> bool:
        """Return whether a switch is closed; ``ahead`` is a further travel of its axis."""
        towards, at = self.places[column, motor]
        shares = self._moved_by[column].items()
        here = sum(share * self.motor_steps[joint][motor] for joint, share in shares)
        return bool((here + ahead - at) * towards >= -ROUNDING)

    def _rows_to_change(self, block: SwitchMove, chunk: PulseChunk) -> int:
        """Return the number of rows to the change of a switch, negative; all rows without one."""
        column, count = block.switch, len(chunk.step)
        motors = self._motors(column) if block.motor is None else (block.motor,)
        travel = sum(share * chunk.step[:, k] for k, share in self._moved_by[column].items())
        ways = np.cumsum(travel).tolist()
        first = count + 1
        for motor in motors:
            if self._alone in (None, (column, motor)):
                changed = (
                    row
                    for row, way in enumerate(ways, 1)
                    if self._closed(column, motor, way) == block.towards
                )
                first = min(first, next(changed, count + 1))
        return -first if first <= count else count


def switch_places(machine: Machine) -> SwitchPlaces:
    """Return the switches of the leading axes that have a travel, as homing settings place them."""
    places: dict[tuple[int, int], tuple[int, float]] = {}
    belts = machine.kinematics.axes if isinstance(machine.kinematics, CoreXY | CoreXZ) else ()
    axes = machine.axes if belts else machine.of_joints.axes
    for column, (letter, axis) in enumerate(axes.items()):
        if axis.travel is None:
            break
        settings = axis.homing or Homing()
        towards = switch_end(letter, settings)
        rest = axis.travel[1 if towards > 0 else 0]
        rest = rest if settings.position is None else settings.position
        stands = min(max(0.0, axis.travel[0]), axis.travel[1])
        for motor, each in enumerate(axis.motors):
            at = rest + towards * settings.pull_off + each.offset - stands
            in_steps = letter not in belts
            places[column, motor] = towards, round(at * axis.steps_per_mm) if in_steps else at
    return places


def _moved_by(machine: Machine) -> list[dict[int, float]]:
    """Return by which joints each axis with a switch moves: its travel for a step of each joint.

    That is one step of its own joint. Belts move it by mm: x = (a + b) / 2, y = (a - b) / 2.
    """
    kinematics, joints = machine.kinematics, machine.of_joints
    names = [str(name) for name in joints.axes]
    if not isinstance(kinematics, CoreXY | CoreXZ):
        return [{column: 1} for column in range(len(names))]
    a, b = (names.index(each) for each in kinematics.joints)
    half_a, half_b = 0.5 / joints.steps_per_mm[a], 0.5 / joints.steps_per_mm[b]
    first, second = kinematics.axes
    belts = {first: {a: half_a, b: half_b}, second: {a: half_a, b: -half_b}}
    return [belts[name] if name in belts else {names.index(name): 1} for name in machine.axes]
