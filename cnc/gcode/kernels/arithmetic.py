"""Operators and functions of expressions, for compiled code and for the interpreter.

Angles are in degrees. A result that does not exist is NaN, one that is too large is infinite; the
interpreter describes the error (:mod:`cnc.gcode.reader.expressions`). The languages differ:

===============  ==========================  ==============================  ====================
operators        RS274/NGC                   FANUC                           SINUMERIK
===============  ==========================  ==============================  ====================
EQ, NE           to within 1e-6              exactly; vacant is not 0        to within 1e-12 of it
GE, LE, GT, LT   exactly                     exactly                         to within 1e-12 of it
AND, OR, XOR     any number but 0 is true    on the bits of whole numbers    as RS274/NGC
FIX, FUP         down, up                    toward zero, away from zero     TRUNC: toward zero
MOD              never negative              has the sign of its left side   as RS274/NGC
===============  ==========================  ==============================  ====================

Sources: LinuxCNC 2.9, "G-code overview"; FANUC, "Custom macro"; Siemens, "SINUMERIK 840D sl
Programming Manual, Job Planning", "Comparison and logic operations" and "Precision correction on
comparison errors (TRUNC)".
"""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit

NUMBER, PARAMETER, NAMED, INDIRECT, MINUS = range(5)
(
    ADD, SUBTRACT, MULTIPLY, DIVIDE, MODULO, POWER, EQ, NE, GT, GE, LT, LE, AND, OR, XOR, ATAN,
    SAME, OTHER, MACRO_MODULO, BITS_AND, BITS_OR, BITS_XOR, MACRO_ATAN,
    NEAR_EQ, NEAR_NE, NEAR_GT, NEAR_GE, NEAR_LT, NEAR_LE,
) = OF_TWO = range(5, 34)  # fmt: skip
"""Operations on two values. SAME and OTHER are EQ and NE of FANUC."""
(
    ABS, ACOS, ASIN, COS, EXP, FIX, FUP, LN, ROUND, SIN, SQRT, TAN,
    MACRO_ASIN, BCD, BIN, TRUNC, AWAY, ATAN_OF_ONE,
) = range(OF_TWO.stop, OF_TWO.stop + 18)  # fmt: skip
"""Operations on one value."""
_FIRST_OF_TWO, _LAST_OF_TWO = OF_TWO[0], OF_TWO[-1]

NEAR = 1e-6
"""Numbers that differ by less are equal in RS274/NGC."""
RELATIVE = 1e-12
"""Numbers whose relative difference is up to this are equal for SINUMERIK."""
_QUADRANT = 90.0
_LARGEST_EXPONENT = 709.78
"""e to this power is nearly the largest number."""
_MOST_BITS = float(1 << 62)
_BCD_DIGITS = 8


@njit
def takes_two(operation: int) -> bool:
    """Return whether an operation takes two values."""
    return _FIRST_OF_TWO <= operation <= _LAST_OF_TWO


@njit
def half_away(x: float) -> float:
    """Return the nearest whole number; halves are rounded away from zero."""
    below = np.floor(abs(x))
    return math.copysign(below + 1.0 if abs(x) - below >= 0.5 else below, x)


@njit
def is_near(a: float, b: float) -> bool:
    """Return whether two numbers are equal for SINUMERIK."""
    return abs(a - b) <= RELATIVE * max(abs(a), abs(b))


@njit
def remainder(a: float, b: float) -> float:
    """Return the remainder of a division, with the sign of the first number; NaN for b = 0."""
    return np.fmod(a, b) if b != 0.0 else math.nan


@njit
def power(a: float, b: float) -> float:
    """Return a power; NaN for a negative power of 0 or a broken one of a negative number."""
    if (a == 0.0 and b < 0.0) or (a < 0.0 and b != np.floor(b)):
        return math.nan
    if a != 0.0 and b * math.log(abs(a)) > _LARGEST_EXPONENT:
        return math.inf
    return math.pow(a, b)


@njit
def on_bits(operation: int, a: float, b: float) -> float:
    """Return the result of an operator on the bits of rounded numbers; NaN for too large ones."""
    if not (abs(a) < _MOST_BITS and abs(b) < _MOST_BITS):
        return math.nan
    x, y = int(half_away(a)), int(half_away(b))
    if operation == BITS_AND:
        return float(x & y)
    return float(x | y) if operation == BITS_OR else float(x ^ y)


@njit
def angle_of(y: float, x: float) -> float:
    """Return the angle of the point (x, y) from -180 to 180 degrees; 0 at the origin."""
    return math.degrees(math.atan2(y, x))


@njit
def compare(operation: int, a: float, b: float) -> bool:
    """Return the result of a comparison or a logical operator."""
    if operation == EQ or operation == NE:
        return (abs(a - b) < NEAR) == (operation == EQ)
    if operation == SAME or operation == OTHER:
        # A vacant variable is NaN, which is equal to another one only.
        return (a == b or (a != a and b != b)) == (operation == SAME)
    if operation == GT:
        return a > b
    if operation == GE:
        return a >= b
    if operation == LT:
        return a < b
    if operation == LE:
        return a <= b
    if operation == AND:
        return a != 0.0 and b != 0.0
    if operation == OR:
        return a != 0.0 or b != 0.0
    if operation == XOR:
        return (a != 0.0) != (b != 0.0)
    near = is_near(a, b)
    if operation == NEAR_EQ or operation == NEAR_NE:
        return near == (operation == NEAR_EQ)
    if operation == NEAR_GT:
        return a > b and not near
    if operation == NEAR_GE:
        return a > b or near
    return (a < b and not near) if operation == NEAR_LT else (a < b or near)


@njit
def binary(operation: int, a: float, b: float) -> float:
    """Return the result of an operation on two values; NaN if there is none."""
    if operation == ADD:
        return a + b
    if operation == SUBTRACT:
        return a - b
    if operation == MULTIPLY:
        return a * b
    if operation == DIVIDE:
        return a / b if b != 0.0 else math.nan
    if operation == MODULO:
        rest = remainder(a, b)
        # Never -0.
        return rest + abs(b) if rest < 0.0 else abs(rest)
    if operation == POWER:
        return power(a, b)
    if operation == ATAN:
        return angle_of(a, b)
    if operation == MACRO_ATAN:
        angle = angle_of(a, b)
        return angle + 360.0 if angle < 0.0 else angle
    if operation == MACRO_MODULO:
        return remainder(half_away(a), half_away(b))
    if BITS_AND <= operation <= BITS_XOR:
        return on_bits(operation, a, b)
    return 1.0 if compare(operation, a, b) else 0.0


@njit
def sine(x: float) -> float:
    """Return the sine; exact if it is -1, 0 or 1."""
    if x % _QUADRANT == 0.0:
        quarter = int(x / _QUADRANT % 4.0)
        return 0.0 if quarter % 2 == 0 else float(2 - quarter)
    return math.sin(math.radians(x))


@njit
def cosine(x: float) -> float:
    """Return the cosine; exact if it is -1, 0 or 1."""
    if x % _QUADRANT == 0.0:
        quarter = (int(x / _QUADRANT % 4.0) + 1) % 4
        return 0.0 if quarter % 2 == 0 else float(2 - quarter)
    return math.cos(math.radians(x))


@njit
def tangent(x: float) -> float:
    """Return the tangent; NaN at 90 degrees."""
    if x % _QUADRANT == 0.0:
        return 0.0 if int(x / _QUADRANT % 2.0) == 0 else math.nan
    return math.tan(math.radians(x))


@njit
def binary_coded(x: float) -> float:
    """Return the binary-coded decimal form of a number (BCD); NaN for more than eight digits."""
    rest, value, shift = half_away(x), 0.0, 1.0
    if not 0.0 <= rest < 10.0**_BCD_DIGITS:
        return math.nan
    while rest > 0.0:
        value += rest % 10.0 * shift
        rest = np.floor(rest / 10.0)
        shift *= 16.0
    return value


@njit
def from_binary_coded(x: float) -> float:
    """Return the number whose binary-coded decimal form is given (BIN); NaN for another one."""
    rest, value, shift = half_away(x), 0.0, 1.0
    if not 0.0 <= rest < 16.0**_BCD_DIGITS:
        return math.nan
    while rest > 0.0:
        digit = rest % 16.0
        if digit > 9.0:
            return math.nan
        value += digit * shift
        rest = np.floor(rest / 16.0)
        shift *= 10.0
    return value


@njit
def unary(operation: int, x: float) -> float:
    """Return the result of an operation on one value; NaN if there is none."""
    if operation == MINUS:
        return -x
    if operation == ABS:
        return abs(x)
    if operation == SIN:
        return sine(x)
    if operation == COS:
        return cosine(x)
    if operation == TAN:
        return tangent(x)
    if operation == ACOS:
        return math.degrees(math.acos(x)) if -1.0 <= x <= 1.0 else math.nan
    if operation == ASIN or operation == MACRO_ASIN:
        angle = math.degrees(math.asin(x)) if -1.0 <= x <= 1.0 else math.nan
        return angle + 360.0 if operation == MACRO_ASIN and angle < 0.0 else angle
    if operation == ATAN_OF_ONE:
        return math.degrees(math.atan(x))
    if operation == EXP:
        return math.exp(x) if x <= _LARGEST_EXPONENT else math.inf
    if operation == LN:
        return math.log(x) if x > 0.0 else math.nan
    if operation == SQRT:
        return math.sqrt(x) if x >= 0.0 else math.nan
    if operation == FIX:
        return np.floor(x) + 0.0  # not -0
    if operation == FUP:
        return np.ceil(x) + 0.0
    if operation == TRUNC:
        return np.trunc(x) + 0.0
    if operation == AWAY:
        return math.copysign(np.ceil(abs(x)), x)
    if operation == BCD:
        return binary_coded(x)
    if operation == BIN:
        return from_binary_coded(x)
    return half_away(x)
