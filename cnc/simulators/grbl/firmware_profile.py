"""The firmwares that the GRBL simulator models, and their differences."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from cnc.machine.models import Homing, Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.units import per_minute

STEPS, RATES, ACCELERATIONS, TRAVELS = 100, 110, 120, 130
"""Numbers of the settings of the X axis; Y and Z follow. Steps/mm, mm/min, mm/s^2, mm."""
TOOL_CHANGE_MODE = 341
"""grblHAL: 0 waits for the operator, 4 ignores M6; 1 to 3 measure the tool."""
ROTARY = 376
"""Mask of the rotary axes on grblHAL; bit 0 is the fourth axis. Inches do not scale these."""
GRBL_SETTINGS: dict[int, float] = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0,
    20: 0, 21: 0, 22: 0, 23: 0, 24: 25.0, 25: 500.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0,
    100: 250.0, 101: 250.0, 102: 250.0, 110: 500.0, 111: 500.0, 112: 500.0,
    120: 10.0, 121: 10.0, 122: 10.0, 130: 200.0, 131: 200.0, 132: 200.0,
}  # fmt: skip
"""``$$`` of a new board (settings.md, ``$$``), with homing off, because no switches are wired."""


@dataclass(frozen=True, slots=True)
class FirmwareProfile:
    """The properties of one firmware.

    Attributes:
        name: ``grbl`` or ``grblhal``.
        banner: The welcome.
        version: The version in the answer to ``$I``.
        options: The option letters in the answer to ``$I``.
        rx_capacity: Bytes that the receive ring holds.
        rx_reported: The size of the receive buffer in the answer to ``$I``.
        tx_capacity: Bytes that the transmit ring holds.
        line_length: Characters of a line without comments and spaces.
        planner_blocks: Moves in the planner, the running one included.
        repeats_error: Whether program lines after an error get the same error until an empty line.
        pairs_line_ends: Whether a line feed after a carriage return ends no further line.
        eeprom_blinds: Whether the processor loses bytes during a write to the EEPROM.
        estop_alarm: Number of the alarm of the emergency stop.
        alarm_s: Time after an alarm's message during which the main program is busy, s.
        line_numbers: Whether ``Ln:`` is reported.
        codes: M7 where mist is compiled in; M6 where the program may change tools.
        variable_spindle: Whether the spindle has a speed.
        max_step_rate_hz: Highest step rate that settings may need; None: not checked, as in GRBL.
        build_lines: Additional lines of the answer to ``$I``.
        start_messages: Lines before the welcome.
        short_info: Whether the answer to ``$I`` has two lines, and ``$I+`` has all.
        sizes_reported: Whether the answer to ``$I`` has the sizes of planner and receive buffer.
        numbered_settings: Whether ``$$`` is answered; error:3 otherwise.
        jog_cancel_flushes: Whether a jog cancel drops the lines that are not read yet.
        lock_bit: Bit of ``$22`` with which a board that has not homed is locked when it starts.
        lock_alarm: Number of the alarm that tells so at every start; None: a message only.
        measured_speed: Whether status reports have the measured speed of the spindle as well.
        reports_homing: Whether a status report is answered during homing.
        error_texts: Whether errors are reported as text (``verbose_errors``).
        axes: Letters of the axes, in the order of their settings and reports.
        settings: The settings of a new board.
    """

    name: str
    banner: str
    version: str
    options: str
    rx_capacity: int
    rx_reported: int
    tx_capacity: int
    line_length: int
    planner_blocks: int
    repeats_error: bool
    pairs_line_ends: bool
    eeprom_blinds: bool
    estop_alarm: int | None
    alarm_s: float = 0.0
    line_numbers: bool = True
    codes: frozenset[str] = frozenset()
    variable_spindle: bool = True
    max_step_rate_hz: float | None = None
    build_lines: tuple[str, ...] = ()
    start_messages: tuple[str, ...] = ()
    short_info: bool = False
    sizes_reported: bool = True
    numbered_settings: bool = True
    jog_cancel_flushes: bool = False
    lock_bit: int = 1
    lock_alarm: int | None = None
    measured_speed: bool = False
    reports_homing: bool = False
    error_texts: bool = False
    axes: str = "XYZ"
    settings: dict[int, float] = field(default_factory=lambda: dict(GRBL_SETTINGS))

    @property
    def printable_anywhere(self) -> bool:
        """Whether ``?``, ``~`` and ``!`` are taken out of ``$`` commands, too (RT- of grblHAL)."""
        return not any("RT-" in line for line in self.build_lines)

    def with_axes(self, letters: str) -> FirmwareProfile:
        """Return the firmware built for other axes. The settings of further ones are those of Z."""
        further = {
            first + axis: GRBL_SETTINGS[first + 2]
            for first in (STEPS, RATES, ACCELERATIONS, TRAVELS)
            for axis in range(3, len(letters))
        }
        build_lines = tuple(
            f"[AXS:{len(letters)}:{letters}]" if line.startswith("[AXS:") else line
            for line in self.build_lines
        )
        if self.name == "grblhal" and len(letters) > 3:
            further[ROTARY] = 0
        settings = dict(sorted((self.settings | further).items()))
        return replace(self, axes=letters, build_lines=build_lines, settings=settings)


GRBL = FirmwareProfile(
    name="grbl",
    banner="Grbl 1.1h ['$' for help]",
    version="1.1h.20190830",
    options="V",
    rx_capacity=128,
    rx_reported=128,
    tx_capacity=104,
    line_length=79,
    planner_blocks=15,
    repeats_error=False,
    pairs_line_ends=False,
    eeprom_blinds=True,
    estop_alarm=None,
    alarm_s=0.5,
    line_numbers=False,
)
"""GRBL 1.1h on an Arduino Uno (interface.md). The line buffer has 80 characters with the end of the
string.
"""

NUMBERED_GRBL = replace(GRBL, options="VN", planner_blocks=14, line_numbers=True)
"""The same compiled with USE_LINE_NUMBERS: the numbers take the memory of a block."""

GRBLHAL = FirmwareProfile(
    name="grblhal",
    banner="GrblHAL 1.1f ['$' or '$HELP' for help]",
    version="1.1f.20240125",
    options="VNMSL",
    rx_capacity=1023,
    rx_reported=1024,
    tx_capacity=1023,
    line_length=256,
    planner_blocks=35,
    repeats_error=True,
    pairs_line_ends=True,
    eeprom_blinds=False,
    estop_alarm=10,
    codes=frozenset(("M6", "M7")),
    jog_cancel_flushes=True,
    lock_bit=4,
    lock_alarm=11,
    build_lines=(
        "[AXS:3:XYZ]",
        "[NEWOPT:ENUMS,RT+,TC]",
        "[FIRMWARE:grblHAL]",
        "[SIGNALS:HSEP]",
        "[DRIVER:simulator]",
    ),
    settings=GRBL_SETTINGS | {44: 4, 45: 3, 46: 0, TOOL_CHANGE_MODE: 0},
)
"""grblHAL as its core is shipped; a ring of 1024 holds one byte less."""

GRBLHAL_AS_GRBL = replace(GRBLHAL, banner="Grbl 1.1f ['$' for help]", short_info=True)
"""grblHAL with a compatibility level of 1."""

FLUIDNC = replace(
    GRBL,
    name="fluidnc",
    banner="Grbl 3.7 [FluidNC v3.7.17 (wifi) '$' for help]",
    version="3.7 FluidNC v3.7.17",
    options="PHSW",
    eeprom_blinds=False,
    alarm_s=0.0,
    build_lines=("[MSG: Machine: 3018 router]", "[MSG: Mode=STA:SSID=shop:IP=192.168.1.20]"),
    start_messages=(
        "[MSG:INFO: FluidNC v3.7.17]",
        "[MSG:INFO: Machine 3018 router]",
        "[MSG:INFO: Axis count 3]",
    ),
    sizes_reported=False,
    numbered_settings=False,
    lock_alarm=14,
    reports_homing=True,
)
"""FluidNC with its settings in a file of YAML, which senders cannot read by numbers."""

FIRMWARES = {profile.name: profile for profile in (GRBL, GRBLHAL, FLUIDNC)}


# Settings of the GRBL simulator for the machine of a machine file.

SOFT_LIMITS, HARD_LIMITS, HOMING, HOMING_DIRECTION = 20, 21, 22, 23
HOMING_FEED, HOMING_SEEK, PULL_OFF = 24, 25, 27


def axes_of(machine: Machine) -> str:
    """Return the letters of a board for the axes of a machine: X, Y, Z at least, C at most."""
    columns = [AXIS_LETTERS.index(letter) for letter in machine.axes]
    return "XYZABC"[: max(3, *(column + 1 for column in columns))]


def profile_of(machine: Machine) -> FirmwareProfile:
    """Return GRBL, or grblHAL for a machine with rotary axes, which GRBL does not have."""
    letters = axes_of(machine)
    return GRBL if len(letters) == 3 else GRBLHAL.with_axes(letters)


def settings_of(machine: Machine) -> dict[int, float]:
    """Return the ``$`` settings of the axes: steps/mm, mm/min, mm/s^2, travel in mm.

    A value that the machine file leaves open is that of a new board. Homing and limits are on
    where the machine file describes limit switches.
    """
    settings: dict[int, float] = {32: 1.0} if machine.kind == "laser" else {}
    if machine.can_home:
        settings |= _homing(machine)
    letters = axes_of(machine)
    if len(letters) > 3:
        settings[ROTARY] = float((1 << (len(letters) - 3)) - 1)
    for column, letter in enumerate(AXIS_LETTERS[: len(letters)]):
        axis = machine.axes.get(letter)
        if axis is None:
            continue
        settings[STEPS + column] = axis.steps_per_mm
        settings[RATES + column] = per_minute(axis.max_velocity)
        settings[ACCELERATIONS + column] = (
            axis.max_acceleration
            or machine.path.max_tangential_acceleration
            or GRBL_SETTINGS[ACCELERATIONS]
        )
        if axis.travel is not None:
            settings[TRAVELS + column] = axis.travel[1] - axis.travel[0]
    return settings


def _homing(machine: Machine) -> dict[int, float]:
    """Return the settings of homing and limits: the lowest speeds and pull-off of the axes."""
    downwards, switched = 0, []
    for column, letter in enumerate(AXIS_LETTERS[: len(axes_of(machine))]):
        axis = machine.axes.get(letter)
        if axis is not None:
            homing = axis.homing or Homing()
            switched.append(homing)
            low = (homing.end or ("high" if letter == "z" else "low")) == "low"
            downwards |= low << column
    return {
        SOFT_LIMITS: 1.0,
        HARD_LIMITS: 1.0,
        HOMING: 1.0,
        HOMING_DIRECTION: float(downwards),
        HOMING_FEED: per_minute(min(homing.latch for homing in switched)),
        HOMING_SEEK: per_minute(min(homing.seek for homing in switched)),
        PULL_OFF: min(homing.pull_off for homing in switched),
    }
