"""The events of a line to a statement.

A token becomes a :class:`Token`, a number at once a node. A rule calls the method with its name,
with its parts; no rule of the grammar has another list of parts than its method.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Protocol, cast

from cnc.gcode.reader.expressions import Builder, Node, ParameterNode, constant
from cnc.gcode.reader.lines import Reading
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.words import MAX_NUMBER, Word, fault, is_line_number
from cnc.model.diagnostics import Fix

# Statements: parsed lines whose values have not been computed yet.
#
# A statement never changes and is shared between equal lines. Values to be computed are closures
# that take the parameters.

Value = Callable[[Parameters], float]
"""Computes the value of an expression with the present parameters.

Raises GcodeError with the column of the part that cannot be computed.
"""

Keyword = Literal[
    "sub", "endsub", "call", "return",
    "if", "elseif", "else", "endif",
    "while", "endwhile", "do", "repeat", "endrepeat", "break", "continue",
    "program", "goto", "if-goto", "if-then", "while-do", "end",
    "cycle", "mcall", "frame", "s-goto", "s-if", "s-else", "s-endif", "s-while", "s-endwhile",
    "s-for", "s-endfor", "s-loop", "s-endloop", "s-repeat", "s-until", "s-call",
    "s-end", "s-proc", "s-def", "s-holes", "s-turn", "s-again", "klartext",
]  # fmt: skip
"""Kinds of control lines. The first three rows are O-words. The next one has those of FANUC, and O
and a number alone ("program"); the last three have SINUMERIK's cycles, frames, jumps,
blocks and subprograms, and the blocks of Klartext.
"""


@dataclass(frozen=True, slots=True)
class Assignment:
    """``#1 = ..``. ``target`` is the name of a parameter, or computes its number."""

    target: str | Value
    value: Value
    column: int
    length: int


DIAMETERS = "diameters"
"""Kind of a remark that says whether X is a diameter from here on (DIAMON, DIAMOF, DIAM90)."""
DIRECTION = "direction"
"""Kind of the remark that sets how a rotary axis turns, or the tool (TOOL): its letter and how."""
MENDED = "mended"
"""Kind of the remark that reports a repair."""
SHOWN = "shown"
"""Kind of the remark that is a message of SINUMERIK: texts in quotes, ``#<name>`` for values."""
NOTED = "noted"
"""Kind of the remark that names a word without effect."""
UNCHECKED = "unchecked"
"""Kind of the remark that names what only the control does: a check goes on, a run refuses it."""


@dataclass(frozen=True, slots=True)
class Remark:
    """A command in a comment. ``kind`` is its first word in lower case: msg, debug, print, ..

    ``fix`` is the repair of the line, where the remark reports one.
    """

    kind: str
    text: str
    column: int
    length: int
    fix: Fix | None = None


@dataclass(frozen=True, slots=True)
class Control:
    """The control part of a line.

    Attributes:
        keyword: The kind of line.
        label: Label of an O-word or of FANUC's DO and END: ``"100"``, ``"<name>"`` in lower case,
            or a computed value; the first name of a line of SINUMERIK.
        values: Condition, count of a repeat, arguments of a call, result of a return or an endsub,
            or target of a GOTO after its condition.
        column: Column from 1.
        length: Number of characters.
        then: The statement after FANUC's IF .. THEN.
        names: Other names of a line of SINUMERIK, and numbers of parameters.
        count: How often a subprogram of SINUMERIK is called.
    """

    keyword: Keyword
    label: str | Value
    values: tuple[Value, ...]
    column: int
    length: int
    then: Statement | None = None
    names: tuple[str | int, ...] = ()
    count: int = 1


@dataclass(frozen=True, slots=True)
class Statement:
    """A parsed line.

    Attributes:
        words: Words in the order written. The number of a word is NaN if it is computed.
        computed: Index and value of each word whose number is computed.
        assignments: Assignments.
        remarks: Commands in comments.
        control: The control part, if there is one.
        board: Text of a command for the board, such as ``$H`` of GRBL; empty for other lines.
        percent: Whether the line is a ``%``.
        deletable: Whether the line begins with ``/``.
    """

    words: tuple[Word, ...] = ()
    computed: tuple[tuple[int, Value], ...] = ()
    assignments: tuple[Assignment, ...] = ()
    remarks: tuple[Remark, ...] = ()
    control: Control | None = None
    board: str = ""
    percent: bool = False
    deletable: bool = False

    def with_words(self, kept: Iterable[int]) -> Statement:
        """Return the words at some indices, the assignments and the remarks."""
        indices, computed = list(kept), dict(self.computed)
        return Statement(
            tuple(self.words[index] for index in indices),
            tuple((at, computed[index]) for at, index in enumerate(indices) if index in computed),
            self.assignments,
            self.remarks,
        )


LENGTHS = "XYZUVWABCIJKRQ"
"""Letters of words in which FANUC's ROUND rounds to the least input increment."""

REMARK = re.compile(
    r"\([ \t]*(msg|debug|print|log|logopen|logappend|logclose|probeopen|probeclose|py"
    r"|abort(?=[ \t]*,))"
    r"(?:[ \t]*|[ \t]*,(.*)|(?<=open)[ \t]+([^,]*))\)",
    re.IGNORECASE | re.ASCII,
)
"""A command in a comment: its first word, and the text after a comma. With PROBEOPEN a blank
is enough; ABORT needs the comma.
"""

Item = tuple[Word, Value | None]


class Token(NamedTuple):
    """A token: its terminal, its text in capitals, and its place in the line, from 0."""

    terminal: str
    text: str
    begin: int
    end: int


_SQUEEZED: dict[int, str | None] = {
    **{ord(char): char.upper() for char in string.ascii_lowercase},
    ord(" "): None,
    ord("\t"): None,
}
_RAW = frozenset(("COMMENT", "TAIL", "STRING"))
"""Terminals whose text stays as it is written."""


def squeezed(text: str) -> str:
    """Return a text without blanks, in capitals."""
    return text.translate(_SQUEEZED)


class Rules(Protocol):
    """The meaning of a language's rules: a method ``_name`` for each rule with a node.

    It takes begin and end of the rule in the line, from 0, and its parts.
    """

    def token(self, token: Token) -> Any:
        """Return what stands for a token among the parts of a rule."""

    def number(self, begin: int, end: int, value: float) -> Any:
        """Return what stands for a number."""


def carried_out(reading: Reading, line: int, text: str, rules: Rules, shift: int = 0) -> Any:
    """Return what the rules of a language make of a line that was read without an error.

    Args:
        reading: The events.
        line: Index of the line in them.
        text: The line.
        rules: The rules.
        shift: Position of the line in the text of the events.
    """
    grammar, events = reading.grammar, reading.events
    terminals, texts, methods = grammar.terminals, grammar.texts, grammar.methods
    is_keyword = grammar.is_keyword
    span = slice(*reading.results.first[line : line + 2].tolist())
    parts: list[Any] = []
    for kind, begin, end, value in zip(
        events.kind[span].tolist(),
        events.begin[span].tolist(),
        events.end[span].tolist(),
        events.value[span].tolist(),
        strict=True,
    ):
        begin, end = begin - shift, end - shift
        if kind < 0:
            at = len(parts) - int(value)
            made = getattr(rules, methods[-kind - 1])
            parts[at:] = [made(begin, end, *parts[at:])]
        elif terminals[kind - 1] == "NUMBER":
            exact = value if value == value else float(squeezed(text[begin:end]))
            parts.append(rules.number(begin, end, exact))
        else:
            name = terminals[kind - 1]
            is_known = is_keyword[kind - 1]
            written = texts[int(value)] if is_known else _written(name, text[begin:end])
            parts.append(rules.token(Token(name, written, begin, end)))
    (whole,) = parts
    return whole


def _written(terminal: str, raw: str) -> str:
    """Return the text of a token without blanks, in capitals."""
    if terminal in _RAW:
        return raw
    if terminal == "NAME" and ";" in raw:
        # Blanks behind a semicolon count.
        return squeezed(raw[: raw.index(";")]) + raw[raw.index(";") :]
    return squeezed(raw)


class ExpressionRules:
    """The rules that the languages share: brackets, signs and operators, for one line.

    A subclass has the method ``number``, and one for each other rule of its grammar.
    """

    def __init__(self, text: str, build: Builder, shift: int = 0) -> None:
        """Create the rules for a line.

        Args:
            text: The line.
            build: Builds the expressions.
            shift: Position of the line in the text of the events.
        """
        self._text, self._build, self._shift = text, build, shift

    def statement(self, reading: Reading, line: int) -> Statement:
        """Return the statement of a line that was read without an error.

        Args:
            reading: The events.
            line: Index of the line in them.
        """
        rules = cast(Rules, self)
        return cast(Statement, carried_out(reading, line, self._text, rules, self._shift))

    def token(self, token: Token) -> Token:
        """Return a token."""
        return token

    def _part(self, node: Node) -> Node:
        """Return a part of an expression; a subclass may refuse it."""
        return node

    def _bracket(self, begin: int, end: int, inside: Node) -> Node:
        return self._part(inside).spanning(begin, end)

    def _sign(self, begin: int, end: int, sign: Token, operand: Node) -> Node:
        return self._build.sign(sign.text, self._part(operand), begin)

    def _binary(self, begin: int, end: int, left: Node, operator: Token, right: Node) -> Node:
        left, right = self._part(left), self._part(right)
        return self._build.binary(left, operator.text, right, operator.begin, operator.end)


class Translator(ExpressionRules):
    """Makes the statement of a line of RS274/NGC or macro B."""

    def __init__(self, text: str, build: Builder, *, siemens: bool, dialect: str) -> None:
        """Create a translator.

        Args:
            text: The line.
            build: Builds the expressions.
            siemens: Whether the dialect has BSPLINE, SD=, PL=, PW=.
            dialect: Name of the dialect for messages.
        """
        super().__init__(text, build)
        self._letter = ""
        self._comments: list[Token] = []
        self._siemens = siemens
        self._dialect = dialect

    def token(self, token: Token) -> Token:
        """Return a token."""
        if token.terminal == "LETTER":
            self._letter = token.text
        return token

    # Expressions

    def number(self, begin: int, end: int, value: float) -> Node:
        """Return a number as a node."""
        if value == math.inf:
            before = self._text[:begin].rstrip(" \t")
            first = len(before) - 1 if before[-1:].isalpha() else begin
            raise self._build.fault("number-too-large", "this number is too large", first, end)
        return constant(value, begin, end)

    def _function(self, begin: int, end: int, function: Token, argument: Node) -> Node:
        # FANUC's ROUND rounds a length in a word to the least input increment.
        increments = self._build.macro and self._letter in LENGTHS and self._letter != ""
        return self._build.call(
            function.text, argument, function.begin, function.end, increments=increments
        )

    def _arctangent(
        self, begin: int, end: int, function: Token, y: Node, *more: Node | Token
    ) -> Node:
        x = more[-1] if more else None
        assert not isinstance(x, Token)
        node = self._build.arctangent(y, x, begin)
        return node.spanning(begin, end)

    def _parameter(self, begin: int, end: int, index: Node | Token) -> ParameterNode:
        if isinstance(index, Token):
            return self._build.parameter(_name(index), begin, end)
        return self._build.parameter(index, begin, end)

    def _exists(self, begin: int, end: int, _function: Token, parameter: ParameterNode) -> Node:
        return self._build.exists(parameter.index, begin, end)

    # Lines

    def _word(self, begin: int, end: int, letter: Token, number: Node) -> Item:
        self._letter = ""
        column, length = self._build.place(begin, end)
        name, written = letter.text.rstrip("="), squeezed(self._text[begin:end])
        if letter.terminal == "ADDRESS":
            self._check_siemens(name, begin, letter.end)
        digits = written[len(letter.text) :]
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

    def _bspline(self, begin: int, end: int, token: Token) -> Item:
        self._check_siemens("BSPLINE", begin, end)
        column, length = self._build.place(begin, end)
        return Word("BSPLINE", 1.0, "BSPLINE", column, length), None

    def _assignment(
        self, begin: int, end: int, target: ParameterNode, _equal: Token, value: Node
    ) -> Assignment:
        column, length = self._build.place(target.begin, target.end)
        index = target.index if isinstance(target.index, str) else target.index.value
        return Assignment(index, value.result, column, length)

    # Control

    def _program(self, begin: int, end: int, letter: Token, number: Node | Token) -> Control:
        return self._control("program", self._written(number), (), begin, end)

    def _oword(
        self, begin: int, end: int, letter: Token, label: Token | Node, keyword: Token,
        *values: Node | Token,
    ) -> Control:  # fmt: skip
        results = tuple(value.value for value in values if isinstance(value, Node))
        self._comments += [value for value in values if isinstance(value, Token)]
        # A label in brackets or with # is computed.
        at = self._text[letter.end :].lstrip(" \t")[:1]
        name = label.value if isinstance(label, Node) and at in "#[" else self._written(label)
        return self._control(cast(Keyword, keyword.text.lower()), name, results, begin, keyword.end)

    def _jump(self, begin: int, end: int, goto: Token, target: Node) -> Control:
        return self._control("goto", "", (target.value,), begin, goto.end)

    def _branch(
        self, begin: int, end: int, if_: Token, condition: Node, goto: Token, target: Node
    ) -> Control:
        return self._control("if-goto", "", (condition.value, target.value), begin, goto.end)

    def _then(
        self, begin: int, end: int, if_: Token, condition: Node, then: Token,
        *assignments: Assignment,
    ) -> Control:  # fmt: skip
        return self._control(
            "if-then", "", (condition.value,), begin, then.end, Statement(assignments=assignments)
        )

    def _loop(self, begin: int, end: int, *parts: Token | Node) -> Control:
        """WHILE [..] DO m, or DO m, whose condition always holds."""
        condition: Value = cast(Node, parts[1]).value if len(parts) == 4 else _always
        return self._control("while-do", self._written(parts[-1]), (condition,), begin, end)

    def _end(self, begin: int, end: int, keyword: Token, label: Node) -> Control:
        return self._control("end", self._written(label), (), begin, end)

    # The whole line

    def _block(self, begin: int, end: int, *items: Any) -> Statement:
        words: list[Word] = []
        computed: list[tuple[int, Value]] = []
        assignments: list[Assignment] = []
        remarks: list[Remark] = []
        control: Control | None = None
        deletable = False
        for item in (*items, *self._comments):
            if isinstance(item, Token):
                if item.terminal == "COMMENT":
                    if remark := REMARK.fullmatch(item.text):
                        column, length = self._build.place(item.begin, item.end)
                        text = (remark[2] or remark[3] or "").strip()
                        remarks.append(Remark(remark[1].lower(), text, column, length))
                elif item.terminal == "SLASH":
                    deletable = True
            elif isinstance(item, Assignment):
                assignments.append(item)
            elif isinstance(item, Control):
                control = item
            elif isinstance(item, tuple):
                word, value = item
                if value is not None:
                    computed.append((len(words), value))
                words.append(word)
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

    def _percent(self, begin: int, end: int, *items: Any) -> Statement:
        return replace(self._block(begin, end, *items), percent=True)

    def _control(
        self,
        keyword: Keyword,
        label: str | Value,
        values: tuple[Value, ...],
        begin: int,
        end: int,
        then: Statement | None = None,
    ) -> Control:
        column, length = self._build.place(begin, end)
        return Control(keyword, label, values, column, length, then)

    def _written(self, label: Node | Token) -> str:
        """Return a written label: ``100``, or ``<name>``."""
        if isinstance(label, Token):
            return f"<{_name(label)}>"
        digits = squeezed(self._text[label.begin : label.end])
        if "." in digits:
            raise self._build.fault(
                "label-malformed",
                f"{digits} is not a label",
                label.begin,
                label.end,
                "a label is a whole number",
            )
        return str(int(digits))

    def _check_siemens(self, name: str, begin: int, end: int) -> None:
        if not self._siemens:
            raise self._build.fault(
                "syntax-not-in-dialect", f"{name} is not in the {self._dialect} dialect", begin, end
            )


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
    return token.text[1:-1].lower()
