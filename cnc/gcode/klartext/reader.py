"""A line of Klartext to a block: its keyword, its words and their values.

Nothing is computed here but constants: a block is shared between equal lines.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from cnc.gcode.reader.expressions import Builder, Node, constant
from cnc.gcode.reader.lines import KLARTEXT, read_line
from cnc.gcode.reader.statements import Control, ExpressionRules, Statement, Token, Value
from cnc.gcode.reader.words import MAX_NUMBER, Word, fault
from cnc.model.diagnostics import GcodeError

_PARAMETERS = frozenset((*range(100), *range(200, 2000)))
"""Q parameters of programs. Q100 to Q199 have the control's own data."""
_FN = {
    "+": (1, "+"), "-": (2, "-"), "*": (3, "*"), "DIV": (4, "/"), "SQRT": (5, "SQRT"),
    "SIN": (6, "SIN"), "COS": (7, "COS"), "LEN": (8, ""), "EQU": (9, "EQ"), "NE": (10, "NE"),
    "GT": (11, "GT"), "LT": (12, "LT"), "ANG": (13, ""), "ERROR": (14, ""), "PRINT": (15, ""),
}  # fmt: skip
"""Number of the FN of each operation, and its name in expressions."""
_TRUNCATED = "TRUNC"
_SAID = {
    "NUMBER": "a number", "SIGN": "a value", "AXIS": "an axis", "UNIT": "MM or INCH",
    "FILE": "the name of the program", "LBL": "LBL", "STRING": "a name in quotes",
    "PARAMETER": "a Q parameter", "EQUAL": "=", "COLON": ":", "RADIUS": "R",
}  # fmt: skip
"""Names of terminals in messages."""
_WORD = re.compile(r'"[^"]*"?|[A-Za-z]+[ \t]*[-+]?[0-9.]*|[-+]?[0-9.]+|.', re.DOTALL)
_COMMAND = re.compile(r"[ \t]*[0-9]*[ \t]*([A-Za-z]+(?:[ \t]+[A-Za-z]+)?)")


class Item(NamedTuple):
    """A word: its letters (``IX``, ``RL``, ``_q200``), value, text, and place in the line."""

    key: str
    value: Value | None
    text: str
    begin: int

    @property
    def letter(self) -> str:
        """The letters without the I of an increment."""
        return self.key.lstrip("I")

    def word(self, letter: str, number: float) -> Word:
        """Return a word of G-code that has the place of this one."""
        return Word(letter, float(number), self.text, self.begin + 1, len(self.text))

    def fault(self, code: str, message: str, hint: str = "") -> GcodeError:
        """Return an error at the word."""
        return fault(code, message, self.word("", 0.0), hint)


@dataclass(frozen=True, slots=True, kw_only=True)
class Block(Control):
    """A block of Klartext: its keyword, which stands for the whole block, and its words."""

    head: Item
    items: tuple[Item, ...]

    def find(self, *keys: str) -> Item | None:
        """Return the first word with one of some keys."""
        return next((item for item in self.items if item.key in keys), None)


def parse(text: str) -> Statement:
    """Return a line as a statement; its block is the control part."""
    reading = read_line(text, KLARTEXT.grammar)
    results = reading.results
    if results.status[0]:
        wanted = reading.grammar.wanted[results.state[0]]
        raise _not_read(text, int(results.place[0]), wanted)
    return _Rules(text, Builder("klartext")).statement(reading, 0)


def block_of(head: Item, *items: Item) -> Block:
    """Return a block of a keyword and words."""
    place = head.begin + 1, len(head.text)
    return Block("klartext", head.key, (), *place, head=head, items=items)


@cache
def _refused() -> dict[str, str]:
    data = tomllib.loads(files(__package__).joinpath("refused.toml").read_text("utf-8"))
    return {name: meaning for meaning, names in data.items() for name in names}


def _not_read(text: str, at: int, wanted: frozenset[str]) -> GcodeError:
    """Return the error of a line that the grammar does not have."""
    if at < len(text) and not text[at].isascii():
        return fault("character-unknown", f"{text[at]!r} has no meaning here", column=at + 1)
    if command := _COMMAND.match(text):
        names = command[1].upper().split()
        for name in (" ".join(names), names[0]):
            if meaning := _refused().get(name):
                message = f"{name} ({meaning}) is not supported"
                hint = "let the CAM system write the moves themselves"
                place = Item(name, None, command[1][: len(name)], command.start(1))
                return place.fault("code-not-supported", message, hint)
    expected = " or ".join(sorted(_SAID[name] for name in wanted if name in _SAID))
    hint = f"expected here: {expected}" if expected else ""
    match = _WORD.match(text, at)
    if match is None or match[0] == ";":
        column = max(len(text[:at].rstrip()), 1)
        return fault("klartext-incomplete", "the block is not complete", column=column, hint=hint)
    message = f"{match[0].strip()} can't stand here in a block of Klartext"
    return fault("klartext-word", message, column=at + 1, length=len(match[0].rstrip()), hint=hint)


class _Rules(ExpressionRules):
    """The meaning of each rule of the grammar, for one line."""

    def number(self, begin: int, end: int, value: float) -> Node:
        """Return a number as a node."""
        if value > MAX_NUMBER:
            message = f"the number is larger than {MAX_NUMBER:.0f}"
            raise self._build.fault("number-too-large", message, begin, end)
        return constant(value, begin, end)

    def _item(self, part: Token | Node | Item) -> Item:
        """Return a part of a block as a word; a value alone has no letters."""
        if isinstance(part, Item):
            return part
        text = self._text[part.begin : part.end]
        if isinstance(part, Node):
            return Item("", part.value, text, part.begin)
        return Item(part.text, None, text, part.begin)

    def _valued(self, begin: int, end: int, name: Token, *value: Node) -> Item:
        text = self._text[begin:end]
        return Item(name.text, value[0].value if value else None, text, begin)

    def _turn(self, begin: int, end: int, name: Token, sign: Token) -> Item:
        turn = 1.0 if sign.text == "+" else -1.0
        return Item("DR", lambda _: turn, self._text[begin:end], begin)

    def _assignment(self, begin: int, end: int, name: Token, value: Node) -> Item:
        return Item(self._name(name), value.value, self._text[begin:end], begin)

    def _words(self, begin: int, end: int, *parts: Any) -> Block:
        """Return a block. M functions alone are the block M, assignments the block Q."""
        key = "M" if parts[0][0] == "M" else "Q"
        if isinstance(parts[0], Token):
            key, parts = parts[0].text, parts[1:]
        return block_of(Item(key, None, self._text[begin:end], begin), *map(self._item, parts))

    def _function(self, begin: int, end: int, fn: Node, *parts: Any) -> Block:
        """Return the block of an FN, whose number must be that of its operation."""
        first, *_, last = parts
        text, number = self._text[begin:end], 0
        if isinstance(first, Node):
            _, relation, right, *_ = parts
            number, operator = _FN[relation.text]
            condition = self._build.binary(first, operator, right, relation.begin, relation.end)
            made = block_of(Item("IF", condition.value, text, begin), self._item(last))
        elif first.terminal == "MESSAGE":
            number, made = _FN[first.text][0], block_of(Item(first.text, last.value, text, begin))
        else:
            number, node = last if isinstance(last, tuple) else (0, last)
            item = Item(self._name(first), node.value, text, begin)
            made = block_of(Item("Q", None, text, begin), item)
        if fn.number != number:
            message = f"this function is FN {number}, not FN {fn.number:g}"
            raise self._build.fault("klartext-word", message, fn.begin, fn.end)
        return made

    def _line(self, begin: int, end: int, *parts: Any) -> Statement:
        return Statement(control=next((part for part in parts if isinstance(part, Block)), None))

    def _parameter(self, begin: int, end: int, name: Token) -> Node:
        return self._build.parameter(self._name(name), begin, end)

    def _name(self, name: Token) -> str:
        """Return the name of a Q parameter for :class:`Parameters`."""
        number = int(name.text[1:])
        if number not in _PARAMETERS:
            message, hint = f"{name.text} is not for programs", "use Q0 to Q99, or Q200 to Q1999"
            raise self._build.fault("parameter-number", message, name.begin, name.end, hint)
        return f"_q{number}"

    def _pi(self, begin: int, end: int) -> Node:
        return constant(math.pi, begin, end)

    def _power(self, begin: int, end: int, left: Node, right: Node) -> Node:
        if self._text[left.begin] in "+-":
            message, hint = "a sign before a power is not clear", "write brackets, such as -(3^2)"
            raise self._build.fault("expression-without-brackets", message, begin, end, hint)
        return self._build.binary(left, "**", right, left.end, right.begin)

    def _call(self, begin: int, end: int, name: Token, argument: Node) -> Node:
        build, place, zero = self._build, (name.begin, name.end), constant(0.0, begin, end)
        match name.text:
            case "SQ":
                made = build.binary(argument, "*", argument, *place)
            case "NEG":
                made = build.sign("-", argument, begin)
            case "ATAN":
                made = build.arctangent(argument, None, begin)
            case "INT":
                made = build.call(_TRUNCATED, argument, *place)
            case "FRAC":
                whole = build.call(_TRUNCATED, argument, *place)
                made = build.binary(argument, "-", whole, *place)
            case "SGN":
                above, below = (build.binary(argument, op, zero, *place) for op in ("GT", "LT"))
                made = build.binary(above, "-", below, *place)
            case _:
                made = build.call(name.text, argument, *place)
        return made.spanning(begin, end)

    def _calculation(self, begin: int, end: int, *parts: Any) -> tuple[int, Node]:
        """Return the number of an FN, and its value."""
        build, name = self._build, parts[-2]
        number, operator = _FN[name.text]
        left, right, place = parts[0], parts[-1], (name.begin, name.end)
        if name.text == "LEN":
            x, y = (build.binary(operand, "*", operand, *place) for operand in (left, right))
            made = build.call("SQRT", build.binary(x, "+", y, *place), *place)
        elif name.text == "ANG":
            angle = build.arctangent(left, right, begin)
            made = build.binary(angle, "MOD", constant(360.0, begin, end), *place)
        elif len(parts) == 2:
            made = build.call(operator, right, *place)
        else:
            made = build.binary(left, operator, right, *place)
        return number, made
