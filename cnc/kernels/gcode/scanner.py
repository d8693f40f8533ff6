"""Lines of a program, from bytes to arrays of words.

A *plain* line has words (a letter and a number without blanks inside) and comments only. Most lines
that CAM systems write are plain, and they are read here. All others (parameters, expressions,
O-words, commands in comments) are only marked for the grammar.

A number is m / 10^k with whole m and k. Where m <= 2^53 and k <= 22 both sides are exact, so one
division gives the correctly rounded number. A line with any other number is not plain. Source:
Clinger, "How to read floating point numbers accurately", PLDI 1990.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

NOT_PLAIN = -1


class Lines(NamedTuple):
    """The lines of a text.

    Attributes:
        begin: (lines,) position of the first byte.
        end: (lines,) position after the last byte.
        head: (lines,) first letter after blanks, comments, ``/`` and N; a capital, 0 for none.
        label: (lines,) N number, -1 for none.
        plain: (lines,) number of consecutive plain lines from here on; 0 if this one is not plain.
        simple: (lines,) number of consecutive plain lines from here on without a repeated word.
        first: (lines + 1,) index of the first word; the last entry is the number of words.
    """

    begin: Counts
    end: Counts
    head: Bytes
    label: Ints
    plain: Counts
    simple: Counts
    first: Counts


class Words(NamedTuple):
    """The words of the plain lines of a text.

    Attributes:
        letter: (words,) code of the capital letter.
        number: (words,) the number.
        column: (words,) column in the line, from 1.
        length: (words,) number of characters.
    """

    letter: Bytes
    number: Floats
    column: Counts
    length: Counts


_DIGITS = 18
"""Most digits of a number: any number of so many digits fits into an int64."""
_EXACT = 1 << 53
_POWERS = np.array([float(f"1e{k}") for k in range(_DIGITS + 1)])

_TAB, _LF, _CR, _BLANK = 9, 10, 13, 32
_OPEN, _CLOSE, _PLUS, _MINUS, _DOT, _SLASH, _ZERO, _SEMICOLON, _DELETE = (
    40,
    41,
    43,
    45,
    46,
    47,
    48,
    59,
    127,
)
_A, _G, _M, _N, _O, _Z = 65, 71, 77, 78, 79, 90
_LOWER = 32
"""The bit that is set in a small letter and not in a capital."""

_ACTIVE = np.array(
    [[ord(char) for char in begin] for begin in ("msg", "deb", "pri", "log", "pro", "abo", "py\0")],
    np.uint8,
)
"""Beginnings of comments that may be commands: msg, debug, print, log.., probe.., abort, py."""


@njit
def comment_end(data: Bytes, at: int, stop: int) -> int:
    """Return the position after the comment that opens at ``at``.

    NOT_PLAIN if it is not closed, holds another comment, or may be a command.
    """
    i = at + 1
    while i < stop and (data[i] == _BLANK or data[i] == _TAB):
        i += 1
    for begin in range(len(_ACTIVE)):
        same = 0
        while same < 3 and i + same < stop and int(data[i + same]) | _LOWER == _ACTIVE[begin, same]:
            same += 1
        if same == 3 or (same == 2 and _ACTIVE[begin, 2] == 0):
            return NOT_PLAIN
    while i < stop:
        char = int(data[i])
        if char == _CLOSE:
            return i + 1
        if char == _OPEN or (char < _BLANK and char != _TAB) or char >= _DELETE:
            return NOT_PLAIN
        i += 1
    return NOT_PLAIN


@njit
def tail_is_plain(data: Bytes, at: int, stop: int) -> bool:
    """Return whether the comment from the semicolon at ``at`` has only legal characters."""
    for i in range(at, stop):
        char = int(data[i])
        if (char < _BLANK and char != _TAB) or char >= _DELETE:
            return False
    return True


@njit
def _read_words(
    data: Bytes, begin: int, stop: int, count: int, largest: float, words: Words
) -> int:
    """Append the words of the line data[begin:stop] to the arrays, which hold ``count``.

    The arrays must have space for as many words as half the line has bytes.

    Returns:
        The new count, or NOT_PLAIN.
    """
    letter, number, column, length = words
    i = begin
    first = count
    while i < stop:
        char = int(data[i])
        if char in (_BLANK, _TAB):
            i += 1
            continue
        if char == _OPEN:
            i = comment_end(data, i, stop)
            if i < 0:
                return NOT_PLAIN
            continue
        if char == _SEMICOLON:
            return count if tail_is_plain(data, i, stop) else NOT_PLAIN
        capital = char & ~_LOWER
        if char < _A or capital < _A or capital > _Z:
            return NOT_PLAIN
        if capital == _O or (capital == _N and count > first):
            return NOT_PLAIN
        at = i
        i += 1
        # Reading the number here, not in a function, saves a sixth of the time of a scan.
        sign = 1.0
        if i < stop and (data[i] == _MINUS or data[i] == _PLUS):
            if data[i] == _MINUS:
                sign = -1.0
            i += 1
        mantissa = 0
        digits = i
        while i < stop and 0 <= int(data[i]) - _ZERO <= 9:
            mantissa = mantissa * 10 + int(data[i]) - _ZERO
            i += 1
        digits = i - digits
        decimals = 0
        if i < stop and data[i] == _DOT:
            i += 1
            decimals = i
            while i < stop and 0 <= int(data[i]) - _ZERO <= 9:
                mantissa = mantissa * 10 + int(data[i]) - _ZERO
                i += 1
            decimals = i - decimals
        digits += decimals
        # More digits than fit have overflowed by now, which is why they are counted.
        if digits == 0 or digits > _DIGITS or mantissa > _EXACT:
            return NOT_PLAIN
        value = mantissa / _POWERS[decimals]
        if value > largest:
            return NOT_PLAIN
        letter[count] = capital
        number[count] = sign * value
        column[count] = at - begin + 1
        length[count] = i - at
        count += 1
    return count


@njit
def _head(data: Bytes, begin: int, stop: int) -> tuple[int, int]:
    """Return the first letter of a line and its N number.

    Blanks, comments, ``/`` and the N number are passed. The letter is a capital, 0 for none; the
    number is -1 for none.
    """
    i = begin
    label = NOT_PLAIN
    while i < stop:
        char = int(data[i])
        capital = char & ~_LOWER
        if char in (_BLANK, _TAB, _SLASH):
            i += 1
        elif char == _OPEN:
            while i < stop and data[i] != _CLOSE:
                i += 1
            i += 1
        elif char == _N or char == _N + _LOWER:
            value = 0
            digits = 0
            i += 1
            while i < stop and (
                data[i] == _BLANK or data[i] == _TAB or 0 <= int(data[i]) - _ZERO <= 9
            ):
                if int(data[i]) >= _ZERO and digits < _DIGITS:
                    value = value * 10 + int(data[i]) - _ZERO
                    digits += 1
                i += 1
            if digits == 0 or label >= 0:
                return _N, label
            label = value
        elif char >= _A and _A <= capital <= _Z:
            return capital, label
        else:
            return 0, label
    return 0, label


@njit
def _is_simple(words: Words, first: int, end: int) -> bool:
    """Return whether a line has each word at most once, except G and M, and a whole line number."""
    letter, number = words.letter, words.number
    seen = 0
    for k in range(first, end):
        code = int(letter[k])
        bit = 1 << (code - _A)
        if seen & bit != 0 and code != _G and code != _M:
            return False
        seen |= bit
        # A line number with a minus is wrong, even -0.
        if code == _N and (
            number[k] != math.floor(number[k]) or math.copysign(1.0, number[k]) < 0.0
        ):
            return False
    return True


@njit
def _run_lengths(flags: Counts, count: int) -> None:
    """Replace each flag (1 or 0) by the number of consecutive ones from it on."""
    run = 0
    for i in range(count - 1, -1, -1):
        run = run + 1 if flags[i] else 0
        flags[i] = run


@njit
def _line_end(data: Bytes, at: int, final: int) -> tuple[int, int]:
    """Find the end of the line that begins at ``at``.

    Returns:
        The position of its end, and that of the next line; -1 for the latter if the line may
        continue after the data.
    """
    size = len(data)
    stop = at
    while stop < size and data[stop] != _LF and data[stop] != _CR:
        stop += 1
    if stop == size:
        return stop, size if final else -1
    if data[stop] == _LF:
        return stop, stop + 1
    # A \r at the end of the data may be the first half of \r\n.
    if stop + 1 == size:
        return stop, size if final else -1
    return stop, stop + 2 if data[stop + 1] == _LF else stop + 1


@njit
def scan(
    data: Bytes, final: int, longest: int, largest: float, lines: Lines, words: Words
) -> tuple[int, int]:
    r"""Split ``data`` into lines and words: all complete lines for which the arrays have space.

    Lines end in ``\n``, ``\r\n`` or ``\r``.

    Args:
        data: The text.
        final: 1 if the end of the data ends a line, too.
        longest: A line of more bytes is not plain.
        largest: A line with a number above this is not plain.
        lines: Filled with the lines.
        words: Filled with the words of plain lines.

    Returns:
        The number of lines, and the bytes that they took.
    """
    begin, end, head, label, plain, simple, first = lines
    letter, number = words.letter, words.number
    count = 0
    found = 0
    at = 0
    while at < len(data) and count < len(begin):
        stop, after = _line_end(data, at, final)
        if after < 0 or (found + (stop - at) // 2 > len(letter) and count > 0):
            break
        total = NOT_PLAIN
        if stop - at <= longest:
            total = _read_words(data, at, stop, found, largest, words)
        begin[count] = at
        end[count] = stop
        first[count] = found
        if total >= 0:
            has_n = total > found and letter[found] == _N
            n_number = number[found] if has_n else -1.0
            is_label = n_number >= 0.0 and n_number == math.floor(n_number)
            label[count] = int(n_number) if is_label else NOT_PLAIN
            named = found + 1 if has_n else found
            head[count] = letter[named] if named < total else 0
            plain[count] = 1
            simple[count] = 1 if _is_simple(words, found, total) else 0
            found = total
        else:
            head[count], label[count] = _head(data, at, stop)
            plain[count] = 0
            simple[count] = 0
        count += 1
        at = after
    first[count] = found
    _run_lengths(plain, count)
    _run_lengths(simple, count)
    return count, at
