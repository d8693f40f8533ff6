"""Names of operators and functions, and the errors of results that do not exist.

The results are those of :mod:`cnc.kernels.gcode.arithmetic`.
"""

from __future__ import annotations

from cnc.kernels.gcode import arithmetic as kernel

_SUMS = {
    "+": kernel.ADD, "-": kernel.SUBTRACT, "*": kernel.MULTIPLY, "/": kernel.DIVIDE,
}  # fmt: skip
_BY_SIZE = {"GT": kernel.GT, "GE": kernel.GE, "LT": kernel.LT, "LE": kernel.LE}
OPERATORS = {
    **_SUMS, **_BY_SIZE, "**": kernel.POWER, "MOD": kernel.MODULO, "EQ": kernel.EQ,
    "NE": kernel.NE, "AND": kernel.AND, "OR": kernel.OR, "XOR": kernel.XOR,
}  # fmt: skip
"""Operators of RS274/NGC."""
MACRO_OPERATORS = {
    **_SUMS, **_BY_SIZE, "MOD": kernel.MACRO_MODULO, "EQ": kernel.SAME, "NE": kernel.OTHER,
    "AND": kernel.BITS_AND, "OR": kernel.BITS_OR, "XOR": kernel.BITS_XOR,
}  # fmt: skip
"""Operators of FANUC."""
SIEMENS_OPERATORS = {
    **_SUMS, "**": kernel.POWER, "MOD": kernel.MODULO, "AND": kernel.AND, "OR": kernel.OR,
    "XOR": kernel.XOR, "==": kernel.NEAR_EQ, "<>": kernel.NEAR_NE, ">": kernel.NEAR_GT,
    ">=": kernel.NEAR_GE, "<": kernel.NEAR_LT, "<=": kernel.NEAR_LE,
}  # fmt: skip
"""Operators of SINUMERIK. Numbers that differ by rounding errors are equal."""
FUNCTIONS = {
    "ABS": kernel.ABS, "ACOS": kernel.ACOS, "ASIN": kernel.ASIN, "COS": kernel.COS,
    "EXP": kernel.EXP, "FIX": kernel.FIX, "FUP": kernel.FUP, "LN": kernel.LN,
    "ROUND": kernel.ROUND, "SIN": kernel.SIN, "SQRT": kernel.SQRT, "TAN": kernel.TAN,
}  # fmt: skip
SIEMENS_FUNCTIONS = {
    **{name: FUNCTIONS[name] for name in FUNCTIONS if name not in ("FIX", "FUP")},
    "ROUNDUP": kernel.FUP, "TRUNC": kernel.TRUNC,
}  # fmt: skip
KLARTEXT_FUNCTIONS = {**FUNCTIONS, "TRUNC": kernel.TRUNC}
MACRO_FUNCTIONS = {
    **FUNCTIONS, "ASIN": kernel.MACRO_ASIN, "BCD": kernel.BCD, "BIN": kernel.BIN,
    "FIX": kernel.TRUNC, "FUP": kernel.AWAY, "RND": kernel.ROUND, "SQR": kernel.SQRT,
}  # fmt: skip


def undefined(operation: int, a: float, b: float) -> tuple[str, str]:
    """Return error code and message of a result that does not exist.

    Args:
        operation: The operation.
        a: Its first value.
        b: Its second value; it has no meaning for an operation on one value.
    """
    if operation in (kernel.MODULO, kernel.MACRO_MODULO):
        return "division-by-zero", "a division by zero (MOD)"
    if operation == kernel.DIVIDE:
        return "division-by-zero", "a division by zero"
    if operation == kernel.POWER:
        reason = (
            "0 has no negative powers" if a == 0 else f"{a:g} is negative and has only whole powers"
        )
        return "power-undefined", f"{a:g}**{b:g}: {reason}"
    reasons = {
        kernel.TAN: f"TAN[{a:g}] is infinite",
        kernel.SQRT: f"SQRT[{a:g}]: a negative number has no square root",
        kernel.LN: f"LN[{a:g}]: only positive numbers have a logarithm",
        kernel.ASIN: f"ASIN[{a:g}]: the argument must be from -1 to 1",
        kernel.MACRO_ASIN: f"ASIN[{a:g}]: the argument must be from -1 to 1",
        kernel.ACOS: f"ACOS[{a:g}]: the argument must be from -1 to 1",
        kernel.BCD: f"BCD[{a:g}]: the argument has at most eight digits and no sign",
        kernel.BIN: _about_digits(a),
    }
    too_large = f"{a:g} and {b:g} are too large for AND, OR and XOR, which take their bits"
    return "argument-out-of-range", reasons.get(operation, too_large)


def _about_digits(x: float) -> str:
    """Return why a number is not binary-coded decimal."""
    value = int(kernel.half_away(x))
    if 0 <= value < 16**8:
        return f"BIN[{x:g}]: {value} is not binary-coded decimal"
    return f"BIN[{x:g}]: the argument has at most eight digits and no sign"
