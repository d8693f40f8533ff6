"""Expressions as closures, which are computed whenever their line is executed.

A node is built from its parts, operator by operator. Constant parts are computed once. An error is
raised when the value is computed, at the column of the operator, function or parameter.

In FANUC's macros a variable that was never set is *vacant*, which is NaN here. EQ and NE
distinguish it from 0. Words and assignments receive it as vacant; all else takes it as 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from cnc.gcode.syntax.arithmetic import (
    FUNCTIONS,
    MACRO_FUNCTIONS,
    MACRO_OPERATORS,
    OPERATORS,
    SIEMENS_FUNCTIONS,
    SIEMENS_OPERATORS,
    Binary,
    Undefined,
    arctangent,
    half_away,
    macro_arctangent,
)
from cnc.gcode.syntax.parameters import LOCAL, LOCAL_MACRO, VACANT, Parameters
from cnc.gcode.syntax.statement import Value
from cnc.gcode.syntax.words import NEAR_WHOLE, fault
from cnc.model.diagnostics import GcodeError

MAX_DEPTH = 100
"""Most operations inside each other. Each takes a frame of Python's stack; brackets take none."""
_CHECK_INPUT = (
    "check the numbers that it is computed from: (DEBUG, #1) in the line before shows a parameter"
)
_INF = math.inf
_OPERATORS = {"ngc": OPERATORS, "macro": MACRO_OPERATORS, "siemens": SIEMENS_OPERATORS}
_FUNCTIONS = {"ngc": FUNCTIONS, "macro": MACRO_FUNCTIONS, "siemens": SIEMENS_FUNCTIONS}


@dataclass(slots=True, eq=False)
class Node:
    """A part of an expression.

    Attributes:
        value: Computes the value.
        begin: Position of its first character in the text without blanks.
        end: Position after its last character.
        number: The value if it is constant.
        raw: Computes the value with vacant as NaN, if it can be vacant.
        depth: Number of operations inside each other.
    """

    value: Value
    begin: int
    end: int
    number: float | None = None
    raw: Value | None = None
    depth: int = 0

    def spanning(self, begin: int, end: int) -> Node:
        """Return the same node with brackets around it."""
        return replace(self, begin=begin, end=end)

    @property
    def result(self) -> Value:
        """The value for a word or an assignment: vacant is NaN."""
        return self.raw or self.value


@dataclass(slots=True, eq=False)
class ParameterNode(Node):
    """A parameter. ``index`` is its name, or computes its number."""

    index: Node | str = ""


def constant(number: float, begin: int, end: int) -> Node:
    """Return a node with a constant value."""
    return Node(lambda _: number, begin, end, number)


class Builder:
    """Builds the nodes of one line."""

    def __init__(self, language: Literal["ngc", "macro", "siemens"]) -> None:
        """Create a builder.

        Args:
            language: The language: RS274/NGC, FANUC's macro B, or that of SINUMERIK.
        """
        self.macro = language == "macro"
        self._operators, self._functions = _OPERATORS[language], _FUNCTIONS[language]

    def place(self, begin: int, end: int) -> tuple[int, int]:
        """Return column (from 1) and length of a part of the line."""
        return begin + 1, end - begin

    def fault(self, code: str, message: str, begin: int, end: int, hint: str = "") -> GcodeError:
        """Return an error at a part of the line."""
        column, length = self.place(begin, end)
        return fault(code, message, column=column, length=length, hint=hint)

    def sign(self, sign: str, operand: Node, begin: int) -> Node:
        """Return an operand with a sign before it."""
        if sign == "+":
            return replace(operand, begin=begin)
        a, raw = operand.value, operand.raw
        node = Node(lambda p: -a(p), begin, operand.end, depth=operand.depth + 1)
        if raw is not None:
            node = replace(node, raw=lambda p: -raw(p))
        return self._folded(node, operand)

    def binary(self, left: Node, operator: str, right: Node, begin: int, end: int) -> Node:
        """Return two operands with an operator and its place."""
        place = self.place(begin, end)
        if operator in ("EQ", "NE") and self.macro:
            a, b = left.result, right.result
        else:
            a, b = left.value, right.value
        if operator in ("+", "-") and right.number is not None:
            value = _add_constant(a, right.number if operator == "+" else -right.number, place)
        elif operator == "*" and right.number is not None:
            value = _multiply_constant(a, right.number, place)
        elif operator == "*" and left.number is not None:
            value = _multiply_constant(b, left.number, place)
        elif operator in _ARITHMETIC:
            value = _ARITHMETIC[operator](a, b, place)
        else:
            value = _operation(a, self._operators[operator], b, place)
        node = Node(value, left.begin, right.end, depth=max(left.depth, right.depth) + 1)
        return self._folded(node, left, right)

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
        column, length = self.place(begin, end)
        a = argument.value
        if increments and name in ("ROUND", "RND"):
            return self._folded(
                Node(_to_increments(a), begin, argument.end, depth=argument.depth + 1)
            )
        function = self._functions[name]

        def value(p: Parameters) -> float:
            try:
                result = function(a(p))
            except Undefined as undefined:
                raise _failed(undefined, column, length) from None
            if -_INF < result < _INF:
                return result
            raise _overflow(column, length)

        return self._folded(Node(value, begin, argument.end, depth=argument.depth + 1), argument)

    def arctangent(self, y: Node, x: Node | None, begin: int) -> Node:
        """Return ATAN[y]/[x], or FANUC's ATAN[y]."""
        if x is None:
            a = y.value
            node = Node(lambda p: math.degrees(math.atan(a(p))), begin, y.end, depth=y.depth + 1)
            return self._folded(node, y)
        function = macro_arctangent if self.macro else arctangent
        b, c = y.value, x.value
        node = Node(lambda p: function(b(p), c(p)), begin, x.end, depth=max(y.depth, x.depth) + 1)
        return self._folded(node, y, x)

    def parameter(self, index: Node | str, begin: int, end: int) -> ParameterNode:
        """Return a parameter with a number, which may be computed, or a name."""
        column = self.place(begin, end)[0]
        if isinstance(index, str):
            return ParameterNode(lambda p: p.name(index, column), begin, end, index=index)
        if index.number is None:
            value = _computed_parameter(index.value, column)
            depth = index.depth + 1
            if depth > MAX_DEPTH:
                raise self._too_deep(begin, end)
        else:
            value = self._numbered(self.whole(index), column)
            depth = 0
        if self.macro:
            return ParameterNode(
                _not_vacant(value), begin, end, raw=value, depth=depth, index=index
            )
        return ParameterNode(value, begin, end, depth=depth, index=index)

    def _numbered(self, number: int, column: int) -> Value:
        """Return the value of a parameter; vacant is NaN."""
        if 0 < number <= (LOCAL_MACRO if self.macro else LOCAL):
            unset = VACANT if self.macro else 0.0
            return lambda p: p.locals.get(number, unset)

        def value(p: Parameters) -> float:
            try:
                return p.values[number]
            except KeyError:
                return p.number(number, column)

        return value

    def whole(self, node: Node) -> int:
        """Return the constant number of a parameter.

        Raises:
            GcodeError: ``parameter-number``, if it is not whole.
        """
        assert node.number is not None
        number = round(node.number)
        if abs(number - node.number) > NEAR_WHOLE:
            raise self.fault(
                "parameter-number", "the number of a parameter must be whole", node.begin, node.end
            )
        return number

    def exists(self, index: Node | str, begin: int, end: int) -> Node:
        """Return whether a parameter exists, as 1 or 0."""
        if isinstance(index, str):
            return Node(lambda p: float(p.exists(index)), begin, end)
        a = index.value
        return self._folded(
            Node(lambda p: float(p.exists(a(p))), begin, end, depth=index.depth + 1)
        )

    def _folded(self, node: Node, *parts: Node) -> Node:
        """Return the node; a constant if its parts are constant and it can be computed."""
        if parts and all(part.number is not None for part in parts):
            try:
                return constant(node.value(_NONE), node.begin, node.end)
            except GcodeError:
                return replace(node, depth=1)
        if node.depth > MAX_DEPTH:
            raise self._too_deep(node.begin, node.end)
        return node

    def _too_deep(self, begin: int, end: int) -> GcodeError:
        message = f"more than {MAX_DEPTH} operations inside each other"
        return self.fault(
            "expression-too-deep", message, begin, end, "compute a part of it into a parameter"
        )


_NONE = Parameters()
"""Parameters for the computation of constants."""


def _computed_parameter(index: Value, column: int) -> Value:
    return lambda p: p.number(index(p), column)


def _not_vacant(raw: Value) -> Value:
    def value(p: Parameters) -> float:
        result = raw(p)
        return result if result == result else 0.0

    return value


def _to_increments(a: Value) -> Value:
    return lambda p: half_away(a(p) * p.increments) / p.increments


# Each of + - * / has its own function. One function for all would need one more call for each
# operation of a program.


def _add(a: Value, b: Value, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        result = a(p) + b(p)
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


def _add_constant(a: Value, b: float, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        result = a(p) + b
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


def _multiply_constant(a: Value, b: float, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        result = a(p) * b
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


def _subtract(a: Value, b: Value, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        result = a(p) - b(p)
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


def _multiply(a: Value, b: Value, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        result = a(p) * b(p)
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


def _divide(a: Value, b: Value, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        try:
            result = a(p) / b(p)
        except ZeroDivisionError:
            raise fault(
                "division-by-zero", "a division by zero", column=place[0], hint=_CHECK_INPUT
            ) from None
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


_ARITHMETIC = {"+": _add, "-": _subtract, "*": _multiply, "/": _divide}


def _operation(a: Value, operate: Binary, b: Value, place: tuple[int, int]) -> Value:
    def value(p: Parameters) -> float:
        try:
            result = operate(a(p), b(p))
        except Undefined as undefined:
            raise _failed(undefined, *place) from None
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


def _failed(undefined: Undefined, column: int, length: int) -> GcodeError:
    code, message, hint = undefined.args
    return fault(code, message, column=column, length=length, hint=hint or _CHECK_INPUT)


def _overflow(column: int, length: int) -> GcodeError:
    return fault(
        "number-too-large",
        "the result is too large for a number",
        column=column,
        length=length,
        hint=_CHECK_INPUT,
    )
