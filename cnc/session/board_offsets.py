"""Offsets of a board that plans for itself: the program is read with them, and writes them back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import cast

from cnc.boards.protocols import LineSink
from cnc.grbl_lines.number_format import BOARD_LETTERS
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, AxisLetter
from cnc.model.streams import GcodeLine
from cnc.session.kept_offsets import KEPT, Offsets

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59")
FIRST_PARAMETERS = {
    "G28": numbers.G28_POSITION,
    "G30": numbers.G30_POSITION,
    "G92": numbers.SHIFT,
    **{name: numbers.origin(system) for system, name in enumerate(SYSTEMS)},
}
"""Number of the parameter with the X of each offset."""
CHANGED = 0.0005
"""Smallest change of an offset that is written to the board, mm: its reports have 3 decimals."""


def board_parameters(board: LineSink, machine: Machine) -> dict[int, float]:
    """Return the parameters of the offsets that the board keeps.

    With them a program has the same meaning as if the board read it.
    """
    return offset_parameters(named_offsets(board, machine))


def named_offsets(board: LineSink, machine: Machine) -> Offsets:
    """Return the offsets that the board keeps."""
    return {
        name: dict(zip(machine.axes, place, strict=True))
        for name, place in board.stored_offsets.items()
    }


def offset_parameters(offsets: Mapping[str, Mapping[str, float]]) -> dict[int, float]:
    """Return the parameters of offsets."""
    values = {numbers.CURRENT_SYSTEM: 1.0, numbers.SHIFT_IN_EFFECT: 1.0}
    for name, place in offsets.items():
        for letter, value in place.items():
            values[FIRST_PARAMETERS[name] + AXIS_LETTERS.index(cast(AxisLetter, letter))] = value
    return values


def offsets_in(values: Mapping[int, float], machine: Machine) -> Offsets:
    """Return the offsets in the parameters of a program."""
    return {
        name: {
            letter: values.get(FIRST_PARAMETERS[name] + AXIS_LETTERS.index(letter), 0.0)
            for letter in machine.axes
        }
        for name in KEPT
    }


def offset_lines(
    board: LineSink, machine: Machine, values: Mapping[int, float]
) -> Iterator[GcodeLine]:
    """Yield the lines that write changed coordinate systems (G10) to the board.

    Args:
        board: The board.
        machine: The machine.
        values: Parameters at the end of the program, by number.
    """
    letters = [letter for letter in machine.axes if letter.upper() in BOARD_LETTERS]
    for number, name in enumerate(SYSTEMS, start=1):
        place = dict(zip(machine.axes, board.stored_offsets.get(name, ()), strict=False))
        new = {
            letter: values.get(FIRST_PARAMETERS[name] + AXIS_LETTERS.index(letter), 0.0)
            for letter in letters
        }
        changed = [
            letter
            for letter in letters
            if letter in place and abs(new[letter] - place[letter]) > CHANGED
        ]
        if changed:
            yield GcodeLine(
                " ".join(
                    (
                        f"G10 L2 P{number}",
                        *(f"{letter.upper()}{new[letter]:.3f}" for letter in changed),
                    )
                ),
                0,
            )
