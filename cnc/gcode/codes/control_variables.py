"""Macro variables that only a control knows: timers, counts of parts, inputs, data of tool life.

A check takes them as 0 until the program sets them, with one warning a variable. A run refuses
them. Which numbers they have is data of the dialect.
"""

from __future__ import annotations

from cnc.gcode.dialects.rules import VariableNumbers
from cnc.gcode.state.reading_policy import ReadingPolicy
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.words import Word, fault


def bind(
    parameters: Parameters, here: SourceLocation, policy: ReadingPolicy, variables: VariableNumbers
) -> None:
    """Bind the variables to the parameters of a program.

    Args:
        parameters: The parameters of the program.
        here: Place of the current line.
        policy: Whether a check goes on without the control.
        variables: Their numbers.
    """
    kept: dict[int, float] = {}
    for first, last in variables.control:
        _bind(parameters, here, policy, range(first, last + 1), kept)


def _bind(
    parameters: Parameters,
    here: SourceLocation,
    policy: ReadingPolicy,
    row: range,
    kept: dict[int, float],
) -> None:
    def read(place: int) -> float:
        number = row[place]
        if number not in kept:
            _report(here, policy, number)
            kept[number] = 0.0
        return kept[number]

    def write(place: int, value: float) -> None:
        if row[place] not in kept:
            _report(here, policy, row[place])
        kept[row[place]] = value

    parameters.bind_row(row, read, write)


def _report(here: SourceLocation, policy: ReadingPolicy, number: int) -> None:
    """Refuse a variable, or report it where a check goes on."""
    written = f"#{number}"
    place = here.text.find(written)
    length = len(written) if place >= 0 else len(here.text)
    at = Word("#", float(number), written, max(place, 0) + 1, length)
    message = f"#{number} belongs to the control: a timer, a count, an input or an output"
    if policy.missing_programs == "error":
        raise fault("parameter-number", message, at, "a run needs a program without it")
    here.report_warning(
        "control-variable",
        f"{message}; it is 0 here until the program sets it",
        at,
        "a run refuses it",
    )
