"""Smooth splines within the tolerance for chains of moves under G64.

    moves ──► chains: feed moves that the same axes measure ──► windows ──► corners, where faster
          ──► the smoothest spline, proved to be within the tolerance ──► records

Arcs and NURBS are members too, as chords (:mod:`cnc.path.fit_curves`). An arc waits until it is
known what follows. At a corner, at the end of a chain and in the middle of a long arc it is exact.

A chain is fitted in windows of some thousand moves. The last spans of a window may still change
with later moves; they are fitted again in the next window. It begins with position, slope and
second derivative at the end of the spans that were issued. So the spline is C2 throughout.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import field
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Answer, Block, canonical
from cnc.path.block_pieces import Frame, Gatherer, Move, Pieces
from cnc.path.chunk import PathChunk
from cnc.path.fit_curves import LEFT, SPARE, Arc, chord_ends
from cnc.path.kernels.fit_pieces import Moves, Written, joint_tolerances, new_writer, write_pieces
from cnc.path.kernels.fit_program import improve
from cnc.path.kernels.fit_proof import far_off, prove
from cnc.path.kernels.fit_spline import (
    DEGREE,
    KNOT,
    LEAST,
    ORDER,
    SHARPEST,
    SLIGHT,
    Chain,
    Flags,
    Knots,
    Spline,
    find_corners,
    find_polygons,
    new_spline,
    transfer,
)
from cnc.path.kernels.fit_squares import (
    NEAR,
    cut_spans,
    least_squares,
    near_spans,
    with_cuts,
    with_knots,
)
from cnc.path.kernels.fit_stretches import first_knots
from cnc.path.records import Floats, Ints, line_records, move_classes

# The spline of a window of a chain: knots, control points, and the proof of the tolerance.
#
#     corners, straight stretches, first knots       kernels/fit_spline, kernels/fit_stretches
#       ──► least squares; spans that miss a vertex are cut at one         kernels/fit_squares
#       ──► the smoothest spline inside the tube about the chain           kernels/fit_program
#       ──► proof; the spline near a span that fails is made anew            kernels/fit_proof
#
# A span that is refused for the first time, and is little off, gets more places where its distance
# is limited. Others are cut, at a vertex if there is one inside, else in the middle. A knot inside
# a move makes the spline less smooth there. A span too short to be cut is left to the polyline.
# There, and at corners, the spline is broken.

ALLOWED = 0.999
"""Part of the tolerance that is proved."""
MOVES_AT_END = 4
"""Most moves of a span at an end whose derivatives are given,"""
SPANS_AT_END = 6
"""and the number of such spans."""
CUT = 1.05
"""In tolerances. A span that is refused is cut if it is farther off; else places are added."""
ROUNDS = 16
"""Rounds after which spans that still fail are left to the polyline."""
NONE = np.empty((0, ORDER, ORDER))
"""No extractions."""


def fitted(chain: Chain, knots: Knots, states: Floats, tolerance: float) -> Spline:
    """Return the spline of a window, all of it within the tolerance.

    Args:
        chain: the chain.
        knots: its first knots.
        states: (2, 5, n): position and derivatives 1 to 4 by t at start and end, or NaN.
        tolerance: mm.
    """
    feet = chain.along.copy()
    speck = np.diff(knots["t"]) <= 0.0
    knots["polyline"][:-1] |= speck
    knots["ends"][:-1] |= speck
    spline = new_spline(chain, knots, states, np.empty(0), np.empty(0, np.int64), NONE)
    spline = with_knots(chain, spline, ~spline.fixed, states, tolerance)
    free = ~spline.fixed
    turn = 0
    while True:
        improve(chain, spline, free, tolerance)
        changed = _touched(spline, free) | _determined(spline)
        wrong = prove(chain, spline, feet, changed, ALLOWED * tolerance)
        if not wrong.any():
            return spline
        turn += 1
        short = wrong & (np.diff(spline.knots["t"]) < 2.0 * LEAST * tolerance)
        left = wrong if turn > ROUNDS else short
        # A span without a free control point would not change.
        again = ~spline.knots["refused"][:-1] & _touched(spline, ~spline.fixed)
        cut = wrong & ~again | far_off(chain, spline, wrong, CUT * tolerance)
        spline.knots["refused"][:-1] |= wrong
        if left.any():
            spline, free = _broken(chain, spline, left, wrong, states, tolerance)
        elif cut.any():
            spline, free = cut_spans(chain, spline, cut, wrong, states)
            least_squares(chain, spline, ~free)
        else:
            free = near_spans(spline, np.flatnonzero(wrong), NEAR)


def with_short_ends(chain: Chain, knots: Knots, ends: Flags) -> Knots:
    """Return knots with short spans at the ends where derivatives are given (2,).

    These determine five control points, so as many spans must be there beside others.
    """
    while ends.any():
        moves = np.diff(knots["vertex"])
        wide = (moves > MOVES_AT_END) & ~knots["straight"][:-1]
        near = np.zeros(len(moves), np.bool_)
        near[:SPANS_AT_END] = ends[0]
        near[-SPANS_AT_END:] |= ends[1]
        wide &= near
        if not wide.any():
            break
        knots = with_cuts(chain, knots, wide)
    return knots


def _touched(spline: Spline, free: Flags) -> Flags:
    """Return the spans that have a free control point."""
    free_before = np.concatenate(([0], np.cumsum(free)))
    touched: Flags = free_before[spline.first + ORDER] > free_before[spline.first]
    return touched


def _determined(spline: Spline) -> Flags:
    """Return the curved spans whose control points are all given, by what is beside them.

    What is beside them changes when spans are left to the polyline.
    """
    knots = spline.knots[:-1]
    curved: Flags = ~_touched(spline, ~spline.fixed) & ~knots["straight"] & ~knots["polyline"]
    return curved


def _broken(
    chain: Chain, spline: Spline, left: Flags, wrong: Flags, states: Floats, tolerance: float
) -> tuple[Spline, Flags]:
    """Leave spans to the polyline, and lay the parts with spans that are wrong anew.

    Returns:
        The spline, and the control points of these parts.
    """
    knots = spline.knots.copy()
    part = np.cumsum(knots["ends"][:-1]) - 1
    anew = np.isin(part, part[wrong])
    knots["polyline"][:-1] |= left
    knots["ends"][:-1] |= left
    knots["ends"][1:] |= left
    following = new_spline(chain, knots, states, spline.t, spline.first, spline.extract)
    transfer(spline, following)
    free = near_spans(following, np.flatnonzero(anew), 0)
    following = with_knots(chain, following, free, states, tolerance)
    before = np.searchsorted(knots["t"], following.knots["t"][:-1], "right") - 1
    # A last span of no length begins at the last knot.
    before = np.minimum(before, len(anew) - 1)
    return following, near_spans(following, np.flatnonzero(anew[before]), 0)


# Pieces of the spline of a window.

NUMBERS = 1 << 18
"""Numbers in an array of records to begin with."""


def spline_pieces(
    chain: Chain,
    spline: Spline,
    moves: Moves,
    last: int,
    here: Floats,
    accuracy: float,
    tolerance: float,
) -> Iterator[Pieces]:
    """Yield the pieces of the first spans of a spline.

    Args:
        chain: the chain.
        spline: its spline.
        moves: feed and line of the moves.
        last: number of spans.
        here: (n,): start of the first span, mm; moved along.
        accuracy: largest error of the inverse arc length, mm.
        tolerance: of the corners between spans, mm.
    """
    joints = joint_tolerances(chain, spline, tolerance)
    numbers = NUMBERS
    span = 0
    most = len(spline.knots) + len(chain.x)
    while span < last:
        writer = new_writer(np.empty(numbers), chain.metric, here, accuracy)
        out = Written(
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty(most),
            np.empty(most),
            np.empty(most, np.int64),
            np.empty(most),
        )
        following, pieces, used = write_pieces(
            chain, spline, moves, joints, span, last, writer, out
        )
        if following == span:
            numbers *= 2
            continue
        before = joints[0] if span == 0 else math.inf
        span = following
        if pieces:
            some = slice(pieces)
            yield Pieces(
                out.kind[some],
                out.at[some],
                writer.data[:used].copy(),
                out.length[some],
                out.feed[some],
                out.line[some].astype(np.int32),
                out.joint[some].copy(),
                before,
            )


# The faster of spline and corners, for parts of a chain with few moves and sharp turns.
#
# Where moves are short, a spline goes round turns that are no corners of the chain. Whether it is
# faster there than a motion that passes the turns one by one depends on the limits of the machine.
# So both are offered to the consumer of the path, which answers before it asks for more
# (cnc.planner.lookahead). A corner between a spline and a move is a stop, too. Elsewhere the spline
# is faster: in parts with many moves, with small turns alone, or with moves of many tolerances
# beside each sharp turn.
#
# With the spline alone, 100 polygons with legs of 3 to 24 tolerances take 1.057 times as long in
# the median (limits along the path). Of 800 random walks the worst takes 2.98 times as long.

MOST_MOVES = 12
"""Most moves of a part that is offered."""
SHARP = math.cos(math.radians(40.0))
"""Cosine of a turn that such a part has at least once, or a corner at an end."""
SHORT = 20.0
"""In tolerances. Beside that turn or corner a move is shorter than this."""
SHORT_ALONE = 100.0
"""In tolerances. So it is in a part with one turn."""


@canonical
class Alternatives(Block):
    """Two paths along the same moves, from rest to rest.

    Programs do not contain this block.

    Attributes:
        spline: the path as a spline.
        corners: the path with corners.
        share: part of them that is offered for the first time.
        answer: whether the motion is to have the corners, as 1 or 0.
    """

    spline: PathChunk
    corners: PathChunk
    share: float
    answer: Answer = field(default_factory=Answer, compare=False)


Fitted = Pieces | Alternatives


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
    """Offers the choice between spline and corners.

    Args:
        frame: axes and accuracy.
        tolerance: largest distance from the moves, mm.
    """

    def __init__(self, frame: Frame, tolerance: float) -> None:
        self._frame, self._tolerance = frame, tolerance

    def mark(
        self, x: Floats, moves: Moves, metrics: Flags, corner: Flags, whole: tuple[bool, bool]
    ) -> Iterator[Alternatives]:
        """Mark the vertices at which the motion is faster with corners.

        Yields:
            Each choice; it is to be answered before the next one. Without an answer it is the last.

        Args:
            x: (m, n): vertices, mm.
            moves: feed and line of the moves.
            metrics: (n,): whether an axis is a metric one.
            corner: (m,): the corners so far, to which these are added.
            whole: whether the chain begins at the first vertex, and ends at the last one.
        """
        slower: set[tuple[int, int, bytes]] = set()
        offered: set[tuple[int, int]] = set()
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
                    spline, corners = self._paths(part, (low, high), x, moves, metrics, corner)
                    own = 0.0 if (first, last) in offered else (last - first) / (high - low)
                    offered.add((first, last))
                    choice = Alternatives(spline.file, int(spline.line[0]), spline, corners, own)
                    yield choice
                    if choice.answer.values is None:
                        # There is no computing time for more choices before the motion goes on.
                        return
                    if choice.answer.values == (1.0,):
                        corner[first : last + 1] |= part.turning
                        again = True
                    else:
                        slower.add(key)

    def _paths(
        self,
        part: Part,
        beside: tuple[int, int],
        x: Floats,
        moves: Moves,
        metrics: Flags,
        corner: Flags,
    ) -> tuple[PathChunk, PathChunk]:
        """Return the paths without and with corners at the vertices of a part.

        ``beside``: their first and their last vertex.
        """
        low, high = beside
        inside = slice(low, high + 1)
        some = Moves(moves.feed[low:high], moves.line[low:high])
        smooth = corner[inside].copy()
        smooth[0] = smooth[-1] = False
        broken = smooth.copy()
        broken[part.first - low : part.last + 1 - low] |= part.turning
        spline = self._path(x[inside], some, metrics, smooth)
        return spline, self._path(x[inside], some, metrics, broken)

    def _path(self, x: Floats, moves: Moves, metrics: Flags, corner: Flags) -> PathChunk:
        """Return the fitted path of a part, from rest to rest."""
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
        return chunk


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
    ends = [k for k in range(far, edge, -way) if corner[k] or k == last]
    return ends[0] if ends else edge + way


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


LEAST_TOLERANCE = 1e-6
"""mm. A smaller tolerance gives the exact path."""
CORNER_COSINE = math.cos(math.radians(50.0))
"""A sharper turn of straight legs that are long enough is a corner, where the spline ends."""
LEGS = 3.0
"""A corner has legs of so many tolerances at least."""
WINDOW = 4096
"""Moves fitted at once."""
SPANS_OPEN = 16
"""Spans that are fitted again when the chain goes on."""
CARRIED = 8
"""Most knots behind those that are issued which the next window keeps: with them the spline of this
one goes on within the tolerance.
"""


class Members:
    """Moves of a chain that are not fitted yet.

    Arcs stay arcs until all of their chords are made at once.

    Args:
        start: (n,): start of the first move, mm.

    Attributes:
        start: the start.
        count: number of moves, each chord as one.
    """

    def __init__(self, start: Floats) -> None:
        self.start = start
        self.count = 0
        self._rows: list[tuple[int, Floats, Floats, Ints]] = []
        self._few: list[tuple[int, Move]] = []
        self._arcs: list[tuple[int, int, Arc]] = []
        self._end: list[float] = start.tolist()
        self._before: list[float] | Arc = self._end

    def end(self) -> list[float]:
        """Return the end of the last move (n,)."""
        return self._end

    def add(self, points: Floats, feeds: Floats, lines: NDArray[np.integer]) -> None:
        """Add straight moves: ends (m, n), feeds and lines (m,)."""
        self._rows.append((self.count, points, feeds, lines.astype(np.int64)))
        self.count += len(points)
        self._before = points[-2].tolist() if len(points) > 1 else self._end
        self._end = points[-1].tolist()

    def add_one(self, move: Move) -> None:
        """Add a straight move."""
        self._few.append((self.count, move))
        self.count += 1
        self._before, self._end = self._end, move[0]

    def add_arc(self, arc: Arc, tolerance: float) -> None:
        """Add an arc; tolerance: that of the chain, mm."""
        chords = arc.chords(tolerance)
        self._arcs.append((self.count, chords, arc))
        self.count += chords
        self._before, self._end = arc, arc.end.tolist()

    def last_leg(self) -> list[float]:
        """Return the last move, from its start to its end (n,)."""
        if isinstance(self._before, Arc):
            return self._before.last_chord(self._arcs[-1][1])
        return [b - a for a, b in zip(self._before, self._end, strict=True)]

    def arrays(self) -> tuple[Floats, Moves]:
        """Return the vertices (count + 1, n), and the feeds and lines of the moves."""
        x = np.empty((self.count + 1, len(self.start)))
        moves = Moves(np.empty(self.count), np.empty(self.count, np.int64))
        x[0] = self.start
        ends = x[1:]
        for first, points, feeds, lines in self._rows:
            row = slice(first, first + len(points))
            ends[row], moves.feed[row], moves.line[row] = points, feeds, lines
        if self._few:
            rows = np.array([first for first, _ in self._few])
            ends[rows], moves.feed[rows], moves.line[rows] = zip(
                *(move for _, move in self._few), strict=True
            )
        if self._arcs:
            firsts, chords, arcs = zip(*self._arcs, strict=True)
            counts = np.array(chords)
            gaps = np.array(firsts) - (np.cumsum(counts) - counts)
            rows = np.arange(counts.sum()) + np.repeat(gaps, counts)
            ends[rows] = chord_ends(arcs, counts)
            moves.feed[rows] = np.repeat([arc.feed for arc in arcs], counts)
            moves.line[rows] = np.repeat([arc.line for arc in arcs], counts)
        return x, moves


class Fitter:
    """Fits splines to moves that come in order, all with one tolerance.

    Args:
        frame: axes and accuracy.
        tolerance: largest distance from the moves, mm.
        position: (n,): start of the first move, mm.
        curved: whether chords stand for curves: the spline leaves them a part of the tolerance. A
            curve sets it.
        short_legs: polygons stay straight, with up to so many vertices with short legs in a row;
            None where they become splines.
        offers_corners: whether corners are offered where they may be faster than the spline.
    """

    def __init__(
        self,
        frame: Frame,
        tolerance: float,
        position: Floats,
        *,
        curved: bool = False,
        short_legs: int | None = None,
        offers_corners: bool = False,
    ) -> None:
        self._short_legs = short_legs
        self._choice = Choice(frame, tolerance) if offers_corners else None
        self._frame = frame
        self._classes = frame.classes
        self._kinds = frame.classes.tolist()
        self._tolerance = tolerance
        self.curved = curved
        self._begin(position.copy(), 0)

    def _begin(self, position: Floats, metric_class: int) -> None:
        """Begin a chain at ``position`` (n,), measured over the axes of ``metric_class``."""
        self._class = metric_class
        self._members = Members(position)
        self._state = np.full((DEGREE, len(position)), math.nan)
        self._carried = np.zeros(0, KNOT)
        self._at_corner = False
        self._waiting: Arc | None = None
        """An arc at the start of a chain, until it is known what follows."""

    def add(
        self, points: Floats, feeds: Floats, lines: NDArray[np.int32], *, curved: bool = False
    ) -> Iterator[Fitted]:
        """Add moves, each of some length, and yield the pieces that are final.

        Args:
            points: (m, n): ends of the moves, mm.
            feeds: (m,): mm/s, NaN for a traverse.
            lines: (m,): source lines.
            curved: whether they are chords of a curve.
        """
        self.curved |= curved
        ends = np.concatenate(([self._position()], points))
        which = np.where(np.isnan(feeds), -1, move_classes(np.diff(ends, axis=0), self._classes))
        borders = np.concatenate(([0], np.flatnonzero(np.diff(which)) + 1, [len(which)]))
        for first, last in zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True):
            run = slice(first, last)
            if which[first] != self._class:
                yield from self.flush()
                self._begin(ends[first], int(which[first]))
            if which[first] < 0:
                records = line_records(ends[first], points[run], self._classes)
                kind = np.full(last - first, records.kind)
                allowed = np.full(last - first, self._tolerance)
                yield Pieces(
                    kind, records.at, records.data, records.length, feeds[run], lines[run], allowed
                )
                self._begin(points[last - 1], -1)
            else:
                if self._waiting is not None:
                    yield from self._go_behind_arc((ends[first + 1] - ends[first]).tolist())
                self._members.add(points[run], feeds[run], lines[run])
                if self._members.count >= WINDOW:
                    yield from self._fit(open_end=True)

    def add_few(self, moves: list[Move]) -> Iterator[Fitted]:
        """Add a few feed moves of axes that all have the class 0, as :meth:`add` does."""
        for move in moves:
            if self._class != 0:
                yield from self.flush()
                self._begin(np.array(self._position()), 0)
            if self._waiting is not None:
                leg = zip(self._position(), move[0], strict=True)
                yield from self._go_behind_arc([b - a for a, b in leg])
            self._members.add_one(move)
        if self._members.count >= WINDOW:
            yield from self._fit(open_end=True)

    def add_arc(self, arc: Arc) -> Iterator[Fitted]:
        """Add an arc, and yield the pieces that are final."""
        if self._class != 0:
            yield from self.flush()
            self._begin(arc.start, 0)
        begins = arc.direction(0.0)
        yield from self._go_behind_arc(begins)
        if self._members.count and self._is_corner(self._members.last_leg(), begins):
            yield from self.flush()
        if not self._members.count:
            self._waiting = arc
            return
        self.curved = True
        bend = arc.bend(self._tolerance)
        if self._keeps_middle(arc):
            self._members.add_arc(arc.between(0.0, bend), self._tolerance)
            yield from self._fit(open_end=False, end=arc.state(bend, self._classes == 0))
            self._waiting = arc.between(bend, 1.0)
        else:
            self._members.add_arc(arc, self._tolerance)
            if self._members.count >= WINDOW:
                yield from self._fit(open_end=True)

    def flush(self) -> Iterator[Fitted]:
        """End the chain, and yield the rest of its pieces."""
        if self._waiting is not None:
            yield from self._exact(self._waiting, self._tolerance)
        elif self._members.count:
            yield from self._fit(open_end=False)

    def _position(self) -> list[float]:
        """Return the end of everything added (n,)."""
        return self._members.end() if self._waiting is None else self._waiting.end.tolist()

    def _is_corner(self, before: list[float], after: list[float]) -> bool:
        """Return whether the chain ends where these directions meet; lengths are those of the legs.

        Moves that are shorter than a corner's legs are left to the chain.
        """
        a = [value for value, kind in zip(before, self._kinds, strict=True) if kind == 0]
        b = [value for value, kind in zip(after, self._kinds, strict=True) if kind == 0]
        sizes = math.hypot(*a), math.hypot(*b)
        long = min(sizes) >= LEGS * self._tolerance
        return long and sum(map(mul, a, b)) < math.cos(SHARPEST) * sizes[0] * sizes[1]

    def _keeps_middle(self, arc: Arc) -> bool:
        """Return whether an arc is so long that its middle stays exact."""
        bend = arc.bend(self._tolerance)
        return 2.0 * SPARE * bend < 1.0 and arc.smallest >= 2.0 * self._tolerance

    def _go_behind_arc(self, direction: list[float]) -> Iterator[Pieces]:
        """Begin the chain with the arc that waits; the chain goes on in ``direction`` (n,)."""
        arc = self._waiting
        if arc is None:
            return
        if self._is_corner(arc.direction(1.0), direction):
            yield from self._exact(arc, self._tolerance)
            return
        self.curved = True
        bend = arc.bend(self._tolerance)
        if 2.0 * bend < 1.0 and arc.smallest >= 2.0 * self._tolerance:
            yield from self._exact(arc.between(0.0, 1.0 - bend), 0.0)
            self._state = arc.state(1.0 - bend, self._classes == 0)
            arc = arc.between(1.0 - bend, 1.0)
        self._waiting = None
        self._members.add_arc(arc, self._tolerance)

    def _exact(self, arc: Arc, joint: float) -> Iterator[Pieces]:
        """Yield an exact arc, and begin a chain behind it; ``joint``: tolerance there, mm."""
        runs = list(arc.records(self._frame))
        for number, records in enumerate(runs):
            count = len(records.at)
            allowed = np.zeros(count)
            allowed[-1] = joint if number == len(runs) - 1 else 0.0
            yield Pieces(
                np.full(count, records.kind),
                records.at,
                records.data,
                records.length,
                np.full(count, arc.feed),
                np.full(count, arc.line, np.int32),
                allowed,
            )
        self._begin(arc.end, 0)

    def _fit(self, *, open_end: bool, end: Floats | None = None) -> Iterator[Fitted]:
        """Yield the spans of the chain that no later move will change; all if the chain ends.

        end: (5, n): position and derivatives 1 to 4 there.
        """
        tolerance = LEFT * self._tolerance if self.curved else self._tolerance
        x, moves = self._members.arrays()
        metrics = self._classes == self._class
        chain = Chain(x, np.empty(len(x)), np.flatnonzero(metrics), metrics)
        corner = np.empty(len(x), np.bool_)
        find_corners(x, chain.metric, CORNER_COSINE, tolerance, corner)
        if self._short_legs is not None and not self.curved:
            find_polygons(x, chain.metric, tolerance, self._short_legs, corner)
        corner[0] = self._at_corner
        if self._choice is not None and not self.curved:
            whole = math.isnan(self._state[0, 0]), not open_end and end is None
            yield from self._choice.mark(x, moves, metrics, corner, whole)
        knots = first_knots(chain, corner, tolerance, self._carried)
        states = np.stack(
            (self._state, np.full_like(self._state, math.nan) if end is None else end)
        )
        if not len(self._carried):
            knots = with_short_ends(chain, knots, ~np.isnan(states[:, 0, 0]))
        spline = fitted(chain, knots, states, tolerance)
        spans = len(spline.knots) - 1
        if end is not None:
            spline.knots["ends"][-1] = False
        last = self._final_spans(spline) if open_end else spans
        yield from spline_pieces(
            chain, spline, moves, last, self._here(), self._frame.accuracy, self._tolerance
        )
        if last == spans:
            self._begin(x[-1], self._class)
        elif last > 0:
            self._go_on(chain, spline, moves, last)

    def _final_spans(self, spline: Spline) -> int:
        """Return the number of spans that no later move will change.

        The last one ends at a corner, between two straight spans, or near a vertex with another one
        behind it.
        """
        knots = spline.knots
        spans = len(knots) - 1
        off = spline.bezier[:, 0] - spline.p[:-1]
        metrics = self._classes == self._class
        distance = np.linalg.norm(off[:, metrics], axis=1)
        distance = np.maximum(distance, np.abs(off[:, ~metrics]).max(axis=1, initial=0.0))
        whole = distance <= self._tolerance
        whole &= (knots["on"] & ~knots["straight"] & ~knots["polyline"])[:-1]
        for k in range(spans - SPANS_OPEN, 0, -1):
            between_lines = knots["straight"][k - 1] and knots["straight"][k]
            if knots["ends"][k] or between_lines or (whole[k] and self._kept(knots, k)):
                return k
        return spans if self._members.count >= 4 * WINDOW else 0

    def _kept(self, knots: Knots, last: int) -> int:
        """Return the number of knots behind knot ``last`` that the next window keeps.

        They end with a vertex, before the next straight or broken span.
        """
        behind = knots[last : last + CARRIED + 1]
        barred = behind["straight"] | behind["polyline"] | behind["ends"]
        reach = int(np.argmax(barred)) if barred.any() else len(behind) - 1
        on = np.flatnonzero(behind["on"][1 : reach + 1])
        return int(on[-1]) + 1 if len(on) else 0

    def _go_on(self, chain: Chain, spline: Spline, moves: Moves, last: int) -> None:
        """Keep the moves behind span ``last``, and the state of the spline there."""
        knot = spline.knots[last]
        first = int(knot["vertex"])
        self._members = Members(spline.p[last].copy())
        self._members.add(chain.x[first + 1 :], moves.feed[first:], moves.line[first:])
        self._at_corner = bool(knot["ends"])
        self._state = np.full((DEGREE, chain.x.shape[1]), math.nan)
        self._carried = np.zeros(0, KNOT)
        if not self._at_corner:
            h = knot["t"] - spline.knots[last - 1]["t"]
            difference, factor = spline.bezier[last - 1], 1.0
            for k in range(DEGREE):
                self._state[k] = factor * difference[-1]
                difference, factor = np.diff(difference, axis=0), factor * (DEGREE - k) / h
            if not knot["straight"]:
                kept = self._kept(spline.knots, last)
                self._carried = spline.knots[last + 1 : last + 1 + kept].copy()
                self._carried["t"] -= chain.along[self._carried["vertex"]]
                self._carried["vertex"] -= first

    def _here(self) -> Floats:
        """Return the end of the spans issued so far (n,)."""
        begin: Floats = self._members.start if math.isnan(self._state[0, 0]) else self._state[0]
        return begin.copy()
