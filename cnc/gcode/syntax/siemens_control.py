"""Control lines of SINUMERIK: jumps, branches, loops, drilling cycles and frames.

Only their form is recognised here; expressions stay as they are written. Source: Siemens,
"SINUMERIK 840D sl/828D Programming Manual, Job Planning", "Program jumps" and "Check structures";
"Fundamentals", "Coordinate transformations (frames)".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container
from typing import NamedTuple

from cnc.gcode.syntax.siemens_variables import (
    DEFINITION,
    HEAD,
    arguments,
    definition,
    parameters,
    without_number,
)
from cnc.gcode.syntax.statement import Keyword

_JUMP = re.compile(r"(?:IF\s*(.+?)\s*)?\bGOTO([FB]?)\s+(?:[N:]\s*)?([A-Z_0-9]+)\s*", re.I)
_ANY_JUMP = re.compile(r"(?:IF\b.*)?\bGOTO[FBCS]?\b", re.I)
_CYCLE = re.compile(r"(MCALL)?\s*(?:CYCLE(8[1-9])\s*\((.*)\))?\s*", re.I)
_AGAIN = re.compile(
    r"REPEAT(B?)\s+([A-Z_][A-Z0-9_]+)(?:\s+(?!P\d)([A-Z_][A-Z0-9_]+))?(?:\s+P\s*(?:=\s*(.+)|([0-9]+)))?",
    re.I,
)
_HOLES = re.compile(r"HOLES([12])\s*\((.*)\)\s*", re.I)
_END = re.compile(r"M17|ENDPROC|RET(?:\s*\(\s*\))?|M0*(2|30)", re.I)
_CALL = re.compile(
    r"(L[0-9]{1,7}|[A-Z_]{2}[A-Z0-9_]*)(?:\s*\(\s*\))?(?:\s+P\s*=?\s*([0-9]{1,4}))?", re.I
)
_CALL_WITH_VALUES = re.compile(r"([A-Z_]{2}[A-Z0-9_]*)\s*\(([^\"]*)\)", re.I)
_LEVEL = re.compile(r"CYCLE800\s*\((.*)\)", re.I)
_FRAME = re.compile(r"(A?(?:TRANS|ROT|SCALE|MIRROR))\b(.*)", re.I)
_STRUCTURES: dict[Keyword, re.Pattern[str]] = {
    "s-if": re.compile(r"IF\b\s*(.+)", re.I),
    "s-else": re.compile(r"ELSE", re.I),
    "s-endif": re.compile(r"ENDIF", re.I),
    "s-while": re.compile(r"WHILE\b\s*(.+)", re.I),
    "s-endwhile": re.compile(r"ENDWHILE", re.I),
    "s-for": re.compile(r"FOR\s+(R[0-9]+|[A-Z_]{2}[A-Z0-9_]*)\s*=\s*(.+?)\s+TO\s+(.+)", re.I),
    "s-endfor": re.compile(r"ENDFOR", re.I),
    "s-loop": re.compile(r"LOOP", re.I),
    "s-endloop": re.compile(r"ENDLOOP", re.I),
    "s-repeat": re.compile(r"REPEAT", re.I),
    "s-until": re.compile(r"UNTIL\b\s*(.+)", re.I),
}


class ControlLine(NamedTuple):
    """A control line.

    Attributes:
        keyword: Its kind.
        label: The target of a jump after its direction (F, B or a blank), the number of a cycle or
            of a pattern of holes, the name of a frame, the R parameter or variable of a FOR, the
            number of M2 or M30, the name of a subprogram and its repeats, or the names of
            variables.
        values: Its expressions, as they are written; empty where one is left out.
    """

    keyword: Keyword
    label: str = ""
    values: tuple[str, ...] = ()


def control_line(text: str, refuse: Callable[[str, str], Exception]) -> ControlLine | None:
    """Return the control line of a text without line number and comment; None for another line.

    Args:
        text: The text.
        refuse: Makes the error of something that is not supported, from its name and a hint.

    Raises:
        GcodeError: A jump or a frame is not supported.
    """
    if jump := _JUMP.fullmatch(text):
        target = jump[3].upper()
        target = str(int(target)) if target.isdigit() else target
        return ControlLine("s-goto", f"{jump[2].upper() or ' '}{target}", (jump[1] or "",))
    if _ANY_JUMP.match(text):
        raise refuse("a jump of this form", "write GOTOF, GOTOB or GOTO and a label or N number")
    for keyword, pattern in _STRUCTURES.items():
        if found := pattern.fullmatch(text):
            groups = found.groups()
            if keyword == "s-for":
                return ControlLine(keyword, groups[0].lower(), groups[1:])
            return ControlLine(keyword, "", groups)
    if again := _AGAIN.fullmatch(text):
        kind, first, last, count, digits = (each or "" for each in again.groups())
        if not (kind and last):
            label = f"{kind.upper()} {first.upper()} {last.upper()}"
            return ControlLine("s-again", label, (count or digits or "1",))
    if end := _END.fullmatch(text):
        return ControlLine("s-end", end[1] or "")
    if head := HEAD.fullmatch(text):
        return _head(head[1] or "", head[2], refuse)
    if (level := _LEVEL.fullmatch(text)) and (name := _level_name(arguments(level[1]))):
        return ControlLine("frame", name, ("", "", "", ""))
    if found := DEFINITION.fullmatch(text):
        return ControlLine("s-def", *definition(found[1].upper(), found[2], refuse))
    if frame := _FRAME.fullmatch(text):
        return _frame(frame[1].upper(), frame[2], refuse)
    if text and (cycle := _CYCLE.fullmatch(text)):
        keyword = "mcall" if cycle[1] else "cycle"
        return ControlLine(keyword, cycle[2] or "0", tuple(arguments(cycle[3] or "")))
    if holes := _HOLES.fullmatch(text):
        return ControlLine("s-holes", holes[1], tuple(arguments(holes[2])))
    return None


def is_end(line: str) -> bool:
    """Whether a line ends a program or a subprogram: M2, M17, M30, RET."""
    return _END.fullmatch(without_number(line).strip()) is not None


_ANGLES_AND_SHIFTS = slice(4, 13)
"""Arguments of CYCLE800: zero before the rotation (3), angles (3), zero after it (3)."""


def _level_name(arguments: list[str]) -> str:
    """Return the name of a CYCLE800 that leaves the plane as it is; empty for another one.

    The name tells whether it has arguments, and whether the first of them is a retraction.
    """
    if arguments == [""]:
        return "CYCLE800"
    if any(value.strip("-+0.") for value in arguments[_ANGLES_AND_SHIFTS]):
        return ""
    return "CYCLE800 FR" if arguments[0].strip("-+0.") else "CYCLE800 ()"


def _head(brackets: str, modes: str, refuse: Callable[[str, str], Exception]) -> ControlLine:
    """Return the head of a subprogram; its label has its parameters and their types."""
    if "SAVE" in modes.upper():
        raise refuse("PROC with SAVE", "write the codes again after the call")
    found = parameters(brackets)
    if found is None:
        raise refuse("PROC with these parameters", "REAL, INT and BOOL are read, without VAR")
    return ControlLine("s-proc", " ".join(f"{each.stored}:{each.kind}" for each in found))


def call_line(text: str, known: Container[str]) -> ControlLine | None:
    """Return the call of a subprogram; None for another line.

    Its repeats stand behind its name; its values are those of the call.

    Args:
        text: The text without line number and comment.
        known: Words that are no names.
    """
    if (call := _CALL_WITH_VALUES.fullmatch(text)) and call[2].strip():
        values = tuple(arguments(call[2]))
        return None if call[1].upper() in known else ControlLine("s-call", call[1].upper(), values)
    call = _CALL.fullmatch(text)
    if call is None or call[1].upper() in known:
        return None
    return ControlLine("s-call", f"{call[1].upper()} {call[2] or ''}".rstrip())


def _frame(name: str, text: str, refuse: Callable[[str, str], Exception]) -> ControlLine:
    """Return the line of a frame: X, Y, Z and the angle in the plane (RPL)."""
    given: dict[str, str] = {}
    rest = text.strip()
    while rest:
        word = re.match(
            r"(RPL|[XYZ])\s*=?\s*([^=]*?)\s*(?=(?:RPL|(?<![A-Z])[XYZ])\s*=?|$)", rest, re.I
        )
        if word is None or not word[2]:
            raise refuse(f"{name} with {rest}", "its words are X, Y, Z, and RPL= for a rotation")
        given[word[1].upper()] = word[2]
        rest = rest[word.end() :]
    turns = name.endswith("ROT")
    if "RPL" in given and (not turns or len(given) > 1):
        raise refuse(f"RPL with {name} and other words", "write RPL= alone, with ROT or AROT")
    if turns and not given.keys() <= {"Z", "RPL"}:
        raise refuse(f"{name} about X or Y", "the plane may be turned in itself only: RPL= or Z")
    return ControlLine("frame", name, tuple(given.get(word, "") for word in ("X", "Y", "Z", "RPL")))
