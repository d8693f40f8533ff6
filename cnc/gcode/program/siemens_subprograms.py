"""Steps of SINUMERIK's subprograms: calls by number or name, PROC, M17, RET.

A subprogram follows a line ``%_N_NAME_SPF`` or ``PROC NAME`` of the same text, or is the file
``name.spf`` in a folder of subroutines. R parameters belong to all programs, and
the parameters of PROC to a call. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job
Planning", "Subprogram technique".
"""

from __future__ import annotations

import math
import re

from cnc.gcode.program.call_stack import NOTHING, Flow, Frame, Listing, Step
from cnc.gcode.program.line_index import Place
from cnc.gcode.program.missing_programs import skips_missing
from cnc.gcode.syntax.statement import Control, Statement
from cnc.gcode.syntax.words import Word

_NUMBERED = re.compile("L[0-9]+")


class Call:
    """``L10``, ``NAME``, one of them with ``P3`` repeats, or ``NAME(1, R2)`` with values."""

    __slots__ = ("at", "control")

    def __init__(self, line: int, control: Control) -> None:
        self.at = Place(line, control.column, control.length)
        self.control = control

    def run(self, flow: Flow, line: int) -> int:
        """Enter the subprogram."""
        assert isinstance(self.control.label, str)
        name, _, repeats = self.control.label.partition(" ")
        count = int(repeats or 1)
        if not count:
            return line + 1
        flow.interpreter.begun = True
        found = self._found(flow, name)
        if found is None:
            return line + 1
        listing, scope = found
        given = self._values(flow, listing, scope, name)
        first = flow.enter(
            Frame(
                "program",
                name,
                listing,
                scope,
                flow.listing,
                self.at,
                line + 1,
                repeats_left=count - 1,
                is_repeated=count > 1,
            )
        )
        for parameter, value in given.items():
            flow.parameters.set_name(parameter, value, 1)
        return first

    def _values(self, flow: Flow, listing: Listing, scope: int, name: str) -> dict[str, float]:
        """Return the values of the parameters; 0 for those that the call leaves out.

        Raises:
            CncError: ``call-arguments``: the call has more values than the head has parameters.
        """
        declared = [each.split(":") for each in _parameters(listing, scope)]
        given = [value(flow.parameters) for value in self.control.values]
        if len(given) > len(declared):
            message = (
                f"{name} has {len(declared)} parameters, and the call gives {len(given)} values"
            )
            hint = f"its head is PROC {name}(REAL FIRST, ..)"
            raise flow.listing.fault(self.at, "call-arguments", message, hint)
        values = given + [0.0] * (len(declared) - len(given))
        return {
            parameter: _as_type(kind, 0.0 if value != value else value)
            for (parameter, kind), value in zip(declared, values, strict=True)
        }

    def _found(self, flow: Flow, name: str) -> tuple[Listing, int] | None:
        """Return the text of a subprogram and the line of its head; 0 for a file without one.

        None if a check continues without the subprogram: one of a number, or one with values. A
        name alone may be a mistyped word of another function.
        """
        for listing in (flow.listing, flow.main):
            if line := _head(listing, name):
                return listing, line
        file = flow.library.find(f"<{name.lower()}>", self.at)
        if file is not None:
            return file, _head(file, name)
        is_call = _NUMBERED.fullmatch(name) or self.control.values
        word = Word("L", 0.0, name, self.at.column, self.at.length)
        if is_call and skips_missing(flow, name, word, self.at.line):
            return None
        message = f"there is no subprogram {name}, and {name} is no word that is known"
        hint = f"%_N_{name}_SPF or PROC {name} begins it in this file; {name.lower()}.spf is a file"
        raise flow.listing.fault(self.at, "sub-unknown", message, hint)


def _head(listing: Listing, name: str) -> int:
    """Return the line that begins a subprogram; 0 if the text does not have it."""
    pattern = re.compile(
        rb"(?<![^\r\n])[ \t]*(?:%_N_" + name.encode() + rb"_[MS]PF\b"
        rb"|(?:N[0-9]+[ \t]*)?PROC[ \t]+" + name.encode() + rb"\b)",
        re.IGNORECASE,
    )
    line = 1
    while (window := listing.window(line)) is not None:
        index = window.find(pattern, 0, window.count)
        if index < window.count:
            return window.first + index
        line = window.first + window.count
    return 0


def _parameters(listing: Listing, scope: int) -> list[str]:
    """Return the parameters of a subprogram, each with its type, from the PROC that begins it."""
    line = max(scope, 1)
    while (window := listing.window(line)) is not None:
        for index in range(line - window.first, window.count):
            statement = listing.statement(window, index)
            if statement is None or statement.words:
                return []
            if (found := statement.control) is not None:
                return str(found.label).split() if found.keyword == "s-proc" else []
        line = window.first + window.count
    return []


def _as_type(kind: str, value: float) -> float:
    if kind == "INT":
        return math.copysign(math.floor(abs(value) + 0.5), value)
    return float(value != 0.0) if kind == "BOOL" else value


class End:
    """``M17``, ``RET``, M2 or M30: the end of a subprogram, or of the main program."""

    __slots__ = ("at", "code")

    def __init__(self, line: int, control: Control) -> None:
        assert isinstance(control.label, str)
        self.at = Place(line, control.column, control.length)
        self.code = control.label

    def run(self, flow: Flow, line: int) -> int:
        """Return to the caller, or end the program."""
        frame = flow.frame
        if frame.kind == "main":
            end = Word("M", float(self.code or 2), f"M{self.code or 2}", *self.at[1:])
            flow.interpreter.execute(Statement((end,)), line)
            return line + 1
        if self.code:
            message = f"M{self.code} in the subprogram {frame.name}"
            hint = "a subprogram ends with M17 or RET"
            raise flow.listing.fault(self.at, "call-style-mixed", message, hint)
        if frame.repeats_left:
            frame.repeats_left -= 1
            return frame.first
        return flow.leave()


_ENDS = {17.0: "", 2.0: "2", 30.0: "30"}


def plain_step(line: int, statement: Statement) -> Step | None:
    """Return the step of ``L10 P3``, M17, M2, M30 or a program number alone; None for others."""
    words = {word.letter: word for word in statement.words if word.letter != "N"}
    first = next(iter(words.values()), None)
    if words.keys() == {"O"} and not statement.computed:
        return NOTHING
    if first is None or statement.computed or not words.keys() <= {"L", "P", "M"}:
        return None
    if words.keys() == {"M"} and len(statement.words) <= 2 and first.number in _ENDS:
        return End(line, Control("s-end", _ENDS[first.number], (), first.column, first.length))
    if "L" in words and "M" not in words and all(word.number >= 0 for word in words.values()):
        repeats = f" {words['P'].whole or 0}" if "P" in words else ""
        label = f"{words['L'].written}{repeats}"
        return Call(line, Control("s-call", label, (), first.column, first.length))
    return None


def _call(_: Flow, line: int, control: Control) -> Step:
    return Call(line, control)


def _end(_: Flow, line: int, control: Control) -> Step:
    return End(line, control)


def _nothing(_: Flow, line: int, control: Control) -> Step:
    return NOTHING


MAKERS = {"s-call": _call, "s-end": _end, "s-proc": _nothing}
"""Functions that make the step of a control line, by keyword."""
