"""Numbered settings (``$$``) of the board of a session."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.boards.protocols import LineSink, PulseSink
from cnc.machine.models import Machine


@dataclass(frozen=True, slots=True)
class BoardSetting:
    """A setting.

    Attributes:
        number: Its number.
        value: Its value, as the board prints it.
        name: Its name; "" if it is not known.
        unit: Its unit; "" without one.
        machine_file: The value that the machine file implies, where that is another one.
    """

    number: int
    value: str
    name: str
    unit: str
    machine_file: float | None


def read_settings(board: PulseSink | LineSink, machine: Machine) -> list[BoardSetting]:
    """Return the settings of a board by number. UsageError ``no-settings``."""
    settings = board.numbered_settings()
    names, other = settings.names(), settings.differing(machine)
    found = []
    for number, value in sorted(settings.values.items()):
        name, _, unit = names.get(number, "").partition(", ")
        found.append(BoardSetting(number, value, name, unit, other.get(number)))
    return found


def change_setting(board: PulseSink | LineSink, number: int, value: str) -> None:
    """Write a setting, and read it back.

    Raises:
        UsageError: ``no-settings``, ``setting-unknown``.
        BoardError: ``board-error``, ``setting-not-kept``.
    """
    settings = board.numbered_settings()
    settings.write(settings.changes({number: value}))
