"""Steps of SINUMERIK's subprograms: calls by number or name, PROC, M17, RET.

A subprogram follows a line ``%_N_NAME_SPF`` or ``PROC NAME`` of the same text, or is the file
``name.spf`` in a folder of subroutines. R parameters belong to all programs, and
the parameters of PROC to a call. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job
Planning", "Subprogram technique".
"""

from __future__ import annotations

import math
import re

from cnc.gcode.program.call_stack import ControlStep, Flow, Frame, Listing, Maker
from cnc.gcode.program.missing_programs import skips_missing
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import Word

_NUMBERED = re.compile("L[0-9]+")


class Call(ControlStep):
    """``L10``, ``NAME``, one of them with ``P3`` repeats, or ``NAME(1, R2)`` with values."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Enter the subprogram."""
        name, count = str(self.control.label), self.control.count
        if not count:
            return line + 1
        flow.interpreter.begun = True
        found = self._found(flow, name)
        if found is None:
            return line + 1
        listing, scope = found
        given = self._values(flow, listing, scope, name)
        caller = flow.listing
        first = flow.enter(Frame("program", name, listing, scope, caller, self.at, line + 1, count))
        for parameter, value in given.items():
            flow.parameters.set_name(parameter, value, 1)
        return first

    def _values(self, flow: Flow, listing: Listing, scope: int, name: str) -> dict[str, float]:
        """Return the values of the parameters; 0 for those that the call leaves out.

        Raises:
            CncError: ``call-arguments``: the call has more values than the head has parameters.
        """
        names = _parameters(listing, scope)
        declared = list(zip(names[::2], names[1::2], strict=True))
        given = [value(flow.parameters) for value in self.control.values]
        if len(given) > len(declared):
            message = (
                f"{name} has {len(declared)} parameters, and the call gives {len(given)} values"
            )
            hint = f"its head is PROC {name}(REAL FIRST, ..)"
            raise flow.listing.fault(self.at, "call-arguments", message, hint)
        values = given + [0.0] * (len(declared) - len(given))
        return {
            str(parameter): _as_type(kind, 0.0 if value != value else value)
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


def _parameters(listing: Listing, scope: int) -> tuple[str | int, ...]:
    """Return the parameters of a subprogram, each with its type, from the PROC that begins it."""
    line = max(scope, 1)
    while (window := listing.window(line)) is not None:
        for index in range(line - window.first, window.count):
            statement = listing.statement(window, index)
            if statement is None or statement.words:
                return ()
            if (found := statement.control) is not None:
                return found.names if found.keyword == "s-proc" else ()
        line = window.first + window.count
    return ()


def _as_type(kind: str | int, value: float) -> float:
    if kind == "INT":
        return math.copysign(math.floor(abs(value) + 0.5), value)
    return float(value != 0.0) if kind == "BOOL" else value


class End(ControlStep):
    """``M17``, ``RET``, M2 or M30: the end of a subprogram, or of the main program."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Return to the caller, or end the program."""
        frame, code = flow.frame, str(self.control.label)
        if frame.kind == "main":
            end = Word("M", float(code or 2), f"M{code or 2}", *self.at[1:])
            flow.interpreter.execute(Statement((end,)), line)
            return line + 1
        if code:
            message = f"M{code} in the subprogram {frame.name}"
            hint = "a subprogram ends with M17 or RET"
            raise flow.listing.fault(self.at, "call-style-mixed", message, hint)
        return flow.finish()


class Head(ControlStep):
    """``PROC``: it has no effect."""

    __slots__ = ()

    def run(self, _: Flow, line: int) -> int:
        """Continue with the next line."""
        return line + 1


MAKERS: dict[str, Maker] = {"s-call": Call, "s-end": End, "s-proc": Head}
"""Classes of the steps of control lines, by keyword."""
