"""Touches of a face along an axis, and moves that a contact ends: their programs and results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cnc.measure.procedures import GoTo, Touch
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import Diagnostic, UsageError

MEASUREMENT = "measurement"
"""Name of the activity in the events."""
BACK = 1.0
"""Way back from a contact before the next one, mm: more than any play of a nut."""
SLOWER = 4.0
"""Factor by which the contacts that count are slower than the first one."""
QUICKER = 6.0
"""Factor by which moves in free space are quicker."""
START, MET, FIRST = 11, 12, 31
"""Parameters of the program: where it begins, the first contact, the contacts that count."""


@dataclass(frozen=True, slots=True)
class Touching:
    """A step of a measurement that the touch probe carries out or guards.

    Attributes:
        step: The step.
        place: Machine place of its axis before it, mm.
        feed: Speed of a first contact, mm/min.
    """

    step: Touch | GoTo
    place: float
    feed: float

    @property
    def program(self) -> str:
        """The program, in work coordinates."""
        axis, step = self.step.axis.upper(), self.step
        column = AXIS_LETTERS.index(step.axis)
        lines = ["G21 G90 G94 G40 G49 G17", f"#{START} = #{5420 + column}"]
        contact = f"#{5061 + column}"
        if isinstance(step, GoTo):
            way, feed = step.place - self.place, QUICKER * self.feed
            lines += [
                f"G38.3 {axis}[#{START} + {way:.6f}] F{feed:g}",
                f"#{MET} = #5070",
                f"#{FIRST} = {contact}",
            ]
            return "\n".join([*lines, "M2", ""])
        back = BACK if step.way > 0.0 else -BACK
        lines += [
            f"G38.2 {axis}[#{START} + {step.way:.6f}] F{self.feed:g}",
            f"#{MET} = {contact}",
        ]
        for k in range(step.contacts):
            lines += [
                f"G0 {axis}[#{MET} - {back:g}]",
                f"G38.2 {axis}[#{MET} + {back:g}] F{self.feed / SLOWER:g}",
                f"#{FIRST + k} = {contact}",
            ]
        return "\n".join([*lines, f"G0 {axis}#{START}", "M2", ""])

    def contacts(self, parameters: Mapping[int, float]) -> tuple[float, ...]:
        """Return the machine places of the contacts, mm, from the parameters after the program.

        Raises:
            UsageError: ``measure-contact`` where a move in free space met something.
        """
        step, start = self.step, parameters[START]
        if isinstance(step, Touch):
            counted = (parameters[FIRST + k] for k in range(step.contacts))
            return tuple(self.place + there - start for there in counted)
        if parameters[MET]:
            name, there = step.axis.upper(), self.place + parameters[FIRST] - start
            message = f"the probe met something at {name}{there:.3f} on its way to {step.place:.3f}"
            hint = "free the way, or begin farther from the faces; then measure again"
            raise UsageError(Diagnostic("measure-contact", message, hint=hint))
        return ()
