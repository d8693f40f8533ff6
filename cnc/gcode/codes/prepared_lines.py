"""Preparation of statements: the part of their interpretation that needs no parameter values.

A statement in a loop is prepared once.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise

from cnc.gcode.codes.builder_codes import BuilderCodes, ExtraCode
from cnc.gcode.dialects import Dialect
from cnc.gcode.state.modal_groups import Codes, codes_of
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import AXES, MAX_NUMBER, LineWords, Word, fault

NEAR_CODE = 1e-3
"""Largest distance of ten times a computed code from a whole number."""
_EXPONENT = re.compile(r"E(?:[+-][0-9]{1,2}|[0-9]{2})")
_COORDINATES = AXES | frozenset("FIJKR")


@dataclass(frozen=True, slots=True)
class PreparedLine:
    """A statement and its sorted words; the ``computed`` ones have no number yet.

    Attributes:
        codes: The codes by modal group; None if a code is computed.
        extra: Codes that were taken out of the words.
        builder: Takes them out.
    """

    statement: Statement
    words: LineWords
    codes: Codes | None
    extra: tuple[ExtraCode, ...]
    builder: BuilderCodes

    def line_words(self, parameters: Parameters) -> LineWords:
        """Return the words for one execution with their computed numbers.

        A word with FANUC's vacant value counts as not written.
        """
        statement = self.statement
        if not statement.computed:
            known = self.words
            return LineWords(known.g, known.m, known.rest.copy())
        rest, sorted_words = self.words.rest, not self.extra and self.codes is not None
        words = list(statement.words)
        vacant: list[int] = []
        for index, value in statement.computed:
            word, number = words[index], value(parameters)
            sorted_words = sorted_words and rest.get(word.letter) is word
            if math.isnan(number):
                vacant.append(index)
            elif not -MAX_NUMBER <= number <= MAX_NUMBER:
                message = f"{word.written} is {number:g}; the limit is {MAX_NUMBER:.0f}"
                raise fault("number-too-large", message, word)
            elif word.letter in "GM":
                words[index] = _code(word, number)
            else:
                words[index] = Word(word.letter, number, word.written, word.column, word.length)
        if sorted_words and not vacant:
            new = {words[index].letter: words[index] for index, _ in statement.computed}
            return LineWords(self.words.g, self.words.m, rest | new)
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


def prepare(statement: Statement, dialect: Dialect, builder: BuilderCodes) -> PreparedLine:
    """Prepare a statement.

    Args:
        statement: The statement.
        dialect: The dialect.
        builder: Takes codes without a part in the motion out of the line.

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
    return PreparedLine(statement, words, codes, extra, builder)


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
            and before.letter in _COORDINATES
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
