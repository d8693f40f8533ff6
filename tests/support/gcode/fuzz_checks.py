"""Checks that hold for every program, for random tests.

- There is no traceback and no hang.
- An error has a message without internal names, and a place in the text.
- Blocks are finite and begin where the last one ended.
- No accepted word is ignored. To check this, each word of an accepted line is changed: numbers to
  others, codes to others of their modal group. The blocks or the final state must then change, or
  the line must be refused.
"""

from __future__ import annotations

import math
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cnc.gcode import dialects
from cnc.gcode.program import program
from cnc.gcode.program.call_stack import Limits
from cnc.gcode.state.modal_groups import GROUP_OF_G, GROUP_OF_M
from cnc.gcode.state.tool_table import ToolEntry, ToolTable
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.parser import Syntax, parse_line
from cnc.gcode.syntax.source_text import Text
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import Word
from cnc.model.blocks import (
    PLANE_AXES,
    AnalogOutput,
    ArcFeed,
    Block,
    Dwell,
    NurbsFeed,
    Orient,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
)
from cnc.model.diagnostics import CncError, Diagnostic
from tests.support.gcode.fuzzing import Author, Program
from tests.support.gcode.gcode_cases import read

SECONDS = 5.0
"""Limit of the CPU time of a program. Most take a millisecond."""
LIMITS = Limits(repeated_lines=500, depth=10)
TOOLS = tuple(
    ToolEntry(number, number, {"X": 0.5, "Z": 10.0 * number}, diameter=0.5 * number)
    for number in (1, 2, 3, 11)
)
FOLDERS = (Path(__file__).parent / "subroutines",)
PLAIN = re.compile(
    r"\b(?:Token|None|True|False|nan|inf|[A-Z]+_[A-Z_]+|__\w+|lark|python|object "
    r"at|self)\b|Error\b|\\x|\bdict\b|<class"
)
"""Internal names, which no message may contain."""
IDLE = frozenset("NO")
"""Line and program numbers have no effect."""
IDLE_CODES = frozenset((G.G15, G.G67, G.G69))
"""Codes that cancel modes which are not supported. Post-processors write them at the start."""
IDLE_WITH = {"Q": {"G64"}}
"""Q of G64 allows a simplification that is not made."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the block after this CPU time, if the platform has such a timer."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def stop(*_: Any) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def blocks_of(sample: Program, **options: Any) -> list[Block]:
    """Run a program."""
    text = Text.of_lines(sample.lines, "test.nc")
    options |= {
        "block_delete": sample.block_delete,
        "limits": LIMITS,
        "folders": FOLDERS,
        "tools": ToolTable(TOOLS),
    }
    return list(read(text, axes=sample.axes, dialect=sample.dialect, **options))


def check_blocks(blocks: list[Block], axes: tuple[str, ...]) -> None:
    """Assert what holds for every list of blocks."""
    position = np.zeros(len(axes))
    for block in blocks:
        match block:
            case Polyline():
                assert np.isfinite(block.points).all()
                assert (np.isnan(block.feeds) | (block.feeds > 0)).all()
                assert len(block.points) == len(block.feeds) == len(block.lines) > 0
                position = block.points[-1]
            case ArcFeed():
                assert np.isfinite(
                    [*block.center, *block.end, block.radius, block.turns, block.feed]
                ).all()
                assert block.radius > 0
                assert block.feed > 0
                assert block.turns != 0
                start = [position[axes.index(axis)] for axis in PLANE_AXES[block.plane]]
                assert math.isclose(
                    math.dist(start, block.center), block.radius, rel_tol=1e-6, abs_tol=1e-6
                ), "it begins elsewhere"
                position = block.end
            case NurbsFeed():
                assert len(block.knots) == len(block.control_points) + block.degree + 1
                assert (np.diff(block.knots) >= 0).all()
                assert (block.weights > 0).all()
                assert np.isfinite(block.control_points).all()
                assert block.feed > 0
                assert block.control_points[0].tolist() == position.tolist()
                position = block.control_points[-1]
            case Probe():
                assert np.isfinite(block.end).all()
                assert block.feed > 0
                position = block.end
            case Dwell():
                assert 0 <= block.seconds < math.inf
            case Spindle():
                assert 0 <= block.rpm < math.inf
                assert 0 <= block.surface_speed < math.inf
            case SpindleSync():
                assert 0 <= block.pitch < math.inf
            case Orient() | AnalogOutput():
                assert np.isfinite(
                    [
                        getattr(block, field.name)
                        for field in fields(block)
                        if isinstance(getattr(block, field.name), float)
                    ]
                ).all()
            case _:
                pass
        assert block.line >= 1
        assert block.file


def check_message(found: Diagnostic, lines: tuple[str, ...]) -> None:
    """Assert that an error has a code, a place in the text and a message without internal names."""
    assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", found.code), found
    assert found.file, found
    if found.file != "test.nc":
        assert Path(found.file).parent in FOLDERS, found
        lines = tuple(Path(found.file).read_text(encoding="utf-8").split("\n"))
    assert 1 <= found.line <= len(lines), found
    text = lines[found.line - 1].removesuffix("\r")
    assert 1 <= found.column <= max(len(text), 1), found
    assert found.text == text, found
    assert found.length >= 1, found
    assert found.message, found
    assert not PLAIN.search(re.sub("#<[^>]*>", "", f"{found.message} {found.hint}")), found


# Blocks and final state of a program

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


# No word is ignored


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
    syntax = Syntax(rules.flavour, siemens=rules.siemens, dollar=rules.dollar, dialect=rules.name)
    before = outcome(sample)
    assert before.error is None
    count = 0
    for word, others in variants(sample.lines[-1], syntax):
        count += 1
        assert any(outcome(sample.with_last(other)) != before for other in others), (word, sample)
    return count


# A program


@dataclass(slots=True)
class Tally:
    """Counts of a random test."""

    programs: int = 0
    accepted: int = 0
    words: int = 0
    codes: set[str] = field(default_factory=set)

    def add(self, other: Tally) -> None:
        """Add the counts of another task."""
        self.programs += other.programs
        self.accepted += other.accepted
        self.words += other.words
        self.codes |= other.codes


def check(sample: Program) -> Diagnostic | None:
    """Run and check a program; return its error if it is refused."""

    def check_warning(odd: Diagnostic) -> None:
        check_message(odd, sample.lines)
        assert odd.severity in ("warning", "note"), odd

    with limited(SECONDS):
        try:
            check_blocks(blocks_of(sample, warn=check_warning), sample.axes)
        except CncError as refused:
            check_message(refused.diagnostic, sample.lines)
            return refused.diagnostic
    return None


def check_words(sample: Program, author: Author, error: Diagnostic | None) -> int:
    """Check the words of a line after an accepted program, or after the lines before an error.

    Returns the number of words checked.
    """
    line = author.expand("tail").split("\n")[0]
    if error is not None:
        sample = replace(sample, lines=sample.lines[: error.line - 1])
    longer = Program((*sample.lines, line), sample.axes, sample.dialect)
    with limited(20.0 * SECONDS):
        last = outcome(longer)
        if last.error is not None or (last.ended and outcome(sample).ended):
            return 0
        return every_word_matters(longer)


def check_seeds(first: int, count: int, words_of: int = 10) -> Tally:
    """Check the programs of some seeds, and the words of a line after every ``words_of``-th.

    Raises an AssertionError with the seed of a program that fails.
    """
    tally = Tally()
    for seed in range(first, first + count):
        author = Author(seed)
        sample = author.program()
        try:
            error = check(sample)
            tally.programs += 1
            if error is not None:
                tally.codes.add(error.code)
            tally.accepted += error is None
            if seed % words_of == 0:
                tally.words += check_words(sample, author, error)
        except Exception as wrong:
            text = "\n".join(sample.lines)
            raise AssertionError(
                f"seed {seed}, {sample.dialect}, {sample.axes}: "
                f"{type(wrong).__name__}: {wrong}\n{text}"
            ) from wrong
    return tally
