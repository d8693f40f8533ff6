"""The ``%`` that begins and ends a program."""

from __future__ import annotations

import re
from collections.abc import Iterator

from cnc.gcode.program import control_flow
from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.parser import Syntax, parse_line
from cnc.gcode.syntax.source_text import Text
from cnc.gcode.syntax.words import Word
from cnc.model.diagnostics import GcodeError

_COMMENT = re.compile(r"\([^)]*\)?|;.*", re.DOTALL)
_CODE = re.compile(r"[A-Za-z#][ \t]*[-+#\[<]?[ \t]*[0-9.]")
_WORD = re.compile(r"(?<![A-Za-z])[A-Za-z#][ \t]*[-+#\[<]?[ \t]*[0-9.]")
_NUMBER = re.compile(r"[ \t]*O[ \t]*[0-9]{1,8}[ \t]*(?:[(;].*)?$", re.IGNORECASE | re.DOTALL)


LEADER = 20
"""Most lines before the first %."""


def leader(text: Text, syntax: Syntax) -> int:
    """Return the number of lines before the program that are no G-code; 0 for none.

    FANUC's and Haas' controls ignore what precedes the first ``%`` or the first end of line: the
    leader of a tape. A line that can be read is none: a file whose first ``%`` is missing would
    lose a program. So the one line before the number of a program must have no word of G-code.

    Source: FANUC Series 16i, "Operator's Manual", file format of memory cards.
    """
    unreadable, is_text, lines = False, False, text.first_lines()
    for count, line in enumerate(lines):
        if count == 1 and is_text and _NUMBER.match(line.rstrip("\r\n")):
            return count
        if line.strip() == "%":
            begins = unreadable and any(_CODE.search(_COMMENT.sub("", behind)) for behind in lines)
            return count if begins else 0
        if count == LEADER:
            break
        try:
            statement = parse_line(line.rstrip("\r\n"), syntax)
        except GcodeError:
            unreadable = True
            is_text = count == 0 and not _WORD.search(_COMMENT.sub("", line))
            continue
        if statement.words or statement.computed or statement.control:
            break
    return 0


class PercentStep:
    """``%``. The first one, before any word, begins the program; any other ends it."""

    def run(self, flow: Flow, line: int) -> int:
        """Begin or end the program."""
        interpreter, frame = flow.interpreter, flow.frame
        if frame.kind != "main":
            if line == frame.first and not frame.scope:  # of a file without an O line
                return line + 1
            raise control_flow.not_ended(flow, f"before the % in line {line}")
        if interpreter.begun and not flow.percent:
            self._check_unopened(flow, line)
        if interpreter.begun or flow.percent:
            self._check_behind(flow, line)
            interpreter.end_of_file()
            interpreter.ended = True
        flow.percent = True
        return line + 1

    @staticmethod
    def _check_unopened(flow: Flow, line: int) -> None:
        """Refuse a % that would end a program without a first one.

        As the last line it is what other controllers leave of a pair of %.
        """
        at = Place(line, 1)
        message = "this % ends the program, and no % begins it"
        hint = "begin the program with %, or end it with M2 or M30"
        if not flow.interpreter.dialect.lenient or _has_code(flow, line + 1):
            raise flow.listing.fault(at, "percent-place", message, hint)
        _warn_of_percent("percent-unopened", flow, line, message, hint)

    @staticmethod
    def _check_behind(flow: Flow, line: int) -> None:
        """Report code behind the % that ends the program: GRBL would execute it."""
        behind = _next_words(flow, line + 1)
        if behind is None:
            return
        message = f"this % ends the program, and the code from line {behind} on is not executed"
        hint = "remove this %, or the lines behind it"
        if flow.interpreter.dialect.lenient:
            raise flow.listing.fault(Place(line, 1), "percent-place", message, hint)
        _warn_of_percent("percent-code-behind", flow, line, message, hint)


def _warn_of_percent(code: str, flow: Flow, line: int, message: str, hint: str) -> None:
    flow.interpreter.here.line = line
    flow.interpreter.here.report_warning(code, message, Word("%", 0.0, "%", 1, 1), hint)


def _has_code(flow: Flow, line: int) -> bool:
    """Whether a line from here on is not empty."""
    return any(text.strip(" \t\0\x1a") for _, text in _texts(flow, line))


def _next_words(flow: Flow, line: int) -> int | None:
    """Return the first line from here on that has a word of G-code outside of comments."""
    for number, text in _texts(flow, line):
        if _CODE.search(_COMMENT.sub("", text)):
            return number
    return None


def _texts(flow: Flow, line: int) -> Iterator[tuple[int, str]]:
    """Yield the lines from here on with their numbers."""
    while (window := flow.listing.window(line)) is not None:
        for index in range(line - window.first, window.count):
            yield window.first + index, window.text(index)
        line = window.first + window.count
