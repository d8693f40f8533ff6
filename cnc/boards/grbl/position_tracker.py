r"""The reported positions of a GRBL board, compared with the moves that it was sent.

A line that loses a few of its bytes may still be a line that the board accepts: ``X12.5`` becomes
``X1.5``. No answer shows this, but the motion does. So the reported positions are followed along
the moves that were sent:

                      o--------->o
                     /            \ x      x is off all of them: the board has read a wrong line
            ---o--*-o              o--
                  `-- the last position: the board continues from here, never back

A toolpath may cross itself, or go back along itself. The earliest possible place counts, so the
board is never assumed to be further than it is. A single report may be wrong (an AVR reads its
position while it steps, so that one number may be half old). So a place counts when the next report
does not lie before it.

A fault of this kind is found when the motion comes to the changed line. Therefore the motion ahead
of the board, in seconds, is limited to what its planner needs
(:attr:`PositionTracker.seconds`). A planner full of moves of some seconds each would hide a fault
for a minute.

Behind a line whose effect is not known, nothing is known until :meth:`PositionTracker.begin`. The
moves before it are still followed, because the machine may rest on them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from operator import mul, sub
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.model.line_effects import ARCS, KINDS, MOTIONS, LineKind

# Moves that a GRBL board has been sent, and the nearest place on them to a reported position.

SHARP_TURN = 0.9
"""Cosine of the turn between two moves below which the board nearly stops between them."""
FULL_TURN = 5e-7
"""rad. GRBL takes an arc that turns by less for a full circle (config.h,
ARC_ANGULAR_TRAVEL_EPSILON).
"""

Point = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Limits of the board's axes; infinite where they are not known.

    Attributes:
        rates: mm/s.
        accelerations: mm/s^2.
    """

    rates: Sequence[float] = ()
    accelerations: Sequence[float] = ()

    def times(self, length: Floats, direction: Floats, feed: Floats, turn: Floats) -> Floats:
        """Return the seconds of straight moves, with the stop before each at a sharp turn.

        Args:
            length: (n,), mm.
            direction: Unit vectors (n, axes).
            feed: (n,), mm/s; infinite for a traverse.
            turn: Cosine of the turn before each (n,); -1 for a start from rest.
        """
        size = np.abs(direction)
        speed, acceleration = feed, np.full(len(length), math.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            limited = min(len(self.rates), len(self.accelerations), size.shape[1])
            for column in range(limited):
                speed = np.fmin(speed, self.rates[column] / size[:, column])
                acceleration = np.fmin(acceleration, self.accelerations[column] / size[:, column])
            seconds = length / speed
            from_rest = np.where(
                length * acceleration > speed * speed,
                seconds + speed / acceleration,
                2.0 * np.sqrt(length / acceleration),
            )
            seconds = np.where(turn > SHARP_TURN, seconds, from_rest)
        return np.where((speed > 0.0) & (speed < math.inf), seconds, 0.0)


class StraightMove(NamedTuple):
    """A straight move.

    Attributes:
        line: Source line.
        start: Machine position, mm.
        end: Machine position, mm.
        length: mm.
        seconds: Approximate time.
    """

    line: int
    start: Point
    end: Point
    length: float
    seconds: float

    def nearest(self, point: Point, after: float, tolerance: float) -> tuple[float, float]:
        """Return the place on the move that is nearest to a point.

        Args:
            point: Machine position, mm.
            after: The part of the move, 0 to 1, that has been passed.
            tolerance: mm; not used by a straight move.

        Returns:
            The part of the move, and the distance there in mm.
        """
        # A move is looked at for each report, so without a function of Python for each axis.
        gone = list(map(sub, point, self.start))
        along = sum(map(mul, gone, map(sub, self.end, self.start)))
        square = self.length * self.length
        part = min(max(along / square, after), 1.0)
        return part, math.sqrt(
            max(sum(map(mul, gone, gone)) - part * (2.0 * along - part * square), 0.0)
        )


@dataclass(frozen=True, slots=True)
class ArcMove:
    """An arc or helix.

    Attributes:
        line: Source line.
        start: Machine position, mm.
        end: Machine position, mm.
        seconds: Approximate time.
        plane: Columns of the two axes of its plane.
        center: Centre along these axes, mm.
        radius: mm.
        first: Angle of the start, rad.
        turn: Signed angle from start to end, rad, positive for counter-clockwise.
    """

    line: int
    start: Point
    end: Point
    seconds: float
    plane: tuple[int, int]
    center: tuple[float, float]
    radius: float
    first: float
    turn: float

    def nearest(self, point: Point, after: float, tolerance: float) -> tuple[float, float]:
        """Return the place on the move that is nearest to a point; see StraightMove.

        Just before its beginning the board seems to be at the end of a full circle. Within the
        tolerance of its last place it counts as being there.
        """
        stays = math.dist(point, self._at(after))
        if stays <= tolerance:
            return after, stays
        i, j = self.plane
        angle = math.atan2(point[j] - self.center[1], point[i] - self.center[0]) - self.first
        turned, whole = (angle if self.turn > 0.0 else -angle) % math.tau, abs(self.turn)
        # A point beside the arc that is nearer to its start lies before it.
        along = (turned - math.tau if turned - whole > math.tau - turned else turned) / whole
        # On a steep helix the height determines the place, on a flat one the angle.
        rises = [
            0.0 if column in self.plane else b - a
            for column, (a, b) in enumerate(zip(self.start, self.end, strict=True))
        ]
        level = (self.radius * self.turn) ** 2
        risen = sum(rise * (p - a) for rise, p, a in zip(rises, point, self.start, strict=True))
        part = min(
            max((level * along + risen) / (level + sum(rise * rise for rise in rises)), after),
            1.0,
        )
        distance = math.dist(point, self._at(part))
        return (part, distance) if distance < stays else (after, stays)

    def _at(self, part: float) -> list[float]:
        place = [a + part * (b - a) for a, b in zip(self.start, self.end, strict=True)]
        angle = self.first + part * self.turn
        place[self.plane[0]] = self.center[0] + self.radius * math.cos(angle)
        place[self.plane[1]] = self.center[1] + self.radius * math.sin(angle)
        return place


Move = StraightMove | ArcMove


# The moves of a group of lines, computed together before the first of them is sent.

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
    values = zip(
        rows["line"].tolist(),
        [places[k] for k in kept],
        [places[k + 1] for k in kept],
        length.tolist(),
        seconds.tolist(),
        strict=True,
    )
    moves: list[Move] = list(map(new_straight, values))
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
    last_named = np.where(np.isnan(points), 0, np.arange(len(points))[:, np.newaxis])
    return np.take_along_axis(points, np.maximum.accumulate(last_named, axis=0), axis=0)


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


TOLERANCE = 0.03
"""mm that a reported position may be off by decimals and rounding. The board's steps and its chords
of arcs are added.
"""
SPARE_MOVES = 4
"""Moves that are kept beside those that planner and receive buffer can hold."""


class PositionTracker:
    """Follows the lines that are sent, and the board along them.

    Args:
        planner: Moves that the board's planner can hold.
        offset: Work offset that the board adds to the numbers of a line, mm.
        tolerance: mm that a position may be off.
        limits: Limits of the axes.
    """

    def __init__(
        self,
        planner: int,
        offset: Sequence[float],
        tolerance: float = TOLERANCE,
        limits: AxisLimits | None = None,
    ) -> None:
        self._offset = tuple(offset)
        self._tolerance = tolerance
        self._planner = planner
        self._limits = limits or AxisLimits()
        self._moves: deque[Move] = deque()
        self._sent = 0
        self._numbers: deque[int] = deque()
        self._traverses: deque[float] = deque()
        self._traversing = 0.0
        self._passed = 0.0
        self._seconds = 0.0
        self._reported = (0, 0.0)
        self._at: Point | None = None
        self._direction: tuple[float, ...] | None = None
        self._kind: LineKind | None = None
        self._prepared: GroupMoves | None = None
        self._next = 0
        self._may_end_early = self._unknown = False

    def begin(self, position: Sequence[float]) -> None:
        """The board stands at this position, mm, with nothing to do."""
        self._moves.clear()
        self._numbers.clear()
        self._traverses.clear()
        self._passed = self._seconds = self._traversing = 0.0
        self._reported = (0, 0.0)
        self._direction = self._prepared = None
        self._may_end_early = self._unknown = False
        self._at = tuple(position)

    @property
    def seconds(self) -> float:
        """Approximate time of the motion ahead at 100 %; 0 where it is not known."""
        if self._unknown or not self._moves:
            return 0.0
        return self._seconds - self._passed * self._moves[0].seconds

    def seconds_at(self, feed: float, rapid: float) -> float:
        """Return the same at overrides of feed and traverse, in per cent."""
        if self._unknown or not self._moves:
            return 0.0
        ahead = self._seconds - self._passed * self._moves[0].seconds
        traversing = self._traversing - self._passed * self._traverses[0]
        return (ahead - traversing) * 100.0 / feed + traversing * 100.0 / rapid

    @property
    def lines(self) -> int:
        """Lines sent since the first move that was not over at the last report; 0 without one."""
        return self._sent - self._numbers[0] if self._moves else 0

    @property
    def line(self) -> int:
        """Source line of the present move; 0 where it is not known."""
        return self._moves[0].line if self._moves else 0

    def prepare(self, rows: NDArray[np.void]) -> None:
        """Note lines that will be sent next: motions, or a single line of another kind.

        Args:
            rows: Source line and effect of each, see :func:`cnc.model.line_effects.row_type`.
        """
        self._kind, self._next, self._prepared = KINDS[rows["kind"][0]], 0, None
        if self._at is not None and not self._unknown and self._kind in MOTIONS:
            self._prepared = moves_of(rows, self._at, self._direction, self._offset, self._limits)
            self._direction = self._prepared.direction

    def within(self, limit: float, most: int, feed: float, rapid: float) -> int:
        """Return how many of the prepared lines may be sent, until the motion ahead is enough.

        Args:
            limit: Motion ahead that is enough, s.
            most: Most lines that may be sent.
            feed: Override of feeds, per cent.
            rapid: Override of traverses, per cent.
        """
        ahead = self.seconds_at(feed, rapid)
        group = self._prepared
        for number in range(most):
            if ahead > limit:
                return number
            if group is not None:
                line = self._next + number
                for move in range(group.before[line], group.before[line + 1]):
                    traverse = group.traverses[move]
                    ahead += (group.seconds[move] - traverse) * 100.0 / feed
                    ahead += traverse * 100.0 / rapid
        return most

    def send(self, count: int) -> None:
        """Note that the next ``count`` of the prepared lines were sent."""
        group, first = self._prepared, self._next
        sent, self._sent = self._sent, self._sent + count
        if self._at is None or self._unknown:
            return
        if group is None:
            self._unknown = self._kind is None
            # The board comes to rest before most lines without motion.
            self._direction = None
            return
        self._next = end = first + count
        self._may_end_early = self._kind is LineKind.PROBE
        self._at = group.ends[end - 1]
        some = slice(group.before[first], group.before[end])
        if not self._moves:
            self._seconds = self._traversing = 0.0
        self._seconds += sum(group.seconds[some])
        self._traversing += sum(group.traverses[some])
        self._moves.extend(group.moves[some])
        self._traverses.extend(group.traverses[some])
        self._numbers.extend([sent + line - first for line in group.lines[some]])

    def off(self, position: Sequence[float], waiting: int) -> float:
        """Return how far a reported position is from the moves ahead.

        Args:
            position: Machine position, mm.
            waiting: Lines that are not answered yet.

        Returns:
            The distance in mm; 0 within the tolerance, and where nothing is known.
        """
        if self._at is None or len(position) != len(self._at):
            return 0.0
        # Twice, because moves of length 0 take no place in the planner.
        kept = 2 * self._planner + waiting + SPARE_MOVES
        if len(self._moves) > kept:
            self._drop(len(self._moves) - kept)
        point = tuple(position)
        place, closest = self._find(point, self._reported)
        if place is not None:
            over, self._reported = self._reported, place
            self._drop(over[0])
            self._passed = over[1]
            return 0.0
        # The report before may have been wrong.
        place, nearest = self._find(point, (0, self._passed))
        if place is None:
            return 0.0 if self._unknown else min(closest, nearest)
        self._reported = place
        return 0.0

    def stopped(self, position: Sequence[float], waiting: int) -> None:
        """Note that the machine has been stopped here; arguments as of :meth:`off`.

        It may have come some lines further than the last report while it moved.
        """
        # A place counts when the next report confirms it.
        for _ in range(2):
            self.off(position, waiting)

    def arrived(self, position: Sequence[float]) -> float:
        """Return how far the board rests from the end of its lines.

        Args:
            position: Machine position at which the board rests with nothing left to do, mm.

        Returns:
            The distance in mm; 0 within the tolerance, and where nothing is known.
        """
        if (
            self._at is None
            or self._unknown
            or self._may_end_early
            or len(position) != len(self._at)
        ):
            return 0.0
        distance = math.dist(position, self._at)
        if distance > self._tolerance:
            return distance
        self._drop(len(self._moves))
        return 0.0

    def _find(
        self, point: Point, after: tuple[int, float]
    ) -> tuple[tuple[int, float] | None, float]:
        """Return the first place on the moves at a point, and the shortest distance from them.

        Args:
            point: Machine position, mm.
            after: Number of a move and a part of it; earlier places do not count.
        """
        assert self._at is not None
        closest = math.inf
        for number in range(after[0], len(self._moves)):
            part, distance = self._moves[number].nearest(
                point, after[1] if number == after[0] else 0.0, self._tolerance
            )
            if distance <= self._tolerance:
                return (number, part), distance
            closest = min(closest, distance)
        distance = math.dist(point, self._at)
        return ((len(self._moves), 0.0) if distance <= self._tolerance else None), min(
            closest, distance
        )

    def _drop(self, count: int) -> None:
        """Forget the first ``count`` moves, which are over."""
        if not count:
            return
        for _ in range(count):
            self._seconds -= self._moves.popleft().seconds
            self._traversing -= self._traverses.popleft()
            self._numbers.popleft()
        self._passed = 0.0
        number, part = self._reported
        self._reported = (number - count, part) if number >= count else (0, 0.0)
