"""Moves that a GRBL board has been sent, and the nearest place on them to a reported position."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul, sub
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SHARP_TURN = 0.9
"""Cosine of the turn between two moves below which the board nearly stops between them."""
FULL_TURN = 5e-7
"""rad. GRBL takes an arc that turns by less for a full circle (config.h,
ARC_ANGULAR_TRAVEL_EPSILON).
"""

Point = tuple[float, ...]
Floats = NDArray[np.float64]


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
