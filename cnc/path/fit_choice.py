"""The faster of spline and corners, for parts of a chain with few moves and sharp turns.

Where moves are short, a spline goes round turns that are no corners of the chain. Whether it is
faster there than a motion that passes the turns one by one depends on the limits of the machine.
So the planner times both, from rest to rest. A corner between a spline and a move is a stop, too.
Elsewhere the spline is faster: in parts with many moves, with small turns alone, or with moves of
many tolerances beside each sharp turn.

With the spline alone, 100 polygons with legs of 3 to 24 tolerances take 1.057 times as long in the
median (limits along the path). Of 800 random walks the worst takes 2.98 times as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from cnc.kernels.path.fit_chain import KNOT, SLIGHT, Chain, Flags
from cnc.kernels.path.fit_pieces import Moves
from cnc.kernels.path.fit_spline import DEGREE
from cnc.kernels.path.fit_stretches import first_knots
from cnc.path.block_pieces import Frame
from cnc.path.chunk import PathChunk
from cnc.path.fit_window import fitted
from cnc.path.fit_writing import spline_pieces
from cnc.path.gatherer import Gatherer
from cnc.path.records import Floats

Duration = Callable[[PathChunk], float]
"""Returns the time of the motion along a path from rest to rest, s."""
MOST_MOVES = 12
"""Most moves of a part that is timed."""
SHARP = math.cos(math.radians(40.0))
"""Cosine of a turn that such a part has at least once, or a corner at an end."""
SHORT = 20.0
"""In tolerances. Beside that turn or corner a move is shorter than this."""
SHORT_ALONE = 100.0
"""In tolerances. So it is in a part with one turn."""
FASTER = 0.99
"""Corners are chosen where the motion takes less than this part of the time along the spline."""


class Part(NamedTuple):
    """A part of a chain between corners or ends, with the vertices that would be corners.

    Attributes:
        first: its first vertex.
        last: its last vertex.
        turning: (last - first + 1,): vertices inside that turn.
    """

    first: int
    last: int
    turning: Flags


class Choice:
    """Chooses between spline and corners.

    Args:
        frame: axes and accuracy.
        tolerance: largest distance from the moves, mm.
        duration: times a motion.
    """

    def __init__(self, frame: Frame, tolerance: float, duration: Duration) -> None:
        self._frame, self._tolerance, self._duration = frame, tolerance, duration

    def mark(
        self, x: Floats, moves: Moves, metrics: Flags, corner: Flags, whole: tuple[bool, bool]
    ) -> None:
        """Mark the vertices at which the motion is faster with corners.

        Args:
            x: (m, n): vertices, mm.
            moves: feed and line of the moves.
            metrics: (n,): whether an axis is a metric one.
            corner: (m,): the corners so far, to which these are added.
            whole: whether the chain begins at the first vertex, and ends at the last one.
        """
        slower: set[tuple[int, int, bytes]] = set()
        again = True
        while again:
            # What is faster in one part depends on the parts beside it.
            again = False
            for part in _parts(x[:, metrics], corner, self._tolerance):
                first, last = part.first, part.last
                if (first > 0 or whole[0]) and (last < len(x) - 1 or whole[1]):
                    # With the moves beside it, corners at its ends are passed as they will be.
                    low, high = _beside(corner, first, -1), _beside(corner, last, 1)
                    key = first, low, corner[low : high + 1].tobytes()
                    if key in slower:
                        # Nothing has changed beside it, and each timing takes long.
                        continue
                    if self._faster_broken(part, (low, high), x, moves, metrics, corner):
                        corner[first : last + 1] |= part.turning
                        again = True
                    else:
                        slower.add(key)

    def _faster_broken(
        self,
        part: Part,
        beside: tuple[int, int],
        x: Floats,
        moves: Moves,
        metrics: Flags,
        corner: Flags,
    ) -> bool:
        """Return whether the motion is faster if the vertices of a part are corners.

        ``beside``: the first and the last vertex of what is timed.
        """
        low, high = beside
        inside = slice(low, high + 1)
        some = Moves(moves.feed[low:high], moves.line[low:high])
        smooth = corner[inside].copy()
        smooth[0] = smooth[-1] = False
        broken = smooth.copy()
        broken[part.first - low : part.last + 1 - low] |= part.turning
        spline = self._time(x[inside], some, metrics, smooth)
        return self._time(x[inside], some, metrics, broken) < FASTER * spline

    def _time(self, x: Floats, moves: Moves, metrics: Flags, corner: Flags) -> float:
        """Return the time of the motion along the fitted path of a part, s."""
        chain = Chain(x, np.empty(len(x)), np.flatnonzero(metrics), metrics)
        knots = first_knots(chain, corner, self._tolerance, np.zeros(0, KNOT))
        free_ends = np.full((2, DEGREE, x.shape[1]), math.nan)
        spline = fitted(chain, knots, free_ends, self._tolerance)
        gatherer = Gatherer(self._frame.axes)
        for pieces in spline_pieces(
            chain,
            spline,
            moves,
            len(spline.knots) - 1,
            x[0].copy(),
            self._frame.accuracy,
            self._tolerance,
        ):
            gatherer.put(pieces, np.zeros(len(pieces.at), np.bool_))
        chunk = gatherer.take()
        chunk.stop_after[-1] = True
        chunk.tolerance[-1] = 0.0
        return self._duration(chunk)


def _beside(corner: Flags, edge: int, way: int) -> int:
    """Return the farthest corner or end within MOST_MOVES of a corner, or the vertex next to it.

    Args:
        corner: (m,): corners of the chain.
        edge: the corner, or the end of the chain.
        way: 1 or -1: direction along the chain.
    """
    last = len(corner) - 1 if way > 0 else 0
    if edge == last:
        return edge
    far = edge + way * min(MOST_MOVES, abs(last - edge))
    found = [k for k in range(far, edge, -way) if corner[k] or k == last]
    return found[0] if found else edge + way


def _parts(x: Floats, corner: Flags, tolerance: float) -> Iterator[Part]:
    """Yield the parts of a chain that are timed.

    Args:
        x: (m, metric axes): vertices, mm.
        corner: (m,): its corners.
        tolerance: mm.
    """
    is_end = corner.copy()
    is_end[0] = is_end[-1] = True
    ends = np.flatnonzero(is_end)
    few = np.flatnonzero((np.diff(ends) > 1) & (np.diff(ends) <= MOST_MOVES))
    for first, last in zip(ends[few].tolist(), ends[few + 1].tolist(), strict=True):
        step = np.diff(x[first : last + 1], axis=0)
        size = np.maximum(np.linalg.norm(step, axis=1), 1e-300)
        cosine = np.ones(last - first + 1)
        cosine[1:-1] = (step[1:] * step[:-1]).sum(axis=1) / (size[1:] * size[:-1])
        sharp = np.concatenate(([corner[first]], cosine[1:-1] < SHARP, [corner[last]]))
        beside = np.minimum(np.append(size, math.inf), np.append(math.inf, size))
        turning = cosine < SLIGHT
        short = SHORT_ALONE if last - first == 2 else SHORT
        if turning.any() and (beside[sharp] < short * tolerance).any():
            yield Part(first, last, turning)
