"""Lines of a program as words and expressions: comments, numbers, variables."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable

Variables = dict[str, float]


class NotRead(Exception):
    """This reader has no meaning for something in the program."""


_VARIABLE = re.compile(r"#(<\w+>|\d+)|\bR(\d+)")
_SPELLINGS = {
    "EQ": "==", "NE": "!=", "GT": ">", "GE": ">=", "LT": "<", "LE": "<=", "MOD": "%",
    "AND": "and", "OR": "or",
}  # fmt: skip
_OPERATORS: dict[type, Callable[[float, float], float]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Mod: operator.mod, ast.Pow: operator.pow,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.Lt: operator.lt, ast.LtE: operator.le,
}  # fmt: skip
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "ABS": abs,
    "SQRT": math.sqrt,
    "SIN": lambda x: math.sin(math.radians(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "TAN": lambda x: math.tan(math.radians(x)),
    "ROUND": lambda x: math.copysign(math.floor(abs(x) + 0.5), x),
}
_NUMBER = r"[-+]*(?:\d+\.?\d*|\.\d+)"
_WORD = re.compile(rf"(,?[A-Z])({_NUMBER}|[-+]?#+(?:<\w+>|\d+)|[-+]?\[)")
_LONG_WORD = re.compile(r"([A-Z]+\d?)=(\"[^\"]*\"|[^\s]+)|(SUPA)")


def code(text: str, *, siemens: bool) -> str:
    """Return a line without its comments, in capitals; without blanks, but for Siemens."""
    text = text.split(";")[0].strip().upper()
    if siemens:
        return re.sub(r"^N\d+\s*", "", text)
    while (less := re.sub(r"\([^()]*\)", "", text)) != text:
        text = less
    text = re.sub(r"\(.*|\)", "", text)
    return re.sub(r"^N[\d.]+", "", re.sub(r"\s", "", text)) or ""


def value(text: str, variables: Variables) -> float:
    """Return the value of an expression.

    Raises:
        NotRead: It has a function, operator or variable that this reader lacks.
    """

    def known(found: re.Match[str]) -> str:
        name = found[1] or f"R{found[2]}"
        if name not in variables:
            raise NotRead(f"#{name} has no value")
        return f"({variables[name]!r})"

    before = None
    while before != text:
        before, text = text, _VARIABLE.sub(known, text)
    for name, sign in _SPELLINGS.items():
        text = re.sub(rf"(?<![A-Z]){name}(?![A-Z])", f" {sign} ", text)
    text = re.sub(r"(?<![\d.])0+(?=\d)", "", text.replace("[", "(").replace("]", ")"))
    try:
        return _computed(ast.parse(text.strip(), mode="eval").body)
    except SyntaxError:
        raise NotRead(text) from None


def _computed(node: ast.expr) -> float:
    match node:
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.UnaryOp(op=ast.USub()):
            return -_computed(node.operand)
        case ast.UnaryOp(op=ast.UAdd()):
            return _computed(node.operand)
        case ast.BinOp():
            return _OPERATORS[type(node.op)](_computed(node.left), _computed(node.right))
        case ast.Compare(ops=[op], comparators=[right]):
            return float(_OPERATORS[type(op)](_computed(node.left), _computed(right)))
        case ast.BoolOp():
            values = [bool(_computed(each)) for each in node.values]
            return float(all(values) if isinstance(node.op, ast.And) else any(values))
        case ast.Call(func=ast.Name(id=name), args=[one]) if name in _FUNCTIONS:
            return _FUNCTIONS[name](_computed(one))
    raise NotRead(ast.dump(node))


def words(text: str, variables: Variables) -> list[tuple[str, float]]:
    """Return the words of a line with their values; a P with a decimal point is named ``P.``.

    Raises:
        NotRead: Something in the line is no word.
    """
    found: list[tuple[str, float]] = []

    def long_word(word: re.Match[str]) -> str:
        if word[3]:
            found.append(("SUPA", 0.0))
        elif not word[2].startswith('"'):
            found.append((word[1], value(word[2], variables)))
        return " "

    text = re.sub(r"\s", "", _LONG_WORD.sub(long_word, text))
    at = 0
    while at < len(text):
        word = _WORD.match(text, at)
        if word is None:
            raise NotRead(text[at:])
        end = word.end()
        if word[2].endswith("["):
            end = closing(text, end - 1) + 1
        number = text[word.start(2) : end]
        letter = "P." if word[1] == "P" and "." in number else word[1]
        found.append((letter, value(number, variables)))
        at = end
    return found


def closing(text: str, begin: int) -> int:
    """Return the position of the bracket that closes the one at ``begin``."""
    depth = 0
    for at in range(begin, len(text)):
        depth += (text[at] == "[") - (text[at] == "]")
        if depth == 0:
            return at
    raise NotRead(text)
