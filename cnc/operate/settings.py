"""Settings (``$$``) of the GRBL board of a session."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.setting_changes import changes, differing, expected_by, names_of, write
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError


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


def read_settings(board: object, machine: Machine) -> list[BoardSetting]:
    """Return the settings of a board by number. UsageError ``no-settings``."""
    grbl = _grbl(board)
    names, other = names_of(grbl.link), differing(grbl.info, expected_by(machine, grbl.info))
    found = []
    for number, value in sorted(grbl.info.settings.items()):
        name, _, unit = names.get(number, "").partition(", ")
        found.append(BoardSetting(number, value, name, unit, other.get(number)))
    return found


def change_setting(board: object, number: int, value: str) -> None:
    """Write a setting, and read it back.

    Raises:
        UsageError: ``no-settings``, ``setting-unknown``.
        BoardError: ``board-error``, ``setting-not-kept``.
    """
    grbl = _grbl(board)
    write(grbl.link, changes(grbl.info, {number: value}))


def _grbl(board: object) -> GrblBoard:
    if isinstance(board, GrblBoard):
        return board
    message, hint = "this board has no settings", "GRBL boards have them"
    raise UsageError(Diagnostic("no-settings", message, hint=hint))
