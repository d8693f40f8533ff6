"""Templates for lines that differ only in their numbers, so that the grammar parses one of them.

Programs with unrolled loops have many such lines::

    X[#1 + 2.5] Y3      template  X[#1 + _] Y_      numbers  2.5, 3

The grammar parses the first two lines of a template: the first as it is, the second with open
numbers. Later lines take the numbers from their text and all else from the template. If a value
cannot be computed, the line is parsed in full, so that the error has its right column.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Assignment, Statement, Value
from cnc.gcode.syntax.words import MAX_NUMBER, Word
from cnc.model.diagnostics import GcodeError

MOST_TEMPLATES = 4096
"""Templates that are kept."""

_OPEN = re.compile(r"(\([^()]*\))|;.*|<[^<>]*>|#[ \t]*[0-9]+|([0-9]+\.?[0-9]*|\.[0-9]+)", re.DOTALL)
"""Open spans of a template: comments and numbers. The digits of names and parameters are part of
the template.
"""
_ACTIVE = re.compile(r"\([ \t]*(?:msg|debug|print|log|probe|py|abort)", re.IGNORECASE)
_CAPITALS = str.maketrans(string.ascii_lowercase, string.ascii_uppercase, " \t")

Span = tuple[int, int]
Parse = Callable[[dict[int, int] | None], Statement]
"""Parses the line. The argument holds the index of each open number by its position in the line,
from 0; None for no open numbers.
"""


@dataclass(frozen=True, slots=True)
class _Place:
    """The place of a part of the line that a template was made from.

    Attributes:
        first: Position of its first character, from 0.
        end: Position after its last character.
        spans_before: Number of open spans before ``first``.
        spans_inside: Number of open spans before ``end``.
    """

    first: int
    end: int
    spans_before: int
    spans_inside: int


@dataclass(frozen=True, slots=True)
class Template:
    """A statement with open numbers.

    Attributes:
        statement: The statement.
        ends: Ends of the open spans in the line that it was made from.
        words: Places of the words.
        assignments: Places of the assignments.
    """

    statement: Statement
    ends: tuple[int, ...]
    words: tuple[_Place, ...]
    assignments: tuple[_Place, ...]


_templates: dict[str, Template | Literal["met", "unfit"]] = {}
"""Templates by their text. ``met``: one line was parsed. ``unfit``: such lines have no template."""


def statement(text: str, flavour: str, parse: Parse) -> Statement:
    """Return the statement of a line, from its template if there is one.

    Args:
        text: The line.
        flavour: Everything else that the parse depends on.
        parse: Parses the line in full.
    """
    if _ACTIVE.search(text):
        return parse(None)
    spans: list[Span] = []
    numbers: list[Span] = []
    pieces: list[str] = []
    at = 0
    for found in _OPEN.finditer(text):
        span = found.span()
        if found[2] is not None:
            numbers.append(span)
            mark = "\0"
        elif found[1] is not None:
            mark = "()"
        else:
            continue
        spans.append(span)
        pieces += text[at : span[0]], mark
        at = span[1]
    if not numbers:
        return parse(None)
    key = f"{flavour}\n{''.join(pieces)}{text[at:]}"
    template = _templates.get(key)
    if isinstance(template, Template):
        return filled(template, text, spans, numbers, parse) or parse(None)
    if template is None:
        if len(_templates) >= MOST_TEMPLATES:
            _templates.clear()
        _templates[key] = "met"
    elif template == "met":
        _templates[key] = make_template(spans, numbers, parse) or "unfit"
    return parse(None)


def make_template(spans: list[Span], numbers: list[Span], parse: Parse) -> Template | None:
    """Return the template of a line; None if it cannot have one."""
    try:
        open_numbers = {begin: index for index, (begin, _) in enumerate(numbers)}
        found = parse(open_numbers)
    except GcodeError:
        return None
    simple = not (found.control or found.remarks or found.board or found.percent) and all(
        len(word.letter) == 1 for word in found.words
    )
    if not simple or open_numbers:  # the grammar did not read a number as one
        return None
    ends = tuple(end for _, end in spans)
    return Template(
        found,
        ends,
        tuple(_place(word.column, word.length, ends) for word in found.words),
        tuple(_place(each.column, each.length, ends) for each in found.assignments),
    )


def _place(column: int, length: int, ends: tuple[int, ...]) -> _Place:
    first, end = column - 1, column - 1 + length
    before = sum(1 for each in ends if each <= first)
    return _Place(first, end, before, sum(1 for each in ends if each <= end))


def filled(
    template: Template,
    text: str,
    spans: list[Span],
    numbers: list[Span],
    parse: Parse,
    place: Span | None = None,
) -> Statement | None:
    """Return the statement of another line of the template; None if it needs the grammar.

    Args:
        template: The template.
        text: The line.
        spans: Its open spans.
        numbers: Those of them that are numbers.
        parse: Parses the line in full.
        place: Column and length of each word, if the line is a translation of another one.
    """
    shifts = [0]
    shifts += [span[1] - end for span, end in zip(spans, template.ends, strict=True)]
    values = tuple([float(text[begin:end]) for begin, end in numbers])
    if math.inf in values:
        return None
    known = template.statement
    words: list[Word] = []
    for word, at in zip(known.words, template.words, strict=True):
        first, end = at.first + shifts[at.spans_before], at.end + shifts[at.spans_inside]
        written = text[first:end].translate(_CAPITALS)
        number = word.number
        if number == number:
            number = float(written[1:])
            if not -MAX_NUMBER <= number <= MAX_NUMBER:
                return None
        column, length = place or (first + 1, end - first)
        words.append(Word(word.letter, number, written, column, length))
    computed = tuple(
        [
            (index, _bound(value, values, partial(_computed_of, parse, k)))
            for k, (index, value) in enumerate(known.computed)
        ]
    )
    assignments: list[Assignment] = []
    for k, (each, at) in enumerate(zip(known.assignments, template.assignments, strict=True)):
        first, end = at.first + shifts[at.spans_before], at.end + shifts[at.spans_inside]
        target = (
            each.target
            if isinstance(each.target, str)
            else _bound(each.target, values, partial(_target_of, parse, k))
        )
        value = _bound(each.value, values, partial(_assigned_of, parse, k))
        column, length = place or (first + 1, end - first)
        assignments.append(Assignment(target, value, column, length))
    return Statement(tuple(words), computed, tuple(assignments), deletable=known.deletable)


def _computed_of(parse: Parse, index: int) -> Value:
    return parse(None).computed[index][1]


def _assigned_of(parse: Parse, index: int) -> Value:
    return parse(None).assignments[index].value


def _target_of(parse: Parse, index: int) -> Value:
    target = parse(None).assignments[index].target
    assert not isinstance(target, str)
    return target


def _bound(value: Value, numbers: tuple[float, ...], exact: Callable[[], Value]) -> Value:
    """Return a value of the template with the numbers of a line.

    Args:
        value: The value.
        numbers: The numbers of the line.
        exact: Returns the value of the line's full parse.
    """

    def bound(parameters: Parameters) -> float:
        parameters.open_numbers = numbers
        try:
            return value(parameters)
        except GcodeError:
            return exact()(parameters)

    return bound
