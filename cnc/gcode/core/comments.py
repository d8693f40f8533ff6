"""Parameter values in the text of DEBUG, PRINT and ABORT comments, and of SINUMERIK's messages.

Source: LinuxCNC, "G-code overview", comment parameters; Siemens, "SINUMERIK 840D sl/828D
Programming Manual, Job Planning", concatenation of strings.
"""

from __future__ import annotations

import re

from cnc.gcode.core.context import Context, Executor
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.statements import MENDED, NOTED, SHOWN, UNCHECKED, Assignment, Remark
from cnc.gcode.reader.words import Word, fault
from cnc.model.blocks import Message
from cnc.model.diagnostics import GcodeError
from cnc.model.parameter_numbers import ALARM, EXTERNAL_OFFSET
from cnc.model.units import decimal_text

UNKNOWN = "######"
"""Replaces a parameter that does not exist."""
_DEFAULT = ".6f"
_QUOTED = re.compile(r'"([^"]*)"|#<([^<>]*)>')
_PART = re.compile(r"%(?:(d)|\.([0-9])f|(f))|#(?:([0-9]+)|<([^<>]*)>)")


def fill(text: str, parameters: Parameters) -> str:
    """Return the text with values in place of ``#1`` and ``#<name>``.

    ``%d`` (no decimals), ``%f`` (four) and ``%.2f`` are removed and apply to the parameters after
    them. Before the first one, values have six decimals.
    """
    form = _DEFAULT

    def value(part: re.Match[str]) -> str:
        nonlocal form
        whole, decimals, fixed, number, name = part.groups()
        if number is None and name is None:
            form = ".0f" if whole else ".4f" if fixed else f".{decimals}f"
            return ""
        try:
            if number is not None:
                found = parameters.number(float(number), 0)
            else:
                found = parameters.name(re.sub(r"\s", "", name).lower(), 0)
        except GcodeError:
            return UNKNOWN
        return f"{found:{form}}" if found == found else UNKNOWN

    return _PART.sub(value, text)


def shown(text: str, parameters: Parameters) -> str:
    """Return a message of texts in quotes and ``#<name>``: values have 10 decimals at most."""

    def value(part: re.Match[str]) -> str:
        quoted, name = part.groups()
        if name is None:
            return str(quoted)
        try:
            found = parameters.name(name, 0)
        except GcodeError:
            return UNKNOWN
        return decimal_text(found, 10) if found == found else UNKNOWN

    return _QUOTED.sub(value, text)


# Commands in comments: MSG, DEBUG, PRINT and ABORT.
#
# Source: LinuxCNC, "G-code overview", messages.

_MESSAGES = ("msg", "debug", "print")


class CommentCommands(Executor):
    """Executes the commands in comments."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._aborts = context.dialect.lines.aborts
        self._noted: set[str] = set()
        self._may_abort: set[tuple[str, int]] = set()

    def execute(self, remark: Remark) -> GcodeError | None:
        """Execute a command; return the error of an ABORT that ends the program, else None."""
        here = self._here
        if remark.kind == "abort" and self._aborts:
            return self._abort(remark)
        if remark.kind in _MESSAGES:
            text = remark.text if remark.kind == "msg" else fill(remark.text, self._parameters)
            self._out.add(Message(here.file, here.line, text))
            return None
        if remark.kind == SHOWN:
            self._out.add(Message(here.file, here.line, shown(remark.text, self._parameters)))
            return None
        if remark.kind == MENDED:
            at = Word("(", 0.0, "(", remark.column, remark.length)
            here.report_warning(
                "comment-mended", remark.text, at,
                "write comments in ( ), without brackets inside", remark.fix,
            )  # fmt: skip
            return None
        if remark.kind == NOTED:
            if remark.text not in self._noted:
                self._noted.add(remark.text)
                at = Word("(", 0.0, "", remark.column, remark.length)
                here.report_note("code-not-needed", remark.text, at)
            return None
        if remark.kind == UNCHECKED:
            at = Word("(", 0.0, "", remark.column, remark.length)
            if self._policy.missing_programs == "error":
                message = f"{remark.text} is not supported"
                raise fault("code-not-supported", message, at, "only spindle 1 is driven here")
            if remark.text not in self._noted:
                self._noted.add(remark.text)
                message = f"{remark.text}: the control's part of it is not checked"
                here.report_warning("moves-not-checked", message, at, "a run refuses it")
            return None
        name = f"({remark.kind.upper()})"
        at = Word("(", 0.0, name, remark.column, 1)
        effect = "stops the program" if remark.kind == "abort" else "writes a file or runs code"
        hint = f"it {effect} on LinuxCNC only"
        here.report_warning("comment-not-active", f"{name} has no effect here", at, hint)
        return None

    def _abort(self, remark: Remark) -> GcodeError | None:
        """Return the error ``program-abort``.

        It is only a warning where a guessed answer of the board may have led here.
        """
        here, text = self._here, fill(remark.text, self._parameters)
        reason = f": {text}" if text else ""
        at = Word("(", 0.0, "(ABORT)", remark.column, remark.length)
        if not self._out.assumed:
            hint = "correct the cause that its text gives, then run it again"
            return fault("program-abort", f"the program aborts itself{reason}", at, hint)
        if (place := (here.file, here.line)) not in self._may_abort:
            self._may_abort.add(place)
            hint = "the check continues; a run aborts here if the board's answer leads here"
            here.report_warning("abort-possible", f"the program may abort itself{reason}", at, hint)
        return None


# Assignments to parameters.


class Assignments(Executor):
    """Execution of the assignments of a line."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        # RS274/NGC computes all values before the first is set.
        self._one_by_one = context.dialect.lines.one_by_one

    def execute(self, assignments: tuple[Assignment, ...]) -> None:
        """Set parameters."""
        if len(assignments) == 1 or self._one_by_one:
            for assignment in assignments:
                self._set(assignment, self._target(assignment), assignment.value(self._parameters))
            return
        computed = [
            (assignment, self._target(assignment), assignment.value(self._parameters))
            for assignment in assignments
        ]
        for assignment, target, value in computed:
            self._set(assignment, target, value)

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
