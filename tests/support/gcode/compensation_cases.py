"""Contours as short lists of moves for compensation, and the distance of a point from a move."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.gcode.core.block_buffer import SourceLocation
from cnc.gcode.core.compensation import Compensation
from cnc.gcode.reader.words import Word
from cnc.model.blocks import ArcFeed, Block, Dwell
from cnc.model.diagnostics import Diagnostic, GcodeError

Row = tuple[Any, ...]
FEED = 10.0
WORD = Word("X", 1.0, "X1", 7, 2)
HERE = SourceLocation("test.nc", None, words_of=lambda line: (WORD,))


@dataclass(frozen=True)
class Line:
    """To x, y (and z, where it changes); as a traverse where ``rapid``."""

    x: float
    y: float
    z: float | None = None
    rapid: bool = False
    feed: float = FEED


@dataclass(frozen=True)
class Arc:
    """To x, y about cx, cy by signed turns."""

    x: float
    y: float
    cx: float
    cy: float
    turns: float
    z: float | None = None


Move = Line | Arc | Literal["dwell"]


@dataclass
class Recorder:
    """The output of compensation as rows: kind, end, and centre, radius and turns of an arc.

    ``lines`` has the line of each.
    """

    rows: list[Row] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    feeds: list[float] = field(default_factory=list)

    def place(self, end: list[float], feed: float, line: int, file: str) -> None:
        self.rows.append(("rapid" if math.isnan(feed) else "line", *end))
        self.lines.append(line)
        self.feeds.append(feed)

    def put(self, block: Block) -> None:
        if isinstance(block, ArcFeed):
            self.rows.append(("arc", *block.end.tolist(), *block.center, block.radius, block.turns))
        else:
            self.rows.append((type(block).__name__.lower(),))
        self.lines.append(block.line)
        self.feeds.append(block.feed if isinstance(block, ArcFeed) else math.nan)


def send(compensation: Compensation, moves: list[Move], position: list[float]) -> None:
    """Moves in the X Y plane, from ``position``, on lines 1, 2, 3 .."""
    for line, move in enumerate(moves, start=1):
        if move == "dwell":
            compensation.add(Dwell("test.nc", line, 1.0))
            continue
        assert not isinstance(move, str)
        start, position = position, [move.x, move.y, position[2] if move.z is None else move.z]
        if isinstance(move, Line):
            compensation.move(position, math.nan if move.rapid else move.feed, line)
        else:
            radius = math.dist(start[:2], (move.cx, move.cy))
            block = ArcFeed(
                "test.nc",
                line,
                "XY",
                (move.cx, move.cy),
                np.array(position),
                radius,
                move.turns,
                FEED,
            )
            compensation.arc(block)


def record(
    moves: list[Move],
    side: Literal["left", "right"],
    radius: float,
    *,
    start: Row = (0.0, 0.0, 0.0),
) -> Recorder:
    """A contour from ``start`` to G40."""
    recorder = Recorder()
    compensation = Compensation(recorder, HERE)
    compensation.start(side, radius, "XY", (0, 1), list(start))
    send(compensation, moves, list(start))
    compensation.stop()
    return recorder


def refused(
    moves: list[Move],
    side: Literal["left", "right"],
    radius: float,
    *,
    start: Row = (0.0, 0.0, 0.0),
) -> Diagnostic:
    """The diagnostic of a contour that can't be cut."""
    with pytest.raises(GcodeError) as caught:
        record(moves, side, radius, start=start)
    return caught.value.diagnostic


def same(found: list[Row], expected: list[Row]) -> None:
    """Equal rows, numbers to 1e-9."""
    assert [row[0] for row in found] == [row[0] for row in expected], found
    for got, want in zip(found, expected, strict=True):
        assert got[1:] == pytest.approx(want[1:], rel=0, abs=1e-9), (got, want)


def sampled(row: Row, start: complex, points: int = 200) -> NDArray[np.complex128]:
    """Points of the plane along a row that begins at ``start``."""
    share = np.linspace(0.0, 1.0, points)
    end = complex(row[1], row[2])
    if row[0] != "arc":
        return start + (end - start) * share
    center = complex(row[4], row[5])
    return center + (start - center) * np.exp(1j * math.tau * row[7] * share)


def distance(
    points: NDArray[np.complex128], move: Line | Arc, start: complex
) -> NDArray[np.float64]:
    """How far points lie from a move that begins at ``start``."""
    end = complex(move.x, move.y)
    if isinstance(move, Line):
        along = end - start
        share = np.clip(((points - start) * along.conjugate()).real / abs(along) ** 2, 0.0, 1.0)
        return np.abs(points - start - share * along)
    center = complex(move.cx, move.cy)
    angle = (
        np.angle((points - center) / (start - center)) * math.copysign(1.0, move.turns) % math.tau
    )
    beside = np.abs(np.abs(points - center) - abs(start - center))
    return np.where(
        angle <= math.tau * abs(move.turns),
        beside,
        np.minimum(np.abs(points - start), np.abs(points - end)),
    )


def headings(row: Row, start: complex) -> tuple[complex, complex]:
    """Directions of a row at its start and at its end."""
    end = complex(row[1], row[2])
    if row[0] != "arc":
        return (end - start) / abs(end - start), (end - start) / abs(end - start)
    center = complex(row[4], row[5])
    spin = 1j * math.copysign(1.0, row[7])
    return spin * (start - center) / abs(start - center), spin * (end - center) / abs(end - center)


def turn(before: complex, after: complex) -> float:
    """The angle between two directions, counter-clockwise positive."""
    return cmath.phase(after / before)
