"""The two firmwares that the simulator can be, and what differs between them."""

from __future__ import annotations

from dataclasses import dataclass, field

GRBL_SETTINGS: dict[int, float] = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0,
    20: 0, 21: 0, 22: 0, 23: 0, 24: 25.0, 25: 500.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0,
    100: 250.0, 101: 250.0, 102: 250.0, 110: 500.0, 111: 500.0, 112: 500.0,
    120: 10.0, 121: 10.0, 122: 10.0, 130: 200.0, 131: 200.0, 132: 200.0,
}  # fmt: skip
"""``$$`` of a fresh board (settings.md, ``$$``), but for homing, which is off as no switches are
wired.
"""


@dataclass(frozen=True, slots=True)
class FirmwareProfile:
    """What one firmware is made of.

    rx_capacity: bytes that the receive ring holds. rx_reported: the figure of ``$I``. tx_capacity:
    bytes of the transmit ring. line_length: characters of a line, comments and spaces not counted.
    planner_blocks: motions that wait, the running one among them. repeats_error: a program line
    after an error gets the same error until an empty line comes. pairs_line_ends: a line feed that
    follows a carriage return ends no line of its own. eeprom_blinds: a write to the EEPROM keeps
    the processor from taking bytes off the wire. estop_alarm: number of the emergency stop's alarm.
    alarm_s: for so long the main program does nothing behind an alarm's message. line_numbers:
    whether ``Ln:`` is reported. mist: whether M7 is compiled in. variable_spindle: whether the
    spindle has a speed. max_step_rate_hz: steps/s that the settings may ask for (in GRBL: not
    checked).
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
    mist: bool = False
    variable_spindle: bool = True
    max_step_rate_hz: float | None = None
    build_lines: tuple[str, ...] = ()
    settings: dict[int, float] = field(default_factory=lambda: dict(GRBL_SETTINGS))


GRBL = FirmwareProfile(
    name="grbl",
    banner="Grbl 1.1h ['$' for help]",
    version="1.1h.20190830",
    options="VN",
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
)
"""GRBL 1.1h on an Arduino Uno with line numbers: interface.md; the line buffer has 80 characters,
one of them its end.
"""

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
    mist=True,
    build_lines=("[AXS:3:XYZ]", "[NEWOPT:ENUMS,RT+]", "[FIRMWARE:grblHAL]", "[DRIVER:the box]"),
)
"""grblHAL as its core is shipped: a ring of 1024 has room for one byte less."""

FIRMWARES = {profile.name: profile for profile in (GRBL, GRBLHAL)}
