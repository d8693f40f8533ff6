"""Expressions as instructions in reverse Polish order, computed whenever their line is executed.

An error is raised when the value is computed, at the column of the operator, function or parameter.

In FANUC's macros a variable that was never set is *vacant*, which is NaN here. EQ and NE
distinguish it from 0. Words and assignments receive it as vacant; all else takes it as 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from cnc.compiled.jit import interpreted
from cnc.gcode.kernels import arithmetic as kernel
from cnc.gcode.kernels.arithmetic import INDIRECT, MINUS, NAMED, NUMBER, PARAMETER
from cnc.gcode.reader.parameters import LOCAL, LOCAL_MACRO, Parameters
from cnc.gcode.reader.words import NEAR_WHOLE, fault
from cnc.model.diagnostics import GcodeError

# Names of operators and functions, and the errors of results that do not exist.
#
# The results are those of :mod:`cnc.gcode.kernels.arithmetic`.

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
    value = int(_half_away(x))
    if 0 <= value < 16**8:
        return f"BIN[{x:g}]: {value} is not binary-coded decimal"
    return f"BIN[{x:g}]: the argument has at most eight digits and no sign"


LOCAL_PARAMETER, EXISTS, NAME_EXISTS, TO_INCREMENTS = 200, 201, 202, 203
"""Operations that compiled code does not have. ROUND to least input increments is FANUC's."""
MOST_INSTRUCTIONS = 10_000
"""Most instructions of an expression."""
_CHECK_INPUT = (
    "check the numbers that it is computed from: (DEBUG, #1) in the line before shows a parameter"
)
_NAMES = {
    "ngc": (OPERATORS, FUNCTIONS),
    "macro": (MACRO_OPERATORS, MACRO_FUNCTIONS),
    "siemens": (SIEMENS_OPERATORS, SIEMENS_FUNCTIONS),
    "klartext": (OPERATORS, KLARTEXT_FUNCTIONS),
}
"""Operators and functions by language."""
_binary, _unary = interpreted(kernel.binary), interpreted(kernel.unary)
_half_away = interpreted(kernel.half_away)
_OF_VACANT = (kernel.SAME, kernel.OTHER)


class Instruction(NamedTuple):
    """An operation, its number or name, and its place in the line: column from 1 and length."""

    operation: int
    operand: Any
    column: int
    length: int


class Expression:
    """The value of a part of a line. It is called with the parameters.

    Attributes:
        code: The instructions.
        vacant: Whether the value may be vacant.
    """

    __slots__ = ("code", "vacant")

    def __init__(self, code: tuple[Instruction, ...], *, vacant: bool) -> None:
        self.code, self.vacant = code, vacant

    def __call__(self, p: Parameters) -> float:
        """Return the value.

        Raises:
            GcodeError: It does not exist, at the place of the operation.
        """
        stack: list[float] = []
        for operation, operand, column, length in self.code:
            if operation == NUMBER:
                stack.append(operand)
            elif operation == LOCAL_PARAMETER:
                stack.append(p.locals.get(operand, p.unset))
            elif operation == PARAMETER:
                found = p.values.get(operand)
                stack.append(p.number(operand, column) if found is None else found)
            elif operation == NAMED:
                stack.append(p.name(operand, column))
            elif operation in kernel.OF_TWO:
                b, a = stack.pop(), stack.pop()
                if (a != a or b != b) and operation not in _OF_VACANT:
                    a, b = _set(a), _set(b)
                result = _binary(operation, a, b)
                if result - result != 0.0:
                    raise _without_result(result, operation, a, b, column, length)
                stack.append(result)
            elif operation == MINUS:
                stack.append(-stack.pop())
            elif operation == NAME_EXISTS:
                stack.append(float(p.exists(operand)))
            else:
                stack.append(_of_one(p, operation, _set(stack.pop()), (column, length)))
        value = float(stack[0])
        return value if self.vacant else _set(value)


def _set(value: float) -> float:
    """Return a value, 0 for vacant."""
    return value if value == value else 0.0


def _of_one(p: Parameters, operation: int, a: float, place: tuple[int, int]) -> float:
    """Return the result of an operation on one value."""
    if operation == INDIRECT:
        return p.number(a, place[0])
    if operation == EXISTS:
        return float(p.exists(a))
    if operation == TO_INCREMENTS:
        return float(_half_away(a * p.increments) / p.increments)
    result = _unary(operation, a)
    if result - result != 0.0:
        raise _without_result(result, operation, a, 0.0, *place)
    return result


def _without_result(
    result: float, operation: int, a: float, b: float, column: int, length: int
) -> GcodeError:
    """Return the error of a result that is infinite or does not exist."""
    code, message = "number-too-large", "the result is too large for a number"
    if result != result:
        code, message = undefined(operation, a, b)
    return fault(code, message, column=column, length=length, hint=_CHECK_INPUT)


@dataclass(slots=True, eq=False)
class Node:
    """A part of an expression.

    Attributes:
        code: Its instructions.
        begin: Position of its first character in the line.
        end: Position after its last character.
    """

    code: tuple[Instruction, ...]
    begin: int
    end: int

    @property
    def value(self) -> Expression:
        """Its value; vacant is 0."""
        return Expression(self.code, vacant=False)

    @property
    def result(self) -> Expression:
        """The value for a word or an assignment: vacant is NaN."""
        return Expression(self.code, vacant=True)

    @property
    def number(self) -> float | None:
        """The value if it is a written number; None for another one."""
        if len(self.code) != 1 or self.code[0].operation != NUMBER:
            return None
        return float(self.code[0].operand)

    def spanning(self, begin: int, end: int) -> Node:
        """Return the same node with brackets around it."""
        return replace(self, begin=begin, end=end)


@dataclass(slots=True, eq=False)
class ParameterNode(Node):
    """A parameter. ``index`` is its name, or computes its number."""

    index: Node | str = ""


def constant(number: float, begin: int, end: int) -> Node:
    """Return a node with a constant value."""
    return Node((Instruction(NUMBER, number, begin + 1, end - begin),), begin, end)


class Builder:
    """Builds the nodes of one line."""

    def __init__(self, language: Literal["ngc", "macro", "siemens", "klartext"]) -> None:
        """Create a builder.

        Args:
            language: RS274/NGC, FANUC's macro B, that of SINUMERIK, or Klartext.
        """
        self.macro = language == "macro"
        self._operators, self._functions = _NAMES[language]

    def place(self, begin: int, end: int) -> tuple[int, int]:
        """Return column (from 1) and length of a part of the line."""
        return begin + 1, end - begin

    def fault(self, code: str, message: str, begin: int, end: int, hint: str = "") -> GcodeError:
        """Return an error at a part of the line."""
        column, length = self.place(begin, end)
        return fault(code, message, column=column, length=length, hint=hint)

    def _instruction(
        self, operation: int, begin: int, end: int, operand: float | str = 0.0
    ) -> Instruction:
        return Instruction(operation, operand, *self.place(begin, end))

    def sign(self, sign: str, operand: Node, begin: int) -> Node:
        """Return an operand with a sign before it."""
        if sign == "+":
            return Node(operand.code, begin, operand.end)
        if operand.number is not None:
            return constant(-operand.number, begin, operand.end)
        code = self._instruction(MINUS, begin, begin + 1)
        return Node((*operand.code, code), begin, operand.end)

    def binary(self, left: Node, operator: str, right: Node, begin: int, end: int) -> Node:
        """Return two operands with an operator and its place."""
        operation = self._operators[operator]
        code = self._instruction(operation, begin, end)
        if len(left.code) + len(right.code) > MOST_INSTRUCTIONS:
            # A written line is shorter: a function of the language takes its argument twice.
            message, hint = "too many functions inside each other", "compute a part of it before"
            raise self.fault("expression-too-deep", message, begin, end, hint)
        return Node((*left.code, *right.code, code), left.begin, right.end)

    def call(
        self, name: str, argument: Node, begin: int, end: int, *, increments: bool = False
    ) -> Node:
        """Return the call of a function.

        Args:
            name: The function.
            argument: Its argument.
            begin: Position of the function.
            end: Position after its name.
            increments: Whether ROUND rounds to least input increments, as in a FANUC word.
        """
        operation = self._functions[name]
        if increments and operation == kernel.ROUND:
            operation = TO_INCREMENTS
        code = self._instruction(operation, begin, end)
        return Node((*argument.code, code), begin, argument.end)

    def arctangent(self, y: Node, x: Node | None, begin: int) -> Node:
        """Return ATAN[y]/[x], or FANUC's ATAN[y]."""
        if x is None:
            code = self._instruction(kernel.ATAN_OF_ONE, begin, y.end)
            return Node((*y.code, code), begin, y.end)
        operation = kernel.MACRO_ATAN if self.macro else kernel.ATAN
        code = self._instruction(operation, begin, x.end)
        return Node((*y.code, *x.code, code), begin, x.end)

    def parameter(self, index: Node | str, begin: int, end: int) -> ParameterNode:
        """Return a parameter with a number, which may be computed, or a name.

        Raises:
            GcodeError: ``parameter-number``, if a written number is not whole.
        """
        if isinstance(index, str):
            code = self._instruction(NAMED, begin, end, index)
            return ParameterNode((code,), begin, end, index)
        if index.number is None:
            code = self._instruction(INDIRECT, begin, end)
            return ParameterNode((*index.code, code), begin, end, index)
        number = round(index.number)
        if abs(number - index.number) > NEAR_WHOLE:
            message = "the number of a parameter must be whole"
            raise self.fault("parameter-number", message, index.begin, index.end)
        local = 0 < number <= (LOCAL_MACRO if self.macro else LOCAL)
        operation = LOCAL_PARAMETER if local else PARAMETER
        return ParameterNode((self._instruction(operation, begin, end, number),), begin, end, index)

    def exists(self, index: Node | str, begin: int, end: int) -> Node:
        """Return whether a parameter exists, as 1 or 0."""
        if isinstance(index, str):
            return Node((self._instruction(NAME_EXISTS, begin, end, index),), begin, end)
        return Node((*index.code, self._instruction(EXISTS, begin, end)), begin, end)
