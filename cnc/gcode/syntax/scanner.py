"""The compiled scanner (:mod:`cnc.kernels.gcode.scanner`) on a piece of a program's text."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc.gcode.syntax.parser import MAX_LINE
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import MAX_NUMBER, Word
from cnc.kernels.gcode import coding
from cnc.kernels.gcode import scanner as kernel
from cnc.kernels.gcode.expressions import Code
from cnc.kernels.gcode.names import Names

_LINE_BYTES, _WORD_BYTES = 8, 3
"""Expected average bytes of a line and a word. A scan takes fewer lines if they are shorter."""

_LETTERS = [chr(code) for code in range(128)]


@dataclass(frozen=True, slots=True)
class Scan:
    """The lines and words of a piece of text.

    Attributes:
        count: Number of lines.
        size: Number of bytes that they take, line ends included.
        lines: The lines.
        words: The words of plain lines.
    """

    count: int
    size: int
    lines: kernel.Lines
    words: kernel.Words

    def line_words(self, index: int) -> tuple[list[int], list[float]]:
        """Return the codes of the letters and the numbers of the words of a plain line."""
        begin, end = self.lines.first[index : index + 2].tolist()
        return self.words.letter[begin:end].tolist(), self.words.number[begin:end].tolist()

    def statement(self, index: int, text: str) -> Statement:
        """Return the statement of a plain line, equal to that of the grammar.

        Args:
            index: The line.
            text: The text of the line.
        """
        span = slice(self.lines.first[index], self.lines.first[index + 1])
        rows = zip(*(values[span].tolist() for values in self.words), strict=True)
        capitals = text.upper()
        return Statement(
            tuple(
                Word(
                    _LETTERS[letter],
                    number,
                    capitals[column - 1 : column - 1 + length],
                    column,
                    length,
                )
                for letter, number, column, length in rows
            )
        )


def scan(data: bytes, *, whole: bool) -> Scan:
    """Scan the lines of ``data``.

    Args:
        data: The text.
        whole: Whether the text ends here. If not, a last line without an end is left out, and so
            are lines for which the arrays have no space.
    """
    shortest_line, shortest_word = (1, 2) if whole else (_LINE_BYTES, _WORD_BYTES)
    most_lines = len(data) // shortest_line + 1
    most_words = len(data) // shortest_word + MAX_LINE
    lines = kernel.Lines(
        begin=np.empty(most_lines, np.int32),
        end=np.empty(most_lines, np.int32),
        head=np.empty(most_lines, np.uint8),
        label=np.empty(most_lines, np.int64),
        plain=np.empty(most_lines, np.int32),
        simple=np.empty(most_lines, np.int32),
        first=np.empty(most_lines + 1, np.int32),
    )
    words = kernel.Words(
        letter=np.empty(most_words, np.uint8),
        number=np.empty(most_words, np.float64),
        column=np.empty(most_words, np.int32),
        length=np.empty(most_words, np.int32),
    )
    text = np.frombuffer(data, np.uint8)
    count, size = kernel.scan(text, int(whole), MAX_LINE, MAX_NUMBER, lines, words)
    return Scan(count, size, lines, words)


def code(data: bytes, found: Scan) -> coding.Coded:
    """Return the lines of a scan as instructions, those with expressions too."""
    size, count = found.size, found.count
    # An item has two bytes at least. A line that is left out may have begun two more.
    items = size // 2 + 2
    coded = coding.Coded(
        np.empty(count, np.uint8),
        np.empty(count + 1, np.int32),
        np.empty(items, np.uint8),
        np.empty(items, np.int64),
        np.empty(items, np.int64),
        Code(np.empty(size, np.uint8), np.empty(size)),
        _names(size),
        np.empty(count, np.int32),
        _names(size),
    )
    coding.code_lines(np.frombuffer(data, np.uint8), found.lines, MAX_LINE, coded)
    return coded


def _names(size: int) -> Names:
    """Return space for the names in a text of ``size`` bytes."""
    places = 16
    while places < size // 2:
        places *= 2
    return Names(
        np.empty(size // 3 + 1, np.int32),
        np.empty(size // 3 + 1, np.int32),
        np.full(places, -1, np.int32),
        np.zeros(1, np.int32),
    )
