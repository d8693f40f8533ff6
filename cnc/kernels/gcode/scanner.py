"""Lines of a program, from bytes to arrays of words.

What is taken here is the bulk of any program that a machine wrote: words of a letter and a number
without blanks inside, comments, line ends. Everything else (parameters, expressions, O-words,
active comments, ...) is only marked, for the grammar to read. So is every number that takes more
than one rounding: m / 10^k is one correctly rounded division where m <= 2^53 and k <= 22, both
sides being exact. Source: Clinger, "How to read floating point numbers accurately", PLDI 1990.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

NOT_PLAIN = -1

_DIGITS = 18
"""Digits of a number at most: as many as an int64 holds in any case."""
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
_A, _F, _G, _N, _O, _Z = 65, 70, 71, 78, 79, 90
_LOWER = 32
"""The bit that a small letter has and a capital has not."""

_STRAIGHT = 0
for _letter in b"NGFXYZABCUVW":
    _STRAIGHT |= 1 << (_letter - _A)
_ACTIVE = np.array(
    [[ord(char) for char in begin] for begin in ("msg", "deb", "pri", "log", "pro", "abo", "py\0")],
    np.uint8,
)
"""How comments begin that may be more than comments: msg, debug, print, log.., probe.., abort,
py.
"""


@njit
def _comment_end(data: Bytes, at: int, stop: int) -> int:
    """The position after the comment that opens at ``at``, or NOT_PLAIN: it is not closed, holds
    another one, or may be active.
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
def _tail_is_plain(data: Bytes, at: int, stop: int) -> bool:
    """Whether the comment that opens with a semicolon at ``at`` has only characters that any
    comment may have.
    """
    for i in range(at, stop):
        char = int(data[i])
        if (char < _BLANK and char != _TAB) or char >= _DELETE:
            return False
    return True


@njit
def _words(
    data: Bytes,
    begin: int,
    stop: int,
    count: int,
    largest: float,
    letter: Bytes,
    number: Floats,
    column: Counts,
    length: Counts,
) -> int:
    """Append the words of the line data[begin:stop] to the arrays, which hold ``count``; the new
    count, or NOT_PLAIN.

    There must be room for as many words as half the line has bytes.
    """
    i = begin
    first = count
    while i < stop:
        char = int(data[i])
        if char in (_BLANK, _TAB):
            i += 1
            continue
        if char == _OPEN:
            i = _comment_end(data, i, stop)
            if i < 0:
                return NOT_PLAIN
            continue
        if char == _SEMICOLON:
            return count if _tail_is_plain(data, i, stop) else NOT_PLAIN
        capital = char & ~_LOWER
        if (
            char < _A
            or capital < _A
            or capital > _Z
            or capital == _O
            or (capital == _N and count > first)
        ):
            return NOT_PLAIN
        at = i
        i += 1
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
    """The first letter (capital, 0 for none) of a line after blanks, comments, ``/`` and its N
    number, and that number (-1 for none).
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
def _is_straight(letter: Bytes, number: Floats, first: int, end: int) -> bool:
    """Whether a line has only words of a straight move: N, one of G0 and G1, axes and a feed, each
    once at most.
    """
    seen = 0
    for k in range(first, end):
        code = int(letter[k])
        bit = 1 << (code - _A)
        if _STRAIGHT & bit == 0 or seen & bit != 0:
            return False
        seen |= bit
        value = number[k]
        # A number with a minus is no code and no line number, not even where it is zero.
        if code == _N and (value != math.floor(value) or math.copysign(1.0, value) < 0.0):
            return False
        if code == _G and ((value != 0.0 and value != 1.0) or math.copysign(1.0, value) < 0.0):
            return False
        if code == _F and not value > 0.0:
            return False
    return True


@njit
def _run_lengths(flags: Counts, count: int) -> None:
    """Turn flags (1 or 0) into how many ones follow each other from here on."""
    run = 0
    for i in range(count - 1, -1, -1):
        run = run + 1 if flags[i] else 0
        flags[i] = run


@njit
def scan(
    data: Bytes, final: int, longest: int, largest: float, begin: Counts, end: Counts, head: Bytes, label: Ints, plain: Counts,
    straight: Counts, first: Counts, letter: Bytes, number: Floats, column: Counts, length: Counts,
) -> tuple[int, int]:  # fmt: skip
    r"""Take the lines of ``data`` apart, as many as are complete and as the arrays have room for;
    their number, and the bytes they took.

    Lines end in ``\n``, ``\r\n`` or ``\r``; with ``final`` the end of the data ends one too. A line
    of more than ``longest`` bytes is not plain, nor is one with a number above ``largest``.

    Of each line: where it begins and ends in ``data``, its first letter ``head`` and its N number
    ``label`` (-1: none); how many lines follow each other from here on that are ``plain``, and that
    have only the words of ``straight`` moves; the index ``first`` of its first word, with one entry
    more than lines for the end of the last. Of each word of a plain line: letter (capital), number,
    column (from 1) and length.
    """
    size = len(data)
    lines = 0
    words = 0
    at = 0
    while at < size and lines < len(begin):
        stop = at
        while stop < size and data[stop] != _LF and data[stop] != _CR:
            stop += 1
        after = stop + 1
        # A \r that the data ends with may be the first half of \r\n.
        if stop < size and data[stop] == _CR:
            if after < size:
                after += 1 if data[after] == _LF else 0
            elif final == 0:
                break
        elif stop == size:
            if final == 0:
                break
            after = size
        if words + (stop - at) // 2 > len(letter) and lines > 0:
            break
        count = NOT_PLAIN
        if stop - at <= longest:
            count = _words(data, at, stop, words, largest, letter, number, column, length)
        begin[lines] = at
        end[lines] = stop
        first[lines] = words
        if count >= 0:
            with_label = count > words and letter[words] == _N
            numbered = (
                with_label and number[words] >= 0.0 and number[words] == math.floor(number[words])
            )
            label[lines] = int(number[words]) if numbered else NOT_PLAIN
            named = words + 1 if with_label else words
            head[lines] = letter[named] if named < count else 0
            plain[lines] = 1
            straight[lines] = 1 if _is_straight(letter, number, words, count) else 0
            words = count
        else:
            head[lines], label[lines] = _head(data, at, stop)
            plain[lines] = 0
            straight[lines] = 0
        lines += 1
        at = after
    first[lines] = words
    _run_lengths(plain, lines)
    _run_lengths(straight, lines)
    return lines, at
