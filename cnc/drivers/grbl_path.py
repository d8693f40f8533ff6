r"""Where a GRBL board can be: on one of the moves that it was sent and may not have finished.

A line that loses a few of its bytes on the way may still be a line that the board takes: ``X12.5`` becomes ``X1.5``. Nothing it answers
tells that, but where it goes does. Positions that it reports are compared with the last moves that were sent:

                      o---------o            moves that the planner may hold, or the receive buffer
                     /           \
            ---o----o             o-- x      x is off them all: some line was not what it was when it was sent

Only moves in absolute mm, and lines that do not move, are understood; after any other nothing is known until :meth:`Whereabouts.begin`.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from cnc.drivers.grbl_lines import bare

SLACK = 0.1
"""mm that a reported position may be off for steps and decimals; the chords that the board makes of arcs come on top."""
SPARE = 4
"""Moves that count beside those that planner and receive buffer can hold."""

_WORD = re.compile(r"([A-Z])([-+]?[0-9]*\.?[0-9]+|[-+]?[0-9]+\.)")
_MOTION = {"0": 0, "1": 1, "2": 2, "3": 3, "38.2": 1, "38.3": 1, "38.4": 1, "38.5": 1}
_PLANES = {"17": (0, 1), "18": (2, 0), "19": (1, 2)}
_HARMLESS = frozenset(("4", "21", "40", "49", "54", "61", "80", "90", "94"))
_AXES = "XYZABC"
_CENTRES = "IJK"


@dataclass(frozen=True, slots=True)
class Move:
    """A straight move, or an arc about ``centre`` in the ``plane`` of two columns. Positions are the machine's, mm."""

    start: tuple[float, ...]
    end: tuple[float, ...]
    plane: tuple[int, int] | None = None
    centre: tuple[float, float] = (0.0, 0.0)

    def distance(self, point: Sequence[float]) -> float:
        """How far a point is from the move; of an arc, from its whole circle or screw."""
        if self.plane is None:
            way = [b - a for a, b in zip(self.start, self.end, strict=True)]
            off = [p - a for a, p in zip(self.start, point, strict=True)]
            length = sum(w * w for w in way)
            part = min(max(sum(w * o for w, o in zip(way, off, strict=True)) / length, 0.0), 1.0) if length else 0.0
            return math.dist(off, [part * w for w in way])
        first, second = self.plane
        radius = math.dist((self.start[first], self.start[second]), self.centre)
        gaps = [math.dist((point[first], point[second]), self.centre) - radius]
        for column in set(range(len(point))) - {first, second}:
            low, high = sorted((self.start[column], self.end[column]))
            gaps.append(max(low - point[column], point[column] - high, 0.0))
        return math.hypot(*gaps)


class Whereabouts:
    """Follows the lines that are sent.

    planner: moves that the board can hold. offset: what it adds to the numbers of a line. slack: mm that a position may be off.
    """

    def __init__(self, planner: int, offset: Sequence[float], slack: float = SLACK) -> None:
        self._offset = tuple(offset)
        self._slack = slack
        self._planner = planner
        self._moves: deque[Move] = deque()
        self._at: tuple[float, ...] | None = None
        self._motion = -1
        self._plane = _PLANES["17"]

    def begin(self, position: Sequence[float]) -> None:
        """The board stands still here, with nothing to do."""
        self._moves.clear()
        self._at = tuple(position)

    def send(self, text: str) -> None:
        """A line was sent."""
        if self._at is None:
            return
        line = bare(text)
        words = _WORD.findall(line)
        if line.startswith("$") or sum(len(letter) + len(value) for letter, value in words) != len(line):
            self._at = None
            return
        ends = list(self._at)
        centre: dict[str, float] = {}
        moves = False
        for letter, value in words:
            if letter == "G":
                code = value.lstrip("0") or "0"
                if code in _MOTION:
                    self._motion = _MOTION[code]
                elif code in _PLANES:
                    self._plane = _PLANES[code]
                elif code not in _HARMLESS:
                    self._at = None
                    return
            elif letter in _AXES and _AXES.index(letter) < len(ends):
                column = _AXES.index(letter)
                ends[column] = float(value) + self._offset[column]
                moves = True
            elif letter in _CENTRES:
                centre[letter] = float(value)
                moves = True
        if not moves:
            return
        if self._motion < 0 or "R" in dict(words):
            self._at = None
            return
        self._add(tuple(ends), centre)

    def off(self, position: Sequence[float], waiting: int) -> float:
        """How far a reported position is from all that the board may be at, beyond the slack; ``waiting``: unanswered lines."""
        if self._at is None or len(position) != len(self._at):
            return 0.0
        # Twice: moves that go nowhere take no place in the planner.
        while len(self._moves) > 2 * self._planner + waiting + SPARE:
            self._moves.popleft()
        # The newest moves are the least likely, but the oldest is where the board is, most of the time.
        nearest = math.dist(position, self._at)
        for move in self._moves:
            nearest = min(nearest, move.distance(position))
            if nearest <= self._slack:
                return 0.0
        return nearest if nearest > self._slack else 0.0

    def _add(self, end: tuple[float, ...], centre: dict[str, float]) -> None:
        assert self._at is not None
        if self._motion >= 2:
            first, second = self._plane
            about = self._at[first] + centre.get(_CENTRES[first], 0.0), self._at[second] + centre.get(_CENTRES[second], 0.0)
            self._moves.append(Move(self._at, end, self._plane, about))
        else:
            self._moves.append(Move(self._at, end))
        self._at = end
