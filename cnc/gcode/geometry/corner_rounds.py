"""Rounds and chamfers between two moves of a plane, of which at least one is an arc.

The centre of a round of radius r lies at the distance r from both moves, on the inner side of the
corner: on a parallel of a line, and on a circle around the centre of an arc. Points are complex
numbers in mm.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

_STRAIGHT = 1e-9
"""Sine of an angle between two moves that counts as none."""
_ROUNDING = 1e-9


class Line(NamedTuple):
    """A straight move."""

    start: complex
    end: complex

    def direction(self, _: complex) -> complex:
        """Return the unit tangent, the same at each point."""
        return (self.end - self.start) / abs(self.end - self.start)

    def nearest(self, point: complex) -> complex:
        """Return the point of the infinite line that is nearest to a point."""
        along = self.direction(self.start)
        return self.start + ((point - self.start) * along.conjugate()).real * along

    def holds(self, point: complex) -> bool:
        """Return whether a point of the infinite line lies on the move."""
        done = ((point - self.start) * self.direction(self.start).conjugate()).real
        return -_ROUNDING <= done <= abs(self.end - self.start) + _ROUNDING


class Arc(NamedTuple):
    """A circular move; ``turns`` is positive anticlockwise."""

    start: complex
    end: complex
    centre: complex
    turns: float

    @property
    def spin(self) -> float:
        """1 anticlockwise, -1 clockwise."""
        return math.copysign(1.0, self.turns)

    def direction(self, point: complex) -> complex:
        """Return the unit tangent at a point of the arc."""
        ray = point - self.centre
        return self.spin * 1j * ray / abs(ray)

    def nearest(self, point: complex) -> complex:
        """Return the point of the circle that is nearest to a point."""
        ray = point - self.centre
        return self.centre + ray / abs(ray) * abs(self.start - self.centre)

    def part(self, point: complex) -> float:
        """Return the turns from the start to a point, at least 0 and less than 1."""
        angle = cmath.phase((point - self.centre) / (self.start - self.centre))
        return (self.spin * angle / math.tau) % 1.0

    def holds(self, point: complex) -> bool:
        """Return whether a point of the circle lies on the move."""
        size = max(abs(self.start - self.centre), _ROUNDING)
        part = self.part(point)
        slack = _ROUNDING / size
        return part <= abs(self.turns) + slack or part >= 1.0 - slack


Move = Line | Arc


class Round(NamedTuple):
    """A round: end of the first move, start of the second one, centre (None: chamfer), turns."""

    begin: complex
    end: complex
    centre: complex | None
    turns: float


def chamfer_between(first: Move, second: Move, size: float) -> Round | None:
    """Return the chamfer whose ends are at a straight distance from the corner of two moves.

    None if the moves have no corner, or one of them is too short.
    """
    corner = first.end
    turn = (first.direction(corner).conjugate() * second.direction(corner)).imag
    begin, end = _at_distance(first, corner, size, back=True), _at_distance(second, corner, size)
    if abs(turn) < _STRAIGHT or begin is None or end is None:
        return None
    return Round(begin, end, None, 0.0)


def _at_distance(move: Move, corner: complex, size: float, *, back: bool = False) -> complex | None:
    """Return the point of a move at a straight distance from the corner; None past its end."""
    sign = -1.0 if back else 1.0
    if isinstance(move, Line):
        point = corner + sign * size * move.direction(corner)
        return point if move.holds(point) else None
    ray = corner - move.centre
    half = size / (2.0 * abs(ray))
    if half > 1.0:
        return None
    angle = 2.0 * math.asin(half)
    if angle > abs(move.turns) * math.tau + _ROUNDING:
        return None
    return move.centre + ray * cmath.exp(1j * sign * move.spin * angle)


def round_between(first: Move, second: Move, radius: float) -> Round | None:
    """Return the round of a radius at the corner of two moves.

    None if the moves have no corner, or one of them is too short.
    """
    corner = first.end
    before, after = first.direction(corner), second.direction(corner)
    turn = (before.conjugate() * after).imag
    if abs(turn) < _STRAIGHT:
        return None
    side = math.copysign(1.0, turn)
    found: list[tuple[float, Round]] = []
    for centre in _meetings(_centres(first, side * radius), _centres(second, side * radius)):
        if any(isinstance(move, Arc) and centre == move.centre for move in (first, second)):
            continue
        begin, end = first.nearest(centre), second.nearest(centre)
        if not (first.holds(begin) and second.holds(end)):
            continue
        angle = cmath.phase((end - centre) / (begin - centre))
        if angle * side < 0.0:
            angle += side * math.tau
        found.append((abs(centre - corner), Round(begin, end, centre, angle / math.tau)))
    return min(found, key=lambda each: each[0])[1] if found else None


_Locus = tuple[complex, complex] | tuple[complex, float]
"""A point and a direction of a line, or centre and radius of a circle."""


def _centres(move: Move, offset: float) -> _Locus:
    """Return the places at a distance to the left of a move."""
    if isinstance(move, Line):
        along = move.direction(move.start)
        return move.start + 1j * offset * along, along
    return move.centre, abs(move.start - move.centre) - move.spin * offset


def _meetings(one: _Locus, other: _Locus) -> list[complex]:
    """Return the common points of two loci, of which at least one is a circle."""
    if isinstance(one[1], complex):
        one, other = other, one
    centre, radius = one
    if isinstance(radius, complex) or radius <= 0.0:
        return []
    point, size = other
    if isinstance(size, complex):
        foot = point + ((centre - point) * size.conjugate()).real * size
        square = radius**2 - abs(foot - centre) ** 2
        return [] if square < 0.0 else [foot + sign * math.sqrt(square) * size for sign in (1, -1)]
    apart = abs(point - centre)
    if size <= 0.0 or not abs(radius - size) <= apart <= radius + size or apart == 0.0:
        return []
    along = (point - centre) / apart
    x = (apart**2 + radius**2 - size**2) / (2.0 * apart)
    y = math.sqrt(max(0.0, radius**2 - x**2))
    return [centre + (x + sign * 1j * y) * along for sign in (1, -1)]
