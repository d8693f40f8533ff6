"""What a machine is: axes, limits of the path, board, and how its programs are to be read. Frozen;
an unknown key is an error.

Lengths are mm (degrees for rotary axes), times s. A limit that is absent is not a limit: a machine
with ``max_acceleration`` on its axes need not have one on its path, and the other way round, but
one of the two has to bound every axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from cnc.model.choices import DialectName

AxisLetter = Literal["x", "y", "z", "a", "b", "c", "u", "v", "w"]
AXIS_LETTERS: tuple[AxisLetter, ...] = get_args(AxisLetter)

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


def _tuple(value: Any) -> Any:
    """TOML arrays are lists; the frozen models hold tuples."""
    return tuple(value) if isinstance(value, list) else value


def _path(value: Any) -> Any:
    """TOML knows no paths."""
    return Path(value) if isinstance(value, str) and value else value


def _rises(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError("must be [lowest, highest]")
    return ends


FilePath = Annotated[Path, BeforeValidator(_path)]
Span = Annotated[tuple[FiniteFloat, FiniteFloat], BeforeValidator(_tuple), AfterValidator(_rises)]
"""Lowest and highest coordinate."""


class _Section(BaseModel):
    """A table of the machine file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Homing(_Section):
    """How an axis finds its limit switch.

    ``end``: of the travel, at which the switch is; None for the high one of Z and the low one of
    the others. ``seek`` and ``latch`` mm/s: the speeds of looking for it and of finding its place.
    ``pull_off`` mm: how far off the switch the axis rests in the end. ``position``: machine
    coordinate of that place, mm; None for the travel's end.
    """

    end: Literal["low", "high"] | None = None
    seek: Positive = 8.0
    latch: Positive = 0.5
    pull_off: Positive = 1.0
    position: FiniteFloat | None = None


class Axis(_Section):
    """One axis.

    ``steps_per_mm`` steps/mm (its inverse is the basic length unit, BLU); ``max_velocity`` mm/s;
    ``max_acceleration`` mm/s^2 and ``max_jerk`` mm/s^3, None where the path alone limits them;
    ``travel`` lowest and highest machine coordinate, None without soft limits; ``invert`` turns the
    direction pin; ``homing`` how it finds its place, None where the file does not say.
    """

    steps_per_mm: Positive
    max_velocity: Positive
    max_acceleration: Positive | None = None
    max_jerk: Positive | None = None
    travel: Span | None = None
    invert: bool = False
    homing: Homing | None = None

    @property
    def step_rate(self) -> float:
        """Steps a second at ``max_velocity``."""
        return self.max_velocity * self.steps_per_mm


class PathLimits(_Section):
    """Limits along the path, and the accuracy that is asked for.

    ``max_feed`` mm/s; ``max_tangential_acceleration`` and ``max_normal_acceleration`` mm/s^2 and
    ``max_jerk`` mm/s^3 (tangential), None where the axes alone limit them; ``chord_error`` mm,
    between the path and the straight line over one ``period`` s; ``tolerance`` mm, of corners and
    smoothing under G64 without P (0: exact path); ``step_deviation``, relative: by how much the
    straight line over one period may be shorter than the path there, None where it may by what the
    other limits leave.
    """

    max_feed: Positive = 500.0
    max_tangential_acceleration: Positive | None = None
    max_normal_acceleration: Positive | None = None
    max_jerk: Positive | None = None
    chord_error: Positive = 0.001
    tolerance: NonNegative = 0.01
    period: Positive = 0.001
    step_deviation: Positive | None = None


InputName = Literal["limits", "probe", "emergency-stop", "hold", "resume"]
"""What switches may hang on at the stepper board; ``limits`` are those of all axes."""
PulseTime = Annotated[FiniteFloat, Field(gt=0, le=60e-6)]
"""Seconds, as far as the board's 8-bit timer reaches."""


class Board(_Section):
    """What takes the motion. ``max_step_rate`` steps/s is the fastest that one axis can be stepped
    at.

    The others are for the stepper board; boards that run GRBL have them as settings.
    ``max_spindle_rpm``: the speed at which a spindle driven by PWM turns with the output always on
    (D11). ``normally_closed``: inputs whose switch is closed until it is pressed, so that a wire
    that breaks counts as pressed, too (limits: GRBL's $5 = 1, probe: $6 = 1). ``invert_enable``:
    the drivers are on while D8 is high ($4 = 1). ``step_pulse`` s, how long a step pin stays high
    ($0), and low after that; ``direction_setup`` s, from a direction to a step.
    """

    kind: Annotated[str, Field(min_length=1)] = "loopback"
    port: str | None = None
    baud: Annotated[int, Field(gt=0)] = 115200
    max_step_rate: Positive = 200_000.0
    max_spindle_rpm: Positive = 1000.0
    normally_closed: Annotated[tuple[InputName, ...], BeforeValidator(_tuple)] = ()
    invert_enable: bool = False
    step_pulse: PulseTime = 5e-6
    direction_setup: PulseTime = 5e-6


class Program(_Section):
    """How programs are read: dialect, limits, and the files that belong to the machine (relative to
    the machine file).

    ``tool_table`` and ``parameters`` are written back after a run that changed them;
    ``subroutines`` are folders that are searched after the program's own. ``max_repeated_lines`` is
    how many lines loops and calls may execute again, ``max_call_depth`` how deep calls may be
    nested: what goes beyond is taken for a program without end.
    """

    dialect: DialectName = "auto"
    tool_table: FilePath | None = None
    parameters: FilePath | None = None
    subroutines: Annotated[tuple[FilePath, ...], BeforeValidator(_tuple)] = ()
    max_repeated_lines: Annotated[int, Field(gt=0)] = 2_000_000
    max_call_depth: Annotated[int, Field(gt=0, le=1000)] = 100

    def files(self) -> Iterator[tuple[str, Path]]:
        """Key and path of what has to be there; the parameter file is made by the first run."""
        if self.tool_table is not None:
            yield "tool_table", self.tool_table
        for path in self.subroutines:
            yield "subroutines", path


class HomingOrder(_Section):
    """Which axes look for their switches, one after the other: ``order``, None for Z first and then
    the others as the file has them.
    """

    order: Annotated[tuple[AxisLetter, ...], BeforeValidator(_tuple)] | None = None


class Stock(_Section):
    """The raw part on the machine: a box, machine coordinates in mm."""

    x: Span
    y: Span
    z: Span


class Machine(_Section):
    """A machine; ``axes`` in the order of the file, which is the order of the columns of every
    position.
    """

    name: str = "machine"
    axes: Annotated[dict[AxisLetter, Axis], Field(min_length=1)]
    path: PathLimits = PathLimits()
    board: Board = Board()
    program: Program = Program()
    homing: HomingOrder | None = None
    stock: Stock | None = None

    @property
    def can_home(self) -> bool:
        """Whether the file says that the machine has switches to find its place by."""
        return self.homing is not None or any(
            axis.homing is not None for axis in self.axes.values()
        )

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, one a column of every position."""
        return tuple(self.axes)

    @property
    def steps_per_mm(self) -> NDArray[np.float64]:
        """Steps per millimetre (degree) of each axis, a new array (axes,)."""
        return np.array([axis.steps_per_mm for axis in self.axes.values()], dtype=np.float64)

    def inconsistencies(self) -> Iterator[tuple[tuple[str, ...], str, str]]:
        """What is wrong between the keys, each with its place, a message and a hint; nothing for a
        machine that can run.
        """
        for letter, axis in self.axes.items():
            if axis.step_rate > self.board.max_step_rate * (1 + 1e-12):
                yield (
                    ("axes", letter, "max_velocity"),
                    f"{axis.max_velocity:g} mm/s at {axis.steps_per_mm:g} steps/mm is {axis.step_rate:.0f} steps/s, "
                    f"but board.max_step_rate is {self.board.max_step_rate:.0f}",
                    f"lower it to {self.board.max_step_rate / axis.steps_per_mm:g}, or raise board.max_step_rate if the board can do it",
                )
            if axis.max_acceleration is None and (
                self.path.max_tangential_acceleration is None
                or self.path.max_normal_acceleration is None
            ):
                yield (
                    ("axes", letter, "max_acceleration"),
                    "nothing limits the acceleration of this axis",
                    f"set axes.{letter}.max_acceleration, or path.max_tangential_acceleration and path.max_normal_acceleration",
                )
            if axis.max_jerk is None and self.path.max_jerk is None:
                yield (
                    ("axes", letter, "max_jerk"),
                    "nothing limits the jerk of this axis",
                    f"set axes.{letter}.max_jerk, or path.max_jerk",
                )
        for letter, axis in self.axes.items():
            place = None if axis.homing is None else axis.homing.position
            if (
                place is not None
                and axis.travel is not None
                and not axis.travel[0] <= place <= axis.travel[1]
            ):
                ends = f"{axis.travel[0]:g} to {axis.travel[1]:g} mm"
                yield (
                    ("axes", letter, "homing", "position"),
                    f"{place:g} lies outside the travel, {ends}",
                    "the axis rests there",
                )
        for letter in (self.homing.order or ()) if self.homing is not None else ():
            if letter not in self.axes:
                yield (
                    ("homing", "order"),
                    f"the machine has no axis {letter}",
                    f"its axes are {', '.join(self.axes)}",
                )
        if self.stock is not None and not {"x", "y", "z"} <= self.axes.keys():
            yield ("stock",), "the machine has not the axes x, y and z", "take the table out"
