"""The moves of a group of lines, computed together before the first of them is sent."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cnc.boards.grbl.tracked_moves import (
    FULL_TURN,
    ArcMove,
    AxisLimits,
    Move,
    Point,
    StraightMove,
)
from cnc.model.line_effects import ARCS, LineKind

Floats = NDArray[np.float64]

PLANES = ((0, 1), (2, 0), (1, 2))
"""Columns of the two axes of each plane: XY, ZX, YZ."""
ARC_KINDS = sorted(ARCS)
new_straight = partial(tuple.__new__, StraightMove)
"""Make a move of all its fields. A call of the type would take a function of Python."""


@dataclass(frozen=True, slots=True)
class GroupMoves:
    """The moves of lines. A line that moves nothing has none.

    Attributes:
        moves: The moves.
        lines: Number in the group of the line of each move.
        before: Number of moves before each line, and of all (n + 1,).
        seconds: Time of each move.
        traverses: The same of each traverse; 0 for other moves.
        ends: Machine position at the end of each line, mm.
        direction: Unit vector of the last move; None after an arc.
    """

    moves: list[Move]
    lines: list[int]
    before: list[int]
    seconds: list[float]
    traverses: list[float]
    ends: list[Point]
    direction: tuple[float, ...] | None


def moves_of(
    rows: NDArray[np.void],
    start: Point,
    direction: tuple[float, ...] | None,
    offset: Point,
    limits: AxisLimits,
) -> GroupMoves:
    """Return the moves of lines, all of which are motions.

    Args:
        rows: Source line and effect of each line, see :func:`cnc.model.line_effects.row_type`.
        start: Machine position before them, mm.
        direction: Unit vector of the move before them; None where the board rests before them, and
            after an arc.
        offset: Work offset that the board adds to the numbers of a line, mm.
        limits: Limits of the axes.
    """
    points = _points(rows, start, offset)
    change = np.diff(points, axis=0)
    length = np.sqrt((change * change).sum(axis=1))
    is_arc = np.isin(rows["kind"], ARC_KINDS)
    kept = np.flatnonzero(is_arc | (length > 0.0))
    rows, length, is_arc = rows[kept], length[kept], is_arc[kept]
    unit = np.zeros((len(kept), len(start)))
    np.divide(change[kept], length[:, np.newaxis], out=unit, where=~is_arc[:, np.newaxis])
    # After an arc, as after a rest, the board is taken to start from rest.
    turns = np.full(len(kept), -1.0)
    turns[1:] = np.where(is_arc[:-1], -1.0, (unit[1:] * unit[:-1]).sum(axis=1))
    if len(kept) and direction is not None:
        turns[0] = np.dot(unit[0], direction)
    rapid = rows["kind"] == LineKind.RAPID
    seconds = limits.times(length, unit, np.where(rapid, math.inf, rows["feed"]), turns)
    places = list(map(tuple, points.tolist()))
    each = zip(
        rows["line"].tolist(),
        [places[k] for k in kept],
        [places[k + 1] for k in kept],
        length.tolist(),
        seconds.tolist(),
        strict=True,
    )
    moves: list[Move] = list(map(new_straight, each))
    for k in np.flatnonzero(is_arc):
        begin, end = places[kept[k]], places[kept[k] + 1]
        moves[k] = arc = _arc(rows[k], begin, end, limits)
        seconds[k] = arc.seconds
    last = direction
    if len(kept):
        last = None if is_arc[-1] else tuple(unit[-1].tolist())
    return GroupMoves(
        moves,
        kept.tolist(),
        np.searchsorted(kept, np.arange(len(change) + 1)).tolist(),
        seconds.tolist(),
        np.where(rapid, seconds, 0.0).tolist(),
        places[1:],
        last,
    )


def _points(rows: NDArray[np.void], start: Point, offset: Point) -> Floats:
    """Return the machine positions before the first line and after each (n + 1, axes), mm."""
    target: Floats = rows["target"]
    named = min(target.shape[1], len(start), len(offset))
    points = np.tile(np.array(start), (len(rows) + 1, 1))
    points[1:, :named] = target[:, :named] + np.array(offset[:named])
    # An axis that a line does not name stays where the line before has left it.
    known = np.where(np.isnan(points), 0, np.arange(len(points))[:, np.newaxis])
    return np.take_along_axis(points, np.maximum.accumulate(known, axis=0), axis=0)


def _arc(row: np.void, start: Point, end: Point, limits: AxisLimits) -> ArcMove:
    i, j = PLANES[row["plane"]]
    across, up = row["center"].tolist()
    center = start[i] + across, start[j] + up
    counterclockwise = row["kind"] == LineKind.COUNTERCLOCKWISE
    radius = math.dist((start[i], start[j]), center)
    first = math.atan2(start[j] - center[1], start[i] - center[0])
    turn = (math.atan2(end[j] - center[1], end[i] - center[0]) - first) % math.tau
    if not counterclockwise:
        turn -= math.tau
    if abs(turn) < FULL_TURN:
        turn += math.tau if counterclockwise else -math.tau
    rates, feed = limits.rates, float(row["feed"])
    speed = min(feed, rates[i], rates[j]) if max(i, j) < len(rates) else feed
    others = [
        b - a for column, (a, b) in enumerate(zip(start, end, strict=True)) if column not in (i, j)
    ]
    length = math.hypot(radius * turn, *others)
    seconds = length / speed if speed else 0.0
    return ArcMove(int(row["line"]), start, end, seconds, (i, j), center, radius, first, turn)
