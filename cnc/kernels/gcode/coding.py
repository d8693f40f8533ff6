"""Lines with expressions: words, assignments and control lines as instructions.

These are the lines that the scanner leaves to the grammar because of ``#`` or ``[``. Those that are
correct and ordinary are compiled here; the others stay with the grammar.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.expressions import (
    MOST_OPERATORS,
    NUMBER,
    Code,
    compile_value,
    past_blanks,
)
from cnc.kernels.gcode.names import Names, index_of_name
from cnc.kernels.gcode.scanner import Lines, comment_end, tail_is_plain
from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]

UNKNOWN, SIMPLE, WORDS, ASSIGNMENT, NUMBERED_ASSIGNMENT, CONTROL = 0, 1, 2, 3, 4, 5
"""Kinds of lines: left to the interpreter, plain words, words with expressions, assignments, those
after a line number, O-words.
"""
TARGET = 35
"""The letter of the left side of an assignment; an item with its value follows."""
MOST_ITEMS = 64
"""Most items of a line."""
_LINE_DIGITS = 9
_WORD_MASK = (1 << 40) - 1
_CALL = ((3 << 5 | 1) << 5 | 12) << 5 | 12
"""The letters of CALL, five bits each."""
_TAB, _BLANK, _OPEN, _DOT, _ZERO, _SEMICOLON, _EQUAL = 9, 32, 40, 46, 48, 59, 61
_LESS, _GREATER, _A, _G, _M, _N, _O, _Z, _LEFT, _LOWER = 60, 62, 65, 71, 77, 78, 79, 90, 91, 32


class Coded(NamedTuple):
    """The lines of a text as items: words, sides of assignments, values of control lines.

    Attributes:
        kind: (lines,) kinds.
        first: (lines + 1,) index of the first item.
        letter: (items,) letter of a word, or TARGET.
        begin: (items,) first instruction of the value.
        end: (items,) instruction after the last one.
        code: The instructions.
        names: The names of parameters.
        label: (lines,) index of the label of a call; -1 for other lines.
        labels: The labels of calls, names in angle brackets.
    """

    kind: Bytes
    first: Counts
    letter: Bytes
    begin: Ints
    end: Ints
    code: Code
    names: Names
    label: Counts
    labels: Names


@njit
def _after_label(data: Bytes, at: int, stop: int) -> tuple[int, int, int, bool]:
    """Read a written label and a keyword.

    Returns:
        Position after both, begin and end of the label, and whether it is a call. The position is
        -1 if the line is left to the grammar; the end is -1 for a label with blanks.
    """
    at = past_blanks(data, at, stop)
    begin = at
    blank = False
    if at < stop and data[at] == _LESS:
        while at < stop and data[at] != _GREATER:
            if data[at] == _OPEN or data[at] == _SEMICOLON:
                return -1, 0, 0, False
            blank = blank or data[at] == _BLANK or data[at] == _TAB
            at += 1
        at += 1
    else:
        while at < stop and data[at] == _ZERO:
            at += 1
        # 0100 is 100.
        begin = at
        while at < stop and 0 <= int(data[at]) - _ZERO <= 9:
            at += 1
    end = at
    at = past_blanks(data, at, stop)
    word = letters = 0
    while at < stop and _A <= (int(data[at]) & ~_LOWER) <= _Z and int(data[at]) >= _A:
        word = (word << 5 | (int(data[at]) & ~_LOWER) - 64) & _WORD_MASK
        letters += 1
        at += 1
    if letters == 0:
        return -1, 0, 0, False
    return at, begin, -1 if blank or end == begin else end, letters == 4 and word == _CALL


@njit
def _after_line_number(data: Bytes, at: int, stop: int) -> int:
    """Return the position after the digits at ``at`` and their blanks; -1 if there are none."""
    begin = at
    while at < stop and 0 <= int(data[at]) - _ZERO <= 9:
        at += 1
    if at == begin or at - begin > _LINE_DIGITS:
        return -1
    at = past_blanks(data, at, stop)
    # Blanks may stand inside a number.
    return -1 if at < stop and (data[at] == _DOT or 0 <= int(data[at]) - _ZERO <= 9) else at


@njit
def _code_line(
    data: Bytes,
    k: int,
    begin: int,
    stop: int,
    coded: Coded,
    items: int,
    count: int,
    operators: Bytes,
) -> tuple[int, int, int]:
    """Append the items and instructions of line ``k``; return its kind, items and instructions."""
    code, names = coded.code, coded.names
    at, first, seen = begin, items, 0
    kind = UNKNOWN
    numbered = False
    while items - first + 2 <= MOST_ITEMS:
        at = past_blanks(data, at, stop)
        char = int(data[at]) if at < stop else _SEMICOLON
        if char == _SEMICOLON:
            known = at >= stop or tail_is_plain(data, at, stop)
            return (kind + (kind == ASSIGNMENT and numbered) if known else UNKNOWN), items, count
        if char == _OPEN:
            at = comment_end(data, at, stop)
            if at < 0:
                break
            continue
        letter = char & ~_LOWER if char >= _A else char
        is_word = _A <= letter <= _Z and kind != ASSIGNMENT and kind != CONTROL
        if is_word and letter == _O:
            at, label, label_end, is_call = _after_label(data, at + 1, stop)
            if at < 0 or items > first:
                break
            if is_call and label_end > 0:
                coded.label[k] = index_of_name(data, label, label_end, coded.labels)
            kind = CONTROL
            continue
        if is_word and letter == _N:
            at = _after_line_number(data, at + 1, stop)
            if at < 0 or items > first or numbered:
                break
            numbered = True
            continue
        if is_word:
            bit = 1 << (letter - _A)
            is_code = letter == _G or letter == _M
            if seen & bit != 0 and not is_code:
                break
            seen |= bit
            kind = WORDS
            at += 1
        elif char == TARGET and kind != WORDS and kind != CONTROL:
            kind = ASSIGNMENT
            is_code = False
        elif char == _LEFT and kind == CONTROL:
            is_code = False
        else:
            break
        coded.begin[items], coded.letter[items] = count, letter
        at, count = compile_value(data, at, stop, code, count, names, operators)
        coded.end[items] = count
        # A computed code has rules of its own.
        if at < 0 or (is_code and code.operation[coded.begin[items]] != NUMBER):
            break
        items += 1
        if kind == ASSIGNMENT:
            at = past_blanks(data, at, stop)
            if at >= stop or data[at] != _EQUAL:
                break
            coded.begin[items], coded.letter[items] = count, _EQUAL
            at, count = compile_value(data, at + 1, stop, code, count, names, operators)
            coded.end[items] = count
            items += 1
            if at < 0:
                break
    return UNKNOWN, items, count


@njit
def code_lines(data: Bytes, lines: Lines, longest: int, coded: Coded) -> None:
    """Fill ``coded`` with the lines of a scan.

    Args:
        data: The text.
        lines: Its lines.
        longest: A line of more bytes is left to the grammar.
        coded: Filled. Its arrays have space for an item for two bytes, two more, and
            an instruction for each byte.
    """
    operators = np.empty(MOST_OPERATORS, np.uint8)
    items = count = 0
    for k in range(len(coded.kind)):
        coded.first[k] = items
        coded.kind[k] = UNKNOWN
        coded.label[k] = -1
        # A sum is an int64. The functions would be compiled for int32, too.
        begin, end = lines.begin[k] + 0, lines.end[k] + 0
        if lines.plain[k] > 0:
            coded.kind[k] = SIMPLE if lines.simple[k] > 0 else UNKNOWN
        elif end - begin <= longest:
            kind, last, used = _code_line(data, k, begin, end, coded, items, count, operators)
            if kind != UNKNOWN:
                coded.kind[k] = kind
                items, count = last, used
    coded.first[len(coded.kind)] = items
