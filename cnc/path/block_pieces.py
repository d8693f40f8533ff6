"""Pieces of the blocks that move: their records, their gathering into chunks, and their checks.

block ──► records (records.py) ──► cut where the tip of a NURBS stands ──► Gatherer ──► PathChunk
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import PLANE_AXES, ArcFeed, Block, NurbsFeed, Polyline
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import Commands, command_array, places_of
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LENGTH, METRIC, METRICS, SPAN_BODY, START, U0, U1
from cnc.path.kernels.span_shape import NEGLIGIBLE
from cnc.path.records import (
    Floats,
    Ints,
    Records,
    arc_records,
    line_records,
    moving,
    spline_records,
)

# Pieces of a path that follow each other, before they are gathered into chunks.


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces that follow each other, one entry each.

    Attributes:
        kind: LINE, ARC or SPAN.
        at: index of the record in ``data``.
        data: the records.
        length: mm.
        feed: mm/s, NaN for a traverse.
        line: source line.
        tolerance: of the joint behind the piece, mm.
        before: largest tolerance of the joint before the first piece, mm.
    """

    kind: Ints
    at: Ints
    data: Floats
    length: Floats
    feed: Floats
    line: NDArray[np.int32]
    tolerance: Floats
    before: float = math.inf


class _Single(NamedTuple):
    """A piece with its entries, as in :class:`Pieces`, and whether motion rests behind it."""

    kind: int
    data: Floats
    feed: float
    line: int
    tolerance: float
    stop: bool


# Records of a path, gathered into chunks.

MOST_PIECES = 4096
MOST_NUMBERS = 1 << 18
"""A chunk is closed when its records are this many, or have this many numbers."""


class Gatherer:
    """Gathers records into chunks."""

    def __init__(self, axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.file = ""
        self.timed = False
        self.waiting: list[Block] = []
        """Commands that take effect at the start of the next piece."""
        self.clear()

    def clear(self) -> None:
        """Forget all pieces and commands but those that wait."""
        self._singles: list[_Single] = []
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
        """Add records of one kind.

        Args:
            records: the records.
            feeds: (m,): mm/s, NaN for a traverse.
            lines: (m,): source lines.
            stops: (m,): whether motion rests behind each.
            tolerance: of their joints, mm.
            commands: (m,): commands that go with each.
        """
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

    def add_single(
        self, records: Records, feed: float, line: int, tolerance: float, *, stop: bool
    ) -> None:
        """Add one piece, as :meth:`add` does; many of them become arrays together."""
        self._take_waiting()
        self._singles.append(
            _Single(records.kind, records.data, feed, line, 0.0 if stop else tolerance, stop)
        )
        self.pieces += 1
        self.numbers += len(records.data)

    def put(self, pieces: Pieces, stops: NDArray[np.bool_]) -> None:
        """Add pieces; motion rests behind those with a stop (m,)."""
        self._pack()
        if len(pieces.at):
            self._take_waiting()
        self.parts.append(pieces)
        self.stops.append(stops)
        self.pieces += len(pieces.at)
        self.numbers += len(pieces.data)

    def limit_last_joint(self, most: float) -> None:
        """Reduce the tolerance of the joint behind the last piece to ``most`` mm."""
        self._pack()
        last = self.parts[-1].tolerance
        last[-1] = min(last[-1], most)

    def _take_waiting(self) -> None:
        """Put the commands that wait before the next piece."""
        if self.waiting:
            self.commands[self.pieces] = (*self.waiting, *self.commands.get(self.pieces, ()))
            self.waiting.clear()

    def _pack(self) -> None:
        """Make arrays of the single pieces."""
        if not self._singles:
            return
        kinds, data, feeds, lines, tolerances, stops = zip(*self._singles, strict=True)
        self._singles = []
        at = np.cumsum([0, *map(len, data[:-1])])
        joined = np.concatenate(data)
        self.parts.append(
            Pieces(
                np.array(kinds),
                at,
                joined,
                joined[at + LENGTH],
                np.array(feeds, np.float64),
                np.array(lines, np.int32),
                np.array(tolerances, np.float64),
            )
        )
        self.stops.append(np.array(stops, np.bool_))

    def full(self) -> bool:
        """Return whether the chunk is to be closed."""
        return self.pieces >= MOST_PIECES or self.numbers >= MOST_NUMBERS

    def take(self) -> PathChunk:
        """Return everything gathered as one chunk, and empty the gatherer."""
        self._pack()
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
            timed=self.timed,
        )
        self.clear()
        return chunk


# Ends of NURBS spans at which the tool tip stands while other axes move on.
#
# The tip measures the length s of a path. Near a cusp of the tip, or near a doubled control point,
# the tip goes like t^k while an axis that rides along goes like t^j with j < k. Its slope dq/ds
# grows like s^(j/k - 1), without bound: no speed of the tip above zero keeps the axis within its
# limits.
#
# The end of such a span is cut off, and the axes that ride along measure the length of the part:
#
#     tip measures       axes that ride along measure       tip measures
#     ────────────────|──────────────── cusp ────────────|──────────────
#                   RATIO                               RATIO
#
# There the tip is a smooth function of the length. Motion stops where the measure changes. The feed
# of the part is scaled, so that the tip does not exceed the feed of the program.

ZERO = 1e-7
"""Part of the extent below which a control point is on the end of the span."""
RATIO = 0.125
"""The part ends where the tip has this share of its mean speed, against that of the other axes."""
STEEPEST = 1.0
"""mm a degree, the largest ratio at the end of a part: the tip goes no farther than the length."""
ROUNDING = 1e-9
"""mm or degrees; a control point nearer than this to the end is on it, too."""
SHARES = 2.0 ** np.arange(-20.0, 0.0)
"""Shares of the span at which the part may end."""
SAMPLES = np.linspace(0.0, 1.0, 33)


class _Span(NamedTuple):
    """A span in Bernstein form, measured from its start.

    Attributes:
        weight: (p + 1,).
        points: (n, p + 1): control points, mm or degrees.
        start: (n,).
        end: (n,).
        metric: columns that measure the length.
        low: parameter at the start.
        high: parameter at the end.
    """

    weight: Floats
    points: Floats
    start: Floats
    end: Floats
    metric: Ints
    low: float
    high: float


class _Cut(NamedTuple):
    """A part of a span.

    Attributes:
        first: share of the span at its start.
        last: share at its end.
        measure: class of the axes that measure its length.
    """

    first: float
    last: float
    measure: int


def with_standing_tip(
    runs: Iterable[Records], classes: Ints, accuracy: float
) -> Iterator[tuple[Records, float]]:
    """Yield the records of a NURBS, cut where the tip stands, and a factor of the feed of each.

    Args:
        runs: records of its spans.
        classes: (n,): class of each axis.
        accuracy: largest error of the inverse arc length, mm.
    """
    for records in runs:
        cuts = [_cuts(_span(records, at, len(classes)), classes) for at in records.at.tolist()]
        if not any(cuts):
            yield records, 1.0
            continue
        for place, cut in enumerate(cuts):
            if cut:
                span = _span(records, int(records.at[place]), len(classes))
                yield from _parts(span, cut, classes, accuracy)
            else:
                yield _one(records, place), 1.0


def _span(records: Records, at: int, n: int) -> _Span:
    data = records.data
    first = at + START + 2 * n
    p = int(data[first])
    first += SPAN_BODY
    rows = data[first : first + (n + 1) * (p + 1)].reshape(n + 1, p + 1)
    metric = data[at + METRIC : at + METRIC + int(data[at + METRICS])].astype(np.int64)
    start, end = data[at + START : at + START + n], data[at + START + n : at + START + 2 * n]
    return _Span(rows[0], rows[1:] / rows[0], start, end, metric, data[at + U0], data[at + U1])


def _one(records: Records, place: int) -> Records:
    """Return one of the pieces."""
    at = int(records.at[place])
    end = int(records.at[place + 1]) if place + 1 < len(records.at) else len(records.data)
    length = records.length[place : place + 1]
    return Records(records.kind, np.zeros(1, np.int64), records.data[at:end].copy(), length.copy())


def _cuts(span: _Span, classes: Ints) -> list[_Cut]:
    """Return the parts at the ends at which the tip stands."""
    cuts = []
    extent = np.abs(span.points - span.points[:, :1]).max(axis=1)
    least = np.maximum(ZERO * extent, ROUNDING)[:, None]
    for at_end in (False, True):
        away = np.abs(span.points - span.points[:, -1 if at_end else 0, None])
        leaves = (away[:, ::-1] if at_end else away) > least
        order = np.where(leaves.any(axis=1), leaves.argmax(axis=1), leaves.shape[1])
        earlier = np.flatnonzero(order < int(order[span.metric].min()))
        if len(earlier) == 0:
            continue
        measure = int(classes[earlier[np.argmin(order[earlier])]])
        riders = np.flatnonzero(classes == measure)
        speeds = _speed(span, span.metric, SAMPLES), _speed(span, riders, SAMPLES)
        wanted = min(RATIO * speeds[0].mean() / speeds[1].mean(), STEEPEST)
        place = 1.0 - SHARES if at_end else SHARES
        far = _speed(span, span.metric, place) >= wanted * _speed(span, riders, place)
        width = float(SHARES[max(int(np.argmax(far)) - 1, 0)]) if far.any() else 0.5
        first, last = (1.0 - width, 1.0) if at_end else (0.0, width)
        cuts.append(_Cut(first, last, measure))
    if len(cuts) == 2 and cuts[0].last >= cuts[1].first:
        return [_Cut(0.0, 1.0, cuts[0].measure)]
    return cuts


def _parts(
    span: _Span, cuts: list[_Cut], classes: Ints, accuracy: float
) -> Iterator[tuple[Records, float]]:
    """Yield the records of a span that is cut, and the factors of the feed."""
    tip = int(classes[span.metric[0]])
    between = [0.0, *(place for cut in cuts for place in (cut.first, cut.last)), 1.0]
    parts = [*cuts, *(_Cut(a, b, tip) for a, b in zip(between[::2], between[1::2], strict=True))]
    position = span.start
    for cut in sorted(cut for cut in parts if cut.first < cut.last):
        part = _part(span, cut)
        swapped, factor = classes, 1.0
        if cut.measure != tip:
            swapped = np.where(classes == tip, cut.measure, classes)
            swapped[classes == cut.measure] = tip
            places = cut.first + SAMPLES * (cut.last - cut.first)
            riders = _speed(span, np.flatnonzero(classes == cut.measure), places)
            moves = riders > 0.0
            ratio = _speed(span, span.metric, places[moves]) / riders[moves]
            factor = 1.0 / float(ratio.max())
        points = (part[1:] / part[0]).T + span.start
        points[0] = position
        if cut.last == 1.0:
            points[-1] = span.end
        position = points[-1]
        degree = len(part[0]) - 1
        u = span.low + np.array([cut.first, cut.last]) * (span.high - span.low)
        knots = np.repeat(u, degree + 1)
        for records in spline_records(degree, knots, points, part[0], swapped, accuracy):
            yield records, factor


def _part(span: _Span, cut: _Cut) -> Floats:
    """Return the homogeneous Bernstein coefficients (n + 1, p + 1) of a part of a span."""
    rows = np.concatenate((span.weight[None], span.points * span.weight))
    rest, left, right = rows, [], []
    for _ in range(rows.shape[1]):
        left.append(rest[:, 0])
        rest = rest[:, :-1] + cut.last * np.diff(rest, axis=1)
    rest = np.stack(left, axis=1)
    for _ in range(rows.shape[1]):
        right.append(rest[:, -1])
        rest = rest[:, :-1] + cut.first / cut.last * np.diff(rest, axis=1)
    return np.stack(right[::-1], axis=1)


def _speed(span: _Span, columns: Ints, t: Floats) -> Floats:
    """Return the speed (m,) of some columns by the share of the span, at shares t (m,)."""
    rows = np.concatenate((span.weight[None], span.points[columns] * span.weight))[..., None]
    degree = rows.shape[1] - 1
    while rows.shape[1] > 2:
        rows = rows[:, :-1] + t * np.diff(rows, axis=1)
    value, slope = rows[:, 0] + t * (rows[:, 1] - rows[:, 0]), degree * (rows[:, 1] - rows[:, 0])
    velocity = (slope[1:] - slope[0] * value[1:] / value[0]) / value[0]
    speed: Floats = np.sqrt(np.sum(np.square(velocity), axis=0))
    return speed


FEW = 8
"""Most moves of a short row."""
Move = tuple[list[float], float, int]
"""End (n,), feed and source line of a move."""

JOIN = 1e-6
"""mm. A NURBS whose first control point is this near to the position is moved there. A larger
distance is an error.
"""


@dataclass(frozen=True, slots=True)
class Frame:
    """Axes of the path: their names, their classes (n,), and the accuracy of arc lengths (mm)."""

    axes: tuple[str, ...]
    classes: NDArray[np.int64]
    accuracy: float


def pieces_of(
    block: Polyline | ArcFeed | NurbsFeed,
    position: Floats,
    frame: Frame,
    *,
    exact_stop: bool,
) -> Iterator[tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_], Commands | None]]:
    """Yield records of one block, with feed, line and stop of each piece, and the commands.

    ``position`` (n,) is moved along. exact_stop: motion rests at the end of the block.
    """
    axes, classes, accuracy = frame.axes, frame.classes, frame.accuracy
    if isinstance(block, Polyline):
        here = position.copy()
        for moves, feeds, lines, commands in moves_of(block, position):
            stops = np.full(len(moves), exact_stop)
            yield line_records(here, moves, classes), feeds, lines, stops, commands
            here[:] = moves[-1]
        return
    if isinstance(block, ArcFeed):
        runs = records_of_arc(block, position.copy(), frame)
    else:
        check_finite(block, block.knots, block.control_points, block.weights, np.array(block.feed))
        points = joined(block, position)
        runs = spline_records(block.degree, block.knots, points, block.weights, classes, accuracy)
    # Only an axis that does not measure the length may go on while the others stand.
    paced: Iterable[tuple[Records, float]] = ((records, 1.0) for records in runs)
    if isinstance(block, NurbsFeed) and np.ptp(points[:, classes != 0], axis=0).any():
        paced = with_standing_tip(runs, classes, accuracy)
    last: tuple[Records, float] | None = None
    for run in paced:
        if last is not None:
            yield *_spread(block, *last, stop=False), None
        last = run
    if last is not None:
        position[:] = _end_of(last[0], len(axes))
        yield *_spread(block, *last, stop=exact_stop), None


def records_of_arc(block: ArcFeed, position: Floats, frame: Frame) -> Iterator[Records]:
    """Return the records of an arc from a position (n,), one for each turn.

    Raises:
        GcodeError: ``not-finite``.
    """
    axes = frame.axes
    check_arc(block, block.end.tolist())
    first_axis, second_axis = PLANE_AXES[block.plane]
    plane = axes.index(first_axis), axes.index(second_axis)
    return arc_records(
        position, block.end, plane, block.center, block.turns, frame.classes, frame.accuracy
    )


def moves_of(
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


def few_moves(block: Polyline, position: Floats, *, traverses: bool) -> list[Move] | None:
    """Return the moves with a length of a short row; None if arrays are to be made of it.

    For a few moves each array takes longer than all their numbers.

    Args:
        block: the row.
        position: (n,): moved along.
        traverses: whether a row with a traverse counts as well.
    """
    if len(block.points) > FEW or block.commands is not None:
        return None
    feeds, moves, here = block.feeds.tolist(), [], position.tolist()
    for move in zip(block.points.tolist(), feeds, block.lines.tolist(), strict=True):
        end, feed, _ = move
        if not (math.isfinite(feed) or (traverses and math.isnan(feed))):
            return None
        if not all(map(math.isfinite, end)):
            return None
        if any(abs(b - a) > NEGLIGIBLE for a, b in zip(here, end, strict=True)):
            moves.append(move)
            here = end
    if moves:
        position[:] = here
    return moves


def _spread(
    block: ArcFeed | NurbsFeed, records: Records, factor: float, *, stop: bool
) -> tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_]]:
    """Return records with the feed, line and stop of each piece; a stop comes after the last.

    factor: of the feed.
    """
    count = len(records.at)
    stops = np.zeros(count, np.bool_)
    stops[-1] = stop
    return records, np.full(count, factor * block.feed), np.full(count, block.line, np.int32), stops


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


def check_finite(block: Block, *arrays: Floats) -> None:
    """Raise ``not-finite`` if a number of a block is not finite."""
    if not all(np.isfinite(array).all() for array in arrays):
        raise _not_finite(block, block.line)


def check_arc(block: ArcFeed, end: list[float]) -> None:
    """Raise ``not-finite`` if a number of an arc to ``end`` (n,) is not finite."""
    if not all(map(math.isfinite, (*end, *block.center, block.radius, block.turns, block.feed))):
        raise _not_finite(block, block.line)


def _check_polyline(block: Polyline) -> None:
    """Check that points are finite, and feeds finite or NaN (a traverse)."""
    if np.isfinite(block.points).all() and not np.isinf(block.feeds).any():
        return
    bad = ~np.isfinite(block.points).all(axis=1) | np.isinf(block.feeds)
    raise _not_finite(block, int(block.lines[int(np.argmax(bad))]))


def joined(block: NurbsFeed, position: Floats) -> Floats:
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
