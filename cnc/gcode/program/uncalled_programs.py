"""Programs of a file that its first program does not call.

A control stores each program of a file under its number, and the operator selects one. Here the
first one is the main program, so that another one is executed only if it is called.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.line_index import PROGRAM, bare_text
from cnc.gcode.syntax.words import Word, fault

_CALL = re.compile(r"(?:m98|g65|g66)(?![0-9.]).*?p([0-9]+)(?![0-9.])")
_REPEATS = 10_000
"""FANUC's M98 reads a larger P as repeats followed by four digits of program number."""


def check_main(flow: Flow, code: Word, line: int) -> None:
    """Refuse a first program that ends with M99 and that a later program of the file calls.

    Raises:
        GcodeError: ``main-program-later``.
    """
    if (number := _main_number(flow)) is None:
        return
    caller = "", 0
    for at, text in _lines(flow, line + 1):
        if other := PROGRAM.fullmatch(text):
            caller = f"O{other[1]}", at
        elif caller[1] and (call := _CALL.search(text)):
            called = int(call[1])
            if called == number or (called >= _REPEATS and called % _REPEATS == number):
                name, first = caller
                message = (
                    f"{name} of line {first} calls O{number}, which ends with {code.written}: "
                    f"{name} is the main program"
                )
                hint = f"put {name} first, and its subprograms behind it, before the last %"
                raise fault("main-program-later", message, code, hint)


def report_uncalled(flow: Flow) -> None:
    """Warn once of the programs behind the end of the main program that were not called.

    A text whose first program has no number is read to its end only: it is a stream, or a file with
    one program.
    """
    if flow.frames or flow.listing is not flow.main or _main_number(flow) is None:
        return
    here = flow.interpreter.here
    left = [
        (f"O{found[1]}", line)
        for line, text in _lines(flow, here.line + 1)
        if (found := PROGRAM.fullmatch(text)) and found[1] and line not in flow.entered
    ]
    if not left:
        return
    name, here.line = left[0]
    more = f" and {len(left) - 1} more" if len(left) > 1 else ""
    message = f"{name}{more} behind the end of the program: not called, and not checked"
    hint = "check each program in a file of its own"
    here.report_warning("program-not-called", message, Word("O", 0.0, name, 1, 1), hint)


def _lines(flow: Flow, line: int) -> Iterator[tuple[int, str]]:
    """Yield the lines of the main text from here on, without comments and blanks."""
    while (window := flow.main.window(line)) is not None:
        for index in range(line - window.first, window.count):
            if text := bare_text(window.text(index)):
                yield window.first + index, text
        line = window.first + window.count


def _main_number(flow: Flow) -> int | None:
    """Return the number of the main program; None without one."""
    found = PROGRAM.fullmatch(bare_text(flow.main.source(flow.main_border)))
    return int(found[1]) if found and found[1] else None
