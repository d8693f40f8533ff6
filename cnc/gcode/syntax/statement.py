"""A line as it was parsed, before anything in it is worth a number.

A statement never changes and is shared between equal lines, however often a loop comes by: what has
to be computed stands in it as a closure over the parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.words import Word

Value = Callable[[Parameters], float]
"""An expression: its value under the parameters as they are. Raises GcodeError with the column of
what can't be computed.
"""

Keyword = Literal[
    "sub", "endsub", "call", "return",
    "if", "elseif", "else", "endif",
    "while", "endwhile", "do", "repeat", "endrepeat", "break", "continue",
    "program", "goto", "if-goto", "if-then", "while-do", "end",
]  # fmt: skip
"""What a control line says. The first three rows are O-words; the last row is FANUC's, and O with
its number alone ("program").
"""


@dataclass(frozen=True, slots=True)
class Assignment:
    """``#1 = ..``: ``target`` is the name of a named parameter, or computes the number of a
    numbered one.
    """

    target: str | Value
    value: Value
    column: int
    length: int


@dataclass(frozen=True, slots=True)
class Remark:
    """A comment that does something: ``kind`` is the word before its comma in lower case (msg,
    debug, print, abort, log, ..).
    """

    kind: str
    text: str
    column: int
    length: int


@dataclass(frozen=True, slots=True)
class Control:
    """What a control line says.

    ``label`` of an O-word or of FANUC's DO and END: ``"100"``, ``"<name>"`` in lower case, or a
    value where it is computed. ``values``: the condition, the count of a repeat, the arguments of a
    call, the result of a return or an endsub, the target of a GOTO after its condition. ``then`` is
    the statement behind FANUC's IF .. THEN.
    """

    keyword: Keyword
    label: str | Value
    values: tuple[Value, ...]
    column: int
    length: int
    then: Statement | None = None


@dataclass(frozen=True, slots=True)
class Statement:
    """A parsed line.

    ``words`` in the order written. Where a number is computed, ``computed`` holds the index of its
    word, which says NaN, and its value. ``board`` is the text of a line for the board alone (GRBL's
    ``$H``).
    """

    words: tuple[Word, ...] = ()
    computed: tuple[tuple[int, Value], ...] = ()
    assignments: tuple[Assignment, ...] = ()
    remarks: tuple[Remark, ...] = ()
    control: Control | None = None
    board: str = ""
    percent: bool = False
    deletable: bool = False
