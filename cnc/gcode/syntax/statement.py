"""Statements: parsed lines whose values have not been computed yet.

A statement never changes and is shared between equal lines. Values to be computed are closures that
take the parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.words import Word

Value = Callable[[Parameters], float]
"""Computes the value of an expression with the present parameters.

Raises GcodeError with the column of the part that cannot be computed.
"""

Keyword = Literal[
    "sub", "endsub", "call", "return",
    "if", "elseif", "else", "endif",
    "while", "endwhile", "do", "repeat", "endrepeat", "break", "continue",
    "program", "goto", "if-goto", "if-then", "while-do", "end",
    "cycle", "mcall", "frame", "s-goto", "s-if", "s-else", "s-endif", "s-while", "s-endwhile",
    "s-for", "s-endfor", "s-loop", "s-endloop", "s-repeat", "s-until", "s-call",
    "s-end", "s-proc", "s-def", "s-holes", "s-again", "klartext",
]  # fmt: skip
"""Kinds of control lines. The first three rows are O-words. The next one has those of FANUC, and O
and a number alone ("program"); the last three have SINUMERIK's cycles, frames, jumps,
blocks and subprograms, and the blocks of Klartext.
"""


@dataclass(frozen=True, slots=True)
class Assignment:
    """``#1 = ..``. ``target`` is the name of a parameter, or computes its number."""

    target: str | Value
    value: Value
    column: int
    length: int


DIAMETERS = "diameters"
"""Kind of a remark that says whether X is a diameter from here on (DIAMON, DIAMOF, DIAM90)."""
DIRECTION = "direction"
"""Kind of the remark that sets how a rotary axis turns, or the tool (TOOL): its letter and how."""
MENDED = "mended"
"""Kind of the remark that reports a repair."""
SHOWN = "shown"
"""Kind of the remark that is a message of SINUMERIK: texts in quotes, ``#<name>`` for values."""
NOTED = "noted"
"""Kind of the remark that names a word without effect."""


@dataclass(frozen=True, slots=True)
class Remark:
    """A command in a comment. ``kind`` is its first word in lower case: msg, debug, print, .."""

    kind: str
    text: str
    column: int
    length: int


@dataclass(frozen=True, slots=True)
class Control:
    """The control part of a line.

    Attributes:
        keyword: The kind of line.
        label: Label of an O-word or of FANUC's DO and END: ``"100"``, ``"<name>"`` in lower case,
            or a computed value; the first name of a line of SINUMERIK.
        values: Condition, count of a repeat, arguments of a call, result of a return or an endsub,
            or target of a GOTO after its condition.
        column: Column from 1.
        length: Number of characters.
        then: The statement after FANUC's IF .. THEN.
        names: Other names of a line of SINUMERIK, and numbers of parameters.
        count: How often a subprogram of SINUMERIK is called.
    """

    keyword: Keyword
    label: str | Value
    values: tuple[Value, ...]
    column: int
    length: int
    then: Statement | None = None
    names: tuple[str | int, ...] = ()
    count: int = 1


@dataclass(frozen=True, slots=True)
class Statement:
    """A parsed line.

    Attributes:
        words: Words in the order written. The number of a word is NaN if it is computed.
        computed: Index and value of each word whose number is computed.
        assignments: Assignments.
        remarks: Commands in comments.
        control: The control part, if there is one.
        board: Text of a command for the board, such as ``$H`` of GRBL; empty for other lines.
        percent: Whether the line is a ``%``.
        deletable: Whether the line begins with ``/``.
    """

    words: tuple[Word, ...] = ()
    computed: tuple[tuple[int, Value], ...] = ()
    assignments: tuple[Assignment, ...] = ()
    remarks: tuple[Remark, ...] = ()
    control: Control | None = None
    board: str = ""
    percent: bool = False
    deletable: bool = False
