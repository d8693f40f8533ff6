"""Expressions as closures: what has to be computed each time that a line is executed.

A node is built from its parts, operator by operator. Constant parts are computed once; what can't
be computed raises when it is asked for, at the column of the operator, function or parameter that
fails. With FANUC's macros a variable that was never set is vacant, which is NaN: EQ and NE tell it
from 0, a word or an assignment hands it on, everything else takes it for 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from cnc.gcode.syntax.arithmetic import (
    FUNCTIONS,
    MACRO_FUNCTIONS,
    MACRO_OPERATORS,
    OPERATORS,
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
"""Operations inside each other. Each costs a frame of Python's stack; brackets alone cost
nothing.
"""
_LOOK = (
    "look at the numbers that it is computed from: (DEBUG, #1) in the line before shows a parameter"
)
_INF = math.inf


@dataclass(frozen=True, slots=True)
class Node:
    """A part of an expression, from ``begin`` to before ``end`` in the text without blanks.

    ``number`` is its value where that is constant. ``raw`` is the value with vacant as NaN, where
    that can be.
    """

    value: Value
    begin: int
    end: int
    number: float | None = None
    raw: Value | None = None
    depth: int = 0

    def spanning(self, begin: int, end: int) -> Node:
        """The same, in brackets."""
        return replace(self, begin=begin, end=end)

    @property
    def result(self) -> Value:
        """The value as a word or an assignment takes it: vacant is NaN."""
        return self.raw or self.value


@dataclass(frozen=True, slots=True)
class ParameterNode(Node):
    """A parameter: ``index`` is its name, or computes its number."""

    index: Node | str = ""


def constant(number: float, begin: int, end: int) -> Node:
    """A node that is always the same."""
    return Node(lambda _: number, begin, end, number)


class Builder:
    """Builds the nodes of one line. ``columns`` holds the place in the line, from 0, of every
    character of the text without blanks.
    """

    def __init__(self, columns: Sequence[int], *, macro: bool) -> None:
        self.columns = columns
        self.macro = macro

    def place(self, begin: int, end: int) -> tuple[int, int]:
        """Column from 1 and length of a part of the line."""
        first = self.columns[begin]
        return first + 1, self.columns[end - 1] + 1 - first

    def fault(self, code: str, message: str, begin: int, end: int, hint: str = "") -> GcodeError:
        """An error at a part of the line."""
        column, length = self.place(begin, end)
        return fault(code, message, column=column, length=length, hint=hint)

    def sign(self, sign: str, operand: Node, begin: int) -> Node:
        """A sign before an operand."""
        if sign == "+":
            return replace(operand, begin=begin)
        a, raw = operand.value, operand.raw
        node = Node(lambda p: -a(p), begin, operand.end, depth=operand.depth + 1)
        if raw is not None:
            node = replace(node, raw=lambda p: -raw(p))
        return self._folded(node, operand)

    def binary(self, left: Node, operator: str, right: Node, begin: int) -> Node:
        """Two operands and what stands between them, at ``begin``."""
        place = self.place(begin, begin + len(operator))
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
            value = _operation(a, operator, b, place, macro=self.macro)
        node = Node(value, left.begin, right.end, depth=max(left.depth, right.depth) + 1)
        return self._folded(node, left, right)

    def call(self, name: str, argument: Node, begin: int, *, increments: bool = False) -> Node:
        """A function. ROUND in a FANUC word (``increments``) rounds to what the control
        resolves.
        """
        column, length = self.place(begin, begin + len(name))
        a = argument.value
        if increments and name in ("ROUND", "RND"):
            return self._folded(
                Node(_to_increments(a), begin, argument.end, depth=argument.depth + 1)
            )
        function = (MACRO_FUNCTIONS if self.macro else FUNCTIONS)[name]

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
        """ATAN[y]/[x], or FANUC's ATAN[y]."""
        if x is None:
            a = y.value
            node = Node(lambda p: math.degrees(math.atan(a(p))), begin, y.end, depth=y.depth + 1)
            return self._folded(node, y)
        function = macro_arctangent if self.macro else arctangent
        b, c = y.value, x.value
        node = Node(lambda p: function(b(p), c(p)), begin, x.end, depth=max(y.depth, x.depth) + 1)
        return self._folded(node, y, x)

    def parameter(self, index: Node | str, begin: int, end: int) -> ParameterNode:
        """``#`` and a number, which may be computed, or a name."""
        column = self.place(begin, end)[0]
        if isinstance(index, str):
            return ParameterNode(lambda p: p.name(index, column), begin, end, index=index)
        if index.number is None:
            i = index.value
            value: Value = lambda p: p.number(i(p), column)  # noqa: E731
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
        """The value of a parameter, vacant as NaN."""
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
        """A constant number of a parameter. GcodeError ``parameter-number``."""
        assert node.number is not None
        number = round(node.number)
        if abs(number - node.number) > NEAR_WHOLE:
            raise self.fault(
                "parameter-number", "the number of a parameter must be whole", node.begin, node.end
            )
        return number

    def exists(self, index: Node | str, begin: int, end: int) -> Node:
        """Whether there is such a parameter."""
        if isinstance(index, str):
            return Node(lambda p: float(p.exists(index)), begin, end)
        a = index.value
        return self._folded(
            Node(lambda p: float(p.exists(a(p))), begin, end, depth=index.depth + 1)
        )

    def _folded(self, node: Node, *parts: Node) -> Node:
        """The node, computed once and for all where its parts are constant and it can be."""
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
            "expression-too-deep", message, begin, end, "keep a part of it in a parameter"
        )


_NONE = Parameters()
"""What constants are computed under."""


def _not_vacant(raw: Value) -> Value:
    def value(p: Parameters) -> float:
        result = raw(p)
        return result if result == result else 0.0

    return value


def _to_increments(a: Value) -> Value:
    return lambda p: half_away(a(p) * p.increments) / p.increments


# The four rules of arithmetic are written out: through one function for all of them each operation
# of a program would take a call more.


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
                "division-by-zero", "a division by zero", column=place[0], hint=_LOOK
            ) from None
        if -_INF < result < _INF:
            return result
        raise _overflow(*place)

    return value


_ARITHMETIC = {"+": _add, "-": _subtract, "*": _multiply, "/": _divide}


def _operation(a: Value, operator: str, b: Value, place: tuple[int, int], *, macro: bool) -> Value:
    operate = (MACRO_OPERATORS if macro else OPERATORS)[operator]

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
    return fault(code, message, column=column, length=length, hint=hint or _LOOK)


def _overflow(column: int, length: int) -> GcodeError:
    return fault(
        "number-too-large",
        "the result is too large to be a number",
        column=column,
        length=length,
        hint=_LOOK,
    )
