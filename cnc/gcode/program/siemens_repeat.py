"""SINUMERIK's repetition of lines: REPEATB of one line, REPEAT of a section.

``REPEAT FIRST`` repeats from the label to ENDLABEL, or to the line before REPEAT.
``REPEAT FIRST LAST`` repeats from one label to the other. P is the number of repetitions, 1 if it
is left out. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job Planning", "Program
section repetition".
"""

from __future__ import annotations

from cnc.gcode.program.call_stack import Flow, Listing, Loop, Step
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.repeated_sections import Section
from cnc.gcode.program.siemens_flow import labelled
from cnc.gcode.program.siemens_subprograms import End, plain_step
from cnc.gcode.syntax.statement import Control
from cnc.model.diagnostics import GcodeError

MOST_REPEATS = 9999
_END = "ENDLABEL"


class Repeat:
    """``REPEAT FIRST LAST P=3`` or ``REPEATB FIRST P=3``."""

    __slots__ = ("at", "control", "loop")

    def __init__(self, line: int, control: Control) -> None:
        self.at = Place(line, control.column, control.length)
        self.control = control
        self.loop: Loop | None = None

    def run(self, flow: Flow, line: int) -> int:
        """Go to the first line of the section; its end leads back."""
        if self.loop is None:
            self.loop = self._find(flow, line)
            flow.listing.loops.append(self.loop)
        self.loop.since = flow.executed
        count = self.control.values[0](flow.parameters) if self.control.values else 1.0
        count = 1.0 if count != count else count
        if not 1.0 <= count <= MOST_REPEATS or count != int(count):
            message = f"P={count:g}: the number of repetitions is 1 to {MOST_REPEATS}"
            raise flow.listing.fault(self.at, "call-repeats", message)
        first, last = self.loop.first, self.loop.last
        flow.sections.begin(
            Section(flow.listing, len(flow.frames), first, last, line + 1, int(count) - 1)
        )
        if last + 1 not in flow.listing.section_ends:
            flow.listing.section_ends.add(last + 1)
            flow.listing.forget_steps()
        return first

    def _find(self, flow: Flow, line: int) -> Loop:
        """Return the first and the last line of the section.

        Raises:
            CncError: ``jump-target-missing``, ``code-not-supported``.
        """
        kind, first, last = str(self.control.label).split(" ")
        begin = self._line_of(flow, first, line)
        if kind == "B":
            end = begin
        elif last:
            end = self._line_of(flow, last, line)
        else:
            end = next(labelled(flow.listing, _END, begin), 0)
            if begin < line and (not end or end > line):
                end = line - 1
        if not end or end < begin or begin <= line <= end:
            message = f"the section from {first} on has no end outside of this line"
            hint = f"write {_END}: first in its last line, or a second label here"
            raise flow.listing.fault(self.at, "jump-target-missing", message, hint)
        if at := next((at for at in range(begin, end + 1) if _is_end(flow.listing, at)), 0):
            message = f"line {at} ends the program inside the repeated section"
            hint = "let the section end before it"
            raise flow.listing.fault(self.at, "code-not-supported", message, hint)
        if flow.listing.page(end + 1) is None:
            message = "the repeated section is the end of the text"
            raise flow.listing.fault(
                self.at, "program-end-missing", message, "write M17 or M30 after it"
            )
        return Loop("this REPEAT", self.at, begin, end)

    def _line_of(self, flow: Flow, label: str, line: int) -> int:
        """Return the nearest line before this one with a label, or else the first one after it."""
        before = list(labelled(flow.listing, label, 1, line))
        found = before[-1] if before else next(labelled(flow.listing, label, line + 1), 0)
        if not found:
            hint = "write the label and a colon first in the target line"
            message = f"there is no {label}:"
            raise flow.listing.fault(self.at, "jump-target-missing", message, hint)
        return found


def _is_end(listing: Listing, line: int) -> bool:
    """Return whether a line ends a program or a subprogram. A faulty line does not."""
    window = listing.window(line)
    if window is None:
        return False
    try:
        statement = listing.statement(window, line - window.first)
    except GcodeError:
        return False
    if statement is None:
        return False
    if statement.control is not None:
        return statement.control.keyword == "s-end"
    return isinstance(plain_step(line, statement), End)


class SectionEnd:
    """The line after a repeated section."""

    __slots__ = ("step",)

    def __init__(self, step: Step) -> None:
        self.step = step

    def run(self, flow: Flow, line: int) -> int:
        """Repeat the section that ends here, or return to the line after its REPEAT."""
        after = flow.sections.after(flow.listing, len(flow.frames), line)
        return after or self.step.run(flow, line)


def _maker(_: Flow, line: int, control: Control) -> Step:
    return Repeat(line, control)


MAKERS = {"s-again": _maker}
