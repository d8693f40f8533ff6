"""Expressions of RS274/NGC as instructions.

Instructions are in reverse Polish order: ``#1 + 2`` is PARAMETER 1, NUMBER 2, ADD. The grammar
defines the language; this module reads a part of it, and leaves the rest to it.
:mod:`cnc.kernels.gcode.evaluation` computes the values.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.names import Names, index_of_name
from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

LAST_PARAMETER = 5000
"""Highest parameter number of instructions. Those above belong to the system."""

NUMBER, PARAMETER, NAMED, INDIRECT, MINUS = 0, 1, 2, 3, 4
ADD, SUBTRACT, MULTIPLY, DIVIDE, MODULO, POWER = 5, 6, 7, 8, 9, 10
EQ, NE, GT, GE, LT, LE, AND, OR, XOR = 11, 12, 13, 14, 15, 16, 17, 18, 19
ABS, ACOS, ASIN, COS, EXP, FIX, FUP, LN = 20, 21, 22, 23, 24, 25, 26, 27
ROUND, SIN, SQRT, TAN, ATAN = 28, 29, 30, 31, 32
"""Operations of instructions."""
_BRACKET, _ATAN_Y = 40, 41
"""Marks on the stack of operators; ``_BRACKET`` plus a function is the bracket of its argument."""

MOST_VALUES = 24
"""Most values on the stack of an expression."""
MOST_OPERATORS = 64
_MOST_INSTRUCTIONS = 90
"""Most instructions of an expression. The interpreter limits their depth."""
_LONGEST = 5
"""Letters of the longest function."""

_LEVEL = np.zeros(80, np.int64)
"""Precedence of binary operators; 0 for all else."""
for _level, _operators in enumerate(
    (
        (AND, OR, XOR),
        (EQ, NE, GT, GE, LT, LE),
        (ADD, SUBTRACT),
        (MULTIPLY, DIVIDE, MODULO),
        (POWER,),
    ),
    start=1,
):
    _LEVEL[list(_operators)] = _level


def _coded(word: str) -> int:
    code = 0
    for letter in word:
        code = code << 5 | ord(letter) - 64
    return code


_WORDS = np.array(
    [
        (_coded(name), operation)
        for name, operation in (
            ("MOD", MODULO), ("EQ", EQ), ("NE", NE), ("GT", GT), ("GE", GE), ("LT", LT), ("LE", LE),
            ("AND", AND), ("OR", OR), ("XOR", XOR), ("ABS", ABS), ("ACOS", ACOS), ("ASIN", ASIN),
            ("COS", COS), ("EXP", EXP), ("FIX", FIX), ("FUP", FUP), ("LN", LN), ("ROUND", ROUND),
            ("SIN", SIN), ("SQRT", SQRT), ("TAN", TAN), ("ATAN", ATAN),
        )
    ]
)  # fmt: skip
"""Names of functions and operators, five bits a letter, and their operations."""

_TAB, _BLANK, _PLUS, _MINUS, _DOT, _SLASH, _ZERO = 9, 32, 43, 45, 46, 47, 48
_HASH, _STAR, _LESS, _GREATER, _LEFT, _RIGHT = 35, 42, 60, 62, 91, 93
_OPEN, _CLOSE, _SEMICOLON, _DELETE, _A, _Z, _LOWER = 40, 41, 59, 127, 65, 90, 32
_DIGITS, _EXACT = 18, 1 << 53
_POWERS = np.array([float(f"1e{k}") for k in range(_DIGITS + 1)])


class Code(NamedTuple):
    """Instructions of a text.

    Attributes:
        operation: (instructions,) operations.
        number: (instructions,) number of NUMBER, parameter number, or index of a name.
    """

    operation: Bytes
    number: Floats


@njit
def past_blanks(data: Bytes, at: int, stop: int) -> int:
    """Return the position of the first byte from ``at`` on that is no blank."""
    while at < stop and (data[at] == _BLANK or data[at] == _TAB):
        at += 1
    return at


@njit
def _read_number(data: Bytes, at: int, stop: int) -> tuple[int, float, bool]:
    """Read a number without a sign: position after it and its blanks, number, is it an index?

    The position is -1 if the number is left to the grammar.
    """
    mantissa = 0
    begin = at
    while at < stop and 0 <= int(data[at]) - _ZERO <= 9:
        mantissa = mantissa * 10 + int(data[at]) - _ZERO
        at += 1
    digits, decimals = at - begin, 0
    is_index = at == stop or data[at] != _DOT
    if not is_index:
        at += 1
        begin = at
        while at < stop and 0 <= int(data[at]) - _ZERO <= 9:
            mantissa = mantissa * 10 + int(data[at]) - _ZERO
            at += 1
        decimals = at - begin
    digits += decimals
    if digits == 0 or digits > _DIGITS or mantissa > _EXACT:
        return -1, 0.0, False
    at = past_blanks(data, at, stop)
    # Blanks may stand inside a number.
    if at < stop and (data[at] == _DOT or 0 <= int(data[at]) - _ZERO <= 9):
        return -1, 0.0, False
    return at, mantissa / _POWERS[decimals], is_index and 1 <= mantissa <= LAST_PARAMETER


@njit
def _read_name(data: Bytes, at: int, stop: int, names: Names) -> tuple[int, int]:
    """Read ``<name>``: position after it, and index; -1 if it is left to the grammar."""
    begin = at + 1
    at = begin
    while at < stop and data[at] != _GREATER:
        char = int(data[at])
        if char <= _BLANK or char >= _DELETE or char == _LESS or char == _OPEN or char == _CLOSE:
            return at, -1
        if char == _SEMICOLON:  # blanks behind it count, as in a comment
            return at, -1
        at += 1
    if at >= stop or at == begin:
        return at, -1
    return at + 1, index_of_name(data, begin, at, names)


@njit
def _read_function(data: Bytes, at: int, stop: int) -> tuple[int, int]:
    """Read a function and the bracket after it: position after both, function; -1 for none."""
    word = 0
    begin = at
    while at < stop and at - begin < _LONGEST:
        capital = int(data[at]) & ~_LOWER
        if int(data[at]) < _A or not _A <= capital <= _Z:
            break
        word = word << 5 | capital - 64
        at += 1
    at = past_blanks(data, at, stop)
    if at < stop and data[at] == _LEFT:
        for k in range(len(_WORDS)):
            if _WORDS[k, 0] == word and _WORDS[k, 1] >= ABS:
                return at + 1, int(_WORDS[k, 1])
    return at, -1


@njit
def _read_operator(data: Bytes, at: int, stop: int) -> tuple[int, int]:
    """Read a binary operator: position after it, operator; -1 for none."""
    char = int(data[at])
    if char == _PLUS:
        return at + 1, ADD
    if char == _MINUS:
        return at + 1, SUBTRACT
    if char == _SLASH:
        return at + 1, DIVIDE
    if char == _STAR:
        following = past_blanks(data, at + 1, stop)
        if following < stop and data[following] == _STAR:
            return following + 1, POWER
        return at + 1, MULTIPLY
    word = 0
    for k in range(at, min(at + _LONGEST, stop)):
        capital = int(data[k]) & ~_LOWER
        if int(data[k]) < _A or not _A <= capital <= _Z:
            break
        word = word << 5 | capital - 64
        for row in range(len(_WORDS)):
            if _WORDS[row, 0] == word and _LEVEL[_WORDS[row, 1]] > 0:
                return k + 1, int(_WORDS[row, 1])
    return at, -1


@njit
def _close(
    data: Bytes,
    at: int,
    stop: int,
    operation: Bytes,
    count: int,
    operators: Bytes,
    height: int,
    values: int,
    brackets: int,
) -> tuple[int, int, int, int, int]:
    """Complete an operand: apply the signs before it, and close the brackets after it.

    Returns:
        Position, number of instructions, operators on the stack, values, and open brackets. The
        position is -1 if the value is left to the grammar; after a bracket that opens, an operand
        follows.
    """
    while True:
        while height > 0 and (operators[height - 1] == MINUS or operators[height - 1] == INDIRECT):
            height -= 1
            operation[count] = operators[height]
            count += 1
        if brackets == 0:
            break
        at = past_blanks(data, at, stop)
        if at >= stop or data[at] != _RIGHT:
            at = at if at < stop else -1
            break
        at += 1
        while operators[height - 1] < _BRACKET:
            height -= 1
            operation[count] = operators[height]
            count += 1
            values -= 1
        height -= 1
        opened = int(operators[height])
        if opened == _ATAN_Y:
            at = past_blanks(data, at, stop)
            at = past_blanks(data, at + 1, stop) if at < stop and data[at] == _SLASH else stop
            if at < stop and data[at] == _LEFT:
                operators[height] = _BRACKET + ATAN
                return at + 1, count, height + 1, values, brackets
            at = -1
            break
        brackets -= 1
        if opened > _BRACKET:
            operation[count] = opened - _BRACKET
            count += 1
            values -= opened == _BRACKET + ATAN
    return at, count, height, values, brackets


@njit
def compile_value(
    data: Bytes, at: int, stop: int, code: Code, count: int, names: Names, operators: Bytes
) -> tuple[int, int]:
    """Append the instructions of the value at ``data[at]``, such as ``2``, ``#1`` or ``-SIN[..]``.

    Args:
        data: The text.
        at: Position of the value.
        stop: End of its line.
        code: Filled with the instructions. It must have space for one for each byte.
        count: Number of instructions before.
        names: Names of parameters, to which new ones are added.
        operators: (MOST_OPERATORS,) scratch space.

    Returns:
        The position after the value and the number of instructions. The position is -1 if the value
        is left to the grammar.
    """
    operation, number = code
    first = count
    height = values = brackets = 0
    signed = False
    while (
        count - first < _MOST_INSTRUCTIONS and height + 2 < MOST_OPERATORS and values < MOST_VALUES
    ):
        at = past_blanks(data, at, stop)
        if at >= stop:
            break
        char = int(data[at])
        if char == _PLUS or char == _MINUS or char == _HASH:
            if signed and char != _HASH:
                break
            signed = True
            if char != _PLUS:
                operators[height] = INDIRECT if char == _HASH else MINUS
                height += 1
            at += 1
            continue
        is_operand = char == _LESS or char == _DOT or 0 <= char - _ZERO <= 9
        if not is_operand:
            function = 0
            if char == _LEFT:
                at += 1
            else:
                at, function = _read_function(data, at, stop)
                if function < 0:
                    break
            operators[height] = _ATAN_Y if function == ATAN else _BRACKET + function
            height += 1
            brackets += 1
            signed = False
            continue
        is_index = height > 0 and operators[height - 1] == INDIRECT
        if char == _LESS:
            at, name = _read_name(data, at, stop, names)
            if name < 0 or not is_index:
                break
            operation[count], number[count] = NAMED, name
        else:
            at, literal, can_index = _read_number(data, at, stop)
            if at < 0 or (is_index and not can_index):
                break
            operation[count], number[count] = PARAMETER if is_index else NUMBER, literal
        height -= is_index
        count += 1
        values += 1
        at, count, height, values, brackets = _close(
            data, at, stop, operation, count, operators, height, values, brackets
        )
        if at < 0 or brackets == 0:
            return at, count
        signed = False
        if operators[height - 1] == _BRACKET + ATAN and data[at - 1] == _LEFT:
            continue
        at, binary = _read_operator(data, at, stop)
        if binary < 0:
            break
        while _LEVEL[operators[height - 1]] >= _LEVEL[binary]:
            height -= 1
            operation[count] = operators[height]
            count += 1
            values -= 1
        operators[height] = binary
        height += 1
    return -1, count
