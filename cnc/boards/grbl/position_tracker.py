r"""Where a GRBL board can be: on the moves that it was sent and has not finished, one after the
other.

A line that loses a few of its bytes on the way may still be a line that the board takes: ``X12.5``
becomes ``X1.5``. Nothing it answers tells that, but where it goes does. So the positions that it
reports are followed along the moves that were sent:

                      o--------->o
                     /            \ x      x is off them all: some line was not what it was when it was sent
            ---o--*-o              o--
                  `-- here the board was last: it goes on from here, never back

A way may cross itself, or go the same way back; the earliest place that the board can have come to
counts, so it is never thought to be further than it is. As one report may be wrong (an AVR reads
its position while it steps, so that a number may be half the old one), a place counts when the next
report does not lie before it.

How much motion lies ahead of the board, in seconds, bounds how late a fault of this kind is found
out, so no more of it is sent than the board's planner has use for (:attr:`PositionTracker.seconds`). A
planner full of moves that take seconds each would hide one for a minute.

Only moves in absolute mm, and lines that do not move, are understood; after any other nothing is
known until :meth:`PositionTracker.begin`.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from cnc.boards.grbl.lines import bare

SLACK = 0.03
"""mm that a reported position may be off for decimals and rounding; the board's steps and its
chords of arcs come on top.
"""
SPARE = 4
"""Moves that count beside those that planner and receive buffer can hold."""
SHARP = 0.9
"""Cosine of the turn from one move to the next below which the board about stops between them."""
FULL_TURN = 5e-7
"""rad: an arc that turns by less is a full circle to GRBL (config.h,
ARC_ANGULAR_TRAVEL_EPSILON).
"""

_WORD = re.compile(r"([A-Z])([-+]?[0-9]*\.?[0-9]+|[-+]?[0-9]+\.)")
_MOTION = {"0": 0, "1": 1, "2": 2, "3": 3, "38.2": 4, "38.3": 4, "38.4": 4, "38.5": 4}
_TRAVERSE, _ARCS, _PROBE = 0, (2, 3), 4
_PLANES = {"17": (0, 1), "18": (2, 0), "19": (1, 2)}
_HARMLESS = frozenset(("4", "21", "40", "49", "54", "61", "80", "90", "94"))
_ENDS = frozenset(("2", "30"))
_AXES = "XYZABC"
_CENTRES = "IJK"

Point = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Limits:
    """Of the board's axes: rates mm/s, accelerations mm/s^2; inf where they are not known."""

    rates: Sequence[float] = ()
    accelerations: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class StraightMove:
    """A straight move, of a source line. Positions are the machine's, mm; ``seconds``: about the
    time that it takes.
    """

    line: int
    start: Point
    end: Point
    length: float
    seconds: float

    def nearest(self, point: Point, after: float, slack: float) -> tuple[float, float]:
        """The part of the move, not before the part ``after``, at which it comes within ``slack``
        of a point, and the distance there.
        """
        along = sum(
            (b - a) * (p - a) for a, b, p in zip(self.start, self.end, point, strict=True)
        ) / (self.length * self.length)
        part = min(max(along, after), 1.0)
        return part, math.dist(
            point, [a + part * (b - a) for a, b in zip(self.start, self.end, strict=True)]
        )


@dataclass(frozen=True, slots=True)
class ArcMove:
    """An arc, or a screw, about ``centre`` in the plane of two columns: from the angle ``first`` on
    by ``turn`` rad, counter-clockwise.
    """

    line: int
    start: Point
    end: Point
    seconds: float
    plane: tuple[int, int]
    centre: tuple[float, float]
    radius: float
    first: float
    turn: float

    def nearest(self, point: Point, after: float, slack: float) -> tuple[float, float]:
        """As :meth:`StraightMove.nearest`. Just before its beginning the board seems to be at the end
        of a full circle: it is where it was.
        """
        waits = math.dist(point, self._at(after))
        if waits <= slack:
            return after, waits
        i, j = self.plane
        angle = math.atan2(point[j] - self.centre[1], point[i] - self.centre[0]) - self.first
        turned, whole = (angle if self.turn > 0.0 else -angle) % math.tau, abs(self.turn)
        # Neither on the arc nor past it, but before it.
        along = (turned - math.tau if turned - whole > math.tau - turned else turned) / whole
        # Along a screw the height tells more the steeper it is.
        rises = [
            0.0 if column in self.plane else b - a
            for column, (a, b) in enumerate(zip(self.start, self.end, strict=True))
        ]
        round_ = (self.radius * self.turn) ** 2
        risen = sum(rise * (p - a) for rise, p, a in zip(rises, point, self.start, strict=True))
        part = min(
            max((round_ * along + risen) / (round_ + sum(rise * rise for rise in rises)), after),
            1.0,
        )
        distance = math.dist(point, self._at(part))
        return (part, distance) if distance < waits else (after, waits)

    def _at(self, part: float) -> list[float]:
        place = [a + part * (b - a) for a, b in zip(self.start, self.end, strict=True)]
        angle = self.first + part * self.turn
        place[self.plane[0]] = self.centre[0] + self.radius * math.cos(angle)
        place[self.plane[1]] = self.centre[1] + self.radius * math.sin(angle)
        return place


class PositionTracker:
    """Follows the lines that are sent, and the board along them.

    planner: moves that the board can hold. offset: what it adds to the numbers of a line. slack: mm
    that a position may be off.
    """

    def __init__(
        self,
        planner: int,
        offset: Sequence[float],
        slack: float = SLACK,
        limits: Limits | None = None,
    ) -> None:
        self._offset = tuple(offset)
        self._slack = slack
        self._planner = planner
        self._limits = limits or Limits()
        self._moves: deque[StraightMove | ArcMove] = deque()
        self._sent = 0
        self._numbers: deque[int] = deque()
        self._traverses: deque[float] = deque()
        self._traversing = 0.0
        self._passed = 0.0
        self._seconds = 0.0
        self._said = (0, 0.0)
        self._at: Point | None = None
        self._direction: Sequence[float] | None = None
        self._motion = -1
        self._feed = 0.0
        self._plane = _PLANES["17"]
        self._open_end = False

    def begin(self, position: Sequence[float]) -> None:
        """The board stands still here, with nothing to do."""
        self._moves.clear()
        self._numbers.clear()
        self._traverses.clear()
        self._passed = self._seconds = self._traversing = 0.0
        self._said = (0, 0.0)
        self._direction = None
        self._open_end = False
        self._at = tuple(position)

    @property
    def seconds(self) -> float:
        """Motion that lies ahead of the board at 100 %, about; 0 where nothing is known."""
        if self._at is None or not self._moves:
            return 0.0
        return self._seconds - self._passed * self._moves[0].seconds

    def seconds_at(self, feed: float, rapid: float) -> float:
        """The same at overrides of feeds and traverses, per cent."""
        ahead = self.seconds
        if not ahead:
            return 0.0
        traversing = self._traversing - self._passed * self._traverses[0]
        return (ahead - traversing) * 100.0 / feed + traversing * 100.0 / rapid

    @property
    def lines(self) -> int:
        """Lines sent from the first move on that is not over yet, or was not when the board
        reported last; 0 if there is none.
        """
        return self._sent - self._numbers[0] if self._moves else 0

    @property
    def line(self) -> int:
        """Source line of the move that the board is on, 0 where that is not known."""
        return self._moves[0].line if self._at is not None and self._moves else 0

    def send(self, text: str, number: int) -> None:
        """A line was sent; ``number``: its source line."""
        self._sent += 1
        if self._at is None:
            return
        line = bare(text)
        words = _WORD.findall(line)
        if line.startswith("$") or sum(len(letter) + len(value) for letter, value in words) != len(
            line
        ):
            self._at = None
            return
        ends = list(self._at)
        centre: dict[str, float] = {}
        moves = False
        for letter, value in words:
            if letter in _AXES and _AXES.index(letter) < len(ends):
                column = _AXES.index(letter)
                ends[column] = float(value) + self._offset[column]
                moves = True
            elif letter == "F":
                self._feed = float(value) / 60.0
            elif letter == "G":
                code = value.lstrip("0") or "0"
                if code in _MOTION:
                    self._motion = _MOTION[code]
                elif code in _PLANES:
                    self._plane = _PLANES[code]
                elif code not in _HARMLESS:
                    self._at = None
                    return
            elif letter in _CENTRES:
                centre[letter] = float(value)
                moves = True
            elif letter == "M" and value.lstrip("0") in _ENDS:
                self._motion, self._plane = _MOTION["1"], _PLANES["17"]
        if not moves:
            # The board comes to rest before most of what is no motion.
            self._direction = None
            return
        if self._motion < 0 or "R" in dict(words):
            self._at = None
            return
        self._open_end = self._motion == _PROBE
        self._add(number, tuple(ends), centre)

    def off(self, position: Sequence[float], waiting: int) -> float:
        """The board reports to be here: how far that is from all its way ahead, 0 within the slack.
        ``waiting``: unanswered lines.
        """
        if self._at is None or len(position) != len(self._at):
            return 0.0
        # Twice: moves that go nowhere take no place in the planner.
        while len(self._moves) > 2 * self._planner + waiting + SPARE:
            self._leave()
        point = tuple(position)
        found, closest = self._find(point, self._said)
        if found is not None:
            over, self._said = self._said, found
            for _ in range(over[0]):
                self._leave()
            self._passed = over[1]
            return 0.0
        # What was said before may have been wrong.
        found, nearest = self._find(point, (0, self._passed))
        if found is None:
            return min(closest, nearest)
        self._said = found
        return 0.0

    def _find(
        self, point: Point, after: tuple[int, float]
    ) -> tuple[tuple[int, float] | None, float]:
        """The first place of the way (number of the move, part of it) behind ``after`` that is at
        the point; how near the way comes.
        """
        assert self._at is not None
        closest = math.inf
        for number in range(after[0], len(self._moves)):
            part, distance = self._moves[number].nearest(
                point, after[1] if number == after[0] else 0.0, self._slack
            )
            if distance <= self._slack:
                return (number, part), distance
            closest = min(closest, distance)
        distance = math.dist(point, self._at)
        return ((len(self._moves), 0.0) if distance <= self._slack else None), min(
            closest, distance
        )

    def arrived(self, position: Sequence[float]) -> float:
        """The board has come to rest here with nothing left to do: how far that is from where the
        lines lead, 0 within the slack.
        """
        if self._at is None or self._open_end or len(position) != len(self._at):
            return 0.0
        distance = math.dist(position, self._at)
        if distance > self._slack:
            return distance
        while self._moves:
            self._leave()
        return 0.0

    def _leave(self) -> None:
        """The first of the moves is over."""
        self._seconds -= self._moves.popleft().seconds
        self._traversing -= self._traverses.popleft()
        self._numbers.popleft()
        self._passed = 0.0
        number, part = self._said
        self._said = (number - 1, part) if number else (0, 0.0)

    def _add(self, line: int, end: Point, centre: dict[str, float]) -> None:
        assert self._at is not None
        start, self._at = self._at, end
        if self._motion in _ARCS:
            move: StraightMove | ArcMove = self._round(line, start, end, centre)
            self._direction = None
        else:
            length = math.dist(start, end)
            if not length:
                return
            direction = [(b - a) / length for a, b in zip(start, end, strict=True)]
            move = StraightMove(line, start, end, length, self._time(length, direction))
            self._direction = direction
        traverse = move.seconds if self._motion == _TRAVERSE else 0.0
        self._seconds = self._seconds + move.seconds if self._moves else move.seconds
        self._traversing = self._traversing + traverse if self._moves else traverse
        self._traverses.append(traverse)
        self._moves.append(move)
        self._numbers.append(self._sent - 1)

    def _time(self, length: float, direction: Sequence[float]) -> float:
        """Seconds of a straight move, and of the stop before it where the way turns sharply."""
        limits, before = self._limits, self._direction
        speed = self._feed if self._motion else math.inf
        pull = math.inf
        for share, rate, acceleration in zip(
            direction, limits.rates, limits.accelerations, strict=False
        ):
            if share:
                speed = min(speed, rate / abs(share))
                pull = min(pull, acceleration / abs(share))
        if not 0.0 < speed < math.inf:
            return 0.0
        if (
            before is not None
            and sum(a * b for a, b in zip(before, direction, strict=True)) > SHARP
        ):
            return length / speed
        return (
            length / speed + speed / pull
            if length * pull > speed * speed
            else 2.0 * math.sqrt(length / pull)
        )

    def _round(self, line: int, start: Point, end: Point, centre: dict[str, float]) -> ArcMove:
        i, j = self._plane
        about = start[i] + centre.get(_CENTRES[i], 0.0), start[j] + centre.get(_CENTRES[j], 0.0)
        radius = math.dist((start[i], start[j]), about)
        first = math.atan2(start[j] - about[1], start[i] - about[0])
        turn = (math.atan2(end[j] - about[1], end[i] - about[0]) - first) % math.tau
        if self._motion == _MOTION["2"]:
            turn -= math.tau
        if abs(turn) < FULL_TURN:
            turn += math.tau if self._motion == _MOTION["3"] else -math.tau
        rates = self._limits.rates
        speed = min(self._feed, rates[i], rates[j]) if max(i, j) < len(rates) else self._feed
        across = [
            b - a
            for column, (a, b) in enumerate(zip(start, end, strict=True))
            if column not in (i, j)
        ]
        length = math.hypot(radius * turn, *across)
        return ArcMove(
            line, start, end, length / speed if speed else 0.0, (i, j), about, radius, first, turn
        )
