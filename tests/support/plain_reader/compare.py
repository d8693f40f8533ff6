"""Compare the moves of two readers, line by line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.program import ProgramOptions, interpret
from cnc.gcode.dialects.recognition import recognise
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import ArcFeed, Block, Polyline, Probe
from cnc.model.diagnostics import Diagnostic
from tests.support.plain_reader.flow import read_plainly
from tests.support.plain_reader.moves import Moved, Point

_PLANES = {"XY": (0, 1, 2), "ZX": (2, 0, 1), "YZ": (1, 2, 0)}
ZERO = ProgramOptions(policy=ReadingPolicy(tool_lengths="zero"))
CLOSE = 1e-5
"""Allowed difference of two positions, mm."""


def difference(lines: list[str], *, plainly: list[str] | None = None) -> str:
    """Return the first difference between the two readers of a program; empty for none.

    Args:
        lines: The program.
        plainly: The program that the plain reader gets instead.
    """
    dialect = recognise(lines).dialect
    warnings: list[Diagnostic] = []
    blocks = interpret(
        Text.of_lines(lines, "corpus.nc"),
        dialect=dialects.load(dialect, lenient=True),
        warn=warnings.append,
        options=ZERO,
    )
    found = [*_joined(_moved(blocks))]
    expected = [*_joined(read_plainly(lines if plainly is None else plainly, dialect))]
    for ours, plain in zip(found, expected, strict=False):
        if not _agree(ours, plain):
            return f"cnc {ours}, plainly {plain}"
    more = found[len(expected) :], expected[len(found) :]
    return "" if not any(more) else f"only in cnc: {more[0][:1]}, only plainly: {more[1][:1]}"


def _moved(blocks: Iterable[Block]) -> Iterator[Moved]:
    at = (0.0, 0.0, 0.0)
    for block in blocks:
        if isinstance(block, Polyline):
            for end, feed, line in zip(
                block.points.tolist(), block.feeds.tolist(), block.lines.tolist(), strict=True
            ):
                at = tuple(end[:3])
                yield Moved(line, (at,), math.isnan(feed), feed * 60)
        elif isinstance(block, ArcFeed):
            end = tuple(block.end.tolist()[:3])
            yield Moved(block.line, (_middle(at, block, end), end), False, block.feed * 60)
            at = end
        elif isinstance(block, Probe):
            at = tuple(block.end.tolist()[:3])
            yield Moved(block.line, (at,), False, block.feed * 60)


def _middle(start: Point, arc: ArcFeed, end: Point) -> Point:
    """Return the point halfway along an arc."""
    first, second, across = _PLANES[arc.plane]
    cx, cy = arc.center
    begin = math.atan2(start[second] - cy, start[first] - cx)
    radius = (arc.radius + math.hypot(end[first] - cx, end[second] - cy)) / 2
    out = [0.0, 0.0, 0.0]
    out[first] = cx + radius * math.cos(begin + math.pi * arc.turns)
    out[second] = cy + radius * math.sin(begin + math.pi * arc.turns)
    out[across] = (start[across] + end[across]) / 2
    return out[0], out[1], out[2]


def _joined(moves: Iterable[Moved]) -> Iterator[Moved]:
    """Yield the moves with those of one line, that follow each other, as one; none at rest."""
    last, at = None, (0.0, 0.0, 0.0)
    for whole in moves:
        points = []
        for point in whole.points:
            if not _near(point, at):
                points.append(point)
                at = point
        if not points and whole.is_whole:
            continue
        moved = replace(whole, points=tuple(points) or whole.points)
        if last is not None and last.line == moved.line:
            feed = last.feed if moved.rapid else moved.feed
            rapid = last.rapid and moved.rapid
            last = Moved(last.line, last.points + moved.points, rapid, feed)
            continue
        if last is not None:
            yield last
        last = moved
    if last is not None:
        yield last


def _agree(ours: Moved, plain: Moved) -> bool:
    feeds = math.isnan(ours.feed) or math.isnan(plain.feed) or math.isclose(ours.feed, plain.feed)
    return (
        ours.line == plain.line
        and ours.rapid == plain.rapid
        and feeds
        and _near(ours.points[-1], plain.points[-1])
        and (
            not plain.is_whole
            or (
                all(_near(a, b) for a, b in zip(ours.box, plain.box, strict=True))
                and all(any(_near(a, b) for b in ours.points) for a in plain.points)
            )
        )
    )


def _near(a: Point, b: Point) -> bool:
    return all(abs(p - q) <= CLOSE for p, q in zip(a, b, strict=True))
