"""Values of instructions (:mod:`cnc.kernels.gcode.statements`).

A result that does not exist is NaN. The line is then left to the interpreter, which reports the
error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.arithmetic import (
    INDIRECT,
    NAMED,
    NUMBER,
    PARAMETER,
    binary,
    takes_two,
    unary,
)
from cnc.kernels.gcode.rules import NEAR_WHOLE
from cnc.kernels.gcode.statements import LAST_PARAMETER, Code
from cnc.kernels.jit import njit

Counts = NDArray[np.int32]
Floats = NDArray[np.float64]


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
        elif takes_two(operation):
            height -= 1
            result = binary(operation, stack[height - 1], stack[height])
        else:
            result = unary(operation, stack[height - 1])
        # NaN, too, is not finite.
        if not -math.inf < result < math.inf:
            return math.nan
        stack[height - 1] = result
    return stack[0]
