"""Preparation of statements: the part of their interpretation that needs no parameter values.

A statement in a loop is prepared once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from typing import NamedTuple

from cnc.gcode.codes.builder_codes import BuilderCodes, ExtraCode
from cnc.gcode.dialects import Dialect
from cnc.gcode.state.modal_groups import QUICK_MOTIONS, Codes, codes_of
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Statement, Value
from cnc.gcode.syntax.words import AXES, MAX_NUMBER, LineWords, Word, fault
from cnc.kernels.gcode.rows import MOST_LINE_NUMBER

NEAR_CODE = 1e-3
"""Largest distance of ten times a computed code from a whole number."""
_MOTION_OF = {motion.code: motion for motion in QUICK_MOTIONS}
_ARC, _FEED, _CODE, _NUMBER, _OTHER = -1, -2, -3, -4, -5
_EXPONENT = re.compile(r"E(?:[+-][0-9]{1,2}|[0-9]{2})")
_QUICK_WORDS = AXES | frozenset("FIJKR")


Known = float | Value
"""A number, or the function that computes it.

A closure for each number would slow down the garbage collector.
"""


class QuickMove(NamedTuple):
    """A line of only G0 to G3, axis words, I J K R and F.

    Attributes:
        motion: None for the motion code in effect.
        axes: Column and value of each axis word.
        arc: Letter and value of I, J, K and R.
        feed: Value of F.
    """

    motion: G | None
    axes: tuple[tuple[int, Known], ...]
    arc: tuple[tuple[str, Known], ...]
    feed: Known | None


@dataclass(frozen=True, slots=True)
class PreparedLine:
    """A statement and its sorted words; the ``computed`` ones have no number yet.

    Attributes:
        codes: The codes by modal group; None if a code is computed.
        extra: Codes that were taken out of the words.
        builder: Takes them out.
        quick: The move for the fast path, if the line is simple enough.
    """

    statement: Statement
    words: LineWords
    codes: Codes | None
    extra: tuple[ExtraCode, ...]
    builder: BuilderCodes
    quick: QuickMove | None

    def line_words(self, parameters: Parameters) -> LineWords:
        """Return the words for one execution with their computed numbers.

        A word with FANUC's vacant value counts as not written.
        """
        statement = self.statement
        if not statement.computed:
            known = self.words
            return LineWords(known.g, known.m, known.rest.copy())
        words = list(statement.words)
        vacant: list[int] = []
        for index, value in statement.computed:
            word, number = words[index], value(parameters)
            if math.isnan(number):
                vacant.append(index)
            elif not -MAX_NUMBER <= number <= MAX_NUMBER:
                message = f"{word.written} is {number:g}; the limit is {MAX_NUMBER:.0f}"
                raise fault("number-too-large", message, word)
            elif word.letter in "GM":
                words[index] = _code(word, number)
            else:
                words[index] = Word(word.letter, number, word.written, word.column, word.length)
        empty = tuple(words.pop(index) for index in reversed(vacant))
        found = LineWords.of(words, self.builder.replace)
        found.vacant = empty
        self.builder.take(found)
        return found


def _code(word: Word, number: float) -> Word:
    """A computed code, rounded to a tenth if it is close to one. Messages name it by its number."""
    tenths = round(number * 10)
    code = tenths / 10 if abs(number * 10 - tenths) < NEAR_CODE else number
    return Word(word.letter, code, f"{word.letter}{code:g}", word.column, word.length)


def prepare(
    statement: Statement, dialect: Dialect, builder: BuilderCodes, column: dict[str, int]
) -> PreparedLine:
    """Prepare a statement.

    Args:
        statement: The statement.
        dialect: The dialect.
        builder: Takes codes without a part in the motion out of the line.
        column: Column of each axis letter.

    Raises:
        GcodeError: The words or codes are wrong.
    """
    words = LineWords.of(statement.words, builder.replace)
    if dialect.most_line_number:
        _check_line_number(statement, dialect)
    if "E" in words.rest:
        _refuse_exponent(statement)
    extra = builder.take(words)
    computed = {index for index, _ in statement.computed}
    constant = all(statement.words[index].letter not in "GM" for index in computed)
    codes = codes_of(words.g, words.m, dialect) if constant else None
    quick = None if extra else _quick(statement, words, codes, dialect, column)
    return PreparedLine(statement, words, codes, extra, builder, quick)


def _check_line_number(statement: Statement, dialect: Dialect) -> None:
    for word in statement.words:
        if word.letter == "N" and word.number > dialect.most_line_number:
            message = f"{word.written}: {dialect.name} has line numbers up to "
            message += f"{dialect.most_line_number}"
            raise fault("line-number-bad", message, word, "number the lines anew, or without N")


def _refuse_exponent(statement: Statement) -> None:
    """Refuse an E that follows a coordinate without a blank and looks like an exponent."""
    for before, word in pairwise(statement.words):
        if (
            word.letter == "E"
            and before.letter in _QUICK_WORDS
            and before.column + before.length == word.column
            and _EXPONENT.fullmatch(word.written)
        ):
            whole = Word(
                before.letter,
                before.number,
                before.written + word.written,
                before.column,
                before.length + word.length,
            )
            message = f"{whole.written}: a number has no exponent"
            raise fault("number-exponent", message, whole, _without_exponent(before, word))


def _without_exponent(before: Word, exponent: Word) -> str:
    """Return the hint for a number with an exponent: its digits, unless they would be too many."""
    value = Decimal(before.number).scaleb(int(exponent.written[1:]))
    if abs(value) > MAX_NUMBER:
        return f"a number is at most {MAX_NUMBER:.0f}"
    digits = f"{value:.9f}".rstrip("0").rstrip(".")
    return f"write {before.letter}{digits}"


def kinds_of_letters(dialect: Dialect, column: dict[str, int]) -> list[int]:
    """Return the kinds of all letters for :func:`move_of`, by ASCII code.

    A kind is the column of an axis, or one of the negative constants.
    """
    kinds = [_OTHER] * 128
    for letter, kind in {
        **dict.fromkeys("IJKR", _ARC),
        "G": _CODE,
        "F": _FEED,
        "N": _NUMBER,
    }.items():
        kinds[ord(letter)] = kind
    for letter in dialect.axes & column.keys():
        kinds[ord(letter)] = column[letter]
    return kinds


def move_of(letters: Iterable[int], numbers: Iterable[float], kinds: list[int]) -> QuickMove | None:
    """Return the move of a line from its letters (ASCII codes) and numbers.

    Returns:
        None if the line is not a simple move, or may be wrong.
    """
    motion: G | None = None
    feed: float | None = None
    axes: list[tuple[int, Known]] = []
    arc: list[tuple[str, Known]] = []
    seen = 0
    for code, number in zip(letters, numbers, strict=True):
        bit = 1 << code
        if seen & bit:
            return None
        seen |= bit
        kind = kinds[code]
        if kind >= 0:
            axes.append((kind, number))
        elif kind == _ARC:
            arc.append((chr(code), number))
        elif kind == _FEED:
            feed = number
        elif kind == _OTHER or (number == 0.0 and math.copysign(1.0, number) < 0.0):
            # A code or line number with a minus is an error, even -0.
            return None
        elif kind == _CODE:
            motion = _MOTION_OF.get(number)
            if motion is None:
                return None
        elif not 0.0 <= number <= MOST_LINE_NUMBER or not number.is_integer():
            return None
    return QuickMove(motion, tuple(axes), tuple(arc), feed) if axes or arc else None


def _quick(
    statement: Statement,
    words: LineWords,
    codes: Codes | None,
    dialect: Dialect,
    column: dict[str, int],
) -> QuickMove | None:
    if (
        codes is None
        or words.m
        or statement.assignments
        or statement.remarks
        or not words.rest.keys() <= _QUICK_WORDS
    ):
        return None
    if codes.keys() - {"motion"} or (codes and codes["motion"].number not in QUICK_MOTIONS):
        return None
    letters = [letter for letter in words.rest if letter in AXES]
    if not all(letter in column and letter in dialect.axes for letter in letters) or not (
        letters or words.rest.keys() & set("IJKR")
    ):
        return None
    values: dict[str, Known] = {letter: word.number for letter, word in words.rest.items()}
    values |= {statement.words[index].letter: value for index, value in statement.computed}
    return QuickMove(
        codes["motion"].g if codes else None,
        tuple((column[letter], values[letter]) for letter in letters),
        tuple((letter, values[letter]) for letter in "IJKR" if letter in values),
        values.get("F"),
    )
