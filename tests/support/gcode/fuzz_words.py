"""Check that no accepted word is ignored.

Each word of an accepted line is changed: numbers to others, codes to others of their modal group.
The blocks or the final state must then change, or the line must be refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from cnc.gcode import dialects
from cnc.gcode.core import program
from cnc.gcode.core.modal_groups import GROUP_OF_G, GROUP_OF_M
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import G, Word
from cnc.model.blocks import (
    Block,
)
from cnc.model.diagnostics import CncError, Diagnostic
from tests.support.gcode.fuzz_runs import blocks_of
from tests.support.gcode.fuzzing import Program

IDLE = frozenset("NO")
"""Line and program numbers have no effect."""
IDLE_CODES = frozenset((G.G15, G.G67, G.G69))
"""Codes that cancel modes which are not supported. Post-processors write them at the start."""
IDLE_WITH = {"Q": {"G64"}}
"""Q of G64 allows a simplification that is not made."""
_UNSEEN = (Word, Statement, Diagnostic)
"""Objects that hold text, not meaning."""


def snapshot(thing: Any, seen: set[int] | None = None) -> Any:
    """All data inside an object of the interpreter as plain tuples, without text and functions."""
    seen = set() if seen is None else seen
    if thing is None or isinstance(thing, str | int | float):
        return repr(thing)
    if isinstance(thing, np.ndarray):
        return thing.tobytes()
    if callable(thing) or isinstance(thing, _UNSEEN) or id(thing) in seen:
        return None
    if isinstance(thing, dict):
        seen.add(id(thing))
        return tuple(
            (repr(key) if isinstance(key, str | int | float) else "", snapshot(value, seen))
            for key, value in thing.items()
        )
    if isinstance(thing, list | tuple):
        return tuple(snapshot(each, seen) for each in thing)
    if isinstance(thing, set | frozenset):
        return tuple(sorted(repr(each) for each in thing))
    seen.add(id(thing))
    names = (
        [field.name for field in fields(thing)]
        if is_dataclass(thing)
        else _slots(thing) or list(getattr(thing, "__dict__", ()))
    )
    return tuple(
        (name, snapshot(getattr(thing, name, None), seen))
        for name in names
        if name not in ("_prepared", "text_of", "here", "_here")
    )


def _slots(thing: Any) -> list[str]:
    return [
        name
        for kind in type(thing).__mro__
        for name in getattr(kind, "__slots__", ())
        if name[:2] != "__"
    ]


def known(dialect: str) -> Parameters:
    """Parameters that give each coordinate system another origin, so that its choice matters."""
    origins = {5221 + 20 * system + axis: 0.5 + system for system in range(9) for axis in range(9)}
    homes = {first + axis: 3.25 + axis for first in (5161, 5181) for axis in range(9)}
    return Parameters(origins | homes, macro=dialects.load(dialect).flavour == "macro-b")


@dataclass(slots=True)
class Outcome:
    """Blocks and state of an accepted program, or the error of a refused one."""

    blocks: list[Block]
    state: Any
    ended: bool
    error: Diagnostic | None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Outcome) or (self.error is None) != (other.error is None):
            return False
        if self.error is not None and other.error is not None:
            return (self.error.code, self.error.line) == (other.error.code, other.error.line)
        return bool(self.state == other.state and snapshot(self.blocks) == snapshot(other.blocks))


def outcome(sample: Program) -> Outcome:
    """Run a program from a start at which every word has an effect."""
    made: list[Any] = []
    whole = program.Interpreter

    def keep(*arguments: Any, **named: Any) -> Any:
        made.append(whole(*arguments, **named))
        return made[-1]

    warnings: list[Diagnostic] = []
    program.Interpreter = keep  # type: ignore[assignment, misc]
    try:
        start = np.full(len(sample.axes), 0.123)
        blocks = blocks_of(
            sample, parameters=known(sample.dialect), start=start, warn=warnings.append
        )
    except CncError as error:
        return Outcome([], None, False, error.diagnostic)
    finally:
        program.Interpreter = whole  # type: ignore[misc]
    return Outcome(
        blocks,
        (snapshot(made[0]), [(found.code, found.line) for found in warnings]),
        made[0].ended,
        None,
    )


def _others(word: Word) -> list[str]:
    """Words to write instead of a word."""
    if word.letter not in "GM":
        numbers = (
            word.number + 4.0,
            -word.number - 3.3,
            word.number / 16.0,
            word.number + 0.5,
            0.0,
        )
        return [f"{word.letter}{number:.6f}" for number in numbers if math.isfinite(number)]
    if not (number := word.tenths if word.letter == "G" else word.whole):
        return ["G1", "G92"] if word.letter == "G" else ["M30"]
    groups, unit = (GROUP_OF_G, 10) if word.letter == "G" else (GROUP_OF_M, 1)
    group = groups.get(number)
    return [
        "",
        *(
            f"{word.letter}{other / unit:g}"
            for other, name in groups.items()
            if name == group and other != number
        ),
    ]


def _assigned_otherwise(text: str, column: int, length: int) -> str:
    """A line whose assignment at ``column`` gives another value."""
    left, _, right = text[column - 1 : column - 1 + length].partition("=")
    return f"{text[: column - 1]}{left}=[[{right}]+4.25]{text[column - 1 + length :]}"


def variants(text: str, syntax: Syntax) -> Iterator[tuple[str, list[str]]]:
    """Yield each word and assignment of a line, with lines in which it is replaced."""
    statement = parse_line(text, syntax)
    computed = {index for index, _ in statement.computed}
    codes = {word.written for word in statement.words if word.letter in "GM"}
    radius = any(word.letter == "@" and abs(word.number) > 0.0 for word in statement.words)
    for index, word in enumerate(statement.words):
        if word.letter == "^" and not radius:
            continue  # of the zero point any angle is the same
        if word.letter == "G" and index not in computed and word.tenths in IDLE_CODES:
            continue
        if (
            word.letter in IDLE
            or codes & IDLE_WITH.get(word.letter, set())
            or (index in computed and word.letter in "GM")
        ):
            continue
        new = (
            [f"{word.letter}{number}" for number in ("37.4321", "-37", "2", "0")]
            if index in computed
            else _others(word)
        )
        yield (
            word.written,
            [
                text[: word.column - 1] + other + text[word.column - 1 + word.length :]
                for other in new
            ],
        )
    for each in statement.assignments:
        yield text, [_assigned_otherwise(text, each.column, each.length)]


def every_word_matters(sample: Program) -> int:
    """Check the last line of an accepted program; return the number of words checked."""
    rules = dialects.load(sample.dialect)
    syntax = Syntax(
        rules.flavour, siemens=rules.lines.bspline, dollar=rules.lines.dollar, dialect=rules.name
    )
    before = outcome(sample)
    assert before.error is None
    count = 0
    for word, others in variants(sample.lines[-1], syntax):
        count += 1
        assert any(outcome(sample.with_last(other)) != before for other in others), (word, sample)
    return count
