"""A line of Klartext to a block: its keyword, its words and their values.

Nothing is computed here but constants: a block is shared between equal lines.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from cnc.gcode.reader.lines import read_line
from cnc.gcode.reader.statements import Token, carried_out
from cnc.gcode.syntax.expressions import Builder, Node, constant
from cnc.gcode.syntax.statement import Control, Statement, Value
from cnc.gcode.syntax.words import MAX_NUMBER, Word, fault
from cnc.model.diagnostics import GcodeError

GRAMMAR = "klartext"
OWN_PARAMETERS = range(100, 200)
"""Q parameters in which the control keeps its own data."""
LAST_PARAMETER = 1999
_FN_OPERATIONS = {
    "+": (1, "+"), "-": (2, "-"), "*": (3, "*"), "DIV": (4, "/"), "SQRT": (5, "SQRT"),
    "SIN": (6, "SIN"), "COS": (7, "COS"), "LEN": (8, "LEN"), "ANG": (13, "ANG"),
    "EQU": (9, "EQ"), "NE": (10, "NE"), "GT": (11, "GT"), "LT": (12, "LT"),
    "ERROR": (14, ""), "PRINT": (15, ""),
}  # fmt: skip
"""Number of the FN of each operation, and its name in expressions."""
_WHOLE = {"INT": math.trunc, "SGN": lambda value: float(value > 0.0) - float(value < 0.0)}
_SAID = {
    "NUMBER": "a number", "SIGN": "a value", "AXIS": "an axis", "UNIT": "MM or INCH",
    "FILE": "the name of the program", "LBL": "LBL", "STRING": "a name in quotes",
    "PARAMETER": "a Q parameter", "EQUAL": "=", "COLON": ":", "RADIUS": "R",
}  # fmt: skip
"""Names of terminals in messages."""
_WORD = re.compile(r'"[^"]*"?|[A-Za-z]+[ \t]*[-+]?[0-9.]*|[-+]?[0-9.]+|.', re.DOTALL)
_COMMAND = re.compile(r"[ \t]*[0-9]*[ \t]*([A-Za-z]+(?:[ \t]+[A-Za-z]+)?)")


class Item(NamedTuple):
    """A word of a block.

    Attributes:
        key: Its letters, such as ``IX``, ``F``, ``RL`` or ``Q200``.
        value: Its value; None for a word without one.
        text: The word as it is written.
        begin: Position of its first character.
    """

    key: str
    value: Value | None
    text: str
    begin: int

    def word(self, letter: str, number: float) -> Word:
        """Return a word of G-code that has the place of this one."""
        return Word(letter, float(number), self.text, self.begin + 1, len(self.text))

    def fault(self, code: str, message: str, hint: str = "") -> GcodeError:
        """Return an error at the word."""
        return fault(code, message, self.word("", 0.0), hint)


@dataclass(frozen=True, slots=True)
class Block(Control):
    """A block of Klartext.

    Attributes:
        head: Its keyword as an item.
        items: Its words.
        then: Value of a condition or of a repetition.
    """

    head: Item = Item("", None, "", 0)
    items: tuple[Item, ...] = ()

    def find(self, *keys: str) -> Item | None:
        """Return the first item with one of some keys."""
        return next((item for item in self.items if item.key in keys), None)


def parse(text: str) -> Statement:
    """Return a line as a statement; its block is the control part.

    Raises:
        GcodeError: A syntax error, with its column.
    """
    reading = read_line(text, GRAMMAR)
    results = reading.results
    if results.status[0]:
        wanted = reading.grammar.wanted[results.state[0]]
        raise _not_read(text, int(results.place[0]), wanted)
    found: Statement = carried_out(reading, 0, text, _Rules(text))
    return found


@cache
def _refused() -> dict[str, str]:
    return tomllib.loads(files(__package__).joinpath("refused.toml").read_text("utf-8"))


def _not_read(text: str, at: int, wanted: frozenset[str]) -> GcodeError:
    """Return the error of a line that the grammar does not have."""
    if at < len(text) and not text[at].isascii():
        message = f"the character {text[at]!r} has no meaning here"
        return fault("character-unknown", message, column=at + 1)
    if command := _COMMAND.match(text):
        names = command[1].upper().split()
        for name in (" ".join(names), names[0]):
            if meaning := _refused().get(name):
                message = f"{name} ({meaning}) is not supported"
                column, length = command.start(1) + 1, len(command[1][: len(name)])
                hint = "let the CAM system write the moves themselves"
                return fault("code-not-supported", message, column=column, length=length, hint=hint)
    expected = " or ".join(sorted(_SAID[name] for name in wanted if name in _SAID))
    hint = f"expected here: {expected}" if expected else ""
    found = _WORD.match(text, at)
    if found is None or found[0].startswith(";"):
        message = "the block is not complete"
        return fault(
            "klartext-incomplete", message, column=max(len(text[:at].rstrip()), 1), hint=hint
        )
    message = f"{found[0].strip()} can't stand here in a block of Klartext"
    return fault("klartext-word", message, column=at + 1, length=len(found[0].rstrip()), hint=hint)


def _words(name: str) -> Callable[..., Block]:
    """Return the method of a rule that is a block of words."""

    def made(self: _Rules, begin: int, end: int, *parts: Any) -> Block:
        head, items = parts[0], tuple(map(self.item, parts[1:]))
        written = self.text[begin:end]
        at = Item(_key(head), None, written, begin)
        return Block("klartext", name, (), begin + 1, end - begin, None, at, items)

    return made


def _key(part: Any) -> str:
    return part.text if isinstance(part, Token) else part.key


def _valued(self: _Rules, begin: int, end: int, name: Token, *value: Node) -> Item:
    """Return a word, with or without a value."""
    return Item(name.text, value[0].value if value else None, self.text[begin:end], begin)


class _Rules:
    """The meaning of each rule of the grammar, for one line."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._build = Builder(macro=False, translated=False)

    def token(self, token: Token, value: float) -> Any:
        """Return a token; a number is a node."""
        if token.terminal != "NUMBER":
            return token
        if value > MAX_NUMBER:
            message = f"the number is larger than {MAX_NUMBER:.0f}"
            raise self._build.fault("number-too-large", message, token.begin, token.end)
        return constant(value, token.begin, token.end)

    def item(self, part: Any) -> Item:
        """Return a part of a block as a word."""
        if isinstance(part, Node):
            return Item("", part.value, self.text[part.begin : part.end], part.begin)
        if isinstance(part, Token):
            return Item(part.text, None, self.text[part.begin : part.end], part.begin)
        assert isinstance(part, Item)
        return part

    # Words

    _coordinate = _polar = _coefficient = _radius = _feed = _function = _valued
    _speed = _delta = _dimension = _rotation = _valued

    def _turn(self, begin: int, end: int, name: Token, sign: Token) -> Item:
        turn = 1.0 if sign.text == "+" else -1.0
        return Item("DR", lambda _: turn, self.text[begin:end], begin)

    def _repeat(self, begin: int, end: int, name: Token, count: Node, *_: Any) -> Item:
        return Item("REP", count.value, self.text[begin:end], begin)

    def _assignment(self, begin: int, end: int, name: Token, _: Token, value: Node) -> Item:
        return Item(self._target(name), value.value, self.text[begin:end], begin)

    # Values

    def _parameter(self, begin: int, end: int, name: Token) -> Node:
        return self._build.parameter(self._target(name), begin, end)

    def _target(self, name: Token) -> str:
        number = int(name.text[1:])
        if number > LAST_PARAMETER or number in OWN_PARAMETERS:
            what = "belongs to the control" if number <= LAST_PARAMETER else "does not exist"
            hint = "use Q0 to Q99, or Q200 to Q1999"
            raise self._build.fault(
                "parameter-number", f"{name.text} {what}", name.begin, name.end, hint
            )
        return f"_q{number}"

    def _sign(self, begin: int, end: int, sign: Token, operand: Node) -> Node:
        return self._build.sign(sign.text, operand, begin)

    def _bracket(self, begin: int, end: int, inside: Node) -> Node:
        return inside.spanning(begin, end)

    def _pi(self, begin: int, end: int, pi: Token) -> Node:
        return constant(math.pi, begin, end)

    def _binary(self, begin: int, end: int, left: Node, operator: Token, right: Node) -> Node:
        return self._build.binary(left, operator.text, right, operator.begin, operator.end)

    def _power(self, begin: int, end: int, left: Node, operator: Token, right: Node) -> Node:
        if self.text[left.begin] in "+-":
            message = "a sign before a power is not clear"
            hint = "write brackets, such as -(3^2)"
            raise self._build.fault("expression-without-brackets", message, begin, end, hint)
        return self._build.binary(left, "**", right, operator.begin, operator.end)

    def _apply(self, begin: int, end: int, name: Token, argument: Node) -> Node:
        build, a = self._build, argument.value
        if name.text in _WHOLE:
            whole = _WHOLE[name.text]
            return Node(lambda p: whole(a(p)), begin, end, depth=argument.depth + 1)
        if name.text == "FRAC":
            return Node(lambda p: a(p) - math.trunc(a(p)), begin, end, depth=argument.depth + 1)
        if name.text == "SQ":
            made = build.binary(argument, "*", argument, name.begin, name.end)
        elif name.text == "NEG":
            made = build.sign("-", argument, begin)
        elif name.text == "ATAN":
            made = build.arctangent(argument, None, begin)
        else:
            made = build.call(name.text, argument, name.begin, name.end)
        return made.spanning(begin, end)

    def _binary_fn(self, begin: int, end: int, left: Node, name: Token, right: Node) -> Any:
        number, operator = _FN_OPERATIONS[name.text]
        build = self._build
        place = name.begin, name.end
        if operator == "LEN":
            squares = (build.binary(each, "*", each, *place) for each in (left, right))
            made = build.call(
                "SQRT", build.binary(next(squares), "+", next(squares), *place), *place
            )
        elif operator == "ANG":
            angle = build.arctangent(left, right, begin).value
            made = Node(lambda p: angle(p) % 360.0, begin, end, depth=left.depth + right.depth + 1)
        else:
            made = build.binary(left, operator, right, *place)
        return number, made

    def _unary_fn(self, begin: int, end: int, name: Token, operand: Node) -> Any:
        number, operator = _FN_OPERATIONS[name.text]
        return number, self._build.call(operator, operand, name.begin, name.end)

    # Blocks

    _begin = _words("begin")
    _end = _words("end")
    _blank = _words("blank")
    _move = _words("move")
    _radius_arc = _words("move")
    _centre = _words("centre")
    _corner = _words("corner")
    _spline = _words("spline")
    _tool_call = _words("tool_call")
    _tool_def = _words("tool_def")
    _stop = _words("stop")
    _cycle = _words("cycle")
    _cycle_call = _words("cycle_call")
    _label = _words("label")
    _call = _words("call")

    def _functions(self, begin: int, end: int, *items: Item) -> Block:
        head = Item("M", None, self.text[begin:end], begin)
        return Block("klartext", "move", (), begin + 1, end - begin, None, head, items)

    def _definition(self, begin: int, end: int, *items: Item) -> Block:
        head = Item("Q", None, self.text[begin:end], begin)
        return Block("klartext", "definition", (), begin + 1, end - begin, None, head, items)

    def _formula(
        self, begin: int, end: int, fn: Token, number: Node, name: Token, _: Token, value: Any
    ) -> Block:
        wanted, node = value if isinstance(value, tuple) else (0, value)
        self._check_fn(number, wanted)
        item = Item(self._target(name), node.value, self.text[begin:end], begin)
        return self._definition(begin, end, item)

    def _jump(
        self, begin: int, end: int, fn: Token, number: Node, if_: Token, left: Node,
        relation: Token, right: Node, *target: Any,
    ) -> Block:  # fmt: skip
        wanted, operator = _FN_OPERATIONS[relation.text]
        self._check_fn(number, wanted)
        condition = self._build.binary(left, operator, right, relation.begin, relation.end)
        head = Item("IF", condition.value, self.text[begin:end], begin)
        label = self.item(target[-1])
        return Block("klartext", "jump", (), begin + 1, end - begin, None, head, (label,))

    def _message(
        self, begin: int, end: int, fn: Token, number: Node, kind: Token, *parts: Any
    ) -> Block:
        self._check_fn(number, _FN_OPERATIONS[kind.text][0])
        head = Item(kind.text, parts[-1].value, self.text[begin:end], begin)
        return Block("klartext", "message", (), begin + 1, end - begin, None, head)

    def _check_fn(self, number: Node, wanted: int) -> None:
        if number.number != wanted:
            message = f"this function is FN {wanted}, not FN {number.number:g}"
            raise self._build.fault("klartext-word", message, number.begin, number.end)

    def _line(self, begin: int, end: int, *parts: Any) -> Statement:
        return Statement(control=next((part for part in parts if isinstance(part, Block)), None))
