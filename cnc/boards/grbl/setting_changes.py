"""Settings (``$$``) of a GRBL board: names, comparison with a machine file, changes, and files.

A file has one setting a line, ``$110=5000.000``, as the board prints them; ``;`` begins a comment.
Source: "Grbl v1.1 Settings" and "Interface"; grblHAL's ``$ES``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from cnc.boards.grbl.link import GrblLink
from cnc.boards.grbl.messages import Feedback, Setting
from cnc.boards.grbl.settings import (
    ACCELERATIONS,
    HOMING,
    LASER_MODE,
    NAMES,
    RATES,
    STEPS,
    TRAVELS,
    BoardInfo,
)
from cnc.boards.protocols import SettingChange, board_error
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.units import per_minute

LISTING = 10.0
"""Longest time of the answer to ``$ES``: some 300 lines at 115200 baud take 2 s."""
SAME = 1e-3
"""Values that differ by less are equal: GRBL prints three decimals."""
_LINE = re.compile(r"\$?(\d{1,5})\s*=\s*([^;]*)")
_VALUE = re.compile(r"-?(\d+\.?\d*|\.\d+)")
_NUMBER = re.compile(r"\$?\d{1,5}")


class GrblSettings:
    """The settings of a connected board.

    Args:
        link: The link to the board.
    """

    def __init__(self, link: GrblLink) -> None:
        self._link = link

    @property
    def firmware(self) -> str:
        """Name and build of the firmware."""
        return f"{self._link.info.firmware} {self._link.info.build}"

    @property
    def values(self) -> Mapping[int, str]:
        """Value of each setting, as the board prints it."""
        return self._link.info.settings

    def names(self) -> Mapping[int, str]:
        """Return the name and unit of each setting, as far as known; grblHAL lists its own."""
        if "ENUMS" not in self._link.info.extensions:
            return NAMES
        names = dict(NAMES)
        for answer in self._link.ask("$ES", LISTING):
            if isinstance(answer, Feedback) and answer.kind == "SETTING":
                number, _, name, unit, *_ = [*answer.text.split("|"), "", "", ""]
                if number.isdigit() and name:
                    names[int(number)] = f"{name}, {unit}" if unit else name
        return names

    def differing(self, machine: Machine) -> Mapping[int, float]:
        """Return the values that a machine file implies, where the board has others."""
        return differing(self._link.info, expected_by(machine, self._link.info))

    @staticmethod
    def number_of(text: str) -> int:
        """Return the number of a setting such as ``$110``; UsageError ``setting-unknown``."""
        if not _NUMBER.fullmatch(text):
            hint = "give its number, such as 110 or 110=5000"
            raise UsageError(Diagnostic("setting-unknown", f"{text!r} is no setting", hint=hint))
        return int(text.removeprefix("$"))

    @staticmethod
    def parsed(lines: Iterable[str], file: str) -> dict[int, str]:
        """Return the settings in the lines of a file.

        Raises:
            UsageError: ``setting-unknown``, for a line that is none.
        """
        values: dict[int, str] = {}
        for number, line in enumerate(lines, start=1):
            text = line.partition(";")[0].strip()
            match = _LINE.fullmatch(text)
            if match is not None:
                values[int(match[1])] = match[2].strip()
            elif text:
                hint = "a line is such as $110=5000"
                raise UsageError(
                    Diagnostic(
                        "setting-unknown", f"{text!r} is no setting", file, number, hint=hint
                    )
                )
        return values

    def changes(self, wanted: Mapping[int, str]) -> list[SettingChange]:
        """Return the settings to write, in their order.

        Homing is the first: soft limits need it, and GRBL switches them off with it.

        Raises:
            UsageError: ``setting-unknown``, where the board does not have one; ``setting-value``
                for a text in place of a number.
        """
        listed = []
        for number, value in wanted.items():
            before = self.values.get(number)
            if before is None:
                hint = "cncrun settings lists those that it has"
                message = f"the board has no setting ${number}"
                raise UsageError(Diagnostic("setting-unknown", message, hint=hint))
            if _VALUE.fullmatch(before) and not _VALUE.fullmatch(value):
                message, hint = f"{value!r} is no number", f"give one, such as {number}={before}"
                raise UsageError(Diagnostic("setting-value", f"${number}: {message}", hint=hint))
            if not _same(before, value):
                listed.append(SettingChange(number, before, value))
        return sorted(listed, key=lambda change: change.number != HOMING)

    def write(self, listed: Sequence[SettingChange]) -> bool:
        """Write settings, and read them back; return whether one changes the steps/mm.

        Raises:
            BoardError: ``board-error`` where the board refuses one, and ``setting-not-kept`` where
                it keeps another value.
        """
        link = self._link
        for change in listed:
            link.ask(f"${change.number}={change.after}")
        kept = {
            answer.number: answer.value for answer in link.ask("$$") if isinstance(answer, Setting)
        }
        link.info.settings.update(kept)
        for number, _, after in listed:
            if not _same(kept.get(number, ""), after):
                message = f"the board keeps ${number}={kept.get(number, '')}, not {after}"
                hint = "look up the values that its firmware accepts"
                raise board_error("setting-not-kept", message, hint=hint)
        return any(STEPS <= change.number < STEPS + len(AXIS_LETTERS) for change in listed)


def expected_by(machine: Machine, info: BoardInfo) -> dict[int, float]:
    """Return the settings that a machine file implies."""
    expected: dict[int, float] = {LASER_MODE: float(machine.kind == "laser")}
    for letter, axis in machine.axes.items():
        column = AXIS_LETTERS.index(letter)
        expected[STEPS + column] = axis.steps_per_mm
        expected[RATES + column] = per_minute(axis.max_velocity)
        if axis.max_acceleration is not None:
            expected[ACCELERATIONS + column] = axis.max_acceleration
        if axis.travel is not None and info.homes:
            expected[TRAVELS + column] = axis.travel[1] - axis.travel[0]
    return expected


def differing(info: BoardInfo, expected: Mapping[int, float]) -> dict[int, float]:
    """Return the expected values of the settings that the board has otherwise."""
    return {
        number: value
        for number, value in expected.items()
        if (own := info.number(number)) is not None and abs(own - value) > SAME * max(1.0, value)
    }


def _same(one: str, other: str) -> bool:
    try:
        return abs(float(one) - float(other)) < 0.5 * SAME
    except ValueError:
        return one == other


# Comparison of a board's settings with the machine file, before a run.
#
# The board moves by its own settings. A check without the board computes with the machine file.

PER_AXIS = 10
"""Numbers from the first setting of one quantity to the first of the next."""


def differences(info: BoardInfo, machine: Machine) -> list[Diagnostic]:
    """Return a warning with the settings that differ and both numbers, or nothing."""
    expected = differing(info, expected_by(machine, info))
    limits = [number for number in expected if _is_of(number, RATES, ACCELERATIONS)]
    groups = (
        ("moves take longer than checked", [n for n in limits if _own(info, n) < expected[n]]),
        (
            "moves are faster than the file allows",
            [n for n in limits if _own(info, n) > expected[n]],
        ),
        ("other steps/mm", [n for n in expected if _is_of(n, STEPS)]),
        ("another travel", [n for n in expected if _is_of(n, TRAVELS)]),
    )
    parts = [f"{effect}: {_both(info, expected, numbers)}" for effect, numbers in groups if numbers]
    if not parts:
        return []
    message = f"the board has other settings than the machine file; {'; '.join(parts)}"
    hint = "correct the machine file or the board: cncrun settings shows both"
    return [Diagnostic("board-differs", message, hint=hint, severity="warning")]


def _both(info: BoardInfo, expected: Mapping[int, float], numbers: Sequence[int]) -> str:
    return ", ".join(
        f"${number} {NAMES[number]} {_own(info, number):.10g} (file {expected[number]:.10g})"
        for number in sorted(numbers)
    )


def _is_of(number: int, *firsts: int) -> bool:
    return any(first <= number < first + PER_AXIS for first in firsts)


def _own(info: BoardInfo, number: int) -> float:
    return info.number(number) or 0.0
