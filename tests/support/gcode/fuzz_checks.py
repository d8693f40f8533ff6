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
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

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
from cnc.model.motion_commands import apart
from tests.support.gcode.fuzz_runs import FOLDERS, SECONDS, blocks_of, limited
from tests.support.gcode.fuzz_words import every_word_matters, outcome
from tests.support.gcode.fuzzing import Author, Program

PLAIN = re.compile(
    r"\b(?:Token|None|True|False|nan|inf|[A-Z]+_[A-Z_]+|__\w+|lark|python|object "
    r"at|self)\b|Error\b|\\x|\bdict\b|<class"
)
"""Internal names, which no message may contain."""


def check_blocks(blocks: list[Block], axes: tuple[str, ...]) -> None:
    """Assert what holds for every list of blocks."""
    position = np.zeros(len(axes))
    for block in apart(blocks):
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
