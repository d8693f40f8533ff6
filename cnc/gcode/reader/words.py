"""Words: a letter, a number, and their place in the line.

A parsed line (:mod:`cnc.gcode.reader.statements`) never changes and is shared between equal lines.
When it is executed, a :class:`LineWords` records the words that no code has used. The interpreter
refuses a line with such a word, so no word is ever ignored.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NoReturn

from cnc.gcode.kernels import rules
from cnc.model.diagnostics import Diagnostic, Fix, GcodeError

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
        """Ten times the number, as in :class:`cnc.gcode.reader.words.G`.

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
    fix: Fix | None = None,
) -> GcodeError:
    """Return an error at a word or a column of the current line, with its repair.

    The interpreter adds file, line and text.
    """
    if word is not None:
        column, length = word.column, word.length
    return GcodeError(Diagnostic(code, message, column=column, length=length, hint=hint, fix=fix))


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


# G- and M-codes of all dialects.
#
# A member is named as the standard writes the code, with ``_`` for the point: ``G.G5_3`` is G5.3.


class G(IntEnum):
    """G-codes; the value of a member is ten times the code."""

    G0 = 0
    G1 = 10
    G2 = 20
    G3 = 30
    G4 = 40
    G5 = 50
    G5_1 = 51
    G5_2 = 52
    G5_3 = 53
    G6_2 = 62
    G7 = 70
    G7_1 = 71
    G8 = 80
    G9 = 90
    G10 = 100
    G12 = 120
    G12_1 = 121
    G13 = 130
    G13_1 = 131
    G15 = 150
    G16 = 160
    G17 = 170
    G18 = 180
    G19 = 190
    G20 = 200
    G21 = 210
    G28 = 280
    G28_1 = 281
    G30 = 300
    G30_1 = 301
    G31 = 310
    G33 = 330
    G33_1 = 331
    G34 = 340
    G35 = 350
    G38_2 = 382
    G38_3 = 383
    G38_4 = 384
    G38_5 = 385
    G40 = 400
    G41 = 410
    G41_1 = 411
    G42 = 420
    G42_1 = 421
    G43 = 430
    G43_1 = 431
    G43_2 = 432
    G43_4 = 434
    G43_5 = 435
    G44 = 440
    G49 = 490
    G50 = 500
    G50_1 = 501
    G51 = 510
    G51_1 = 511
    G52 = 520
    G53 = 530
    G53_1 = 531
    G54 = 540
    G54_1 = 541
    G55 = 550
    G56 = 560
    G57 = 570
    G58 = 580
    G59 = 590
    G59_1 = 591
    G59_2 = 592
    G59_3 = 593
    G61 = 610
    G61_1 = 611
    G64 = 640
    G65 = 650
    G66 = 660
    G67 = 670
    G68 = 680
    G68_2 = 682
    G69 = 690
    G70 = 700
    G71 = 710
    G72 = 720
    G73 = 730
    G74 = 740
    G75 = 750
    G76 = 760
    G77 = 770
    G78 = 780
    G79 = 790
    G80 = 800
    G81 = 810
    G82 = 820
    G83 = 830
    G84 = 840
    G85 = 850
    G86 = 860
    G87 = 870
    G88 = 880
    G89 = 890
    G90 = 900
    G90_1 = 901
    G91 = 910
    G91_1 = 911
    G92 = 920
    G92_1 = 921
    G92_2 = 922
    G92_3 = 923
    G93 = 930
    G94 = 940
    G95 = 950
    G96 = 960
    G97 = 970
    G98 = 980
    G99 = 990
    BSPLINE = -10
    """Siemens' motion code that is a word. A program can read this number as #<_motion_mode>."""

    @property
    def code(self) -> float:
        """The number behind the letter: 5.3 of G5.3."""
        return self / 10

    @property
    def written(self) -> str:
        """The code as messages name it: "G5.3"."""
        return "BSPLINE" if self is G.BSPLINE else f"G{self / 10:g}"


class M(IntEnum):
    """M-codes."""

    M0 = 0
    M1 = 1
    M2 = 2
    M3 = 3
    M4 = 4
    M5 = 5
    M6 = 6
    M7 = 7
    M8 = 8
    M9 = 9
    M19 = 19
    M30 = 30
    M48 = 48
    M49 = 49
    M50 = 50
    M51 = 51
    M52 = 52
    M53 = 53
    M60 = 60
    M61 = 61
    M62 = 62
    M63 = 63
    M64 = 64
    M65 = 65
    M66 = 66
    M67 = 67
    M68 = 68
    M70 = 70
    M71 = 71
    M72 = 72
    M73 = 73
    M78 = 78
    M79 = 79
    M97 = 97
    M98 = 98
    M99 = 99
    M428 = 428
    M429 = 429
    M430 = 430


# Look-ups in these are faster than calls of the classes.
G_OF_TENTHS = {code.value: code for code in G}
M_OF_NUMBER = {code.value: code for code in M}
