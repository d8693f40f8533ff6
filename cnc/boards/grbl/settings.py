"""Firmware (``$I``), settings (``$$``) and offsets (``$#``) of a GRBL board.

Source: "Grbl v1.1 Settings" and "Interface".
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from cnc.boards.grbl.messages import Feedback, Firmware, Setting, in_mm
from cnc.boards.grbl.protocol import RX_BYTES
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.units import MM_PER_INCH

ARC_TOLERANCE, JUNCTION_DEVIATION, REPORT_INCHES, SOFT_LIMITS, HARD_LIMITS = 12, 11, 13, 20, 21
TOOL_CHANGE_MODE = 341
TOOL_CHANGES = {
    1: "it would lift the tool, and wait until you touch off ($341=1)",
    2: "it would go to G59.3, and wait until you touch off ($341=2)",
    3: "it would lift the tool, then measure the new one at G59.3 ($341=3)",
}
"""Tool changes of grblHAL that also set the tool length, by ``$341``."""
HOMING, HOMING_DIRECTION, PULL_OFF, LASER_MODE = 22, 23, 27, 32
HOMING_CYCLES = range(44, 50)
"""Settings of grblHAL: the axes of each part of its homing, masks."""
ROTARY_AXES = 376
STEPS, RATES, ACCELERATIONS, TRAVELS = 100, 110, 120, 130
"""Numbers of the settings of the X axis; the other axes follow. Steps/mm, mm/min, mm/s^2, mm."""
SYSTEMS = numbers.SYSTEMS[:6]
PLACES = (*SYSTEMS, "G28", "G30", "G92")
ABOUT = ("DRIVER", "DRIVER VERSION", "BOARD", "SIGNALS", "AUX IO", "PLUGIN")
"""Lines of grblHAL's ``$I+`` that describe the board."""
NAMES = {
    0: "step pulse, us",
    1: "motors stay on at rest, ms (255: always)",
    2: "step pins inverted, mask",
    3: "direction pins inverted, mask",
    4: "enable pin inverted",
    5: "limit pins inverted",
    6: "probe pin inverted",
    10: "status report, mask",
    11: "junction deviation, mm",
    12: "arc tolerance, mm",
    13: "reports in inches",
    20: "soft limits",
    21: "hard limits",
    22: "homing",
    23: "homing direction inverted, mask",
    24: "homing feed, mm/min",
    25: "homing seek, mm/min",
    26: "homing debounce, ms",
    27: "homing pull-off, mm",
    30: "highest spindle speed, rev/min",
    31: "lowest spindle speed, rev/min",
    32: "laser mode",
    **{
        first + column: f"{letter} {quantity}"
        for first, quantity in (
            (STEPS, "steps/mm"),
            (RATES, "highest rate, mm/min"),
            (ACCELERATIONS, "acceleration, mm/s^2"),
            (TRAVELS, "travel, mm"),
        )
        for column, letter in enumerate("XYZABC")
    },
}
"""Names of the settings."""
LINEAR_AXES = 3
"""X, Y and Z."""
_INCHES = re.compile(r"-?[0-9]+\.[0-9]{4}(?![0-9])")
_HAL_BUILD = re.compile(r"1\.1f\.20(?:19|[2-9][0-9])")
"""Builds of grblHAL, and of few others. GRBL was 1.1h by then."""
SMALLEST_RX = 32
"""Bytes of the smallest receive buffer that is believed."""


@dataclass(slots=True)
class BoardInfo:
    """Firmware, settings and offsets of a board.

    Attributes:
        version: Version of the welcome, such as ``1.1h``.
        kind: The firmware.
        build: The VER line of ``$I``.
        options: Letters of its OPT line.
        extensions: Names of its NEWOPT line, of grblHAL: ENUMS, TC, ATC and others.
        about: Further lines of ``$I``, such as ``DRIVER:STM32F407``.
        letters: Names of the axes in the order of their settings; "" where they are not reported.
        blocks: Blocks of the planner; 0 where it is not reported.
        rx_bytes: Bytes of the receive buffer.
        settings: Value of each setting as text, by number.
        places: G54 to G59, G28, G30 and G92, mm.
        tool_length: Along Z, mm.
        four_decimals: Whether FluidNC reports inches: it has no ``$13``, but then four decimals.
    """

    version: str
    kind: Firmware
    build: str = ""
    options: str = ""
    extensions: frozenset[str] = frozenset()
    about: list[str] = field(default_factory=list)
    letters: str = ""
    blocks: int = 0
    rx_bytes: int = RX_BYTES
    settings: dict[int, str] = field(default_factory=dict)
    places: dict[str, tuple[float, ...]] = field(default_factory=dict)
    tool_length: float = 0.0
    four_decimals: bool = False

    @property
    def firmware(self) -> str:
        """Name and version."""
        return f"{self.kind.value} {self.version}"

    @property
    def may_be_hal(self) -> bool:
        """Whether it is grblHAL, which greets as GRBL with a compatibility level above 0."""
        hal = self.kind is Firmware.HAL
        return hal or (self.kind is Firmware.GRBL and bool(_HAL_BUILD.match(self.build)))

    @property
    def fluid(self) -> bool:
        """Whether it is FluidNC."""
        return self.kind is Firmware.FLUID

    def take(self, answers: Sequence[Feedback | Setting]) -> None:
        """Note the answers to ``$I``, ``$$`` and, last, ``$#``."""
        for answer in answers:
            if isinstance(answer, Setting):
                self.settings[answer.number] = answer.value
            elif answer.kind == "VER":
                self.build = answer.text.rstrip(":")
            elif answer.kind == "OPT":
                self._options(answer.text)
            elif answer.kind == "AXS":
                self.letters = answer.text.partition(":")[2].upper()
            elif answer.kind == "NEWOPT":
                self.extensions = frozenset(answer.text.upper().split(","))
            elif answer.kind == "FIRMWARE" and "grblhal" in answer.text.lower():
                self.kind = Firmware.HAL
            elif answer.kind in ABOUT:
                self.about.append(f"{answer.kind}: {answer.text}")
            elif answer.kind in PLACES:
                self.four_decimals = self.fluid and _INCHES.match(answer.text) is not None
                self.places[answer.kind] = self._lengths(answer.text)
            elif answer.kind == "TLO":
                # GRBL reports one number, grblHAL one for each axis.
                lengths = self._lengths(answer.text)
                self.tool_length = (
                    (lengths[2] if len(lengths) > 2 else lengths[0]) if lengths else 0.0
                )

    @property
    def unit(self) -> float:
        """Unit of reported lengths and feeds in mm (``$13``)."""
        inches = self.four_decimals or self.number(REPORT_INCHES) == 1
        return MM_PER_INCH if inches else 1.0

    @property
    def rotary(self) -> frozenset[int]:
        """Numbers of the axes that the board reports in degrees, whatever the unit of lengths is.

        grblHAL names them in ``$376``, where bit 0 is the axis behind Z ("Settings_Axis_Rotational"
        of its core). In FluidNC these are A, B and C.
        """
        further = range(LINEAR_AXES, len(AXIS_LETTERS))
        if self.fluid:
            return frozenset(further)
        mask = int(self.number(ROTARY_AXES) or 0)
        return frozenset(column for column in further if mask >> (column - LINEAR_AXES) & 1)

    def number(self, setting: int) -> float | None:
        """Return the value of a setting; None if it is absent or not a number."""
        try:
            return float(self.settings[setting])
        except (KeyError, ValueError):
            return None

    def axis(self, first: int, column: int) -> float | None:
        """Return the setting of an axis; None if it is absent or not positive.

        Args:
            first: Number of the setting of X: STEPS, RATES, ACCELERATIONS or TRAVELS.
            column: Number of the axis, from 0.
        """
        value = self.number(first + column)
        return value if value is not None and value > 0 else None

    @property
    def axes(self) -> int:
        """Number of axes with settings."""
        return next((column for column in range(6) if self.axis(STEPS, column) is None), 6)

    def travel(self, column: int) -> tuple[float, float] | None:
        """Return the lowest and highest machine position of an axis, mm.

        Machine zero is the end of homing, at the top of the travel. With option Z it is the bottom
        for axes that home downwards (``$23``). An axis that does not home has no ends.
        """
        reach = self.axis(TRAVELS, column)
        if reach is None or not self.homes_axis(column):
            return None
        downwards = int(self.number(HOMING_DIRECTION) or 0) >> column & 1
        return (0.0, reach) if "Z" in self.options and downwards else (-reach, 0.0)

    @property
    def homes(self) -> bool:
        """Whether the board homes the machine (``$22``)."""
        return self.number(HOMING) not in (None, 0.0)

    def homes_axis(self, column: int) -> bool:
        """Whether homing includes an axis: of grblHAL by its cycles, of other boards all."""
        masks = [int(mask) for cycle in HOMING_CYCLES if (mask := self.number(cycle)) is not None]
        return (
            self.kind is not Firmware.HAL or not masks or any(mask >> column & 1 for mask in masks)
        )

    def limited_travel(self, column: int) -> tuple[float, float] | None:
        """Return the lowest and highest position that the soft limits of the board allow, mm.

        grblHAL keeps the pull-off from the switches where hard limits are on
        ("limits_set_work_envelope" of its core).
        """
        travel = self.travel(column)
        if travel is None or self.kind is not Firmware.HAL:
            return travel
        off = (self.number(PULL_OFF) or 0.0) if int(self.number(HARD_LIMITS) or 0) & 1 else 0.0
        if "Z" not in self.options:
            return travel[0] + off, travel[1] - off
        return (travel[0], travel[1] - off) if travel[1] else (travel[0] + off, travel[1])

    @property
    def commands_above_ascii(self) -> bool:
        """Whether the board gets other real-time commands than ``?``, ``~`` and ``!`` (RT-).

        While grblHAL carries out a ``$`` command, these would enter the next line.
        """
        return "RT-" in self.extensions

    @property
    def laser(self) -> bool:
        """Whether the power changes during motion (``$32``)."""
        return self.number(LASER_MODE) == 1.0

    @property
    def may_be_laser(self) -> bool:
        """Whether the board is in laser mode, or is FluidNC, whose file of settings decides."""
        return self.laser or (self.fluid and LASER_MODE not in self.settings)

    @property
    def codes(self) -> frozenset[str]:
        """M6, if the board waits then until the operator resumes, and M7 if it has mist.

        grblHAL has M6 with option TC. It only waits where ``$341`` is 0. In modes 1 to 3 it
        measures the tool, and changes its tool length, which the lines of a program contain
        already. Mode 4 ignores M6. A tool changer (option ATC) moves the machine by itself.
        """
        waits = "TC" in self.extensions and "ATC" not in self.extensions
        has = (waits and self.number(TOOL_CHANGE_MODE) == 0.0, "M" in self.options)
        return frozenset(code for code, there in zip(("M6", "M7"), has, strict=True) if there)

    @property
    def unused_tool_change(self) -> str:
        """What the board would do at an M6 that it does not get; "" for nothing.

        Source: grblHAL's wiki, "Manual, semi automatic and automatic tool change".
        """
        if "ATC" in self.extensions:
            return "its tool changer would change the tool"
        mode = self.number(TOOL_CHANGE_MODE) if "TC" in self.extensions else None
        return TOOL_CHANGES.get(int(mode or 0), "")

    def top(self, column: int) -> float | None:
        """Return the highest machine position that keeps clear of the limit switch, mm."""
        travel = self.travel(column)
        if travel is None:
            return None
        return travel[1] - (0.0 if "Z" in self.options else self.number(PULL_OFF) or 0.0)

    def homed(self, column: int, here: float) -> float:
        """Return the machine position of an axis after homing, mm; ``here``: its present one.

        The axis rests the pull-off (``$27``) from its switch. With option Z that is machine zero.
        """
        if not self.homes_axis(column):
            return here
        if "Z" in self.options:
            return 0.0
        off, travel = self.number(PULL_OFF) or 0.0, self.travel(column)
        downwards = int(self.number(HOMING_DIRECTION) or 0) >> column & 1
        return travel[0] + off if travel is not None and downwards else -off

    def g54_offset(self, axes: int) -> tuple[float, ...]:
        """Return the work offset of each axis in G54, mm: G54, G92 and tool length."""
        nothing = (0.0,) * axes
        places = self.places.get("G54", nothing), self.places.get("G92", nothing)
        sums = [a + b for a, b in zip(*places, strict=False)]
        if len(sums) > 2:
            sums[2] += self.tool_length
        return tuple(sums)

    def named_places(self) -> dict[str, dict[str, float]]:
        """Return the offsets by name and axis, mm."""
        return {
            name: dict(zip(AXIS_LETTERS, place, strict=False))
            for name, place in self.places.items()
        }

    @property
    def soft_limits(self) -> bool:
        """Whether the board refuses targets outside its travel (``$20``)."""
        return self.number(SOFT_LIMITS) not in (None, 0.0)

    @property
    def hard_limits(self) -> bool:
        """Whether a pressed limit switch locks the board (``$21``)."""
        return self.number(HARD_LIMITS) not in (None, 0.0)

    def braking_s(self) -> float:
        """Return the longest time of any axis to stop from its highest rate, s."""
        times = []
        for column in range(self.axes):
            rate, acceleration = self.axis(RATES, column), self.axis(ACCELERATIONS, column)
            if rate is not None and acceleration is not None:
                times.append(rate / 60.0 / acceleration)
        return max(times, default=1.0)

    def narrowed(self, machine: Machine) -> Machine:
        """Return the machine with its travel limited to the board's soft limits, if they are on.

        A board in laser mode makes it a laser.
        """
        if self.laser:
            machine = machine.model_copy(update={"kind": "laser"})
        if not self.soft_limits:
            return machine
        axes = dict(machine.axes)
        for column, letter in enumerate(machine.axes):
            travel = self.limited_travel(column)
            if travel is None:
                continue
            own = axes[letter].travel or travel
            both = max(own[0], travel[0]), min(own[1], travel[1])
            if both[0] < both[1]:
                axes[letter] = axes[letter].model_copy(update={"travel": both})
            else:
                axes[letter] = axes[letter].model_copy(update={"travel": travel})
        return machine.model_copy(update={"axes": axes})

    def _options(self, text: str) -> None:
        """Take the OPT line ``VL,15,128``: letters, planner blocks, receive buffer."""
        self.options, *numbers = text.split(",")
        sizes = [int(number) if number.isdigit() else 0 for number in numbers]
        if len(sizes) >= 2:
            self.blocks = sizes[0]
            self.rx_bytes = sizes[1] if sizes[1] >= SMALLEST_RX else RX_BYTES

    def _lengths(self, text: str) -> tuple[float, ...]:
        try:
            return in_mm([float(value) for value in text.split(",")], self.unit, self.rotary)
        except ValueError:
            return ()
