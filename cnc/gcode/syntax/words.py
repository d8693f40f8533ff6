"""Words: a letter, a number, and their place in the line.

A parsed line (:mod:`cnc.gcode.syntax.statement`) never changes and is shared between equal lines.
When it is executed, a :class:`LineWords` records the words that no code has used. The interpreter
refuses a line with such a word, so no word is ever ignored.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NoReturn

from cnc.kernels.gcode import rules
from cnc.model.diagnostics import Diagnostic, GcodeError

MAX_NUMBER, NEAR_WHOLE = rules.MAX_NUMBER, rules.NEAR_WHOLE
AXES = frozenset("XYZABCUVW")
POLAR = frozenset("@^")
"""Distance and angle of polar coordinates, instead of X and Y."""
_POINT = AXES | POLAR
_LINE_NUMBER = re.compile(r"N\+?[0-9]+(\.[0-9]*)?")
"""Source: LinuxCNC, "G-code overview", line numbers: a second number may follow a point."""


@dataclass(frozen=True, slots=True)
class Word:
    """A word.

    Attributes:
        letter: Capital letter.
        number: Number; NaN if it is computed.
        written: Text without blanks, in capitals.
        column: Column from 1.
        length: Number of characters, blanks included.
    """

    letter: str
    number: float
    written: str
    column: int
    length: int

    @property
    def tenths(self) -> int | None:
        """Ten times the number, as in :class:`cnc.gcode.syntax.code_numbers.G`.

        None for a number that is not a code.
        """
        if not math.isfinite(self.number):
            return None
        tenths = round(self.number * 10)
        return tenths if self.number == tenths / 10 and "-" not in self.written else None

    @property
    def whole(self) -> int | None:
        """The number if it is whole, else None. A computed number is rounded if it is close."""
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
    """Return an error at a word or a column of the current line.

    The interpreter adds file, line and text.
    """
    if word is not None:
        column, length = word.column, word.length
    return GcodeError(Diagnostic(code, message, column=column, length=length, hint=hint))


def under_compensation(at: Word, hint: str = "give G40 and a move before") -> GcodeError:
    """Return the error of a word that cutter compensation excludes."""
    return fault("compensation-active", f"{at.written} under cutter compensation", at, hint)


def offset_missing(kind: str, letter: str, words: LineWords, at: Word) -> GcodeError:
    """Return the error of a code that has no number of an offset: no H, or no D."""
    for word in words.vacant:
        if word.letter == letter:
            message = f"{word.written} gives no offset: the variable is empty"
            hint = f"set the variable before, or give {letter} and a number"
            return fault(kind, message, word, hint)
    hint = f"give {letter} and the number of the offset"
    return fault(
        kind, f"{at.written} needs {'an' if letter == 'H' else 'a'} {letter} word", at, hint
    )


@dataclass(slots=True)
class LineWords:
    """The words of the line that is being executed.

    Attributes:
        g: G words in the order written.
        m: M words in the order written.
        rest: Other words that no code has used yet, by letter.
        users: Code and word of each used word, by letter.
        vacant: Words without a value, as FANUC's empty variables give them.
    """

    g: list[Word] = field(default_factory=list)
    m: list[Word] = field(default_factory=list)
    rest: dict[str, Word] = field(default_factory=dict)
    users: dict[str, tuple[str, Word]] = field(default_factory=dict)
    vacant: tuple[Word, ...] = ()

    @classmethod
    def of(
        cls, written: Iterable[Word], replace: Callable[[Word, Word], bool] | None = None
    ) -> LineWords:
        """Sort the words of a line. The line number is left out.

        Args:
            written: The words in the order written.
            replace: Called with both words where a letter is given again: returns whether the last
                one counts. None if a repeated letter is an error.

        Raises:
            GcodeError: ``word-repeated``, ``line-number-place``, ``line-number-bad``.
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
            elif letter in words.rest and not (replace and replace(words.rest[letter], word)):
                message = f"{letter} is given twice in this line"
                hint = "remove one: FANUC takes the last one, other controllers refuse the line"
                if letter == "T":
                    hint = "write the tool to load beside M6, and the next tool in a line behind it"
                raise fault("word-repeated", message, word, hint)
            else:
                words.rest[letter] = word
        return words

    def take(self, letter: str, user: str) -> Word | None:
        """Return a word and remove it from ``rest``; None if the line has none.

        Args:
            letter: The letter of the word.
            user: Name of the code that uses it.

        Raises:
            GcodeError: ``word-wanted-twice``, if another code has used it.
        """
        word = self.rest.pop(letter, None)
        if word is not None:
            self.users[letter] = user, word
        elif letter in self.users:
            other, taken = self.users[letter]
            message = f"both {other} and {user} use the {letter} word of this line"
            raise fault("word-wanted-twice", message, taken, f"write {user} in a separate line")
        return word

    def has_axis(self) -> bool:
        """Return whether an axis word or a polar word is left."""
        return not _POINT.isdisjoint(self.rest)

    def first(self) -> Word:
        """Return the leftmost word left, except codes."""
        return min(self.rest.values(), key=lambda word: word.column)

    def first_axis(self) -> Word:
        """Return the leftmost axis word left."""
        return min(
            (word for letter, word in self.rest.items() if letter in _POINT),
            key=lambda word: word.column,
        )


def is_line_number(written: str) -> bool:
    """Return whether a word is N and a number from 0, without a sign."""
    return _LINE_NUMBER.fullmatch(written) is not None


def _check_line_number(word: Word, *, first: bool) -> None:
    if not first:
        raise fault(
            "line-number-place",
            "a line number must stand first in its line",
            word,
            "move the N word to the front",
        )
    if not is_line_number(word.written):
        raise fault(
            "line-number-bad",
            f"{word.written} is not a line number",
            word,
            "a line number is a number from 0, such as N100",
        )


def whole(word: Word, meaning: str, low: int, high: int | None = None) -> int:
    """Return the number of a word, which must be whole.

    Args:
        word: The word.
        meaning: Meaning of the number, for the message.
        low: Smallest number allowed.
        high: Largest number allowed; None for no limit.

    Raises:
        GcodeError: ``value-out-of-range``.
    """
    number = word.whole
    if number is None or number < low or (high is not None and number > high):
        span = f"from {low}" if high is None else f"from {low} to {high}"
        _refuse(word, f"{meaning} must be a whole number {span}")
    return number


def not_negative(word: Word, meaning: str) -> float:
    """Return the number of a word, which must not be negative.

    Raises:
        GcodeError: ``value-out-of-range``.
    """
    if word.number < 0:
        _refuse(word, f"{meaning} must not be negative")
    return word.number


def positive(word: Word, meaning: str) -> float:
    """Return the number of a word, which must be more than 0.

    Raises:
        GcodeError: ``value-out-of-range``.
    """
    if word.number <= 0.0:
        _refuse(word, f"{meaning} must be more than 0")
    return word.number


def _refuse(word: Word, message: str) -> NoReturn:
    raise fault("value-out-of-range", f"{word.written}: {message}", word)
