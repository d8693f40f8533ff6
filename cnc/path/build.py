"""Canonical blocks to a path, as a stream: moving blocks become :class:`PathChunk`, the others pass
through in their order.

    blocks  ──►  records of the pieces, gathered to about a chunk  ──►  held until it is known whether the motion
                                                                       must rest at their end  ──►  chunks and blocks

Motion rests at the end of the stream, before every block that isn't motion (but a message), under
exact stop (G61.1) at the end of every block and every straight move, and at both ends of a probing
move. Under G64 each joint of two pieces is given the tolerance in effect, or the smaller one where
it changes there. PathMode ends here: nothing below asks for it.

A probe passes through, then its move, and no block is read behind it before somebody asks for more:
by then the board has answered, and the path goes on from where contact was.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import START
from cnc.model.blocks import (
    PLANE_AXES,
    ArcFeed,
    Block,
    Message,
    NurbsFeed,
    PathMode,
    Polyline,
    Probe,
)
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.path.chunk import PathChunk
from cnc.path.fit import LEAST_TOLERANCE, Fitter, Pieces
from cnc.path.records import (
    Floats,
    Records,
    arc_records,
    axis_classes,
    line_records,
    moving,
    spline_records,
)

MOST_PIECES = 4096
MOST_NUMBERS = 1 << 18
"""A chunk is closed when it has this many pieces or this many numbers in its records."""
ENOUGH = 64
"""Under G64 a chunk is closed with the block when it has this many pieces: they may stand for
thousands of moves.
"""
JOIN = 1e-6
"""mm. A NURBS whose first control point is this near to the position is moved there; farther off is
an error.
"""


class _Gatherer:
    """Gathers records into chunks."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.file = ""
        self.clear()

    def clear(self) -> None:
        self.parts: list[Pieces] = []
        self.stops: list[NDArray[np.bool_]] = []
        self.pieces = 0
        self.numbers = 0

    def add(
        self,
        records: Records,
        feeds: Floats,
        lines: NDArray[np.int32],
        stops: NDArray[np.bool_],
        tolerance: float,
    ) -> None:
        kind = np.full(len(records.at), records.kind)
        self.put(
            Pieces(
                kind,
                records.at,
                records.data,
                records.length,
                feeds,
                lines,
                np.where(stops, 0.0, tolerance),
            ),
            stops,
        )

    def put(self, pieces: Pieces, stops: NDArray[np.bool_]) -> None:
        self.parts.append(pieces)
        self.stops.append(stops)
        self.pieces += len(pieces.at)
        self.numbers += len(pieces.data)

    def full(self) -> bool:
        return self.pieces >= MOST_PIECES or self.numbers >= MOST_NUMBERS

    def take(self) -> PathChunk:
        """What was gathered, as one chunk; the gatherer is empty after it."""
        parts = self.parts
        offsets = np.cumsum([0] + [len(part.data) for part in parts[:-1]])
        chunk = PathChunk(
            axes=self.axes,
            file=self.file,
            kind=np.concatenate([part.kind for part in parts]),
            at=np.concatenate(
                [part.at + offset for part, offset in zip(parts, offsets, strict=True)]
            ),
            data=np.concatenate([part.data for part in parts]),
            length=np.concatenate([part.length for part in parts]),
            feed=np.concatenate([part.feed for part in parts]),
            line=np.concatenate([part.line for part in parts]),
            stop_after=np.concatenate(self.stops),
            tolerance=np.concatenate([part.tolerance for part in parts]),
        )
        self.clear()
        return chunk


def build(
    blocks: Iterable[Block],
    *,
    axes: tuple[str, ...],
    start: Floats,
    accuracy: float = 1e-12,
    tolerance: float = 0.0,
) -> Iterator[PathChunk | Block]:
    """Yield the path of ``blocks`` in chunks, and the blocks that don't move, in order.

    axes: names, one a column; start (n,): position before the first block, mm; accuracy: largest
    error of arc length and its inverse, mm; tolerance: that of G64 without P, mm. Raises GcodeError
    (``not-finite``, ``nurbs-not-continuous``, ``nurbs-start``) at the block's line.
    """
    classes = axis_classes(axes)
    position = np.array(start, np.float64)
    gatherer = _Gatherer(axes)
    exact_stop = False
    allowed = 0.0
    # a chunk and the messages behind it wait here until it is known whether the motion goes on
    held: list[PathChunk | Block] = []

    fitter: Fitter | None = None

    def gather(fitted: Iterable[Pieces]) -> Iterator[PathChunk | Block]:
        for pieces in fitted:
            gatherer.put(pieces, np.zeros(len(pieces.at), np.bool_))
            if gatherer.full():
                yield from hold()

    def end_chain() -> Iterator[PathChunk | Block]:
        """No more moves will be fitted with those so far."""
        nonlocal fitter
        if fitter is not None:
            yield from gather(fitter.flush())
            fitter = None

    def close() -> Iterator[PathChunk | Block]:
        """Hold all there is."""
        yield from end_chain()
        yield from hold()

    def hold() -> Iterator[PathChunk | Block]:
        """Hold what was gathered; what was held before it is followed by motion, so it may go."""
        if gatherer.pieces:
            chunk = gatherer.take()
            yield from held
            held[:] = [chunk]

    def rest() -> Iterator[PathChunk | Block]:
        """Let go of everything: motion rests here."""
        yield from close()
        if held and isinstance(held[0], PathChunk):
            held[0].stop_after[-1] = True
            held[0].tolerance[-1] = 0.0
        yield from held
        held.clear()

    def limit_last(allowed: float) -> None:
        """Let the joint behind the last piece so far have no more than this."""
        last = (
            gatherer.parts[-1].tolerance
            if gatherer.pieces
            else held[0].tolerance
            if held and isinstance(held[0], PathChunk)
            else None
        )
        if last is not None:
            last[-1] = min(last[-1], allowed)

    for block in blocks:
        if isinstance(block, Polyline | ArcFeed | NurbsFeed):
            if block.file != gatherer.file:
                yield from close()
                gatherer.file = block.file
            if isinstance(block, Polyline) and allowed >= LEAST_TOLERANCE:
                if fitter is None:
                    fitter = Fitter(classes, allowed, accuracy, position)
                for points, feeds, lines in _moves(block, position):
                    yield from gather(fitter.add(points, feeds, lines))
                if gatherer.pieces >= ENOUGH:
                    yield from hold()
                continue
            yield from end_chain()
            for records, feeds, lines, stops in _pieces(
                block, position, axes, classes, accuracy, exact_stop
            ):
                gatherer.add(records, feeds, lines, stops, allowed)
                if gatherer.full():
                    yield from hold()
        elif isinstance(block, PathMode):
            exact_stop = block.control == "exact-stop"
            before = allowed
            allowed = (block.tolerance or tolerance) if block.control == "blend" else 0.0
            if allowed != before:
                yield from end_chain()
                limit_last(allowed)
        elif isinstance(block, Probe):
            yield from rest()
            yield block
            gatherer.file = block.file
            for records, feeds, lines, stops in _pieces(
                _probing(block), position, axes, classes, accuracy, True
            ):
                gatherer.add(records, feeds, lines, stops, 0.0)
            yield from rest()
            if block.answer.values is not None:
                position[:] = block.answer.values[1:]
        elif isinstance(block, Message):
            yield from close()
            held.append(block)
            if not isinstance(held[0], PathChunk):
                yield from held
                held.clear()
        else:
            yield from rest()
            yield block
    yield from rest()


def _probing(probe: Probe) -> Polyline:
    """The move of a probe."""
    return Polyline(
        probe.file,
        probe.line,
        probe.end[None],
        np.array([probe.feed]),
        np.array([probe.line], np.int32),
    )


def _pieces(
    block: Polyline | ArcFeed | NurbsFeed,
    position: Floats,
    axes: tuple[str, ...],
    classes: NDArray[np.int64],
    accuracy: float,
    exact_stop: bool,
) -> Iterator[tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_]]]:
    """Records of one block with feed, line and stop of each piece; ``position`` is moved along."""
    if isinstance(block, Polyline):
        here = position.copy()
        for moves, feeds, lines in _moves(block, position):
            yield line_records(here, moves, classes), feeds, lines, np.full(len(moves), exact_stop)
            here[:] = moves[-1]
        return
    if isinstance(block, ArcFeed):
        _check_finite(
            block,
            block.end,
            np.array([*block.center, block.radius, block.turns]),
            np.array(block.feed),
        )
        first_axis, second_axis = PLANE_AXES[block.plane]
        plane = axes.index(first_axis), axes.index(second_axis)
        end = np.array(block.end, np.float64)
        runs = arc_records(
            position.copy(), end, plane, block.center, block.turns, classes, accuracy
        )
    else:
        _check_finite(block, block.knots, block.control_points, block.weights, np.array(block.feed))
        points = _joined(block, position)
        runs = spline_records(block.degree, block.knots, points, block.weights, classes, accuracy)
    last: Records | None = None
    for records in runs:
        if last is not None:
            yield _spread(block, last, False)
        last = records
    if last is not None:
        position[:] = _end_of(last, len(axes))
        yield _spread(block, last, exact_stop)


def _moves(block: Polyline, position: Floats) -> Iterator[tuple[Floats, Floats, NDArray[np.int32]]]:
    """Ends, feeds and lines of the moves that have a length, MOST_PIECES at a time; ``position`` is
    moved along.
    """
    _check_polyline(block)
    for first in range(0, len(block.points), MOST_PIECES):
        part = slice(first, first + MOST_PIECES)
        points, feeds, lines = block.points[part], block.feeds[part], block.lines[part]
        keep = moving(position, points)
        if not keep.all():
            points, feeds, lines = points[keep], feeds[keep], lines[keep]
        if len(points):
            position[:] = points[-1]
            yield points, feeds.astype(np.float64), lines.astype(np.int32)


def _spread(
    block: ArcFeed | NurbsFeed, records: Records, stop: bool
) -> tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_]]:
    """The block's feed and line for each of its pieces, and a stop after the last if it has one."""
    count = len(records.at)
    stops = np.zeros(count, np.bool_)
    stops[-1] = stop
    return records, np.full(count, block.feed), np.full(count, block.line, np.int32), stops


def _end_of(records: Records, n: int) -> Floats:
    """End point (n,) of the last piece."""
    at = int(records.at[-1]) + START + n
    return records.data[at : at + n]


def _error(block: Block, code: str, message: str, hint: str, line: int | None = None) -> GcodeError:
    return GcodeError(
        Diagnostic(
            code, message, file=block.file, line=block.line if line is None else line, hint=hint
        )
    )


def _not_finite(block: Block, line: int) -> GcodeError:
    return _error(
        block,
        "not-finite",
        "a coordinate or feed of this move is not a finite number",
        "check the values it computes",
        line,
    )


def _check_finite(block: Block, *arrays: Floats) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        raise _not_finite(block, block.line)


def _check_polyline(block: Polyline) -> None:
    """Points are finite; feeds too, or NaN for a traverse."""
    if np.isfinite(block.points).all() and not np.isinf(block.feeds).any():
        return
    bad = ~np.isfinite(block.points).all(axis=1) | np.isinf(block.feeds)
    raise _not_finite(block, int(block.lines[int(np.argmax(bad))]))


def _joined(block: NurbsFeed, position: Floats) -> Floats:
    """The control points, the first of them on ``position``; an error if the curve doesn't start
    there or jumps inside.
    """
    points = np.array(block.control_points, np.float64)
    gap = float(np.abs(points[0] - position).max())
    if gap > JOIN:
        raise _error(
            block,
            "nurbs-start",
            f"the NURBS starts {gap:.6g} mm from where the motion is",
            "make the first control point the position before the block",
        )
    points[0] = position
    order = block.degree + 1
    inner = slice(1, len(block.knots) - 1)
    if len(block.knots) > 2 * order:
        values, firsts, counts = np.unique(
            block.knots[inner], return_index=True, return_counts=True
        )
        for value, first, count in zip(values, firsts + 1, counts, strict=True):
            # order equal knots: the curve ends at the control point before them and starts anew at
            # the last one that they leave over
            if count >= order and block.knots[0] < value < block.knots[-1]:
                jump = float(np.abs(points[first + count - order] - points[first - 1]).max())
                if jump > JOIN:
                    raise _error(
                        block,
                        "nurbs-not-continuous",
                        f"the NURBS jumps {jump:.6g} mm at knot {value:.6g}, which occurs {count} times",
                        f"a knot inside may occur {block.degree} times at most",
                    )
    return points
