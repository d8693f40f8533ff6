"""Lines to words the quick way: the compiled scanner over a piece of a file
(:mod:`cnc.kernels.gcode.scanner`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.syntax.parser import MAX_LINE
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import MAX_NUMBER, Word
from cnc.kernels.gcode import scanner as kernel

_LINE_BYTES, _WORD_BYTES = 8, 3
"""Bytes that a line and a word are expected to have on average; where they have fewer, a scan takes
fewer lines.
"""

_LETTERS = [chr(code) for code in range(128)]


@dataclass(frozen=True, slots=True)
class Scan:
    """The lines that a piece of text holds, as arrays (see :func:`cnc.kernels.gcode.scanner.scan`),
    and the bytes that they take with their ends.

    begin, end, plain, straight (lines,) int32; head (lines,) uint8; label (lines,) int64; first
    (lines + 1,) int32; letter uint8, number float64, column int32, length int32 (words,).
    """

    count: int
    size: int
    begin: NDArray[np.int32]
    end: NDArray[np.int32]
    head: NDArray[np.uint8]
    label: NDArray[np.int64]
    plain: NDArray[np.int32]
    straight: NDArray[np.int32]
    first: NDArray[np.int32]
    letter: NDArray[np.uint8]
    number: NDArray[np.float64]
    column: NDArray[np.int32]
    length: NDArray[np.int32]

    def words(self, index: int) -> tuple[list[int], list[float]]:
        """The codes of the letters of a plain line's words, and the numbers."""
        begin, end = self.first[index : index + 2].tolist()
        return self.letter[begin:end].tolist(), self.number[begin:end].tolist()

    def statement(self, index: int, text: str) -> Statement:
        """The words of a plain line, the same as the grammar would give; ``text`` is the line."""
        span = slice(self.first[index], self.first[index + 1])
        rows = zip(
            self.letter[span].tolist(),
            self.number[span].tolist(),
            self.column[span].tolist(),
            self.length[span].tolist(),
            strict=True,
        )
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
    """The lines of ``data``: all where it is ``whole``, or else some, all of them complete; none if
    not one is.
    """
    shortest_line, shortest_word = (1, 2) if whole else (_LINE_BYTES, _WORD_BYTES)
    lines, words = len(data) // shortest_line + 1, len(data) // shortest_word + MAX_LINE
    begin, end, plain, straight = (np.empty(lines, np.int32) for _ in range(4))
    head, label, first = (
        np.empty(lines, np.uint8),
        np.empty(lines, np.int64),
        np.empty(lines + 1, np.int32),
    )
    letter, number = np.empty(words, np.uint8), np.empty(words, np.float64)
    column, length = np.empty(words, np.int32), np.empty(words, np.int32)
    count, size = kernel.scan(
        np.frombuffer(data, np.uint8), int(whole), MAX_LINE, MAX_NUMBER, begin, end, head, label, plain, straight, first, letter, number,
        column, length,
    )  # fmt: skip
    return Scan(
        count, size, begin, end, head, label, plain, straight, first, letter, number, column, length
    )
