"""Paths of canonical blocks, as a stream.

Moving blocks become :class:`PathChunk`; the others pass through in their order.

    blocks  ──►  records of the pieces, gathered to about a chunk
            ──►  held until it is known whether the motion rests at their end  ──►  chunks, blocks

Commands that go with the motion (:mod:`cnc.model.motion_commands`) are kept with their piece.
Motion rests at the end of the stream, before every other block without motion (but a message),
under exact stop (G61.1) at the end of every block and every straight move, and at both ends of a
probing move. Under G64 each joint of two pieces has the tolerance in effect, or the smaller one
where it changes there. PathMode ends here: no layer below needs it.

Where a spline or corners may be faster, both are offered (:class:`cnc.path.fit.Alternatives`), and
the consumer answers before it asks for more. A probe passes through, then its move. No block behind
it is read before the consumer asks for more. By then the board has answered, and the path goes on
from the point of contact.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import (
    ArcFeed,
    Block,
    BoardCommand,
    Message,
    NurbsFeed,
    PathMode,
    Polyline,
    Probe,
    TipControl,
)
from cnc.model.motion_commands import apart, goes_with_motion, rests
from cnc.path.block_pieces import (
    Frame,
    Gatherer,
    Move,
    few_moves,
    moves_of,
    pieces_of,
    records_of_arc,
)
from cnc.path.chunk import PathChunk
from cnc.path.fit import LEAST_TOLERANCE, Alternatives, Fitted, Fitter
from cnc.path.fit_curves import arc_of, nurbs_chords
from cnc.path.records import Floats, axis_classes, line_record, moving

# Times that the blocks of a path are to take under inverse time feed (G93).
#
# They are taken from the blocks as they are programmed, before a fit or a blend changes the path.

Place = tuple[str, int]
"""File and line of a block."""


class DueTimes:
    """The blocks under G93 that are not taken yet, in the order of their motion."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[Place, float]] = deque()

    def clear(self) -> None:
        """Forget all blocks."""
        self._blocks.clear()

    def add(self, file: str, lines: NDArray[np.int32], seconds: Floats) -> None:
        """Add moves: the source line and the time of each (m,), s; NaN for a traverse."""
        for line, duration in zip(lines.tolist(), seconds.tolist(), strict=True):
            self._blocks.append(((file, line), duration))

    def before(self, place: Place | None) -> float:
        """Take the moves before the next one of a place, and return the sum of their times, s.

        Args:
            place: None takes all moves.
        """
        return self._taken(lambda at: at != place)

    def at(self, place: Place) -> float:
        """Take the next moves while they are of a place, and return the sum of their times, s."""
        return self._taken(lambda at: at == place)

    def _taken(self, wanted: Callable[[Place], bool]) -> float:
        total, blocks = 0.0, self._blocks
        while blocks and wanted(blocks[0][0]):
            total += blocks.popleft()[1]
        return total


ENOUGH = 64
"""Under G64 a chunk is closed with the block when it has this many pieces: they may stand for
thousands of moves.
"""


def build(
    blocks: Iterable[Block],
    *,
    axes: tuple[str, ...],
    start: Floats,
    accuracy: float = 1e-12,
    tolerance: float = 0.0,
    due_times: DueTimes | None = None,
    short_legs: int | None = None,
    offers_corners: bool = False,
) -> Iterator[PathChunk | Block]:
    """Yield the path of ``blocks`` in chunks, and the blocks without motion, in order.

    Args:
        blocks: canonical blocks.
        axes: names of the axes, one for each column.
        start: (n,): position before the first block, mm.
        accuracy: largest error of arc length and its inverse, mm.
        tolerance: that of G64 without P, mm.
        due_times: receives the times of the blocks under G93; None for no record.
        short_legs: polygons under a tolerance stay straight, with up to so many vertices with short
            legs in a row (:class:`cnc.planner.joints.Joints`); None where they become splines.
        offers_corners: whether corners are offered where they may be faster than a spline. The
            consumer answers :class:`cnc.path.fit.Alternatives` before it asks for more.

    Raises:
        GcodeError: ``not-finite``, ``nurbs-not-continuous`` or ``nurbs-start`` at the block's line.
    """
    builder = _Builder(axes, start, accuracy, tolerance, due_times, short_legs, offers_corners)
    for block in blocks:
        yield from builder.add(block)
    yield from builder.rest()


# The path of a program for a board with a planner of its own.
#
# Such a board rounds corners by itself (GRBL by its junction deviation $11). So the path is exact,
# also under G64: the tolerance is left to the lines and arcs that replace it. Exact stop (G61.1)
# stays: the motion rests at the end of each move.


def exact_path(
    blocks: Iterable[Block],
    *,
    axes: tuple[str, ...],
    start: Floats,
) -> Iterator[PathChunk | Block]:
    """Yield the path of ``blocks`` without blends, see :func:`build`.

    Args:
        blocks: The program.
        axes: Letters of the machine's axes.
        start: Start position (axes,), mm.
    """
    return build(without_blends(blocks), axes=axes, start=start)


def without_blends(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks, with the exact path in place of the tolerance of G64."""
    for block in blocks:
        if isinstance(block, PathMode) and block.control == "blend":
            yield replace(block, control="exact-path", tolerance=0.0)
        else:
            yield block


class _Builder:
    """Builds a path block by block; see :func:`build`."""

    def __init__(
        self,
        axes: tuple[str, ...],
        start: Floats,
        accuracy: float,
        tolerance: float,
        due_times: DueTimes | None,
        short_legs: int | None,
        offers_corners: bool,
    ) -> None:
        self._short_legs, self._offers_corners = short_legs, offers_corners
        self._frame = Frame(axes, axis_classes(axes), accuracy)
        self._classes = bool(self._frame.classes.any())
        self._tolerance, self._due_times = tolerance, due_times
        self._position = np.array(start, np.float64)
        self._gatherer = Gatherer(axes)
        self._fitter: Fitter | None = None
        self._curved = False
        self._exact_stop = False
        self._allowed = 0.0
        # A chunk and the messages behind it, until it is known whether the motion goes on.
        self._held: list[PathChunk | Block] = []

    def add(self, block: Block) -> Iterator[PathChunk | Block]:
        """Add a block, and yield the chunks and blocks that are final."""
        if isinstance(block, Polyline | ArcFeed | NurbsFeed):
            if block.file != self._gatherer.file or block.timed != self._gatherer.timed:
                yield from self._close()
                self._gatherer.file, self._gatherer.timed = block.file, block.timed
            fits = self._allowed >= LEAST_TOLERANCE
            if (
                isinstance(block, Polyline)
                and block.commands is not None
                and (
                    fits or rests(block.commands) or not moving(self._position, block.points).all()
                )
            ):
                # A command rests the motion or ends a chain, or waits for a move with a length.
                for part in apart((block,)):
                    yield from self.add(part)
                return
            if block.timed:
                self._record_times(block)
            fitted = self._fitted(block) if fits else None
            if fitted is not None:
                yield from self._gather(fitted)
                if self._gatherer.pieces >= ENOUGH:
                    yield from self._hold()
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
            if isinstance(block, TipControl):
                self._position[:] = block.position
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

    def _fitted(self, block: Polyline | ArcFeed | NurbsFeed) -> Iterator[Fitted] | None:
        """Return the pieces of a block under G64 that are final; None if it is to be exact."""
        here, frame = self._position, self._frame
        if self._fitter is None:
            self._fitter = Fitter(
                frame,
                self._allowed,
                here,
                curved=self._curved,
                short_legs=self._short_legs,
                offers_corners=self._offers_corners,
            )
        fitter = self._fitter
        match block:
            case Polyline():
                few = self._few_moves(block, traverses=False)
                return self._fitted_moves(block, fitter) if few is None else fitter.add_few(few)
            case ArcFeed():
                arc = arc_of(block, here, frame)
                if arc is None:
                    return None
                here[:] = arc.end
                return fitter.add_arc(arc)
            case NurbsFeed():
                runs = nurbs_chords(block, here, frame, self._allowed)
                if runs is None:
                    return None
                return self._fitted_chords(block, runs, fitter)

    def _few_moves(self, block: Polyline, *, traverses: bool) -> list[Move] | None:
        """Return the moves of a short row, see few_moves; the same axes measure all of them."""
        return None if self._classes else few_moves(block, self._position, traverses=traverses)

    def _fitted_moves(self, block: Polyline, fitter: Fitter) -> Iterator[Fitted]:
        """Yield the final pieces when straight moves are added."""
        for points, feeds, lines, _ in moves_of(block, self._position):
            yield from fitter.add(points, feeds, lines)

    def _fitted_chords(
        self, block: NurbsFeed, runs: Iterator[Floats], fitter: Fitter
    ) -> Iterator[Fitted]:
        """Yield the final pieces when the chords of a curve are added."""
        for run in runs:
            points = run[moving(self._position, run)]
            if len(points):
                self._position[:] = points[-1]
                feeds = np.full(len(points), block.feed)
                lines = np.full(len(points), block.line, np.int32)
                yield from fitter.add(points, feeds, lines, curved=True)

    def _record_times(self, block: Polyline | ArcFeed | NurbsFeed) -> None:
        """Record the times that the moves of a block are to take."""
        if self._due_times is None:
            return
        for records, feeds, lines, _, _ in pieces_of(
            block, self._position.copy(), self._frame, exact_stop=False
        ):
            self._due_times.add(block.file, lines, records.length / feeds)

    def _set_mode(self, block: PathMode) -> Iterator[PathChunk | Block]:
        """Take over a path mode. A new tolerance ends the chain."""
        self._exact_stop = block.control == "exact-stop"
        before = self._allowed
        blends = block.control == "blend"
        self._allowed = (block.tolerance or self._tolerance) if blends else 0.0
        if self._allowed != before:
            yield from self._end_chain()
            self._limit_last_joint(self._allowed)

    def _probe(self, block: Probe) -> Iterator[PathChunk | Block]:
        """Yield a probe and its move; the path goes on from the point of contact."""
        yield from self.rest()
        yield block
        self._gatherer.file, self._gatherer.timed = block.file, False
        for records, feeds, lines, stops, _ in pieces_of(
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
        if isinstance(block, ArcFeed):
            yield from self._gather_arc(block, exact_stop, allowed)
            return
        if isinstance(block, Polyline):
            start = self._position.tolist()
            few = self._few_moves(block, traverses=True)
            if few is not None:
                yield from self._gather_few(start, few, exact_stop, allowed)
                return
        for records, feeds, lines, stops, commands in pieces_of(
            block, self._position, self._frame, exact_stop=exact_stop
        ):
            self._gatherer.add(records, feeds, lines, stops, allowed, commands)
            if self._gatherer.full():
                yield from self._hold()

    def _gather_few(
        self, start: list[float], moves: list[Move], exact_stop: bool, allowed: float
    ) -> Iterator[PathChunk | Block]:
        """Gather straight moves, each of some length, that begin at ``start`` (n,)."""
        for end, feed, line in moves:
            record = line_record(start, end, self._frame.classes)
            self._gatherer.add_single(record, feed, line, allowed, stop=exact_stop)
            start = end
        if self._gatherer.full():
            yield from self._hold()

    def _gather_arc(
        self, arc: ArcFeed, exact_stop: bool, allowed: float
    ) -> Iterator[PathChunk | Block]:
        """Gather the turns of an arc."""
        turns = list(records_of_arc(arc, self._position, self._frame))
        for number, records in enumerate(turns, 1):
            stop = exact_stop and number == len(turns)
            self._gatherer.add_single(records, arc.feed, arc.line, allowed, stop=stop)
            if self._gatherer.full():
                yield from self._hold()
        if turns:
            self._position[:] = arc.end

    def _gather(self, fitted: Iterable[Fitted]) -> Iterator[PathChunk | Block]:
        """Gather fitted pieces."""
        for pieces in fitted:
            if isinstance(pieces, Alternatives):
                yield pieces
                continue
            self._limit_last_joint(pieces.before)
            self._gatherer.put(pieces, np.zeros(len(pieces.at), np.bool_))
            if self._gatherer.full():
                yield from self._hold()

    def _end_chain(self) -> Iterator[PathChunk | Block]:
        """End the chain of moves that are fitted together."""
        if self._fitter is not None:
            yield from self._gather(self._fitter.flush())
            self._curved = self._fitter.curved
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

    def _limit_last_joint(self, most: float) -> None:
        """Reduce the tolerance of the joint behind the last piece to ``most`` mm."""
        if self._gatherer.pieces:
            self._gatherer.limit_last_joint(most)
        elif self._held and isinstance(self._held[0], PathChunk):
            last = self._held[0].tolerance
            last[-1] = min(last[-1], most)


def _probing(probe: Probe) -> Polyline:
    """Return the move of a probe."""
    return Polyline(
        probe.file,
        probe.line,
        probe.end[None],
        np.array([probe.feed]),
        np.array([probe.line], np.int32),
    )
