"""The place in a line at which the grammar stopped, for the functions that describe the error."""

from __future__ import annotations

import difflib
import re
import string
import unicodedata
from bisect import bisect_left
from collections.abc import Iterable

from cnc.gcode.syntax.arithmetic import FUNCTIONS, MACRO_FUNCTIONS, MACRO_OPERATORS, OPERATORS
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import GcodeError

O_KEYWORDS = (
    "SUB",
    "ENDSUB",
    "CALL",
    "RETURN",
    "IF",
    "ELSEIF",
    "ELSE",
    "ENDIF",
    "WHILE",
    "ENDWHILE",
    "DO",
    "REPEAT",
    "ENDREPEAT",
    "BREAK",
    "CONTINUE",
)
MACRO_KEYWORDS = ("GOTO", "IF", "THEN", "WHILE", "DO", "END")
_ASCII = 128
_TYPOGRAPHIC = {
    "\u2212": "a minus sign (-)",
    "\u2010": "a minus sign (-)",
    "\u2011": "a minus sign (-)",
    "\u2012": "a minus sign (-)",
    "\u2013": "a minus sign (-)",
    "\u2014": "a minus sign (-)",
    "\u00a0": "a plain blank",
    "\u2009": "a plain blank",
    "\u202f": "a plain blank",
    "\u3000": "a plain blank",
    "\u200b": "nothing: the character is invisible",
    "\ufeff": "nothing: the character is invisible",
    "\u00ad": "nothing: the character is invisible",
    "\u2018": "a comment in ( )",
    "\u2019": "a comment in ( )",
    "\u201c": "a comment in ( )",
    "\u201d": "a comment in ( )",
    "\u00d7": "a * in an expression",
    "\uff0e": "a decimal point (.)",
    "\u00b7": "a decimal point (.)",
    "\uff08": "a ( with its )",
    "\uff09": "a ) with its (",
}
"""Characters of word processors that stand for one of G-code."""
DIGITS = "0123456789."
LETTERS = re.compile(r"[A-Z]+")

_PIECE = re.compile(r"\([^()]*\)|[(;].*|[ \t]+|[^ \t(;]+", re.DOTALL)
_CAPITALS = str.maketrans(string.ascii_lowercase, string.ascii_uppercase)
_TOKEN = re.compile(r"\([^()]*\)|(?:SD|PL|PW|[ABC]3)=|[A-Z]+|[0-9.]+|\*\*|<[^<>]*>|.")


def squeeze(text: str) -> tuple[str, list[int]]:
    """Remove blanks and make capitals, except in comments.

    Returns:
        The text, and the position in the line of each of its characters and of the line's end.
    """
    kept: list[str] = []
    columns: list[int] = []
    for piece in _PIECE.finditer(text):
        part = piece[0]
        if part[0] in " \t":
            continue
        kept.append(part if part[0] in "(;" else part.translate(_CAPITALS))
        columns.extend(range(*piece.span()))
    columns.append(columns[-1] + 1 if columns else len(text))
    return "".join(kept), columns


class ErrorContext:
    """The place in a line at which the grammar stopped.

    Attributes:
        text: The line without blanks.
        columns: Position in the line, from 0, of each character of ``text`` and of its end.
        macro: Whether the language is FANUC's macro B.
        at: Position in ``text`` at which the grammar stopped.
        char: The character there; empty at the end of the line.
        wanted: Names of the tokens that the grammar would have accepted.
        before: Begin and end of each token before the place, comments left out.
        functions: Names of functions.
        operators: Names of operators.
        open: Positions of the brackets that are open at the place.
    """

    def __init__(self, line: str, place: int, wanted: frozenset[str], *, macro: bool) -> None:
        """Create a context.

        Args:
            line: The line.
            place: Position at which the grammar stopped.
            wanted: Names of the tokens that it would have accepted there.
            macro: Whether the language is FANUC's macro B.
        """
        text, columns = squeeze(line)
        self.text, self.macro = text, macro
        self.at = bisect_left(columns, place) if place < len(line.rstrip(" \t")) else len(text)
        self.columns = columns
        self.char = text[self.at : self.at + 1]
        self.wanted = wanted
        self.before = [
            found.span()
            for found in _TOKEN.finditer(text[: self.at])
            if not found[0].startswith("(")
        ]
        self.functions = {
            *(MACRO_FUNCTIONS if macro else FUNCTIONS),
            "ATAN",
            *(() if macro else ("EXISTS",)),
        }
        self.operators = {*(MACRO_OPERATORS if macro else OPERATORS)}
        self.open: list[int] = []
        for begin, _ in self.before:
            if text[begin] == "[":
                self.open.append(begin)
            elif text[begin] == "]" and self.open:
                self.open.pop()

    def fault(
        self, code: str, message: str, begin: int | None = None, end: int = 0, hint: str = ""
    ) -> GcodeError:
        """Return an error.

        Args:
            code: Error code.
            message: Message.
            begin: Position of the faulty part; by default the place at which the grammar stopped.
            end: End of the faulty part; by default it is one character long.
            hint: Hint.
        """
        begin = min(self.at, len(self.text) - 1) if begin is None else begin
        first = self.columns[begin]
        length = self.columns[end - 1] + 1 - first if end > begin else 1
        return fault(code, message, column=first + 1, length=length, hint=hint)

    def last(self, back: int = 1) -> str:
        """Return a token before the place, the last by default; empty if there is none."""
        return self.text[slice(*self.before[-back])] if len(self.before) >= back else ""

    def letters_around(self) -> tuple[int, int]:
        """Return begin and end of the letters around the place."""
        begin = self.at
        while begin > 0 and LETTERS.fullmatch(self.text[begin - 1]):
            begin -= 1
        found = LETTERS.match(self.text, begin)
        return (begin, found.end()) if found else (self.at, self.at)

    def unknown_character(self) -> GcodeError:
        """Return the error for a character that the language does not have."""
        char = self.char
        if char == "," and self.text[self.at + 1 : self.at + 2].isdigit():
            hint = "write a decimal point"
            return self.fault("character-unknown", "a decimal comma is not G-code", hint=hint)
        message, hint = about_character(char)
        return self.fault("character-unknown", message, hint=hint)


def about_character(char: str) -> tuple[str, str]:
    """Return the message and the hint for a character that G-code does not have."""
    if ord(char) < _ASCII:
        return f"the character {char!r} has no meaning here", ""
    name = unicodedata.name(char, "").lower()
    shown = f"U+{ord(char):04X}{f', {name}' if name else ''}"
    if char.isprintable():
        shown = f"'{char}' ({shown})"
    meant = _TYPOGRAPHIC.get(char)
    hint = f"write {meant}" if meant else "the word processor or web page may have changed it"
    return f"the character {shown} has no meaning here", hint


def near_hint(name: str, known: Iterable[str]) -> str:
    """Return a hint at a known name of similar spelling; empty if there is none."""
    near = difflib.get_close_matches(name, sorted(known), 1)
    return f"did you mean {near[0]}?" if near else ""
