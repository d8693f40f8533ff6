"""Assignments to parameters."""

from __future__ import annotations

from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.coordinates import Coordinates
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Assignment
from cnc.gcode.syntax.words import Word
from cnc.model.parameter_numbers import ALARM, EXTERNAL_OFFSET


class Assignments:
    """Execution of the assignments of a line.

    Args:
        one_by_one: Whether they take effect from left to right. If not, all values are computed
            before the first is set (RS274/NGC).
    """

    def __init__(
        self,
        parameters: Parameters,
        coordinates: Coordinates,
        here: SourceLocation,
        out: BlockBuffer,
        *,
        one_by_one: bool,
    ) -> None:
        self._here, self._out = here, out
        self._parameters = parameters
        self._coordinates = coordinates
        self._one_by_one = one_by_one

    def execute(self, assignments: tuple[Assignment, ...]) -> None:
        """Set parameters."""
        if len(assignments) == 1 or self._one_by_one:
            for each in assignments:
                self._set(each, self._target(each), each.value(self._parameters))
            return
        found = [(each, self._target(each), each.value(self._parameters)) for each in assignments]
        for each, target, value in found:
            self._set(each, target, value)

    def _target(self, assignment: Assignment) -> str | float:
        target = assignment.target
        return target if isinstance(target, str) else target(self._parameters)

    def _set(self, assignment: Assignment, target: str | float, value: float) -> None:
        if isinstance(target, str):
            self._parameters.set_name(target, value, assignment.column)
            return
        if target == ALARM and self._parameters.macro and self._out.assumed:
            self._report_alarm(assignment, value)
            return
        self._parameters.set_number(target, value, assignment.column)
        # Variables of FANUC's coordinate systems take effect at once.
        if target >= EXTERNAL_OFFSET and self._parameters.macro:
            self._coordinates.refresh()

    def _report_alarm(self, assignment: Assignment, value: float) -> None:
        """Report an alarm to which a guessed answer of the board may have led."""
        at = Word("#", 0.0, "#3000", assignment.column, assignment.length)
        message = f"the program may stop itself with alarm {ALARM + value:g}"
        hint = "the check continues; a run stops here if the board's answer leads here"
        self._here.report_warning("abort-possible", message, at, hint)
