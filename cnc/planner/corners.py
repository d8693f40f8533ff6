"""Blends at corners under a tolerance.

:class:`CornerBlending` works on the path before the window. It chooses the treatment of each corner
and inserts blends (:mod:`cnc.planner.kernels.corners`). Motions past stops are made behind the
window (:mod:`cnc.planner.corner_motions`).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block, Message
from cnc.model.motion_commands import carried_over
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import Pieces
from cnc.planner.kernels.arrays import PathArrays
from cnc.planner.kernels.corner_bends import no_kept_blends
from cnc.planner.kernels.corners import MOST_PIECES, round_corners
from cnc.planner.kernels.legs import record_end
from cnc.planner.limits import Limits

Together = Callable[[PathChunk, bool], NDArray[np.bool_]]

BLENDS_SIZE = 1 << 16
"""Size of the space for the records of blends, in numbers, at first."""


class _Memory(threading.local):
    """The last blends of a thread. They depend on nothing but what the search is given."""

    def __init__(self) -> None:
        self.kept = no_kept_blends()


_memory = _Memory()


class CornerBlending:
    """Inserts blends into the corners of a path.

    A tolerance that stays marks a corner at which the motion shall pass the stop.

    Args:
        limits: of the columns of the path.
        ramps: whether the motion may pass stops.
        where: whether the path has blends at all, asked for each chunk.
        together: returns for each piece of a chunk whether the corner behind it is to be passed
            with those beside it. Its second argument: whether the motion rests at the start of the
            chunk. None: at no corner.
    """

    def __init__(
        self,
        limits: Limits,
        *,
        ramps: bool = True,
        where: Callable[[], bool] = lambda: True,
        together: Together | None = None,
    ) -> None:
        self._limits, self._ramps, self._where, self._together = limits, ramps, where, together
        self._taken = 0.0
        """Length that the last blend takes off the next chunk, mm."""
        self._rests = True
        """Whether the motion rests at the start of the next chunk."""

    def blended(self, stream: Iterable[PathChunk | Block]) -> Iterator[PathChunk | Block]:
        """Yield the stream with blends in its path.

        While the motion goes on this is one chunk behind: a blend may reach into the next chunk.
        """
        held: PathChunk | None = None
        for item in stream:
            if not isinstance(item, PathChunk):
                if held is not None and not isinstance(item, Message):
                    yield self._with_blends(held, None)
                    held = None
                yield item
                continue
            if held is not None:
                yield self._with_blends(held, item)
            held = item
            if item.stop_after[-1]:
                yield self._with_blends(item, None)
                held = None
        if held is not None:
            yield self._with_blends(held, None)

    def _with_blends(self, path: PathChunk, following: PathChunk | None) -> PathChunk:
        """Return the chunk with its corners decided; ``following`` continues the motion."""
        taken, self._taken = self._taken, 0.0
        rests, self._rests = self._rests, bool(path.stop_after[-1])
        if not (self._where() and (taken or path.tolerance.any())):
            return path
        limits, own = self._limits, len(path)
        arrays, bound = numbered(path), limits.feeds(path)
        together = self._together(path, rests) if self._together else np.zeros(own, np.bool_)
        if following is not None:
            arrays = _with_first_piece(arrays, following)
            bound = np.append(bound, limits.feeds(following)[:1])
        size = len(arrays.pieces.data) + BLENDS_SIZE
        while True:
            out = empty_path(MOST_PIECES * own, size)
            count, numbers, self._taken = round_corners(
                own,
                arrays,
                bound,
                taken,
                limits.arrays,
                self._ramps,
                rests,
                together,
                _memory.kept,
                out,
            )
            if count >= 0:
                break
            size *= 2
        return new_chunk(path, out, count, numbers)


def path_arrays(path: PathChunk) -> PathArrays:
    """Return a chunk of path as kernels take it."""
    return PathArrays(
        Pieces(path.kind, path.at, path.data),
        path.length,
        path.feed,
        path.line,
        path.stop_after,
        path.tolerance,
    )


def numbered(path: PathChunk) -> PathArrays:
    """Return a chunk as kernels take it, with the number of each piece in place of its line.

    Kernels copy the line to the pieces that they make of a piece.
    """
    return path_arrays(path)._replace(line=np.arange(len(path), dtype=np.int32))


def _with_first_piece(path: PathArrays, following: PathChunk) -> PathArrays:
    """Return ``path`` and the first piece of ``following``.

    Of that piece kernels read the curve, its length, its feed and whether it ends with a stop.
    """
    start, data = int(following.at[0]), path.pieces.data
    end = record_end(Pieces(following.kind, following.at, following.data), 0)
    return path._replace(
        pieces=Pieces(
            np.append(path.pieces.kind, following.kind[:1]),
            np.append(path.pieces.at, len(data)),
            np.append(data, following.data[start:end]),
        ),
        length=np.append(path.length, following.length[:1]),
        feed=np.append(path.feed, following.feed[:1]),
        stop_after=np.append(path.stop_after, following.stop_after[:1]),
    )


def empty_path(pieces: int, size: int) -> PathArrays:
    """Return space for so many pieces, and for records of so many numbers."""
    return PathArrays(
        Pieces(np.empty(pieces, np.int64), np.empty(pieces, np.int64), np.empty(size)),
        np.empty(pieces),
        np.empty(pieces),
        np.empty(pieces, np.int32),
        np.empty(pieces, np.bool_),
        np.empty(pieces),
    )


def new_chunk(like: PathChunk, path: PathArrays, count: int, numbers: int) -> PathChunk:
    """Return the first ``count`` pieces of ``path``, with records of ``numbers`` numbers.

    They were made of the :func:`numbered` pieces of ``like``.
    """
    origin = path.line[:count]
    commands = None
    if like.commands is not None:
        commands, behind = carried_over(like.commands, origin)
        if behind:
            # The last pieces have become part of a corner before them.
            commands = np.full(count, None, np.object_) if commands is None else commands
            commands[-1] = (*(commands[-1] or ()), *behind)
    return PathChunk(
        like.axes,
        like.file,
        path.pieces.kind[:count],
        path.pieces.at[:count],
        path.pieces.data[:numbers].copy(),
        path.length[:count],
        path.feed[:count],
        like.line[origin],
        path.stop_after[:count],
        path.tolerance[:count],
        commands,
        like.timed,
    )
