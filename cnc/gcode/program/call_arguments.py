"""Arguments of macro calls: the words of G65 and G66, and the variables that they set.

Source: FANUC operator's manual, "Custom macro", argument specification I and II.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Statement, Value
from cnc.gcode.syntax.words import Word, fault
from cnc.model.diagnostics import GcodeError

_ARGUMENTS = dict(
    zip(
        "ABCDEFHIJKMQRSTUVWXYZ",
        (1, 2, 3, 7, 8, 9, 11, 4, 5, 6, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26),
        strict=True,
    )
)
"""FANUC's argument list I: the variable of each letter of G65. I, J and K given several times are
list II: #4 to #33 in threes.
"""
_MAX_THREES = 10
_ARGUMENT_LETTERS = "arguments have the letters A to F, H to K, M and Q to Z"


class Argument(NamedTuple):
    """An argument of G65: the number of its variable, its word, and its value if computed."""

    number: int
    word: Word
    value: Value | None

    def result(self, parameters: Parameters) -> float:
        """Return the number of the argument."""
        return self.word.number if self.value is None else self.value(parameters)


class _ArgumentNumbers:
    """Assigns the words of G65 to variables, in the order written."""

    def __init__(self) -> None:
        self._threes, self._last = 0, "K"
        self._given: set[str] = set()

    def number(self, word: Word) -> int:
        """Return the variable of a word.

        Raises:
            GcodeError: ``argument-bad``, ``word-repeated``.
        """
        letter = word.letter
        if letter not in _ARGUMENTS:
            message = f"{word.written} is not an argument of G65"
            raise fault("argument-bad", message, word, _ARGUMENT_LETTERS)
        number = _ARGUMENTS[letter]
        if letter in "IJK":
            # A letter that does not come after the one before it begins another three.
            self._threes += letter <= self._last
            self._last = letter
            number += 3 * (self._threes - 1)
            if self._threes > _MAX_THREES:
                message = f"{word.written}: G65 takes I, J and K at most {_MAX_THREES} times"
                raise fault("argument-bad", message, word)
        elif letter in self._given:
            raise repeated(word)
        self._given.add(letter)
        return number


def split_arguments(statement: Statement, code: Word) -> tuple[Statement, list[Argument]]:
    """Split the statement of G65 into its other words and its arguments.

    A later argument of the same variable replaces an earlier one.
    """
    computed = dict(statement.computed)
    kept: list[Word] = []
    left: list[tuple[int, Value]] = []
    arguments: list[Argument] = []
    numbers = _ArgumentNumbers()
    behind = False
    for index, word in enumerate(statement.words):
        behind = behind or word is code
        if word is code or word.letter in "PLN":
            if index in computed:
                left.append((len(kept), computed[index]))
            kept.append(word)
            continue
        if word.letter in _ARGUMENTS and not behind:
            message = f"{word.written} stands before G65"
            raise fault("argument-bad", message, word, "write arguments after G65")
        arguments.append(Argument(numbers.number(word), word, computed.get(index)))
    rest = Statement(tuple(kept), tuple(left), statement.assignments, statement.remarks)
    return rest, arguments


def repeated(word: Word) -> GcodeError:
    """Return the error for a word that a line gives twice."""
    return fault("word-repeated", f"{word.letter} is given twice in this line", word)
