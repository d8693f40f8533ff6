"""Operators and functions of expressions, on plain numbers; angles are in degrees.

The two families differ:

===============  ==========================  ===================================
operators        RS274/NGC                   FANUC
===============  ==========================  ===================================
EQ, NE           to within 1e-6              exactly
AND, OR, XOR     any number but 0 is true    on the bits of whole numbers
FIX, FUP         down, up                    toward zero, away from zero
MOD              never negative              has the sign of its left side
===============  ==========================  ===================================

GE and LE compare exactly in both. Sources: LinuxCNC 2.9, "G-code overview"; FANUC, "Custom macro".

SINUMERIK's comparisons have names of their own, with a ~ that no program writes, and so has TRUNC.
They take numbers as equal whose relative difference is up to 1e-12: a loop that counts by 0.1 makes
its last pass. Source: Siemens, "SINUMERIK 840D sl Programming Manual, Job Planning", "Comparison
and logic operations" and "Precision correction on comparison errors (TRUNC)".
"""

from __future__ import annotations

import math
from collections.abc import Callable

NEAR = 1e-6
"""Numbers that differ by less are equal in RS274/NGC."""
_RELATIVE = 1e-12
"""Numbers whose relative difference is up to this are equal for SINUMERIK."""
_QUADRANT = 90.0

Unary = Callable[[float], float]
Binary = Callable[[float, float], float]


class Undefined(Exception):
    """The result does not exist. The arguments are error code, message and hint."""

    def __init__(self, code: str, message: str, hint: str = "") -> None:
        super().__init__(code, message, hint)


def power(a: float, b: float) -> float:
    """Return a power. Negative numbers have only whole powers; 0 has no negative ones."""
    try:
        return math.pow(a, b)
    except OverflowError:
        return math.inf
    except ValueError:
        reason = (
            "0 has no negative powers" if a == 0 else f"{a:g} is negative and has only whole powers"
        )
        raise Undefined("power-undefined", f"{a:g}**{b:g}: {reason}") from None


def modulo(a: float, b: float) -> float:
    """Return the remainder of a division; never negative."""
    if b == 0:
        raise Undefined("division-by-zero", "a division by zero (MOD)")
    rest = math.fmod(a, b)
    # The remainder may be -0.
    return rest + abs(b) if rest < 0 else abs(rest)


def macro_modulo(a: float, b: float) -> float:
    """Return the remainder of a division of rounded numbers, with the sign of the first."""
    divisor = half_away(b)
    if divisor == 0:
        raise Undefined("division-by-zero", "a division by zero (MOD)")
    return math.fmod(half_away(a), divisor)


def half_away(x: float) -> float:
    """Return the nearest whole number; halves are rounded away from zero."""
    below = math.floor(abs(x))
    return math.copysign(below + (abs(x) - below >= 0.5), x)


def down(x: float) -> float:
    """Return the number rounded down."""
    return float(math.floor(x))


def up(x: float) -> float:
    """Return the number rounded up."""
    return float(math.ceil(x))


def toward_zero(x: float) -> float:
    """Return the number without its decimals."""
    return float(math.trunc(x))


def away_from_zero(x: float) -> float:
    """Return the number rounded away from zero."""
    return math.copysign(math.ceil(abs(x)), x)


def sine(x: float) -> float:
    """Return the sine; exact if it is -1, 0 or 1."""
    if x % _QUADRANT == 0:
        return (0.0, 1.0, 0.0, -1.0)[int(x / _QUADRANT % 4)]
    return math.sin(math.radians(x))


def cosine(x: float) -> float:
    """Return the cosine; exact if it is -1, 0 or 1."""
    if x % _QUADRANT == 0:
        return (1.0, 0.0, -1.0, 0.0)[int(x / _QUADRANT % 4)]
    return math.cos(math.radians(x))


def tangent(x: float) -> float:
    """Return the tangent; it is undefined at 90 degrees."""
    if x % _QUADRANT == 0:
        if x / _QUADRANT % 2:
            raise Undefined("argument-out-of-range", f"TAN[{x:g}] is infinite")
        return 0.0
    return math.tan(math.radians(x))


def square_root(x: float) -> float:
    """Return the square root."""
    if x < 0:
        raise Undefined(
            "argument-out-of-range", f"SQRT[{x:g}]: a negative number has no square root"
        )
    return math.sqrt(x)


def exponential(x: float) -> float:
    """Return the power of e."""
    try:
        return math.exp(x)
    except OverflowError:
        return math.inf


def logarithm(x: float) -> float:
    """Return the natural logarithm."""
    if x <= 0:
        raise Undefined(
            "argument-out-of-range", f"LN[{x:g}]: only positive numbers have a logarithm"
        )
    return math.log(x)


def arcsine(x: float) -> float:
    """Return the angle from -90 to 90."""
    _check_ratio("ASIN", x)
    return math.degrees(math.asin(x))


def arccosine(x: float) -> float:
    """Return the angle from 0 to 180."""
    _check_ratio("ACOS", x)
    return math.degrees(math.acos(x))


def arctangent(y: float, x: float) -> float:
    """Return the angle of the point (x, y) from -180 to 180; 0 at the origin."""
    return math.degrees(math.atan2(y, x))


def macro_arcsine(x: float) -> float:
    """Return the angle from 0 to 90 or from 270 to 360: FANUC's default."""
    angle = arcsine(x)
    return angle + 360 if angle < 0 else angle


def macro_arctangent(y: float, x: float) -> float:
    """Return the angle of the point (x, y) from 0 to 360: FANUC's default."""
    angle = arctangent(y, x)
    return angle + 360 if angle < 0 else angle


def to_binary(x: float) -> float:
    """Return the number whose binary-coded decimal form is given."""
    value = _bits("BIN", x)
    digits = f"{value:x}"
    if not digits.isdecimal():
        raise Undefined("argument-out-of-range", f"BIN[{x:g}]: {value} is not binary-coded decimal")
    return float(digits)


def to_decimal(x: float) -> float:
    """Return the binary-coded decimal form of a number."""
    return float(int(str(_bits("BCD", x)), 16))


def _bits(name: str, x: float) -> int:
    value = int(half_away(x))
    if not 0 <= value <= (99_999_999 if name == "BCD" else 0x99999999):
        raise Undefined(
            "argument-out-of-range",
            f"{name}[{x:g}]: the argument has at most eight digits and no sign",
        )
    return value


def _check_ratio(name: str, x: float) -> None:
    if not -1 <= x <= 1:
        raise Undefined(
            "argument-out-of-range", f"{name}[{x:g}]: the argument must be from -1 to 1"
        )


def _bitwise(operate: Callable[[int, int], int]) -> Binary:
    return lambda a, b: float(operate(int(half_away(a)), int(half_away(b))))


OPERATORS: dict[str, Binary] = {
    "**": power,
    "MOD": modulo,
    "EQ": lambda a, b: 1.0 if abs(a - b) < NEAR else 0.0,
    "NE": lambda a, b: 0.0 if abs(a - b) < NEAR else 1.0,
    "GT": lambda a, b: 1.0 if a > b else 0.0,
    "GE": lambda a, b: 1.0 if a >= b else 0.0,
    "LT": lambda a, b: 1.0 if a < b else 0.0,
    "LE": lambda a, b: 1.0 if a <= b else 0.0,
    "AND": lambda a, b: 1.0 if a != 0 and b != 0 else 0.0,
    "OR": lambda a, b: 1.0 if a != 0 or b != 0 else 0.0,
    "XOR": lambda a, b: 1.0 if (a != 0) != (b != 0) else 0.0,
}
"""Operators of RS274/NGC except + - * /."""
MACRO_OPERATORS: dict[str, Binary] = {
    "MOD": macro_modulo,
    "EQ": lambda a, b: 1.0 if a == b or (a != a and b != b) else 0.0,
    "NE": lambda a, b: 0.0 if a == b or (a != a and b != b) else 1.0,
    "GT": OPERATORS["GT"],
    "GE": OPERATORS["GE"],
    "LT": OPERATORS["LT"],
    "LE": OPERATORS["LE"],
    "AND": _bitwise(int.__and__),
    "OR": _bitwise(int.__or__),
    "XOR": _bitwise(int.__xor__),
}
"""Operators of FANUC except + - * /. EQ and NE take vacant variables as NaN."""
SIEMENS_OPERATORS: dict[str, Binary] = {
    **{name: OPERATORS[name] for name in ("**", "MOD", "AND", "OR", "XOR")},
    "==": lambda a, b: 1.0 if math.isclose(a, b, rel_tol=_RELATIVE) else 0.0,
    "<>": lambda a, b: 0.0 if math.isclose(a, b, rel_tol=_RELATIVE) else 1.0,
    ">": lambda a, b: 1.0 if a > b and not math.isclose(a, b, rel_tol=_RELATIVE) else 0.0,
    ">=": lambda a, b: 1.0 if a > b or math.isclose(a, b, rel_tol=_RELATIVE) else 0.0,
    "<": lambda a, b: 1.0 if a < b and not math.isclose(a, b, rel_tol=_RELATIVE) else 0.0,
    "<=": lambda a, b: 1.0 if a < b or math.isclose(a, b, rel_tol=_RELATIVE) else 0.0,
}
"""Operators of SINUMERIK except + - * /. Numbers that differ by rounding errors are equal."""
FUNCTIONS: dict[str, Unary] = {
    "ABS": abs,
    "ACOS": arccosine,
    "ASIN": arcsine,
    "COS": cosine,
    "EXP": exponential,
    "FIX": down,
    "FUP": up,
    "LN": logarithm,
    "ROUND": half_away,
    "SIN": sine,
    "SQRT": square_root,
    "TAN": tangent,
}
SIEMENS_FUNCTIONS: dict[str, Unary] = {
    **{name: FUNCTIONS[name] for name in FUNCTIONS if name not in ("FIX", "FUP")},
    "ROUNDUP": up,
    "TRUNC": toward_zero,
}
MACRO_FUNCTIONS: dict[str, Unary] = {
    **FUNCTIONS,
    "ASIN": macro_arcsine,
    "BCD": to_decimal,
    "BIN": to_binary,
    "FIX": toward_zero,
    "FUP": away_from_zero,
    "RND": half_away,
    "SQR": square_root,
}
