"""The words of SINUMERIK (``dialects/siemens_words.toml``), and the errors that name one."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib.resources import files

from cnc.gcode.syntax.error_context import about_character
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import GcodeError

_NAME = re.compile(r'"[^"]*"?|;.*|([A-Z_][A-Z_]+[0-9]*)', re.IGNORECASE)
_JUMP = re.compile(r"\bGOTO[BCFS]?\b", re.IGNORECASE)
_HEAD = re.compile(r"\s*(?:N[0-9]+\s*)?(DEF|PROC|REPEATB?)\b", re.IGNORECASE)
_CLOSING = {"(": ")", "[": "]"}
_FORMS = {
    "DEF": "write DEF REAL NAME=1.5, OTHER[3,2]; the types are REAL, INT and BOOL",
    "PROC": "REAL, INT and BOOL are read, without VAR",
}


@cache
def words() -> dict[str, dict[str, str]]:
    """Return the tables of words."""
    file = files("cnc.gcode.dialects").joinpath("siemens_words.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


@cache
def no_names() -> frozenset[str]:
    """Return the words that are no names of subprograms."""
    tables = ("not-needed", "only-zero", "refused", "codes", "turns", "diameters")
    return frozenset(name for table in tables for name in words()[table]) | {"BSPLINE"}


def not_supported(what: str, begin: int, end: int, hint: str = "") -> GcodeError:
    """Return the error of something that is not supported."""
    hint = hint or "this looks like SINUMERIK; docs/reference/sinumerik.md lists what is read"
    return fault(
        "code-not-supported", f"{what} is not supported", column=begin + 1,
        length=max(end - begin, 1), hint=hint,
    )  # fmt: skip


def refused(name: str, begin: int, *, values: bool = False) -> GcodeError:
    """Return the error of a word that would change the path, or that is not known.

    Args:
        name: The word.
        begin: Its place.
        values: Whether values in brackets follow it.
    """
    what = words()["refused"].get(name)
    hint = words()["instead"].get(name, "")
    if what is None and values:
        what = "call of a subprogram with values"
        hint = "write its moves in place of the call, or hand values over in R parameters"
    what = what or "a name, or a word that is not known"
    return not_supported(f"{name} ({what})", begin, begin + len(name), hint)


def describe(text: str, place: int, wanted: frozenset[str]) -> GcodeError:
    """Return the error of a line that is not in the grammar.

    Args:
        text: The line.
        place: Position at which the grammar stopped.
        wanted: Names of the terminals that it would have accepted there.
    """
    char = text[place : place + 1]
    if char and not char.isascii():
        message, hint = about_character(char)
        return fault("character-unknown", message, column=place + 1, hint=hint)
    for found in _NAME.finditer(text):
        if found[1] and found.start() <= place and found[1].upper() in words()["refused"]:
            return refused(found[1].upper(), found.start())
    if jump := _JUMP.search(text[: place + 1].rstrip() + " "):
        hint = "write GOTOF, GOTOB or GOTO and a label or N number"
        return not_supported("a jump of this form", *jump.span(), hint)
    if char == '"':
        return fault("bracket-not-closed", 'this " is not closed', column=place + 1)
    is_end = not text[place:].strip() or char == ";"
    open_ = _open_brackets(text[:place])
    if is_end and open_:
        begin = open_[-1]
        return fault("bracket-not-closed", f"this {text[begin]} is not closed", column=begin + 1)
    if (head := _HEAD.match(text)) and head[1].upper() in _FORMS:
        word = head[1].upper()
        return not_supported(f"{word} of this form", *head.span(1), _FORMS[word])
    if char and char in ")]" and not open_:
        return fault("bracket-not-open", f"a {char} without its bracket before", column=place + 1)
    if "NUMBER" in wanted and "LEFT" in wanted:
        return not_supported("an expression that is not complete", place, place + 1)
    if is_end:
        end = len(text[:place].rstrip())
        return not_supported("a line that ends here", end - 1, end)
    return not_supported(repr(char), place, place + 1)


def _open_brackets(text: str) -> list[int]:
    """Return the places of brackets that are open at the end of a text."""
    found: list[int] = []
    quoted = False
    for at, char in enumerate(text):
        quoted ^= char == '"'
        if char in _CLOSING and not quoted:
            found.append(at)
        elif char in ")]" and not quoted and found:
            found.pop()
    return found
