"""The machine: axes, motors, path limits, board, and reading of programs, as pydantic models.

The models are frozen. An unknown key is an error. Lengths are in mm (degrees for rotary axes),
times in s. A limit that is absent does not limit. The acceleration and the jerk of each axis need a
limit of the axis itself or of the path.

The descriptions of the fields are those in the JSON Schema of the machine file
(:func:`cnc.machine.load.machine_schema`) and in the reference.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, FiniteFloat, WithJsonSchema

from cnc.kinematics.compensation import Compensation, leaning_axes
from cnc.machine.compensation import ErrorTable, Squareness, screw
from cnc.machine.error_map import ErrorMap, ErrorMapFile
from cnc.machine.kinematics import Cartesian, KinematicsTable, OfJoints
from cnc.machine.klipper import KlipperBoard
from cnc.machine.program_codes import Codes, RunFile
from cnc.model.blocks import AxisLetter
from cnc.model.choices import DialectName, GcodeSystem, MachineKind, TextStyle, WrapRule
from cnc.model.section import (
    FilePath,
    Inconsistency,
    MotionLimit,
    NonNegative,
    Positive,
    Section,
    Span,
    as_tuple,
)

# The motors of an axis: one, or several that move it together, as in a gantry.

MOST_MOTORS = 4


class Motor(Section):
    """One motor of an axis."""

    offset: FiniteFloat = Field(
        default=0.0,
        description=(
            "Coordinate at which its limit switch closes less that of the first motor's switch, "
            "while the gantry is square, mm."
        ),
    )
    invert: bool = Field(
        default=False,
        description="Whether its direction pin has the other level than that of the axis.",
    )


def _motors(value: Any) -> Any:
    """Return a number of motors, or a list of tables, as a tuple of tables."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MOST_MOTORS:
            raise ValueError(f"must be 1 to {MOST_MOTORS}")
        return (Motor(),) * value
    return as_tuple(value)


Motors = Annotated[
    tuple[Motor, ...],
    BeforeValidator(_motors),
    Field(min_length=1, max_length=MOST_MOTORS),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "integer", "minimum": 1, "maximum": MOST_MOTORS},
                {
                    "type": "array",
                    "items": {
                        "type": "object",
                        "properties": {
                            "offset": {"type": "number"},
                            "invert": {"type": "boolean"},
                        },
                        "additionalProperties": False,
                    },
                    "minItems": 1,
                    "maxItems": MOST_MOTORS,
                },
            ]
        }
    ),
]
"""The motors of an axis."""


def gantry_inconsistencies(
    key: tuple[str, str], motors: tuple[Motor, ...], pull_off: float
) -> Iterator[Inconsistency]:
    """Yield the contradictions between the motors of an axis and its homing.

    Args:
        key: Table of the axis.
        motors: Its motors.
        pull_off: Distance from the place of rest to the first switch, mm; negative at the low end.
    """
    if motors[0].offset:
        message = "the offset of the first motor is not 0"
        hint = "the offsets of the other motors count from its switch"
        yield Inconsistency((*key, "motors"), message, hint)
    towards = 1 if pull_off > 0 else -1
    for number, motor in enumerate(motors[1:], start=2):
        if (pull_off + motor.offset) * towards <= 0.0:
            message = (
                f"with the offset {motor.offset:g}, the switch of motor {number} is closed "
                f"{abs(pull_off):g} mm off that of motor 1, where homing ends"
            )
            hint = f"raise {'.'.join(key)}.homing.pull_off above {abs(motor.offset):g}"
            yield Inconsistency((*key, "motors"), message, hint)


# The table [program] of a machine file: how programs are read.


class Program(Section):
    """How programs are read. File names are relative to the machine file."""

    dialect: DialectName = Field(
        default="auto", description="Dialect of G-code; auto recognises it in the program."
    )
    style: TextStyle = Field(
        default="readable",
        description="Form of the text that cncrun format writes: readable or compact.",
    )
    g_code_system: GcodeSystem = Field(
        default="A",
        description=(
            "System of the G-codes of a FANUC or Haas lathe: in A G98 and G99 are the feed modes "
            "and G90, G92 and G94 cycles; in B and C G94 and G95 are the feed modes."
        ),
    )
    least_increments: bool = Field(
        default=False,
        description=(
            "For a FANUC or Haas lathe: whether a length without a decimal point counts least "
            "increments, 0.001 mm or 0.0001 inch (FANUC's parameter 3401, DPI = 0)."
        ),
    )
    tool_table: FilePath | None = Field(
        default=None,
        description="File with the tool table. A run that changes the table writes the file.",
    )
    tool_widths: dict[
        Annotated[str, Field(pattern=r"^T[1-9][0-9]{0,4}$")], Annotated[float, Field(gt=0)]
    ] = Field(
        default={},
        description=(
            "Width of the edge of grooving tools, mm, such as { T3 = 3.0 }: for CYCLE93 (siemens)."
        ),
    )
    parameters: FilePath | None = Field(
        default=None,
        description=(
            "File with the parameters that are kept between programs. A run that changes "
            "them writes it."
        ),
    )
    subroutines: Annotated[tuple[FilePath, ...], BeforeValidator(as_tuple)] = Field(
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


# The table [board] of a machine file.

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
        description="Name of the board driver, such as loopback, file, grbl, stepper or klipper.",
    )
    port: str | None = Field(
        default=None,
        description=(
            "Serial port of the board, such as /dev/ttyUSB0 or COM3; usb:NUMBER for the device "
            "with this serial number; a pyserial URL such as socket://host:port; a WebSocket such "
            "as ws://host:port; or the file of the file board."
        ),
    )
    baud: Annotated[int, Field(gt=0)] = Field(
        default=115200,
        description=(
            "Speed of the serial port, bits/s. Without it, a stepper board has 1000000, a Klipper "
            "board 250000."
        ),
    )
    max_step_rate: Positive = Field(
        default=200_000.0, description="Highest step rate of one axis, steps/s."
    )
    max_spindle_rpm: Positive = Field(
        default=1000.0,
        description="Speed of a PWM spindle while its output (D11) is on all the time, rpm.",
    )
    normally_closed: Annotated[tuple[InputName, ...], BeforeValidator(as_tuple)] = Field(
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
    klipper: KlipperBoard | None = Field(
        default=None, description="Pins and motor drivers of a Klipper board."
    )


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
    start: dict[str, FiniteFloat] = Field(
        default={},
        description=(
            "Where the machine stands before a program while no board knows it: places of axes, "
            "or of joints (mm, degrees). Without it: machine zero, or the nearest place in reach."
        ),
    )
    diameters: bool | None = Field(
        default=None,
        description=(
            "For a lathe: whether X of a program is a diameter at its start. Without it: true for "
            "fanuc, haas, siemens and mach3, false for the others."
        ),
    )
    squareness: Squareness | None = Field(
        default=None,
        description=(
            'Angles between the axes, such as { xy = "0.02 deg" }. The motion is corrected, so '
            "that positions are true places."
        ),
    )
    error_map: ErrorMapFile | None = Field(
        default=None,
        description=(
            "Errors in the volume: a csv file with x,y,z,dx,dy,dz, mm, for each point of a grid. "
            "The motion is corrected."
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
    squaring_limit: Positive = Field(
        default=2.5,
        description=(
            "Largest difference between the motors of an axis that homing squares, mm. A larger "
            "one is an error."
        ),
    )


class Axis(Section):
    """One axis. Its inverse resolution is the basic length unit (BLU)."""

    steps_per_mm: Positive = Field(description="Steps per mm (per degree for a rotary axis).")
    max_velocity: MotionLimit = Field(description="Highest speed, mm/s.")
    max_acceleration: MotionLimit | None = Field(
        default=None,
        description="Highest acceleration, mm/s^2. Without it, the limits of the path are needed.",
    )
    max_jerk: MotionLimit | None = Field(
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
    wrap: WrapRule | None = Field(
        default=None,
        description=(
            "For a rotary axis that repeats after 360 degrees: the direction of absolute moves. "
            'That of the dialect ("dialect"), the shortest way ("shortest"), by the sign of the '
            'word ("sign"), or within the turn from 0 to 360 ("in-turn").'
        ),
    )
    homing: Homing | None = Field(
        default=None,
        description="How the axis finds its limit switch. Without it, the defaults hold.",
    )
    motors: Motors = Field(
        default=(Motor(),),
        description=(
            "Number of motors that move the axis together, as in a gantry, or a table for each. "
            "Each has a limit switch of its own, by which homing squares the gantry."
        ),
    )
    backlash: Positive | None = Field(
        default=None,
        description=(
            "Play of the nut: way of the motor at a reversal until the axis moves, mm. The motor "
            "takes it up."
        ),
    )
    error_table: ErrorTable | None = Field(
        default=None,
        description=(
            "Errors of the screw: a csv file with position,error, a .comp file of LinuxCNC, or "
            "rows [position, error], mm. The motion is corrected."
        ),
    )

    @property
    def step_rate(self) -> float:
        """Steps per second at ``max_velocity``."""
        return self.max_velocity * self.steps_per_mm

    def home(self, letter: str) -> float:
        """Return where the axis is after homing, mm; 0 for an axis that cannot home."""
        if self.homing is not None and self.homing.position is not None:
            return self.homing.position
        if self.travel is None:
            return 0.0
        return self.travel[1 if switch_end(letter, self.homing) > 0 else 0]


def switch_end(letter: str, homing: Homing | None) -> int:
    """Return the end of the travel at which an axis has its switch, +1 or -1."""
    end = None if homing is None else homing.end
    return 1 if (end or ("high" if letter == "z" else "low")) == "high" else -1


class PathLimits(Section):
    """Limits along the path, and the required accuracy."""

    max_feed: MotionLimit = Field(default=500.0, description="Highest speed along the path, mm/s.")
    max_tangential_acceleration: MotionLimit | None = Field(
        default=None,
        description="Highest acceleration along the path, mm/s^2. Without it, the axes limit it.",
    )
    max_normal_acceleration: MotionLimit | None = Field(
        default=None,
        description="Highest acceleration across the path, mm/s^2. Without it, the axes limit it.",
    )
    max_jerk: MotionLimit | None = Field(
        default=None,
        description="Highest jerk along the path, mm/s^3. Without it, the axes alone limit it.",
    )
    chord_error: FiniteFloat = Field(
        default=0.001,
        ge=1e-9,
        description="Largest distance between the path and its chord over one period, mm.",
    )
    tolerance: NonNegative = Field(
        default=0.01,
        description=(
            "Tolerance of corner blends and smoothing under G64 without P, mm. 0 is the exact path."
        ),
    )
    period: FiniteFloat = Field(
        default=0.001, ge=1e-6, le=10, description="Sampling period of the interpolator, s."
    )
    step_deviation: FiniteFloat | None = Field(
        default=None,
        ge=1e-9,
        description=(
            "Largest relative difference between the chord over one period and the path "
            "there. Without it, the other limits alone limit it."
        ),
    )


class VibrationMode(Section):
    """A way in which the machine rings; ``cncrun measure ringing`` finds it."""

    frequency: Annotated[FiniteFloat, Field(ge=1.0)] = Field(description="Frequency, Hz.")
    damping: Annotated[FiniteFloat, Field(ge=0.0, le=0.5)] = Field(
        default=0.05, description="Damping ratio: 0 for none, 1 where nothing rings."
    )


def _modes(value: Any) -> Any:
    """Return a single mode as one of several."""
    if not isinstance(value, dict | list | tuple):
        raise ValueError("must be a table, {frequency = 38.0, damping = 0.05}, or two of them")
    return (value,) if isinstance(value, dict) else as_tuple(value)


VibrationModes = Annotated[
    tuple[VibrationMode, ...],
    Field(min_length=1, max_length=2),
    BeforeValidator(_modes, json_schema_input_type=VibrationMode | tuple[VibrationMode, ...]),
]


class HomingOrder(Section):
    """The sequence of the axes in a homing cycle."""

    order: Annotated[tuple[AxisLetter, ...], BeforeValidator(as_tuple)] | None = Field(
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


class Machine(Header):
    """A machine. The order of ``axes`` is the order of the columns of every position."""

    file: str = Field(default="", description="Name of the machine file.", exclude=True)
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
    vibration: dict[str, VibrationModes] = Field(
        default={},
        description=(
            "How the machine rings, by the axis whose motion excites it, or tool for all axes: up "
            "to two modes each. The motion is planned so that little of it remains."
        ),
    )

    @property
    def has_travel(self) -> bool:
        """Whether an axis or a joint has a travel."""
        return any(axis.travel for axis in (*self.axes.values(), *self.joints.values()))

    @property
    def can_home(self) -> bool:
        """Whether the machine file mentions limit switches."""
        return self.homing is not None or any(
            axis.homing is not None for axis in self.axes.values()
        )

    def is_sensorless(self, letter: str) -> bool:
        """Whether an axis homes without a switch: its motor driver tells that the motor stalls."""
        axis = None if self.board.klipper is None else self.board.klipper.axis(letter)
        drivers = () if axis is None else axis.driver or ()
        return any(driver.stallguard is not None for driver in drivers)

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
        moved, tables = self.kinematics.axes, {}
        for letter, axis in self.axes.items():
            if letter not in moved:
                tables[str(letter)] = axis
            elif letter == next(other for other in self.axes if other in moved):
                tables |= {name: self.joints[name] for name in self.kinematics.joints}
        return tables

    @property
    def tip_columns(self) -> int:
        """Columns of the tool tip in front of those of the joints in a path; 0 without them."""
        kinematics = self.kinematics
        apart = kinematics.joints or kinematics.with_tip_control or self.is_compensated
        return len(self.axes) if apart else 0

    @property
    def is_compensated(self) -> bool:
        """Whether the motors go to other places than the axes, because errors are compensated."""
        return (self.squareness, self.error_map) != (None, None) or any(
            axis.error_table is not None or axis.backlash is not None for axis in self.axes.values()
        )

    @property
    def compensation(self) -> Compensation:
        """The places of the motors of a machine with a motor for each axis.

        Raises:
            TableError: An error table is not that of a screw.
        """
        names = self.axis_names
        leaning = np.eye(len(names))
        if self.squareness is not None:
            among_three = leaning_axes(**self.squareness.given)
            own = [names.index(letter) for letter in "xyz" if letter in names]
            three = ["xyz".index(names[column]) for column in own]
            leaning[np.ix_(own, own)] = among_three[np.ix_(three, three)]
        screws = {
            column: screw(axis.error_table, axis.backlash)
            for column, axis in enumerate(self.axes.values())
            if axis.error_table is not None or axis.backlash is not None
        }
        if not isinstance(self.error_map, ErrorMap):
            return Compensation(leaning, screws)
        columns = [names.index(letter) for letter in ("x", "y", "z")]
        return Compensation(leaning, screws, (self.error_map.volume, columns))

    @property
    def has_joints_as_axes(self) -> bool:
        """Whether the axes are the joints of another machine, as in ``of_joints``."""
        return isinstance(self.kinematics, OfJoints)

    @property
    def of_joints(self) -> Machine:
        """The machine whose axes are the joints, for what lies behind the plan: pulses, boards."""
        if self.is_compensated:
            plain = {"axes": self._motors, "squareness": None, "error_map": None}
            return self.model_copy(update=plain)
        if self.kinematics.with_tip_control:
            return self.model_copy(update={"kinematics": Cartesian()})
        if not self.kinematics.joints:
            return self
        update = {"axes": self.joint_tables, "kinematics": OfJoints(), "joints": {}}
        return self.model_copy(update=update)

    @property
    def plays_at_home(self) -> dict[str, float]:
        """Play of the nut of each axis with backlash, where it is after homing, mm."""
        if not self.is_compensated:
            return {}
        home = np.array([[axis.home(letter) for letter, axis in self.axes.items()]])
        compensation = self.compensation
        down = compensation.motors_at(home, dict.fromkeys(compensation.screws, -1.0))
        plays = (compensation.motors_at(home) - down)[0].tolist()
        return {letter: play for letter, play in zip(self.axes, plays, strict=True) if play}

    @property
    def _motors(self) -> dict[AxisLetter, Axis]:
        """The motors behind the compensation: where they are at home, the tip is."""
        home = [axis.home(letter) for letter, axis in self.axes.items()]
        motors = self.compensation.motors_at(np.array([home]))[0].tolist()
        tables: dict[AxisLetter, Axis] = {}
        for (letter, axis), place in zip(self.axes.items(), motors, strict=True):
            changes: dict[str, Any] = {"error_table": None, "backlash": None}
            if axis.travel is not None:
                shift = place - axis.home(letter)
                changes["travel"] = (axis.travel[0] + shift, axis.travel[1] + shift)
            if axis.homing is not None and axis.homing.position is not None:
                changes["homing"] = axis.homing.model_copy(update={"position": place})
            tables[letter] = axis.model_copy(update=changes)
        return tables
