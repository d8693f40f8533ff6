"""Variables of SINUMERIK with names: DEF, the parameters of PROC, and their names here.

A variable of the main program has a name for all programs. One of a subprogram, or a parameter of
its PROC, belongs to the call. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job
Planning", "User data" and "Subprogram technique".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

DEFINITION = re.compile(r"DEF\s+(REAL|INT|BOOL)\s+(.+)", re.I)
HEAD = re.compile(r"PROC\s+[A-Z_][A-Z0-9_]*\s*(?:\((.*)\))?((?:\s*(?:DISPLOF|SAVE|SBLOF))*)", re.I)
_DEFINED = re.compile(r"([A-Z_]{2}[A-Z0-9_]*)\s*(?:=\s*(.+))?", re.I)
_ARRAY = re.compile(
    r"((?!R\s*\[)[A-Z_][A-Z0-9_]*)\s*\[\s*([0-9]+)\s*(?:,\s*([0-9]+)\s*)?\](?:\s*=\s*(.+))?", re.I
)
_FIRST_ARRAY = 20_000_000_000
ROW = 100_000
"""Distance between the numbers of two elements whose first index differs by 1."""
SPAN = ROW * ROW
"""Distance between two arrays."""
MOST_ELEMENTS = 10_000
_PARAMETER = re.compile(r"(REAL|INT|BOOL)\s+([A-Z_][A-Z0-9_]+)", re.I)
_SUBPROGRAM = re.compile(r"\s*(?:%_N_\w+_(SPF|MPF)\b|(?:N[0-9]+\s*)?(PROC)\s)", re.I)
_NUMBER = re.compile(r"\s*(?:/[0-9]?\s*)?(?:N[0-9]+\s*)?", re.I)


class Variable(NamedTuple):
    """A variable.

    Attributes:
        name: Its name in capitals.
        kind: REAL, INT or BOOL.
        local: Whether it belongs to the call of a subprogram.
        sizes: Numbers of elements of an array, by index; empty for a single value.
        first: Number of the parameter of the first element of an array.
    """

    name: str
    kind: str
    local: bool = False
    sizes: tuple[int, ...] = ()
    first: int = 0

    @property
    def stored(self) -> str:
        """Name of the parameter of RS274/NGC that holds it."""
        return f"p{self.name.lower()}" if self.local else variable_name(self.name)


Variables = tuple[Variable, ...]


def variable_name(written: str) -> str:
    """Return the name here of a variable that belongs to all programs."""
    return f"_v{written.lower()}"


def written_name(stored: str) -> str:
    """Return an R parameter or a variable as a program writes it, from its name here."""
    return stored[1 if stored[1:2] == "r" or stored[0] == "p" else 2 :].upper()


def defined_variables(lines: Iterable[str], *, in_subprogram: bool = False) -> Variables:
    """Return the variables that lines define by DEF and PROC.

    Args:
        lines: The lines.
        in_subprogram: Whether the first line belongs to a subprogram.
    """
    local, found, arrays = in_subprogram, [], 0
    for line in lines:
        if border := _SUBPROGRAM.match(line):
            local = (border[1] or "SPF").upper() == "SPF"
        text = without_number(line).strip()
        if definition := DEFINITION.fullmatch(text):
            kind = definition[1].upper()
            for part in arguments(definition[2]):
                if name := _DEFINED.fullmatch(part):
                    found.append(Variable(name[1].upper(), kind, local))
                elif (array := _ARRAY.fullmatch(part)) and (sizes := _sizes(array)) and not local:
                    first = _FIRST_ARRAY + SPAN * arrays
                    found.append(Variable(array[1].upper(), kind, local, sizes, first))
                    arrays += 1
        elif head := HEAD.fullmatch(text):
            found += parameters(head[1] or "") or ()
    return tuple(dict.fromkeys(found))


def _sizes(found: re.Match[str]) -> tuple[int, ...]:
    """Return the sizes of an array; empty for one without elements, or with too many."""
    sizes = tuple(int(each) for each in found.group(2, 3) if each)
    return sizes if 0 < math.prod(sizes) <= MOST_ELEMENTS else ()


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
    """Return the names that a DEF defines, with blanks between them, and their values or 0.

    An array is its name and a bracket, with its SET or REP as the value.
    """
    names, values = [], []
    for part in arguments(text):
        if found := _DEFINED.fullmatch(part):
            names.append(found[1].lower())
            values.append(as_type(kind, found[2]) if found[2] else "0")
        elif (found := _ARRAY.fullmatch(part)) and _sizes(found):
            names.append(f"{found[1].lower()}[")
            values.append(found[4] or "")
        else:
            hint = f"DEF REAL NAME=1.5, OTHER[3,2] is read; {MOST_ELEMENTS} elements at most"
            raise refuse(f"DEF {kind} of this form", hint)
    return " ".join(names), tuple(values)


def as_type(kind: str, value: str) -> str:
    """Return an expression as a type keeps its value: INT is rounded, BOOL is 0 or 1."""
    if kind == "INT":
        return f"ROUND({value})"
    return f"({value})<>0" if kind == "BOOL" else value


def arguments(text: str) -> list[str]:
    """Return the arguments of a cycle, split at commas outside of brackets."""
    parts, depth, begin = [], 0, 0
    for at, char in enumerate(text):
        depth += (char in "([") - (char in ")]")
        if char == "," and depth == 0:
            parts.append(text[begin:at])
            begin = at + 1
    return [part.strip() for part in (*parts, text[begin:])]
