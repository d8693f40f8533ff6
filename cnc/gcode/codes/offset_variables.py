"""Macro variables of the offset memory, of coordinate systems by axis, and of Haas' numbers.

Lengths are in the units of the program. Which number shows what is data of the dialect:
:class:`cnc.gcode.dialects.rules.VariableNumbers`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cnc.gcode.codes.motion import MotionCodes
from cnc.gcode.codes.tool_codes import ToolCodes
from cnc.gcode.state.tool_table import ToolEntry
from cnc.gcode.syntax.parameters import KEPT_MACRO, MORE_MACRO
from cnc.gcode.syntax.words import Word
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS

_AXIS_STEP = 100
"""From #2500, the external offset of the first axis, to #2600, that of the next one."""
_BY_AXIS = 7
"""The external offset and G54 to G59."""
_COMMON = (range(100, 200), range(500, 1000))


_Value = Callable[[ToolEntry], float]
_Change = Callable[[ToolEntry, float], ToolEntry]


class OffsetVariables(MotionCodes):
    """Binds the variables of a dialect to the parameters of a program.

    Args:
        dialect: The dialect.
        here: Place of the current line.
        tools: The codes of tools, with the offset memory.
        coordinates: The coordinate systems, with the parameters.
    """

    def __init__(self, tools: ToolCodes) -> None:
        super().__init__(tools.motion)
        self._tools, dialect = tools, self._dialect
        self._wear_reported = False
        variables = dialect.variables
        unsure = [range(first, last + 1) for first, last in variables.wear_is_length]
        size = 2.0 if dialect.offset_diameters else 1.0
        rows: tuple[tuple[list[list[int]], _Value, _Change], ...] = (
            (variables.length, lambda entry: entry.offsets.get("Z", 0.0),
             lambda entry, value: replace(entry, offsets=entry.offsets | {"Z": value})),
            (variables.wear, lambda entry: entry.wear.get("Z", 0.0),
             lambda entry, value: replace(entry, wear=entry.wear | {"Z": value})),
            (variables.radius, lambda entry: size * entry.diameter / 2.0,
             lambda entry, value: replace(entry, diameter=2.0 * value / size)),
            (variables.radius_wear, lambda entry: size * entry.radius_wear,
             lambda entry, value: replace(entry, radius_wear=value / size)),
        )  # fmt: skip
        for places, value, change in rows:
            for first, count in places:
                is_unsure = any(first in each for each in unsure)
                self._bind(range(first, first + count), value, change, is_unsure=is_unsure)
        if variables.origins:
            self._bind_origins(variables.origins)
        if variables.more_origins:
            last = numbers.MOST_G54_1_SYSTEMS * numbers.SYSTEM_STEP
            self._alias(
                range(variables.more_origins, variables.more_origins + last), numbers.G54_1_ORIGIN
            )
        if variables.common:
            self._bind_common()

    def _bind(self, row: range, value: _Value, change: _Change, *, is_unsure: bool) -> None:
        """Bind the variables of one kind of offset."""
        table, state = self._tools.table, self._tools.state

        def place_of(place: int) -> Word:
            number = row[place]
            at = Word("#", float(number), f"#{number}", 1, len(self._here.text))
            if is_unsure:
                self._report_wear(number, at)
            return at

        def read(place: int) -> float:
            entry = self._tools.entry(place + 1, place_of(place))
            return value(entry) / state.scale

        def write(place: int, number: float) -> None:
            place_of(place)
            length = 0.0 if number != number else number * state.scale
            table.put(change(table.tool(place + 1) or ToolEntry(place + 1), length))

        self._parameters.bind_row(row, read, write)

    def _report_wear(self, number: int, at: Word) -> None:
        """Report once that a variable is read as a wear, and is a whole length elsewhere."""
        if self._wear_reported:
            return
        self._wear_reported = True
        message = f"#{number} is the wear of a length; controls with memory A keep the length there"
        hint = f"the geometry is #{number % 1000 + 11000}"
        self._here.report_warning("offset-variable-wear", message, at, hint)

    def _bind_origins(self, first: int) -> None:
        """Bind the offsets of the coordinate systems by axis: #2500, #2501 for G54, #2600, .."""
        for axis in (AXIS_LETTERS.index(letter) for letter in "xyz"):
            for system in range(_BY_AXIS):
                origin = numbers.origin(system - 1) if system else numbers.EXTERNAL_OFFSET
                number = first + _AXIS_STEP * axis + system
                self._alias(range(number, number + 1), origin + axis)

    def _alias(self, row: range, first: int) -> None:
        """Give the variables from ``first`` on second numbers; such as those of origins."""

        def write(place: int, value: float) -> None:
            self._parameters.set_number(first + place, value, 1)
            self._coordinates.refresh()

        self._parameters.bind_row(
            row, lambda place: self._parameters.number(first + place, 1), write
        )

    def _bind_common(self) -> None:
        """Bind the second numbers of common variables: #10100 is #100. Those between are more."""
        self._parameters.kept = KEPT_MACRO.union(MORE_MACRO)
        for span in _COMMON:
            row = range(MORE_MACRO.start + span.start, MORE_MACRO.start + span.stop)
            self._alias(row, span.start)
