"""The EEPROM of the board: settings, offsets, start-up lines, build info; and the time of a write.

A byte is written only where it differs, in 3.4 ms each
(:data:`cnc.boards.grbl.simulator.wire.EEPROM_BYTE_TIME`). Numbers are single floats, and every
record has one byte of checksum.
"""

from __future__ import annotations

import struct

from cnc.boards.grbl.simulator.firmware_profile import RATES, ROTARY, STEPS, TOOL_CHANGE_MODE
from cnc.boards.grbl.simulator.modal import Refused
from cnc.boards.grbl.simulator.planner import Point

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")
STARTUP_LINES = 2
LONGEST_TEXT = 79
"""Characters of a start-up line or of the build info."""
WHOLE = (0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 32, TOOL_CHANGE_MODE, ROTARY)
"""Settings that are a byte, a mask or a switch."""
NO_DECIMALS = (*WHOLE, 30, 31)
SWITCHES = (4, 5, 6, 13, 20, 21, 22, 32)
LARGEST = 3.4e38
"""Approximately the largest single float."""


class Eeprom:
    """The memory. ``damaged``: names of records with a wrong checksum (error 7)."""

    def __init__(self, defaults: dict[int, float], axes: int = 3) -> None:
        self._axes = axes
        self._origin: Point = (0.0,) * axes
        self._defaults = dict(defaults)
        self.settings = dict(defaults)
        self.systems: dict[str, Point] = dict.fromkeys(SYSTEMS, self._origin)
        self.startup = [""] * STARTUP_LINES
        self.build_info = ""
        self.damaged: set[str] = set()

    def set(
        self, number: int, value: float, max_step_rate_hz: float | None, variable_spindle: bool
    ) -> int:
        """Store ``$number=value``, and return the bytes written. Errors 3, 4, 6, 10, 12, 17."""
        settings = dict(self.settings)
        if number not in settings:
            raise Refused(3)
        if value < 0.0:
            raise Refused(4)
        if number in SWITCHES:
            value = float(value != 0.0)
        elif number in WHOLE:
            value = float(int(value) % 65536 if number == 26 else int(value) % 256)
        if number == 0 and value < 3:
            raise Refused(6)
        if number == 20 and value and not settings[22]:
            raise Refused(10)
        if number == 32 and value and not variable_spindle:
            raise Refused(17)
        settings[number] = value
        rates = [settings[STEPS + axis] * settings[RATES + axis] for axis in range(self._axes)]
        fastest = max(rates) / 60.0
        if max_step_rate_hz is not None and number >= 100 and fastest > max_step_rate_hz:
            raise Refused(12)
        if number == 22 and not value:
            settings[20] = 0.0
        before, self.settings = self.settings, settings
        return _changed(_numbers(before), _numbers(settings))

    def store(self, name: str, value: Point) -> int:
        """Store a coordinate system or position, and return the bytes written."""
        before, self.systems[name] = self.systems[name], value
        return _changed(_point(before), _point(value))

    def store_startup(self, index: int, text: str) -> int:
        """Store a start-up line, and return the bytes written."""
        before, self.startup[index] = self.startup[index], text
        return _changed(_text(before), _text(text))

    def store_build_info(self, text: str) -> int:
        """Store the text of ``$I``, and return the bytes written."""
        before, self.build_info = self.build_info, text
        return _changed(_text(before), _text(text))

    def restore(self, part: str) -> int:
        """Restore ``$`` settings, ``#`` coordinates or ``*`` all; return the bytes written."""
        written = 0
        if part in "$*":
            before, self.settings = self.settings, dict(self._defaults)
            written += _changed(_numbers(before), _numbers(self.settings))
        if part in "#*":
            written += sum(self.store(name, self._origin) for name in SYSTEMS)
        if part == "*":
            written += sum(
                self.store_startup(index, "") for index in range(STARTUP_LINES)
            ) + self.store_build_info("")
        return written


def setting_text(number: int, value: float) -> str:
    """Return a setting as ``$$`` prints it."""
    return f"${number}={value:.0f}" if number in NO_DECIMALS else f"${number}={value:.3f}"


def _numbers(settings: dict[int, float]) -> bytes:
    return b"".join(
        struct.pack("<H", int(value)) if number in WHOLE else _single(value)
        for number, value in settings.items()
    )


def _point(point: Point) -> bytes:
    return b"".join(_single(value) for value in point)


def _single(value: float) -> bytes:
    """Return a single float; a larger number becomes the largest."""
    return struct.pack("<f", min(max(value, -LARGEST), LARGEST))


def _text(text: str) -> bytes:
    return text.encode("latin-1").ljust(LONGEST_TEXT + 1, b"\0")


def _changed(before: bytes, after: bytes) -> int:
    """Return the number of bytes that differ, with the checksum."""
    changed = sum(a != b for a, b in zip(before, after, strict=True))
    return changed + (sum(before) % 256 != sum(after) % 256)
