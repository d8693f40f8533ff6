"""Lines that differ in their numbers alone are parsed once.

A program that was unrolled, or written by a macro, is full of them::

    X[#1 + 2.5] Y3      shape  X[#1 + _] Y_      numbers  2.5, 3

The grammar reads the first two lines of a shape: one as it stands, one with its numbers left open.
From then on a line takes its numbers from its text, and everything else from its shape. What a line
can't compute is computed once more by its own full parse, so that errors stand at their places.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import Assignment, Statement, Value
from cnc.gcode.syntax.words import MAX_NUMBER, Word
from cnc.model.diagnostics import GcodeError

MOST_SHAPES = 4096
"""Shapes that are kept."""

_OPEN = re.compile(r"(\([^()]*\))|;.*|<[^<>]*>|#[ \t]*[0-9]+|([0-9]+\.?[0-9]*|\.[0-9]+)", re.DOTALL)
"""What is left open in a shape: comments and numbers, but for the digits of names and of
parameters.
"""
_ACTIVE = re.compile(r"\([ \t]*(?:msg|debug|print|log|probe|py|abort)", re.IGNORECASE)
_CAPITALS = str.maketrans(string.ascii_lowercase, string.ascii_uppercase, " \t")

Span = tuple[int, int]
Parse = Callable[[dict[int, int] | None], Statement]
"""Parses the line; with the places of its numbers (from 0, as they stand in the line) by index,
those are left open.
"""


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a part of the first line stands: from column ``first`` to before ``end``, behind so
    many open spans each.
    """

    first: int
    end: int
    spans_before: int
    spans_inside: int


@dataclass(frozen=True, slots=True)
class _Shape:
    """A statement with its numbers open; ``ends`` are the ends of the open spans in the line that
    it was made from.
    """

    statement: Statement
    ends: tuple[int, ...]
    words: tuple[_Place, ...]
    assignments: tuple[_Place, ...]


_shapes: dict[str, _Shape | Literal["met", "unfit"]] = {}
"""Shapes by their text: one that was met once is made at the second time, one that is unfit
never.
"""


def statement(text: str, flavour: str, parse: Parse) -> Statement:
    """The statement of a line, from its shape where that is known. ``flavour``: whatever else the
    parse depends on.
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
    shape = _shapes.get(key)
    if isinstance(shape, _Shape):
        return _filled(shape, text, spans, numbers, parse) or parse(None)
    if shape is None:
        if len(_shapes) >= MOST_SHAPES:
            _shapes.clear()
        _shapes[key] = "met"
    elif shape == "met":
        _shapes[key] = _learnt(text, spans, numbers, parse) or "unfit"
    return parse(None)


def _learnt(text: str, spans: list[Span], numbers: list[Span], parse: Parse) -> _Shape | None:
    """The shape of a line, if it can be one."""
    try:
        open_numbers = {begin: index for index, (begin, _) in enumerate(numbers)}
        found = parse(open_numbers)
    except GcodeError:
        return None
    simple = not (found.control or found.remarks or found.board or found.percent) and all(
        len(word.letter) == 1 for word in found.words
    )
    if not simple or open_numbers:  # a number that was not taken as one
        return None
    ends = tuple(end for _, end in spans)
    return _Shape(
        found,
        ends,
        tuple(_place(word.column, word.length, ends) for word in found.words),
        tuple(_place(each.column, each.length, ends) for each in found.assignments),
    )


def _place(column: int, length: int, ends: tuple[int, ...]) -> _Place:
    first, end = column - 1, column - 1 + length
    before = sum(1 for each in ends if each <= first)
    return _Place(first, end, before, sum(1 for each in ends if each <= end))


def _filled(
    shape: _Shape, text: str, spans: list[Span], numbers: list[Span], parse: Parse
) -> Statement | None:
    """The statement of another line of the shape; None where it needs the grammar after all."""
    shifts = [0]
    shifts += [span[1] - end for span, end in zip(spans, shape.ends, strict=True)]
    values = tuple([float(text[begin:end]) for begin, end in numbers])
    if math.inf in values:
        return None
    known = shape.statement
    words: list[Word] = []
    for word, place in zip(known.words, shape.words, strict=True):
        first, end = (
            place.first + shifts[place.spans_before],
            place.end + shifts[place.spans_inside],
        )
        written = text[first:end].translate(_CAPITALS)
        number = word.number
        if number == number:
            number = float(written[1:])
            if not -MAX_NUMBER <= number <= MAX_NUMBER:
                return None
        words.append(Word(word.letter, number, written, first + 1, end - first))
    computed = tuple(
        [
            (index, _bound(value, values, lambda k=k: parse(None).computed[k][1]))
            for k, (index, value) in enumerate(known.computed)
        ]  # type: ignore[misc]
    )
    assignments: list[Assignment] = []
    for k, (each, place) in enumerate(zip(known.assignments, shape.assignments, strict=True)):
        first, end = (
            place.first + shifts[place.spans_before],
            place.end + shifts[place.spans_inside],
        )
        target = (
            each.target
            if isinstance(each.target, str)
            else _bound(each.target, values, lambda k=k: _target(parse(None), k))
        )  # type: ignore[misc]
        value = _bound(each.value, values, lambda k=k: parse(None).assignments[k].value)  # type: ignore[misc]
        assignments.append(Assignment(target, value, first + 1, end - first))
    return Statement(tuple(words), computed, tuple(assignments), deletable=known.deletable)


def _target(found: Statement, index: int) -> Value:
    target = found.assignments[index].target
    assert not isinstance(target, str)
    return target


def _bound(value: Value, numbers: tuple[float, ...], exact: Callable[[], Value]) -> Value:
    """A value of the shape with the numbers of a line; ``exact`` is that of its full parse."""

    def bound(parameters: Parameters) -> float:
        parameters.open_numbers = numbers
        try:
            return value(parameters)
        except GcodeError:
            return exact()(parameters)

    return bound
