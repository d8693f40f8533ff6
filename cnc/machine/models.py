"""The machine: axes, path limits, board, and the reading of programs, as pydantic models.

The models are frozen. An unknown key is an error. Lengths are in mm (degrees for rotary axes),
times in s. A limit that is absent does not limit. The acceleration and the jerk of each axis need a
limit of the axis itself or of the path.

The descriptions of the fields are those in the JSON Schema of the machine file
(:func:`cnc.machine.schema.machine_schema`) and in the reference.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, FiniteFloat

from cnc.machine.kinematics import Cartesian, KinematicsTable, OfJoints
from cnc.machine.program_codes import Codes, RunFile
from cnc.machine.section import FilePath, Section
from cnc.model.blocks import AxisLetter
from cnc.model.choices import DialectName, GcodeSystem, MachineKind

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]

RATE_ROUNDING = 1e-12
"""Relative rounding error that the product of a speed and a resolution may have."""


def _tuple(value: Any) -> Any:
    """Return a TOML array as a tuple, because the frozen models hold tuples."""
    return tuple(value) if isinstance(value, list) else value


def _ascending(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError("must be [lowest, highest]")
    return ends


Span = Annotated[
    tuple[FiniteFloat, FiniteFloat], BeforeValidator(_tuple), AfterValidator(_ascending)
]
"""Lowest and highest coordinate."""


class Header(Section):
    """The machine file's statements about itself."""

    name: str = Field(default="machine", description="Name of the machine, for reports.")
    kind: MachineKind = Field(
        default="mill",
        description=(
            "Kind of machine. The power of a laser (S) changes during motion. A program that is "
            "evidently for another kind is refused."
        ),
    )


class Homing(Section):
    """How an axis finds its limit switch."""

    end: Literal["low", "high"] | None = Field(
        default=None,
        description=(
            "End of the travel at which the switch is. Without it: high for Z, low for the others."
        ),
    )
    seek: Positive = Field(default=8.0, description="Speed of the search for the switch, mm/s.")
    latch: Positive = Field(
        default=0.5,
        description=(
            "Speed of the second approach, which measures the position of the switch, mm/s."
        ),
    )
    pull_off: Positive = Field(
        default=1.0, description="Distance from the switch at which the axis comes to rest, mm."
    )
    position: FiniteFloat | None = Field(
        default=None,
        description=(
            "Machine coordinate of that position of rest, mm. Without it: the end of the travel."
        ),
    )


class Axis(Section):
    """One axis. Its inverse resolution is the basic length unit (BLU)."""

    steps_per_mm: Positive = Field(description="Steps per mm (per degree for a rotary axis).")
    max_velocity: Positive = Field(description="Highest speed, mm/s.")
    max_acceleration: Positive | None = Field(
        default=None,
        description="Highest acceleration, mm/s^2. Without it, the limits of the path are needed.",
    )
    max_jerk: Positive | None = Field(
        default=None,
        description="Highest jerk, mm/s^3. Without it, the limit of the path is needed.",
    )
    travel: Span | None = Field(
        default=None,
        description=(
            "Soft limits: lowest and highest machine coordinate, mm. Without them, none are "
            "checked."
        ),
    )
    invert: bool = Field(
        default=False, description="Whether the level of the direction pin is inverted."
    )
    homing: Homing | None = Field(
        default=None,
        description="How the axis finds its limit switch. Without it, the defaults hold.",
    )

    @property
    def step_rate(self) -> float:
        """Steps per second at ``max_velocity``."""
        return self.max_velocity * self.steps_per_mm


class PathLimits(Section):
    """Limits along the path, and the required accuracy."""

    max_feed: Positive = Field(default=500.0, description="Highest speed along the path, mm/s.")
    max_tangential_acceleration: Positive | None = Field(
        default=None,
        description=(
            "Highest acceleration along the path, mm/s^2. Without it, the axes alone limit it."
        ),
    )
    max_normal_acceleration: Positive | None = Field(
        default=None,
        description=(
            "Highest acceleration across the path, mm/s^2. Without it, the axes alone limit it."
        ),
    )
    max_jerk: Positive | None = Field(
        default=None,
        description="Highest jerk along the path, mm/s^3. Without it, the axes alone limit it.",
    )
    chord_error: Positive = Field(
        default=0.001,
        description="Largest distance between the path and its chord over one period, mm.",
    )
    tolerance: NonNegative = Field(
        default=0.01,
        description=(
            "Tolerance of corner blends and smoothing under G64 without P, mm. 0 is the exact path."
        ),
    )
    period: Positive = Field(default=0.001, description="Sampling period of the interpolator, s.")
    step_deviation: Positive | None = Field(
        default=None,
        description=(
            "Largest relative difference between the chord over one period and the path "
            "there. Without it, the other limits alone limit it."
        ),
    )


InputName = Literal["limits", "probe", "emergency-stop", "hold", "resume"]
"""Inputs of the stepper board that have a switch; ``limits`` are the switches of all axes."""
PulseTime = Annotated[FiniteFloat, Field(gt=0, le=60e-6)]
"""Seconds, within the range of the board's 8-bit timer."""


class Board(Section):
    """The board that takes the motion.

    ``max_spindle_rpm`` and the keys after it are for the stepper board. GRBL has its own settings.
    """

    kind: Annotated[str, Field(min_length=1)] = Field(
        default="loopback",
        description="Name of the board driver, such as loopback, file, grbl or stepper.",
    )
    port: str | None = Field(
        default=None,
        description=(
            "Serial port of the board, such as /dev/ttyUSB0 or COM3; usb:NUMBER for the device "
            "with this serial number; a pyserial URL such as socket://host:port; or the file of "
            "the file board."
        ),
    )
    baud: Annotated[int, Field(gt=0)] = Field(
        default=115200,
        description="Speed of the serial port, bits/s. Without it, the stepper board has 1000000.",
    )
    max_step_rate: Positive = Field(
        default=200_000.0, description="Highest step rate of one axis, steps/s."
    )
    max_spindle_rpm: Positive = Field(
        default=1000.0,
        description="Speed of a PWM spindle while its output (D11) is on all the time, rpm.",
    )
    normally_closed: Annotated[tuple[InputName, ...], BeforeValidator(_tuple)] = Field(
        default=(),
        description=(
            "Inputs with a switch that opens when it is pressed, so that a broken wire "
            "counts as pressed (limits: $5 = 1 in GRBL, probe: $6 = 1)."
        ),
    )
    invert_enable: bool = Field(
        default=False,
        description=(
            "Whether the motor drivers are on while the enable pin (D8) is high ($4 = 1 in GRBL)."
        ),
    )
    step_pulse: PulseTime = Field(
        default=5e-6,
        description="Time for which a step pin stays high ($0 in GRBL), and low after that, s.",
    )
    direction_setup: PulseTime = Field(
        default=5e-6, description="Time from a change of direction to the next step, s."
    )


class Program(Section):
    """How programs are read. File names are relative to the machine file."""

    dialect: DialectName = Field(
        default="auto", description="Dialect of G-code; auto recognises it in the program."
    )
    g_code_system: GcodeSystem = Field(
        default="A",
        description=(
            "System of the G-codes of a FANUC or Haas lathe: in A G98 and G99 are the feed modes "
            "and G90, G92 and G94 cycles; in B and C G94 and G95 are the feed modes."
        ),
    )
    tool_table: FilePath | None = Field(
        default=None,
        description="File with the tool table. A run that changes the table writes the file.",
    )
    parameters: FilePath | None = Field(
        default=None,
        description=(
            "File with the parameters that are kept between programs. A run that changes "
            "them writes it."
        ),
    )
    subroutines: Annotated[tuple[FilePath, ...], BeforeValidator(_tuple)] = Field(
        default=(),
        description="Folders with subprograms, searched after the folder of the program.",
    )
    codes: Codes = Field(
        default={},
        description=(
            'Effects of a builder\'s M-codes, such as M31 = "ignore", "pass-on" (to a GRBL board), '
            '"pause", { file = "m31.ngc" } or { output = 3, on = true }.'
        ),
    )
    max_repeated_lines: Annotated[int, Field(gt=0)] = Field(
        default=2_000_000,
        description="Repeated lines in loops and calls after which the program counts as endless.",
    )
    max_call_depth: Annotated[int, Field(gt=0, le=1000)] = Field(
        default=100, description="Nesting of calls beyond which the program counts as endless."
    )

    def files(self) -> Iterator[tuple[str, Path]]:
        """Yield key and path of each file that must exist; the first run makes the parameters."""
        if self.tool_table is not None:
            yield "tool_table", self.tool_table
        for path in self.subroutines:
            yield "subroutines", path
        for action in self.codes.values():
            if isinstance(action, RunFile):
                yield "codes", action.file


class HomingOrder(Section):
    """The sequence of the axes in a homing cycle."""

    order: Annotated[tuple[AxisLetter, ...], BeforeValidator(_tuple)] | None = Field(
        default=None,
        description=(
            "Axes in the order in which they home. Without it: Z first, then the order of the file."
        ),
    )


class Stock(Section):
    """The raw part on the machine: a cuboid in machine coordinates."""

    x: Span = Field(description="Lowest and highest X, mm.")
    y: Span = Field(description="Lowest and highest Y, mm.")
    z: Span = Field(description="Lowest and highest Z, mm.")


class Inconsistency(NamedTuple):
    """A contradiction between keys of a machine file.

    Attributes:
        key: Full path of the key that the message is about.
        message: The problem.
        hint: The remedy.
    """

    key: tuple[str, ...]
    message: str
    hint: str


class Machine(Section):
    """A machine. The order of ``axes`` is the order of the columns of every position."""

    name: str = Field(default="machine", description="Name of the machine, for reports.")
    kind: MachineKind = Field(default="mill", description="Kind of machine.")
    axes: Annotated[dict[AxisLetter, Axis], Field(min_length=1)] = Field(
        description="The axes, each as a table [axes.x]; their order is the order of the columns."
    )
    kinematics: KinematicsTable = Field(
        default=Cartesian(), description="How the joints move the tool tip."
    )
    joints: dict[str, Axis] = Field(
        default={},
        description=(
            "The joints of the kinematics, each as a table [joints.a] with the keys of an axis."
        ),
    )
    path: PathLimits = Field(
        default=PathLimits(), description="Limits along the path, and the required accuracy."
    )
    board: Board = Field(default=Board(), description="The board that takes the motion.")
    program: Program = Field(default=Program(), description="How programs are read.")
    homing: HomingOrder | None = Field(
        default=None,
        description=(
            "The homing cycle; a machine file with this table says that the machine has "
            "limit switches."
        ),
    )
    stock: Stock | None = Field(
        default=None, description="The raw part, for the check of collisions."
    )

    @property
    def can_home(self) -> bool:
        """Whether the machine file mentions limit switches."""
        return self.homing is not None or any(
            axis.homing is not None for axis in self.axes.values()
        )

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Letters of the axes, one for each column of a position."""
        return tuple(self.axes)

    @property
    def steps_per_mm(self) -> NDArray[np.float64]:
        """Steps per millimetre (degree) of each axis, a new array (axes,)."""
        return np.array([axis.steps_per_mm for axis in self.axes.values()], dtype=np.float64)

    @property
    def joint_tables(self) -> dict[str, Axis]:
        """The joints with their limits, in the order of their columns.

        They are the axes. Those of the kinematics stand where the first axis stood that they move.
        """
        if not self.kinematics.joints:
            return {str(letter): axis for letter, axis in self.axes.items()}
        moved, found = self.kinematics.axes, {}
        for letter, axis in self.axes.items():
            if letter not in moved:
                found[str(letter)] = axis
            elif letter == next(other for other in self.axes if other in moved):
                found |= {name: self.joints[name] for name in self.kinematics.joints}
        return found

    @property
    def of_joints(self) -> Machine:
        """The machine whose axes are the joints, for what lies behind the plan: pulses, boards."""
        if not self.kinematics.joints:
            return self
        update = {"axes": self.joint_tables, "kinematics": OfJoints(), "joints": {}}
        return self.model_copy(update=update)

    def inconsistencies(self) -> Iterator[Inconsistency]:
        """Yield the contradictions between keys; none for a machine that can run."""
        yield from self._joint_names()
        for table, name, joint in self._motors():
            yield from self._axis_limits(table, name, joint)
        for letter in self.axes:
            yield from self._homing_position(letter)
        for letter in (self.homing.order or ()) if self.homing is not None else ():
            if letter not in self.axes:
                yield Inconsistency(
                    ("homing", "order"),
                    f"the machine has no axis {letter}",
                    f"its axes are {', '.join(self.axes)}",
                )
        if self.stock is not None and not {"x", "y", "z"} <= self.axes.keys():
            yield Inconsistency(
                ("stock",),
                "the machine does not have the axes x, y and z",
                "remove the table",
            )

    def _motors(self) -> Iterator[tuple[str, str, Axis]]:
        """Yield table, name and limits of each joint."""
        for name, joint in self.joint_tables.items():
            yield "joints" if name in self.kinematics.joints else "axes", name, joint

    def _joint_names(self) -> Iterator[Inconsistency]:
        """Compare the tables of the joints, and the axes, with those of the kinematics."""
        wanted, kind = self.kinematics.joints, self.kinematics.type
        hint = f"the joints of {kind} are {', '.join(wanted)}" if wanted else f"{kind} has none"
        for letter in self.kinematics.axes:
            if letter not in self.axes:
                message = f"{kind} moves the axis {letter}, which the machine does not have"
                yield Inconsistency(("kinematics", "type"), message, f"add [axes.{letter}]")
        for name in self.joints:
            if name not in wanted:
                yield Inconsistency(("joints", name), "there is no such joint", hint)
        for name in wanted:
            if name not in self.joints:
                yield Inconsistency(("kinematics", "type"), f"[joints.{name}] is missing", hint)
            if name in self.axes and name not in self.kinematics.axes:
                message = f"the kinematics has a joint {name}, too"
                yield Inconsistency(("axes", name), message, "choose another kinematics or axis")

    def _axis_limits(self, table: str, letter: str, axis: Axis) -> Iterator[Inconsistency]:
        most = self.board.max_step_rate
        if axis.step_rate > most * (1 + RATE_ROUNDING):
            yield Inconsistency(
                (table, letter, "max_velocity"),
                f"{axis.max_velocity:g} mm/s at {axis.steps_per_mm:g} steps/mm is "
                f"{axis.step_rate:.0f} steps/s, but board.max_step_rate is {most:.0f}",
                f"lower it to {most / axis.steps_per_mm:g}, "
                "or raise board.max_step_rate if the board supports it",
            )
        path = self.path
        if axis.max_acceleration is None and (
            path.max_tangential_acceleration is None or path.max_normal_acceleration is None
        ):
            yield Inconsistency(
                (table, letter, "max_acceleration"),
                "nothing limits the acceleration of this axis",
                f"set {table}.{letter}.max_acceleration, "
                "or path.max_tangential_acceleration and path.max_normal_acceleration",
            )
        if axis.max_jerk is None and path.max_jerk is None:
            yield Inconsistency(
                (table, letter, "max_jerk"),
                "nothing limits the jerk of this axis",
                f"set {table}.{letter}.max_jerk, or path.max_jerk",
            )

    def _homing_position(self, letter: AxisLetter) -> Iterator[Inconsistency]:
        axis = self.axes[letter]
        position = None if axis.homing is None else axis.homing.position
        if position is None or axis.travel is None:
            return
        if not axis.travel[0] <= position <= axis.travel[1]:
            yield Inconsistency(
                ("axes", letter, "homing", "position"),
                f"{position:g} is outside the travel, {axis.travel[0]:g} to {axis.travel[1]:g} mm",
                f"give a coordinate within axes.{letter}.travel",
            )
