"""The tree of the grammar to a statement.

This module imports Lark. It is imported when the first line is parsed by the grammar, so that
programs of plain lines start faster. Methods have the names of the grammar's rules.
"""

# ruff: noqa: D102

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any, cast

from lark import Token, Transformer_NonRecursive, Tree, v_args

from cnc.gcode.syntax.expressions import Builder, Node, ParameterNode, constant
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Assignment, Control, Keyword, Remark, Statement, Value
from cnc.gcode.syntax.words import MAX_NUMBER, Word, fault, is_line_number

LENGTHS = "XYZUVWABCIJKRQ"
"""Letters of words in which FANUC's ROUND rounds to the least input increment."""

_REMARK = re.compile(
    r"\([ \t]*(msg|debug|print|log|logopen|logappend|logclose|probeopen|probeclose|py"
    r"|abort(?=[ \t]*,))"
    r"(?:[ \t]*|[ \t]*,(.*)|(?<=open)[ \t]+([^,]*))\)",
    re.IGNORECASE | re.ASCII,
)
"""A command in a comment: its first word, and the text after a comma. With PROBEOPEN a blank
is enough; ABORT needs the comma.
"""

CHECKED_NOW = -1
"""A key of the open numbers that is no position in the line: the line has a constant that must be
checked when it is parsed, so it can have no template.
"""

Item = tuple[Word, Value | None]


@v_args(inline=True)
class Translator(Transformer_NonRecursive):  # type: ignore[type-arg]
    """Makes the statement of one line."""

    def __init__(
        self,
        text: str,
        build: Builder,
        open_numbers: dict[int, int] | None,
        *,
        siemens: bool,
        dialect: str,
    ) -> None:
        """Create a translator.

        Args:
            text: The line without blanks.
            build: Builds the expressions.
            open_numbers: Indices of open numbers by position in the line. Those that the grammar
                reads as numbers are removed.
            siemens: Whether the dialect has BSPLINE, SD=, PL=, PW=.
            dialect: Name of the dialect for messages.
        """
        super().__init__(visit_tokens=False)
        self._open = open_numbers
        self._opened = -1
        self._comments: list[Token] = []
        self._text = text
        self._build = build
        self._siemens = siemens
        self._dialect = dialect

    # Expressions

    def number(self, digits: Token) -> Node:
        begin, end = _begin(digits), _end(digits)
        number = float(digits)
        if number == math.inf:
            letter = begin - 1 if self._text[begin - 1].isalpha() else begin
            raise self._build.fault("number-too-large", "this number is too large", letter, end)
        if (
            self._open is not None
            and (index := self._open.pop(self._build.columns[begin], None)) is not None
        ):
            self._opened = begin
            return Node(lambda p: p.open_numbers[index], begin, end)
        return constant(number, begin, end)

    def bracket(self, left: Token, inside: Node, right: Token) -> Node:
        return inside.spanning(_begin(left), _begin(right) + 1)

    def sign(self, sign: Token, operand: Node) -> Node:
        return self._build.sign(str(sign), operand, _begin(sign))

    def binary(self, left: Node, operator: Token, right: Node) -> Node:
        return self._build.binary(left, str(operator), right, _begin(operator))

    def call(self, function: Token, argument: Node) -> Node:
        return self._build.call(
            function.value, argument, _begin(function), increments=function.type == "WORD_FUNCTION"
        )

    def arctangent(
        self, function: Token, y: Node, _slash: Token | None = None, x: Node | None = None
    ) -> Node:
        return self._build.arctangent(y, x, _begin(function))

    def parameter(self, hash_: Token, index: Node | Token) -> ParameterNode:
        if isinstance(index, Node):
            if (
                self._open is not None
                and _begin(hash_) < self._opened
                and "#" not in self._text[_begin(hash_) + 1 : index.end]
            ):
                self._open[CHECKED_NOW] = 0
            return self._build.parameter(index, _begin(hash_), index.end)
        return self._build.parameter(_name(index), _begin(hash_), _end(index))

    def exists(self, function: Token, _left: Token, parameter: ParameterNode, right: Token) -> Node:
        return self._build.exists(parameter.index, _begin(function), _end(right))

    # Lines

    def word(self, letter: Token, number: Node) -> Item:
        begin, end = _begin(letter), number.end
        column, length = self._build.place(begin, end)
        name, written = str(letter).rstrip("="), self._text[begin:end]
        if letter.type == "ADDRESS":
            self._check_siemens(name, begin, _end(letter))
        digits = self._text[_end(letter) : end]
        if "[" in digits or "#" in digits:
            return Word(name, math.nan, written, column, length), number.result
        value = float(digits)
        if abs(value) > MAX_NUMBER:
            raise self._build.fault(
                "number-too-large",
                f"the number after {name} is larger than {MAX_NUMBER:.0f}",
                begin,
                end,
            )
        return Word(name, value, written, column, length), None

    def bspline(self, token: Token) -> Item:
        self._check_siemens("BSPLINE", _begin(token), _end(token))
        column, length = self._build.place(_begin(token), _end(token))
        return Word("BSPLINE", 1.0, "BSPLINE", column, length), None

    def assignment(self, target: ParameterNode, value: Node) -> Assignment:
        column, length = self._build.place(target.begin, target.end)
        index = target.index if isinstance(target.index, str) else target.index.value
        return Assignment(index, value.result, column, length)

    # Control

    def program(self, letter: Token, number: Token) -> Control:
        return self._control("program", self._label(number), (), letter, number)

    def oword(
        self, letter: Token, label: Token | Node, keyword: Token, *values: Node | Token
    ) -> Control:
        results = tuple(value.value for value in values if isinstance(value, Node))
        self._comments += [value for value in values if not isinstance(value, Node)]
        return self._control(
            cast(Keyword, str(keyword).lower()), self._label(label), results, letter, keyword
        )

    def jump(self, goto: Token, target: Node) -> Control:
        return self._control("goto", "", (target.value,), goto, goto)

    def branch(self, if_: Token, condition: Node, goto: Token, target: Node) -> Control:
        return self._control("if-goto", "", (condition.value, target.value), if_, goto)

    def then(self, if_: Token, condition: Node, then: Token, *assignments: Assignment) -> Control:
        return self._control(
            "if-then", "", (condition.value,), if_, then, Statement(assignments=assignments)
        )

    def loop(self, *parts: Token | Node) -> Control:
        """WHILE [..] DO m, or DO m, whose condition always holds."""
        condition: Value = parts[1].value if isinstance(parts[1], Node) else _always
        return self._control("while-do", self._label(parts[-1]), (condition,), parts[0], parts[-1])

    def end(self, end: Token, label: Token) -> Control:
        return self._control("end", self._label(label), (), end, label)

    # The whole line

    @v_args(inline=False)
    def block(self, items: list[Any]) -> Statement:
        words: list[Word] = []
        computed: list[tuple[int, Value]] = []
        assignments: list[Assignment] = []
        remarks: list[Remark] = []
        control: Control | None = None
        deletable = False
        for item in (*items, *self._comments):
            if isinstance(item, tuple):
                word, value = item
                if value is not None:
                    computed.append((len(words), value))
                words.append(word)
            elif isinstance(item, Assignment):
                assignments.append(item)
            elif isinstance(item, Control):
                control = item
            elif item.type == "COMMENT":
                if remark := _REMARK.fullmatch(item):
                    column, length = self._build.place(_begin(item), _end(item))
                    text = (remark[2] or remark[3] or "").strip()
                    remarks.append(Remark(remark[1].lower(), text, column, length))
            elif item.type == "SLASH":
                deletable = True
        if control is not None:
            _check_alone(control, words, assignments)
        return Statement(
            tuple(words),
            tuple(computed),
            tuple(assignments),
            tuple(remarks),
            control,
            deletable=deletable,
        )

    @v_args(inline=False)
    def percent(self, items: list[Any]) -> Statement:
        statement: Statement = self.block(items)
        return replace(statement, percent=True)

    def _control(
        self,
        keyword: Keyword,
        label: str | Value,
        values: tuple[Value, ...],
        first: Any,
        last: Any,
        then: Statement | None = None,
    ) -> Control:
        column, length = self._build.place(_begin(first), _end(last))
        return Control(keyword, label, values, column, length, then)

    def _label(self, label: Any) -> str | Value:
        """Return ``100``, ``<name>``, or a value that computes the number."""
        if isinstance(label, Node):
            return label.value
        if label.type == "NAME":
            return f"<{_name(label)}>"
        if "." in label:
            raise self._build.fault(
                "label-malformed",
                f"{label} is not a label",
                _begin(label),
                _end(label),
                "a label is a whole number",
            )
        return str(int(label))

    def _check_siemens(self, name: str, begin: int, end: int) -> None:
        if not self._siemens:
            raise self._build.fault(
                "syntax-not-in-dialect", f"{name} is not in the {self._dialect} dialect", begin, end
            )


def mark_rounding(tree: Tree[Token]) -> None:
    """Mark ROUND in FANUC words, where it rounds lengths to the least input increment."""
    for word in tree.find_data("word"):
        if str(word.children[0]) in LENGTHS:
            for call in word.find_data("call"):
                cast(Token, call.children[0]).type = "WORD_FUNCTION"


def _always(_: Parameters) -> float:
    return 1.0


def _check_alone(control: Control, words: list[Word], assignments: list[Assignment]) -> None:
    """Raise the error for a control line with anything but a line number before it."""
    number = (
        words[0] if words and words[0].letter == "N" and words[0].column < control.column else None
    )
    if number is not None and not is_line_number(number.written):
        raise fault(
            "line-number-bad",
            f"{number.written} is not a line number",
            number,
            "a line number is a number from 0, such as N100",
        )
    places = [(word.column, word.length) for word in words if word is not number]
    places += [(assignment.column, assignment.length) for assignment in assignments]
    if places:
        column, length = min(places)
        message = "a control line must stand alone in its line"
        raise fault(
            "control-not-alone",
            message,
            column=column,
            length=length,
            hint="write this in another line",
        )


def _name(token: Token) -> str:
    return str(token)[1:-1].lower()


def _begin(token: Token) -> int:
    return cast(int, token.start_pos)


def _end(token: Token) -> int:
    return cast(int, token.end_pos)
