"""Values of instructions (:mod:`cnc.kernels.gcode.statements`).

The arithmetic is that of :mod:`cnc.gcode.syntax.arithmetic`, operation by operation, so that the
bits of the results are equal. A result that does not exist is NaN here. The line is then left to
the interpreter, which reports the error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.statements import (
    ABS,
    ACOS,
    ADD,
    AND,
    ASIN,
    ATAN,
    COS,
    DIVIDE,
    EQ,
    EXP,
    FIX,
    FUP,
    GE,
    GT,
    INDIRECT,
    LAST_PARAMETER,
    LE,
    LN,
    LT,
    MINUS,
    MODULO,
    MULTIPLY,
    NAMED,
    NE,
    NUMBER,
    OR,
    PARAMETER,
    POWER,
    SIN,
    SQRT,
    SUBTRACT,
    TAN,
    XOR,
    Code,
)  # fmt: skip
from cnc.kernels.jit import njit

Counts = NDArray[np.int32]
Floats = NDArray[np.float64]

NEAR, NEAR_WHOLE = 1e-6, 1e-4
"""As :data:`cnc.gcode.syntax.arithmetic.NEAR` and :data:`cnc.gcode.syntax.words.NEAR_WHOLE`."""
_QUADRANT = 90.0
_LARGEST_EXPONENT = 709.0
"""e to this power is a number. Results near the largest number are left to the interpreter."""


class Parameters(NamedTuple):
    """Values of parameters.

    Attributes:
        numbered: (LAST_PARAMETER + 1,) values by number; NaN for one of the interpreter.
        named: (slots,) values of named parameters; NaN for one of the interpreter.
        slot: (names,) slot of each name of the text.
    """

    numbered: Floats
    named: Floats
    slot: Counts


@njit
def _binary(operation: int, a: float, b: float) -> float:
    """Return the result of a binary operator; NaN if there is none."""
    if operation == ADD:
        return a + b
    if operation == SUBTRACT:
        return a - b
    if operation == MULTIPLY:
        return a * b
    if operation == DIVIDE:
        return a / b if b != 0.0 else math.nan
    if operation == MODULO:
        # Never -0, and never negative.
        return abs(a % abs(b)) if b != 0.0 else math.nan
    if operation == POWER:
        if (a == 0.0 and b < 0.0) or (a < 0.0 and b != np.floor(b)):
            return math.nan
        # Python raises an error where the result overflows.
        if a != 0.0 and b * math.log(abs(a)) > _LARGEST_EXPONENT:
            return math.nan
        return math.pow(a, b)
    if operation == ATAN:
        return math.degrees(math.atan2(a, b))
    if operation == EQ:
        return 1.0 if abs(a - b) < NEAR else 0.0
    if operation == NE:
        return 0.0 if abs(a - b) < NEAR else 1.0
    if operation == GT:
        return 1.0 if a > b else 0.0
    if operation == GE:
        return 1.0 if a >= b else 0.0
    if operation == LT:
        return 1.0 if a < b else 0.0
    if operation == LE:
        return 1.0 if a <= b else 0.0
    if operation == AND:
        return 1.0 if a != 0.0 and b != 0.0 else 0.0
    if operation == OR:
        return 1.0 if a != 0.0 or b != 0.0 else 0.0
    return 1.0 if (a != 0.0) != (b != 0.0) else 0.0


@njit
def _unary(operation: int, x: float) -> float:
    """Return the result of a function of one number; NaN if there is none."""
    if operation == MINUS:
        return -x
    if operation == ABS:
        return abs(x)
    if operation == COS or operation == SIN or operation == TAN:
        if x % _QUADRANT == 0.0:
            quarter = int(x / _QUADRANT % 4.0)
            if operation == TAN:
                return 0.0 if quarter % 2 == 0 else math.nan
            if operation == COS:
                quarter = (quarter + 1) % 4
            return 0.0 if quarter % 2 == 0 else float(2 - quarter)
        angle = math.radians(x)
        if operation == SIN:
            return math.sin(angle)
        return math.cos(angle) if operation == COS else math.tan(angle)
    if operation == ACOS or operation == ASIN:
        if not -1.0 <= x <= 1.0:
            return math.nan
        return math.degrees(math.acos(x) if operation == ACOS else math.asin(x))
    if operation == EXP:
        return math.exp(x) if x <= _LARGEST_EXPONENT else math.nan
    if operation == LN:
        return math.log(x) if x > 0.0 else math.nan
    if operation == SQRT:
        return math.sqrt(x) if x >= 0.0 else math.nan
    if operation == FIX:
        return np.floor(x) + 0.0  # not -0
    if operation == FUP:
        return np.ceil(x) + 0.0
    below = np.floor(abs(x))
    return math.copysign(below + 1.0 if abs(x) - below >= 0.5 else below, x)


@njit
def number_of(value: float) -> int:
    """Return the number of a parameter from a computed value; 0 for one of the interpreter."""
    if not 0.5 < value < LAST_PARAMETER + 0.5:
        return 0
    whole = int(value + 0.5)
    return whole if abs(value - whole) <= NEAR_WHOLE else 0


@njit
def evaluate(code: Code, at: int, end: int, parameters: Parameters, stack: Floats) -> float:
    """Return the value of instructions, or NaN if the interpreter must compute it.

    Args:
        code: The instructions of the text.
        at: The first instruction.
        end: The instruction after the last.
        parameters: The parameters.
        stack: (MOST_VALUES,) scratch space.
    """
    height = 0
    for k in range(at, end):
        operation = int(code.operation[k])
        if operation == NUMBER:
            stack[height] = code.number[k]
            height += 1
            continue
        if operation == PARAMETER:
            result = parameters.numbered[int(code.number[k])]
            height += 1
        elif operation == NAMED:
            result = parameters.named[parameters.slot[int(code.number[k])]]
            height += 1
        elif operation == INDIRECT:
            index = number_of(stack[height - 1])
            result = parameters.numbered[index] if index else math.nan
        elif ADD <= operation <= XOR or operation == ATAN:
            height -= 1
            result = _binary(operation, stack[height - 1], stack[height])
        else:
            result = _unary(operation, stack[height - 1])
        # NaN, too, is not finite.
        if not -math.inf < result < math.inf:
            return math.nan
        stack[height - 1] = result
    return stack[0]
