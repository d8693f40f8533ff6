"""Paths of canonical blocks, as a stream.

Moving blocks become :class:`PathChunk`; the others pass through in their order.

    blocks  ──►  records of the pieces, gathered to about a chunk
            ──►  held until it is known whether the motion rests at their end  ──►  chunks, blocks

Commands that go with the motion (:mod:`cnc.model.motion_commands`) are kept with their piece.
Motion rests at the end of the stream, before every other block without motion (but a message),
under exact stop (G61.1) at the end of every block and every straight move, and at both ends of a
probing move. Under G64 each joint of two pieces has the tolerance in effect, or the smaller one
where it changes there. PathMode ends here: no layer below needs it.

A probe passes through, then its move. No block behind it is read before the consumer asks for more.
By then the board has answered, and the path goes on from the point of contact.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import START
from cnc.model.blocks import (
    PLANE_AXES,
    ArcFeed,
    Block,
    BoardCommand,
    Message,
    NurbsFeed,
    PathMode,
    Polyline,
    Probe,
)
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import (
    Commands,
    apart,
    command_array,
    goes_with_motion,
    places_of,
)
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
"""A chunk is closed when its records are this many, or have this many numbers."""
ENOUGH = 64
"""Under G64 a chunk is closed with the block when it has this many pieces: they may stand for
thousands of moves.
"""
JOIN = 1e-6
"""mm. A NURBS whose first control point is this near to the position is moved there. A larger
distance is an error.
"""


@dataclass(frozen=True, slots=True)
class _Frame:
    """Axes of the path: their names, their classes (n,), and the accuracy of arc lengths (mm)."""

    axes: tuple[str, ...]
    classes: NDArray[np.int64]
    accuracy: float


class _Gatherer:
    """Gathers records into chunks."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.file = ""
        self.waiting: list[Block] = []
        """Commands that take effect at the start of the next piece."""
        self.clear()

    def clear(self) -> None:
        self.parts: list[Pieces] = []
        self.stops: list[NDArray[np.bool_]] = []
        self.pieces = 0
        self.numbers = 0
        self.commands: dict[int, tuple[Block, ...]] = {}

    def add(
        self,
        records: Records,
        feeds: Floats,
        lines: NDArray[np.int32],
        stops: NDArray[np.bool_],
        tolerance: float,
        commands: Commands | None = None,
    ) -> None:
        for place in places_of(commands):
            assert commands is not None
            self.commands[self.pieces + place] = commands[place]
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
        if self.waiting and len(pieces.at):
            self.commands[self.pieces] = (*self.waiting, *self.commands.get(self.pieces, ()))
            self.waiting.clear()
        self.parts.append(pieces)
        self.stops.append(stops)
        self.pieces += len(pieces.at)
        self.numbers += len(pieces.data)

    def full(self) -> bool:
        return self.pieces >= MOST_PIECES or self.numbers >= MOST_NUMBERS

    def take(self) -> PathChunk:
        """Return everything gathered as one chunk, and empty the gatherer."""
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
            commands=command_array(self.pieces, self.commands),
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
    """Yield the path of ``blocks`` in chunks, and the blocks without motion, in order.

    Args:
        blocks: canonical blocks.
        axes: names of the axes, one for each column.
        start: (n,): position before the first block, mm.
        accuracy: largest error of arc length and its inverse, mm.
        tolerance: that of G64 without P, mm.

    Raises:
        GcodeError: ``not-finite``, ``nurbs-not-continuous`` or ``nurbs-start`` at the block's line.
    """
    builder = _Builder(axes, start, accuracy, tolerance)
    for block in blocks:
        yield from builder.add(block)
    yield from builder.rest()


class _Builder:
    """Builds a path block by block; see :func:`build`."""

    def __init__(
        self, axes: tuple[str, ...], start: Floats, accuracy: float, tolerance: float
    ) -> None:
        self._frame = _Frame(axes, axis_classes(axes), accuracy)
        self._tolerance = tolerance
        self._position = np.array(start, np.float64)
        self._gatherer = _Gatherer(axes)
        self._fitter: Fitter | None = None
        self._exact_stop = False
        self._allowed = 0.0
        # A chunk and the messages behind it, until it is known whether the motion goes on.
        self._held: list[PathChunk | Block] = []

    def add(self, block: Block) -> Iterator[PathChunk | Block]:
        """Add a block, and yield the chunks and blocks that are final."""
        if isinstance(block, Polyline | ArcFeed | NurbsFeed):
            if block.file != self._gatherer.file:
                yield from self._close()
                self._gatherer.file = block.file
            fits = isinstance(block, Polyline) and self._allowed >= LEAST_TOLERANCE
            if (
                isinstance(block, Polyline)
                and block.commands is not None
                and (fits or not moving(self._position, block.points).all())
            ):
                # A command ends a chain, and goes to the next move that has a length.
                for part in apart((block,)):
                    yield from self.add(part)
                return
            if isinstance(block, Polyline) and fits:
                yield from self._fit(block)
            else:
                yield from self._end_chain()
                yield from self._gather_block(block, self._exact_stop, self._allowed)
        elif goes_with_motion(block) and self._moves:
            yield from self._end_chain()
            self._gatherer.waiting.append(block)
        elif isinstance(block, PathMode):
            yield from self._set_mode(block)
        elif isinstance(block, Probe):
            yield from self._probe(block)
        elif isinstance(block, Message):
            yield from self._close()
            self._held.append(block)
            if not isinstance(self._held[0], PathChunk):
                yield from self._release()
        else:
            yield from self.rest()
            yield block
            if isinstance(block, BoardCommand) and block.answer.values is not None:
                self._position[:] = block.answer.values

    def rest(self) -> Iterator[PathChunk | Block]:
        """Yield everything: motion rests here."""
        yield from self._close()
        if self._held and isinstance(self._held[0], PathChunk):
            self._held[0].stop_after[-1] = True
            self._held[0].tolerance[-1] = 0.0
        yield from self._release()
        yield from self._gatherer.waiting
        self._gatherer.waiting.clear()

    @property
    def _moves(self) -> bool:
        """Whether the motion may go on from the pieces so far."""
        return (
            bool(self._gatherer.pieces or self._gatherer.waiting)
            or self._fitter is not None
            or (bool(self._held) and isinstance(self._held[0], PathChunk))
        )

    def _fit(self, block: Polyline) -> Iterator[PathChunk | Block]:
        """Fit straight moves under G64."""
        if self._fitter is None:
            classes, accuracy = self._frame.classes, self._frame.accuracy
            self._fitter = Fitter(classes, self._allowed, accuracy, self._position)
        for points, feeds, lines, _ in _moves(block, self._position):
            yield from self._gather(self._fitter.add(points, feeds, lines))
        if self._gatherer.pieces >= ENOUGH:
            yield from self._hold()

    def _set_mode(self, block: PathMode) -> Iterator[PathChunk | Block]:
        """Take over a path mode. A new tolerance ends the chain."""
        self._exact_stop = block.control == "exact-stop"
        before = self._allowed
        blends = block.control == "blend"
        self._allowed = (block.tolerance or self._tolerance) if blends else 0.0
        if self._allowed != before:
            yield from self._end_chain()
            self._limit_last_joint()

    def _probe(self, block: Probe) -> Iterator[PathChunk | Block]:
        """Yield a probe and its move; the path goes on from the point of contact."""
        yield from self.rest()
        yield block
        self._gatherer.file = block.file
        for records, feeds, lines, stops, _ in _pieces(
            _probing(block), self._position, self._frame, exact_stop=True
        ):
            self._gatherer.add(records, feeds, lines, stops, 0.0)
        yield from self.rest()
        if block.answer.values is not None:
            self._position[:] = block.answer.values[1:]

    def _gather_block(
        self, block: Polyline | ArcFeed | NurbsFeed, exact_stop: bool, allowed: float
    ) -> Iterator[PathChunk | Block]:
        """Gather the pieces of a block that is not fitted."""
        for records, feeds, lines, stops, commands in _pieces(
            block, self._position, self._frame, exact_stop=exact_stop
        ):
            self._gatherer.add(records, feeds, lines, stops, allowed, commands)
            if self._gatherer.full():
                yield from self._hold()

    def _gather(self, fitted: Iterable[Pieces]) -> Iterator[PathChunk | Block]:
        """Gather fitted pieces."""
        for pieces in fitted:
            self._gatherer.put(pieces, np.zeros(len(pieces.at), np.bool_))
            if self._gatherer.full():
                yield from self._hold()

    def _end_chain(self) -> Iterator[PathChunk | Block]:
        """End the chain of moves that are fitted together."""
        if self._fitter is not None:
            yield from self._gather(self._fitter.flush())
            self._fitter = None

    def _close(self) -> Iterator[PathChunk | Block]:
        """End the chain and hold all pieces."""
        yield from self._end_chain()
        yield from self._hold()

    def _hold(self) -> Iterator[PathChunk | Block]:
        """Hold the gathered pieces as a chunk. Motion follows the earlier chunk, so it is final."""
        if self._gatherer.pieces:
            chunk = self._gatherer.take()
            yield from self._release()
            self._held = [chunk]

    def _release(self) -> Iterator[PathChunk | Block]:
        """Yield everything that is held."""
        yield from self._held
        self._held = []

    def _limit_last_joint(self) -> None:
        """Reduce the tolerance of the joint behind the last piece to the one in effect."""
        if self._gatherer.pieces:
            last = self._gatherer.parts[-1].tolerance
        elif self._held and isinstance(self._held[0], PathChunk):
            last = self._held[0].tolerance
        else:
            return
        last[-1] = min(last[-1], self._allowed)


def _probing(probe: Probe) -> Polyline:
    """Return the move of a probe."""
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
    frame: _Frame,
    *,
    exact_stop: bool,
) -> Iterator[tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_], Commands | None]]:
    """Yield records of one block, with feed, line and stop of each piece, and the commands.

    ``position`` (n,) is moved along. exact_stop: motion rests at the end of the block.
    """
    axes, classes, accuracy = frame.axes, frame.classes, frame.accuracy
    if isinstance(block, Polyline):
        here = position.copy()
        for moves, feeds, lines, commands in _moves(block, position):
            stops = np.full(len(moves), exact_stop)
            yield line_records(here, moves, classes), feeds, lines, stops, commands
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
            yield *_spread(block, last, False), None
        last = records
    if last is not None:
        position[:] = _end_of(last, len(axes))
        yield *_spread(block, last, exact_stop), None


def _moves(
    block: Polyline, position: Floats
) -> Iterator[tuple[Floats, Floats, NDArray[np.int32], Commands | None]]:
    """Yield ends, feeds, lines and commands of the moves with a length, MOST_PIECES at a time.

    ``position`` (n,) is moved along. With commands, all moves must have a length.
    """
    _check_polyline(block)
    for first in range(0, len(block.points), MOST_PIECES):
        part = slice(first, first + MOST_PIECES)
        points, feeds, lines = block.points[part], block.feeds[part], block.lines[part]
        keep = moving(position, points)
        commands = None if block.commands is None else block.commands[part]
        if not keep.all():
            points, feeds, lines = points[keep], feeds[keep], lines[keep]
        if len(points):
            position[:] = points[-1]
            yield points, feeds.astype(np.float64), lines.astype(np.int32), commands


def _spread(
    block: ArcFeed | NurbsFeed, records: Records, stop: bool
) -> tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_]]:
    """Return records with the feed, line and stop of each piece; a stop comes after the last."""
    count = len(records.at)
    stops = np.zeros(count, np.bool_)
    stops[-1] = stop
    return records, np.full(count, block.feed), np.full(count, block.line, np.int32), stops


def _end_of(records: Records, n: int) -> Floats:
    """Return the end point (n,) of the last piece."""
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
        "check the values that the block computes",
        line,
    )


def _check_finite(block: Block, *arrays: Floats) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        raise _not_finite(block, block.line)


def _check_polyline(block: Polyline) -> None:
    """Check that points are finite, and feeds finite or NaN (a traverse)."""
    if np.isfinite(block.points).all() and not np.isinf(block.feeds).any():
        return
    bad = ~np.isfinite(block.points).all(axis=1) | np.isinf(block.feeds)
    raise _not_finite(block, int(block.lines[int(np.argmax(bad))]))


def _joined(block: NurbsFeed, position: Floats) -> Floats:
    """Return the control points, with the first one on ``position``.

    Raises:
        GcodeError: if the curve does not start there, or is not continuous.
    """
    points = np.array(block.control_points, np.float64)
    gap = float(np.abs(points[0] - position).max())
    if gap > JOIN:
        raise _error(
            block,
            "nurbs-start",
            f"the NURBS starts {gap:.6g} mm from the current position",
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
            # As many equal knots as the order: the curve ends at the control point before them, and
            # begins anew at the last one that they leave over.
            if count >= order and block.knots[0] < value < block.knots[-1]:
                jump = float(np.abs(points[first + count - order] - points[first - 1]).max())
                if jump > JOIN:
                    raise _error(
                        block,
                        "nurbs-not-continuous",
                        f"the NURBS jumps {jump:.6g} mm at knot {value:.6g}, "
                        f"which occurs {count} times",
                        f"give an inner knot at most {block.degree} times",
                    )
    return points
