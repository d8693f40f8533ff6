"""Parameters that show the position to a program."""

from __future__ import annotations

from collections.abc import Callable

from cnc.gcode.state.coordinates import SYSTEM_CODES, Coordinates
from cnc.gcode.syntax.code_numbers import G
from cnc.model.blocks import AXIS_LETTERS, ROTARY_LETTERS
from cnc.model.parameter_numbers import POSITION


def bind_position(
    coordinates: Coordinates, here: Callable[[], list[float]], scale: Callable[[], float]
) -> None:
    """Show the position as parameters: 5420 to 5428 and their names.

    Args:
        coordinates: The coordinate systems, with the parameters.
        here: Returns the programmed machine position.
        scale: Returns the mm of a program unit.
    """
    axes, bind = coordinates.axes, coordinates.parameters.bind
    for place, letter in enumerate(AXIS_LETTERS):
        index = axes.index(letter) if letter in axes else None
        relative = _reading(index, letter, lambda: coordinates.to_program(here()), scale)
        bind(POSITION + place, relative)
        bind(f"_{letter}", relative)
        bind(f"_abs_{letter}", _reading(index, letter, here, scale))

    def code() -> float:
        system = coordinates.system
        return float(SYSTEM_CODES[system] if system < len(SYSTEM_CODES) else G.G54_1)

    bind("_coord_system", code)


def bind_numbers(
    coordinates: Coordinates,
    first: int,
    position: Callable[[], list[float]],
    scale: Callable[[], float],
) -> None:
    """Show a position in mm as one parameter for each axis of the machine."""
    for index, letter in enumerate(coordinates.axes):
        coordinates.parameters.bind(first + index, _reading(index, letter, position, scale))


def _reading(
    index: int | None,
    letter: str,
    position: Callable[[], list[float]],
    scale: Callable[[], float],
) -> Callable[[], float]:
    if index is None:
        return lambda: 0.0
    if letter in ROTARY_LETTERS:
        return lambda: position()[index]
    return lambda: position()[index] / scale()
