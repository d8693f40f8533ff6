"""The loopback board with simulated limit switches, which rehearses homing and squaring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cnc.boards.loopback import Loopback
from cnc.machine.models import Homing, Machine, switch_end
from cnc.model.blocks import Block, SwitchMove
from cnc.model.streams import PulseChunk

SwitchPlaces = Mapping[tuple[int, int], tuple[int, float]]
"""Direction and place of the switch of each motor (column, motor), in steps of that motor from its
place when the board is opened.
"""


class SwitchedLoopback(Loopback):
    """A loopback board in which each motor of an axis has a limit switch.

    Args:
        machine: The machine; its axes are the joints.
        places: The switches. Without it the leading axes that have a travel have theirs, and the
            machine stands at zero or at the nearest point of the travel.
    """

    def __init__(self, machine: Machine, places: SwitchPlaces | None = None) -> None:
        super().__init__(
            len(machine.axes),
            1e9 / machine.board.max_step_rate,
            motors=[len(axis.motors) for axis in machine.axes.values()],
        )
        self.places = dict(switch_places(machine) if places is None else places)
        self._scale = machine.steps_per_mm
        self._known: tuple[bool, ...] = (False,) * self.axes
        self._armed: SwitchMove | None = None
        self._cut = False

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis; None before it is homed."""
        steps = self.position_steps.tolist()
        return tuple(s if k else None for s, k in zip(steps, self._known, strict=True))

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis that has one is closed, in the order of the motors."""
        return tuple(
            tuple(self._closed(column, motor) for motor in range(len(motors)))
            for column, motors in enumerate(self.motor_steps)
            if (column, 0) in self.places
        )

    @property
    def switches(self) -> tuple[bool, ...]:
        """Whether a switch of each axis that has one is closed."""
        return tuple(any(each) for each in self.motor_switches)

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

    def _closed(self, column: int, motor: int, ahead: int = 0) -> bool:
        towards, at = self.places[column, motor]
        return bool((self.motor_steps[column][motor] + ahead - at) * towards >= 0)

    def _rows_to_change(self, block: SwitchMove, chunk: PulseChunk) -> int:
        """Return the number of rows to the change of a switch, negative; all rows without one."""
        column, count = block.switch, len(chunk.step)
        motors = range(len(self.motor_steps[column])) if block.motor is None else (block.motor,)
        ways = np.cumsum(chunk.step[:, column], dtype=np.int64).tolist()
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
    for column, (letter, axis) in enumerate(machine.axes.items()):
        if axis.travel is None:
            break
        settings = axis.homing or Homing()
        towards = switch_end(letter, settings)
        rest = axis.travel[1 if towards > 0 else 0]
        rest = rest if settings.position is None else settings.position
        stands = min(max(0.0, axis.travel[0]), axis.travel[1])
        for motor, each in enumerate(axis.motors):
            at = rest + towards * settings.pull_off + each.offset - stands
            places[column, motor] = towards, round(at * axis.steps_per_mm)
    return places
