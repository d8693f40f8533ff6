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

import numpy as np
from numpy.typing import NDArray

from cnc.boards.grbl.group_moves import GroupMoves, moves_of
from cnc.boards.grbl.tracked_moves import AxisLimits, Move, Point
from cnc.model.line_effects import KINDS, MOTIONS, LineKind

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
        found, closest = self._find(point, self._reported)
        if found is not None:
            over, self._reported = self._reported, found
            self._drop(over[0])
            self._passed = over[1]
            return 0.0
        # The report before may have been wrong.
        found, nearest = self._find(point, (0, self._passed))
        if found is None:
            return 0.0 if self._unknown else min(closest, nearest)
        self._reported = found
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
