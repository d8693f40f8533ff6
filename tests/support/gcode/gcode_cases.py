"""Helpers of the language's tests: run programs from text, and compare blocks as tuples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from cnc.gcode import dialects
from cnc.gcode.core.program import ProgramOptions, interpret
from cnc.gcode.reader.parser import MAX_LINE
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import (
    ArcFeed,
    Block,
    Coolant,
    Dwell,
    End,
    Message,
    NurbsFeed,
    Orient,
    Overrides,
    PathMode,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
    Stop,
    Tool,
)
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import apart

Row = tuple[Any, ...]


def read(text: Text, **options: Any) -> Iterator[Block]:
    """The blocks of a program; the options are those of ``interpret`` and ProgramOptions."""
    names = {field.name for field in fields(ProgramOptions)} & options.keys()
    rare = ProgramOptions(**{name: options.pop(name) for name in names})
    return interpret(text, options=rare, **options)


def run(source: str, **options: Any) -> list[Block]:
    """The blocks of a program."""
    return list(read(Text.of_lines(source.split("\n"), "test.nc"), **options))


def rows(blocks: list[Block]) -> Iterator[Row]:
    """Blocks as tuples, one for each straight move; feeds in mm/min."""
    for block in apart(blocks):
        match block:
            case Polyline():
                for end, feed in zip(block.points.tolist(), block.feeds.tolist(), strict=True):
                    yield ("rapid", *end) if math.isnan(feed) else ("line", *end, feed * 60)
            case ArcFeed():
                yield (
                    "arc",
                    block.plane,
                    *block.center,
                    *block.end.tolist(),
                    block.radius,
                    block.turns,
                    block.feed * 60,
                )
            case NurbsFeed():
                yield (
                    "nurbs",
                    block.degree,
                    block.knots.tolist(),
                    block.control_points.tolist(),
                    block.weights.tolist(),
                    block.feed * 60,
                )
            case PathMode():
                yield ("path", block.control, block.tolerance)
            case Dwell():
                yield ("dwell", block.seconds)
            case Spindle():
                yield ("spindle", block.state, block.rpm)
            case Coolant():
                yield ("coolant", block.mist, block.flood)
            case Tool():
                yield ("tool", block.number)
            case Stop():
                yield ("optional-stop",) if block.optional else ("stop",)
            case End():
                yield ("end",)
            case Message():
                yield ("message", block.text)
            case Overrides():
                yield ("overrides", block.feed, block.spindle)
            case SpindleSync():
                yield ("sync", block.pitch, *([block.angle] if block.angle else []))
            case Orient():
                yield ("orient", block.angle)
            case Probe():
                yield ("probe", *block.end.tolist(), block.feed * 60, block.towards, block.must)
            case _:
                raise AssertionError(block)


def block_summaries(source: str, **options: Any) -> list[str]:
    """The blocks of a program as text, such as ``line 4 5 -1 F600``, with up to six decimals."""
    out = []
    for kind, *values in rows(run(source, **options)):
        words = [
            str(value).lower() if isinstance(value, str | bool) else f"{round(value, 6) + 0.0:.10g}"
            for value in values
        ]
        if kind == "line":
            words[-1] = f"F{words[-1]}"
        elif kind == "probe":
            words[-3] = f"F{words[-3]}"
        out.append(" ".join((kind, *words)))
    return out


def flat(row: Row) -> list[Any]:
    """A row without nested lists."""
    out: list[Any] = []
    for item in row:
        out += flat(tuple(item)) if isinstance(item, list | tuple) else [item]
    return out


def assert_rows_equal(found: list[Row], expected: list[Row], *, abs: float = 1e-12) -> None:
    """Assert that rows are equal, numbers to within rounding errors."""
    assert [row[0] for row in found] == [row[0] for row in expected]
    for got, want in zip(found, expected, strict=True):
        for a, b in zip(flat(got), flat(want), strict=True):
            exact = isinstance(b, str | bool) or b is None
            assert a == (b if exact else pytest.approx(b, rel=1e-12, abs=abs)), (got, want)


def assert_blocks(source: str, *expected: Row, **options: Any) -> None:
    """Assert that the program has exactly these blocks."""
    assert_rows_equal(list(rows(run(source, **options))), list(expected))


def error_of(source: str, **options: Any) -> Diagnostic:
    """The diagnostic of a program, which must be refused."""
    with pytest.raises(GcodeError) as caught:
        run(source, **options)
    return caught.value.diagnostic


def assert_diagnostic_at(
    found: Diagnostic, code: str, marked: str, *, file: str = "test.nc"
) -> None:
    """Assert the code of a diagnostic, and its place at the mark ¦ in the text of ``file``."""
    before = marked[: marked.index("¦")]
    place = before.count("\n") + 1, len(before) - before.rfind("\n")
    assert (found.code, found.file, found.line, found.column) == (code, file, *place), (
        found.render()
    )
    line = marked.replace("¦", "").split("\n")[found.line - 1]
    assert found.text == (line if len(line) <= MAX_LINE else "")
    assert found.length >= 1
    assert found.message


def assert_error_at(code: str, marked: str, **options: Any) -> Diagnostic:
    """Assert that a program is refused at the mark ¦; return the diagnostic."""
    found = error_of(marked.replace("¦", ""), **options)
    assert_diagnostic_at(found, code, marked)
    return found


def end_of(source: str, **options: Any) -> list[float]:
    """The end position of a program of straight moves."""
    block = run(source, **options)[-1]
    assert isinstance(block, Polyline)
    return np.asarray(block.points[-1]).tolist()


def points(
    source: str, dialect: str, *, lenient: bool = False, **options: Any
) -> list[tuple[float, ...]]:
    """The ends of the moves of a program."""
    rules = dialects.load(dialect, lenient=lenient)
    return [
        tuple(row)
        for block in run(source, dialect=rules, **options)
        if isinstance(block, Polyline)
        for row in block.points.tolist()
    ]


def warnings(
    source: str, dialect: str, *, lenient: bool = False, **options: Any
) -> list[Diagnostic]:
    """The warnings and notes of a program."""
    found: list[Diagnostic] = []
    run(source, dialect=dialects.load(dialect, lenient=lenient), **options, warn=found.append)
    return found
