"""A program from its first line to its end: lines are parsed and executed, and their blocks handed on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.canon import Block
from cnc.errors import CncError, GcodeError
from cnc.gcode import dialects
from cnc.gcode.here import Warn
from cnc.gcode.interpreter import Interpreter
from cnc.gcode.parameters import Parameters
from cnc.gcode.parser import MAX_LINE, Syntax, parse_line
from cnc.gcode.tools import ToolTable
from cnc.gcode.words import fault


def interpret(
    lines: Iterable[str],
    *,
    file: str,
    axes: tuple[str, ...] = ("x", "y", "z"),
    dialect: str = "auto",
    start: NDArray[np.float64] | None = None,
    block_delete: bool = False,
    warn: Warn | None = None,
    parameters: Parameters | None = None,
    tools: ToolTable | None = None,
) -> Iterator[Block]:
    """The canonical blocks of a program, as its lines are read.

    ``file`` names the program in blocks and errors. ``axes`` are the machine's, in the order of the columns of every position; ``start`` is
    the machine position (axes,) at the start, zeros by default. With ``block_delete`` lines that begin with ``/`` are skipped unread.
    ``warn`` is given what is legal but odd.

    Reading stops at M2, M30 or a second ``%``. Raises GcodeError at the first fault, with file, line, column, source text and hint;
    blocks of the lines before may have been handed on by then. Raises UsageError ``unknown-dialect``.
    """
    position = [0.0] * len(axes) if start is None else [float(value) for value in start]
    spoken = dialects.load(dialect)
    known = Parameters(macro=spoken.flavour == "macro-b") if parameters is None else parameters
    program = Interpreter(file, axes, spoken, position, known, warn, tools)
    syntax = Syntax(spoken.flavour, siemens=spoken.siemens, dollar=spoken.dollar, dialect=spoken.name)
    ready = program.out.ready
    percent = False
    for number, raw in enumerate(lines, start=1):
        text = raw.removesuffix("\n").removesuffix("\r")
        if block_delete and text.lstrip(" \t").startswith("/"):
            continue
        program.here.text_of = lambda _, text=text: text  # type: ignore[misc]
        try:
            statement = parse_line(text, syntax)
            if control := statement.control:
                if control.keyword == "program" and spoken.program_number and not program.begun:
                    continue
                raise fault("not-supported", "control flow is not supported", column=control.column, length=control.length)
            program.execute(statement, number)
            if statement.percent:
                if program.begun or percent:
                    program.end_of_file()
                    program.ended = True
                percent = True
        except GcodeError as error:
            raise _placed(error, file, number, text) from None
        if ready:
            yield from ready
            ready.clear()
        if program.ended:
            return
    try:
        program.end_of_file()
    except GcodeError as error:
        raise error.at(file=file) from None
    yield from ready


def _placed(error: GcodeError, file: str, line: int, text: str) -> CncError:
    """The error with file, line and text, unless it points at an earlier line already."""
    if error.diagnostic.line:
        return error.at(file=file)
    return error.at(file=file, line=line, text=text if len(text) <= MAX_LINE else None)
