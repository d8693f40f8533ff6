"""The words of a line: a letter, a number, and where they stand.

A parsed line (:mod:`cnc.gcode.syntax.statement`) never changes and is shared between equal lines.
Executing it goes through a :class:`LineWords`, the record of which words have found a user: the
interpreter refuses a line that has a word left, so no word is ever ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NoReturn

from cnc.model.diagnostics import Diagnostic, GcodeError

MAX_NUMBER = 1e9
"""Largest magnitude of a word's number: a thousand kilometres, or a slip."""
AXES = frozenset("XYZABCUVW")
POLAR = frozenset("@^")
"""Distance and angle, in the place of X and Y."""
_POINT = AXES | POLAR
NEAR_WHOLE = 1e-4
"""How far from a whole number a computed number may be that has to be whole. Source: LinuxCNC,
which takes as much.
"""


@dataclass(frozen=True, slots=True)
class Word:
    """A word: upper-case ``letter``, ``number``, ``written`` as in the source but for blanks and
    case, ``column`` from 1, ``length``.
    """

    letter: str
    number: float
    written: str
    column: int
    length: int

    @property
    def tenths(self) -> int | None:
        """Ten times the number of a G word, as in :class:`cnc.gcode.syntax.code_numbers.G`; None
        for a number that is not a code.
        """
        tenths = round(self.number * 10)
        return tenths if self.number == tenths / 10 and "-" not in self.written else None

    @property
    def whole(self) -> int | None:
        """The number where it is a whole one; a computed one may be off by as much as computing
        makes it.
        """
        if self.number.is_integer():
            return int(self.number)
        if not math.isfinite(self.number) or not ("[" in self.written or "#" in self.written):
            return None
        number = round(self.number)
        return number if abs(self.number - number) < NEAR_WHOLE else None


def fault(
    code: str,
    message: str,
    word: Word | None = None,
    hint: str = "",
    *,
    column: int = 0,
    length: int = 1,
) -> GcodeError:
    """An error at a word (or a column) of the current line; the interpreter adds file, line and
    text.
    """
    if word is not None:
        column, length = word.column, word.length
    return GcodeError(Diagnostic(code, message, column=column, length=length, hint=hint))


@dataclass(slots=True)
class LineWords:
    """The words of the line that is being executed, and which of them are still without a user.

    ``g`` and ``m`` hold the code words in the order written; ``rest`` every other word by its
    letter.
    """

    g: list[Word] = field(default_factory=list)
    m: list[Word] = field(default_factory=list)
    rest: dict[str, Word] = field(default_factory=dict)
    users: dict[str, tuple[str, Word]] = field(default_factory=dict)

    @classmethod
    def of(cls, written: Iterable[Word]) -> LineWords:
        """Sort the words of a line; the line number is dropped: only a jump looks for it,
        elsewhere.
        """
        words = cls()
        for index, word in enumerate(written):
            letter = word.letter
            if letter in ("G", "BSPLINE"):
                words.g.append(word)
            elif letter == "M":
                words.m.append(word)
            elif letter == "N":
                _check_line_number(word, first=index == 0)
            elif letter in words.rest:
                raise fault("word-repeated", f"{letter} is given twice in this line", word)
            else:
                words.rest[letter] = word
        return words

    def take(self, letter: str, user: str) -> Word | None:
        """Give the word to ``user`` (the name of a code); None where the line has none. A word has
        one user only.
        """
        word = self.rest.pop(letter, None)
        if word is not None:
            self.users[letter] = user, word
        elif letter in self.users:
            other, taken = self.users[letter]
            message = f"both {other} and {user} take a {letter} word in this line"
            raise fault("word-wanted-twice", message, taken, f"write {user} on a line of its own")
        return word

    def has_axis(self) -> bool:
        """Whether an axis word is left, polar ones among them."""
        return not _POINT.isdisjoint(self.rest)

    def first(self) -> Word:
        """The leftmost word left, codes aside."""
        return min(self.rest.values(), key=lambda word: word.column)

    def first_axis(self) -> Word:
        """The leftmost axis word left."""
        return min(
            (word for letter, word in self.rest.items() if letter in _POINT),
            key=lambda word: word.column,
        )


def _check_line_number(word: Word, *, first: bool) -> None:
    if not first:
        raise fault(
            "line-number-place",
            "a line number must stand first in its line",
            word,
            "move the N word to the front",
        )
    if word.whole is None or "-" in word.written:
        raise fault(
            "line-number-bad",
            f"{word.written} is no line number",
            word,
            "a line number is a whole number from 0",
        )


def whole(word: Word, what: str, low: int, high: int | None = None) -> int:
    """The word's number as a whole number from ``low`` to ``high``, or an error that says what it
    is for.
    """
    number = word.whole
    if number is None or number < low or (high is not None and number > high):
        span = f"from {low}" if high is None else f"from {low} to {high}"
        _refuse(word, f"{what} must be a whole number {span}")
    return number


def not_negative(word: Word, what: str) -> float:
    """The word's number, which must not be negative."""
    if word.number < 0:
        _refuse(word, f"{what} must not be negative")
    return word.number


def _refuse(word: Word, message: str) -> NoReturn:
    raise fault("value-out-of-range", f"{word.written}: {message}", word)
