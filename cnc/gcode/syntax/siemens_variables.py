"""Variables of SINUMERIK with names: DEF, the parameters of PROC, and their names here.

A variable of the main program has a name for all programs. One of a subprogram, or a parameter of
its PROC, belongs to the call. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job
Planning", "User data" and "Subprogram technique".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

DEFINITION = re.compile(r"DEF\s+(REAL|INT|BOOL)\s+(.+)", re.I)
HEAD = re.compile(r"PROC\s+[A-Z_][A-Z0-9_]*\s*(?:\((.*)\))?((?:\s*(?:DISPLOF|SAVE|SBLOF))*)", re.I)
_DEFINED = re.compile(r"([A-Z_]{2}[A-Z0-9_]*)\s*(?:=\s*(.+))?", re.I)
_PARAMETER = re.compile(r"(REAL|INT|BOOL)\s+([A-Z_][A-Z0-9_]+)", re.I)
_SUBPROGRAM = re.compile(r"\s*(?:%_N_\w+_(SPF|MPF)\b|(?:N[0-9]+\s*)?(PROC)\s)", re.I)
_NUMBER = re.compile(r"\s*(?:/[0-9]?\s*)?(?:N[0-9]+\s*)?", re.I)


class Variable(NamedTuple):
    """A variable.

    Attributes:
        name: Its name in capitals.
        kind: REAL, INT or BOOL.
        local: Whether it belongs to the call of a subprogram.
    """

    name: str
    kind: str
    local: bool = False

    @property
    def stored(self) -> str:
        """Name of the parameter of RS274/NGC that holds it."""
        return f"p{self.name.lower()}" if self.local else variable_name(self.name)


Variables = tuple[Variable, ...]


def variable_name(written: str) -> str:
    """Return the name here of a variable that belongs to all programs."""
    return f"_v{written.lower()}"


def defined_variables(lines: Iterable[str], *, in_subprogram: bool = False) -> Variables:
    """Return the variables that lines define by DEF and PROC.

    Args:
        lines: The lines.
        in_subprogram: Whether the first line belongs to a subprogram.
    """
    local, found = in_subprogram, []
    for line in lines:
        if part := _SUBPROGRAM.match(line):
            local = (part[1] or "SPF").upper() == "SPF"
        text = without_number(line).strip()
        if definition := DEFINITION.fullmatch(text):
            names = (_DEFINED.fullmatch(each) for each in arguments(definition[2]))
            kind = definition[1].upper()
            found += [Variable(each[1].upper(), kind, local) for each in names if each]
        elif head := HEAD.fullmatch(text):
            found += parameters(head[1] or "") or ()
    return tuple(dict.fromkeys(found))


def without_comment(text: str) -> str:
    """Return a line without the comment after a semicolon, which may not stand in quotes."""
    quoted = False
    for at, char in enumerate(text):
        if char == '"':
            quoted = not quoted
        elif char == ";" and not quoted:
            return text[:at]
    return text


def without_number(line: str) -> str:
    """Return a line without block delete, line number and comment."""
    return _NUMBER.sub("", without_comment(line), count=1)


def parameters(text: str) -> Variables | None:
    """Return the parameters in the brackets of a PROC; None for forms that are not supported."""
    if not text.strip():
        return ()
    found = [_PARAMETER.fullmatch(each) for each in arguments(text)]
    if not all(found):
        return None
    return tuple(Variable(each[2].upper(), each[1].upper(), True) for each in found if each)


def definition(
    kind: str, text: str, refuse: Callable[[str, str], Exception]
) -> tuple[str, tuple[str, ...]]:
    """Return the names that a DEF defines, with blanks between them, and their values or 0."""
    found = [_DEFINED.fullmatch(part) for part in arguments(text)]
    if any(each is None for each in found):
        hint = "DEF REAL NAME=1.5, OTHER is read; arrays are not"
        raise refuse(f"DEF {kind} of this form", hint)
    values = (as_type(kind, each[2]) if each[2] else "0" for each in found if each)
    return " ".join(each[1].lower() for each in found if each), tuple(values)


def as_type(kind: str, value: str) -> str:
    """Return an expression as a type keeps its value: INT is rounded, BOOL is 0 or 1."""
    if kind == "INT":
        return f"ROUND({value})"
    return f"({value})<>0" if kind == "BOOL" else value


def arguments(text: str) -> list[str]:
    """Return the arguments of a cycle, split at commas outside of brackets."""
    parts, depth, begin = [], 0, 0
    for at, char in enumerate(text):
        depth += (char == "(") - (char == ")")
        if char == "," and depth == 0:
            parts.append(text[begin:at])
            begin = at + 1
    return [part.strip() for part in (*parts, text[begin:])]
