"""Homing cycles of the axes: their order, directions and places of rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.machine.kinematics import OfJoints
from cnc.machine.models import Homing, Machine, switch_end
from cnc.model.blocks import ROTARY_LETTERS, AxisLetter
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.planner.joints import Joints


@dataclass(frozen=True, slots=True)
class AxisHoming:
    """The homing cycle of an axis.

    Attributes:
        column: Column of the axis.
        letter: Letter of the axis.
        towards: Direction of the switch, +1 or -1.
        rest: Coordinate at the end of the cycle, mm.
        longest: Longest distance of the search for the switch, mm.
        settings: Settings of the machine file.
        offsets: Coordinate of each motor's switch less that of the first motor's, mm.
        angular: Whether the unit is the degree.
    """

    column: int
    letter: AxisLetter
    towards: int
    rest: float
    longest: float
    settings: Homing
    offsets: tuple[float, ...] = (0.0,)
    angular: bool = False

    @property
    def description(self) -> str:
        """Description of the cycle for the operator."""
        letter, settings = self.letter.upper(), self.settings
        direction = "up" if self.towards > 0 else "down"
        unit = "°" if self.angular else "mm"
        return (
            f"{letter}: {direction} to its switch, at most {self.longest:g} {unit} at "
            f"{settings.seek:g} {unit}/s, then once more at {settings.latch:g} {unit}/s; "
            f"{settings.pull_off:g} {unit} off it is {letter}{self.rest:g}"
            + (f"; {len(self.offsets)} motors are squared" if len(self.offsets) > 1 else "")
        )

    @classmethod
    def of(cls, machine: Machine, letter: AxisLetter) -> AxisHoming:
        """Return the cycle of an axis.

        Raises:
            UsageError: ``homing-travel``, for an axis without travel, because the search must end.
        """
        axis = machine.axes[letter]
        settings = axis.homing or Homing()
        if machine.is_sensorless(letter):
            # A slow motor does not tell that it stalls.
            settings = settings.model_copy(update={"latch": settings.seek})
        if axis.travel is None:
            hint = f"write axes.{letter}.travel = [lowest, highest] into the machine file"
            raise UsageError(
                Diagnostic(
                    "homing-travel",
                    f"{letter.upper()} has no travel, so the distance of its switch is not known",
                    hint=hint,
                )
            )
        towards = switch_end(letter, settings)
        near, far = (axis.travel[1], axis.travel[0]) if towards > 0 else axis.travel
        rest = near if settings.position is None else settings.position
        longest = abs(rest - far) + 2.0 * settings.pull_off
        return cls(
            tuple(machine.axes).index(letter),
            letter,
            towards,
            rest,
            longest,
            settings,
            tuple(motor.offset for motor in axis.motors),
            # A joint of another kinematics may have the letter of a rotary axis.
            letter in ROTARY_LETTERS and not isinstance(machine.kinematics, OfJoints),
        )


def homing_sequence(
    machine: Machine, axes: Sequence[str] = (), switches: int = 3
) -> tuple[AxisHoming, ...]:
    """Return the homing cycles of axes in their order.

    Args:
        machine: The machine.
        axes: Letters of the axes; all that have a switch if there are none.
        switches: Number of axes, from the first one, that have a switch on the board.

    Raises:
        UsageError: ``unknown-axis``, ``no-switch``, ``homing-travel``.
    """
    letters = tuple(machine.axes)
    known = letters[:switches]
    named = {axis.lower() for axis in axes}
    for axis in sorted(named):
        if axis not in letters:
            raise UsageError(
                Diagnostic(
                    "unknown-axis",
                    f"the machine has no axis {axis}",
                    hint=f"its axes are {', '.join(letters)}",
                )
            )
    order = machine.homing.order if machine.homing is not None else None
    if order is None:
        order = tuple(sorted(known, key=lambda letter: letter != "z"))
    wanted = [letter for letter in order if not named or letter in named]
    wanted += [letter for letter in letters if letter in named and letter not in wanted]
    for letter in wanted:
        if letter not in known:
            hint = (
                f"the board has switches for {', '.join(known)}; "
                f"remove {letter} from the command or from homing.order"
            )
            raise UsageError(
                Diagnostic(
                    "no-switch", f"the board has no limit switch for {letter.upper()}", hint=hint
                )
            )
    return tuple(AxisHoming.of(machine, letter) for letter in wanted)


def homed_steps(
    machine: Machine,
    cycles: Iterable[AxisHoming],
    standing: Sequence[int | None],
    start: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the grid point (joints,) of the machine after homing.

    Args:
        machine: The machine.
        cycles: Homing cycles.
        standing: Grid point of each joint before, None where it is not known.
        start: Position (axes,) of the tip that is assumed where that of a joint is not known, mm.
    """
    joints = Joints(machine)
    scale = joints.machine.steps_per_mm
    assumed = np.round(joints.at(start) * scale).astype(np.int64)
    steps = np.array(
        [
            other if known is None else known
            for known, other in zip(standing, assumed.tolist(), strict=True)
        ],
        np.int64,
    )
    if not joints.linear:
        for cycle in cycles:
            steps[cycle.column] = round(cycle.rest * float(scale[cycle.column]))
        return steps
    tip = joints.tip(steps / scale)
    for cycle in cycles:
        tip[cycle.column] = on_grid(machine, cycle, cycle.rest)
    return np.rint(joints.at(tip) * scale).astype(np.int64)


def on_grid(machine: Machine, cycle: AxisHoming, place: float) -> float:
    """Return the place of an axis that is a whole number of its steps, mm."""
    scale = float(machine.steps_per_mm[cycle.column])
    return round(place * scale) / scale
