"""Moves with a chamfer or a round at their end: a move is kept until the next one is known."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cnc.gcode.core.arcs import ArcMoves
from cnc.gcode.core.context import Executor
from cnc.gcode.reader.words import LineWords, Word, fault, positive
from cnc.model.blocks import ArcFeed
from cnc.model.diagnostics import CncError, GcodeError

# Chamfers and rounds between two moves: ``,C`` and ``,R``. Those at arcs: corner_rounds.
#
# The corner between the move of the line and the next one is cut by a chamfer, C from the corner on
# both moves, or rounded by an arc of radius R that touches both. Source: FANUC Series 0i operator's
# manual, "Optional chamfering and corner R"; Haas, "Mill Operator's Manual", G01.

_ROUNDING = 1e-9
_STRAIGHT = 1e-9
"""Sine of an angle between two moves that counts as none."""

_CORNERS = (",C", ",R", ",H")
"""Chamfer by its legs, round, chamfer by its own length (SINUMERIK's CHF)."""

Point = tuple[float, float]


class Corner(NamedTuple):
    """A corner whose second move is not known yet.

    Attributes:
        word: ``,C``, ``,R``, or ``,H`` for SINUMERIK's CHF.
        size: mm.
        start: Machine position at the start of the first move.
        end: The corner.
        feed: Feed of the first move, mm/s.
        line: Line of the first move.
        plane: Columns of the axes of the plane.
        arc: The first move, if it is an arc.
    """

    word: Word
    size: float
    start: list[float]
    end: list[float]
    feed: float
    line: int
    plane: tuple[int, int]
    arc: ArcFeed | None = None


class Cut(NamedTuple):
    """The way round a corner.

    Attributes:
        begin: End of the first move.
        end: Start of the second move.
        centre: Centre of the arc in the plane; None for a chamfer.
        turns: Turns of the arc, anticlockwise positive.
    """

    begin: list[float]
    end: list[float]
    centre: Point | None
    turns: float


def take(words: LineWords, user: str) -> Word | None:
    """Take the word of a corner.

    Raises:
        GcodeError: ``corner-angle`` for ``,A``, ``word-wanted-twice``.
    """
    if not words.rest:
        return None
    if ",A" in words.rest:
        angle = words.rest[",A"]
        raise fault("corner-angle", f"{angle.written}: only a G1 has the angle of a line", angle)
    given = [word for letter in _CORNERS if (word := words.take(letter, user))]
    if len(given) > 1:
        raise fault("word-wanted-twice", "a corner takes one of ,C and ,R", given[1])
    word = given[0] if given else None
    if word is not None:
        positive(word, "the size")
    return word


def line_with_angle(
    word: Word, start: list[float], end: list[float], plane: tuple[int, int], given: list[int]
) -> list[float]:
    """Return the end of a straight move of which one axis and the angle are given (``,A``).

    The angle counts from the first axis of the plane, anticlockwise. Source: FANUC Series 0i,
    "Direct input of drawing dimensions"; Siemens, "Fundamentals", "Contour definitions" (ANG).

    Args:
        word: The angle, degrees.
        start: Machine position at the start.
        end: Machine position at the end by the axis words alone.
        plane: Columns of the axes of the plane.
        given: Columns of the axes of the plane that the line gives.

    Raises:
        GcodeError: ``corner-angle``.
    """
    if len(given) != 1:
        message = f"{word.written} needs one axis of the plane; the angle gives the other"
        raise fault("corner-angle", message, word, "give one of the two axes")
    (given_axis,) = given
    (free_axis,) = (index for index in plane if index != given_axis)
    angle, target = math.radians(word.number), end.copy()
    first, second = math.cos(angle), math.sin(angle)
    along, across = (first, second) if given_axis == plane[0] else (second, first)
    if abs(along) < _STRAIGHT:
        message = f"{word.written} is at right angles to the axis that the line gives"
        raise fault("corner-angle", message, word, "give the other axis of the plane")
    target[free_axis] = start[free_axis] + (end[given_axis] - start[given_axis]) * across / along
    return target


def cut(corner: Corner, following: list[float]) -> Cut:
    """Return the way round a corner.

    Args:
        corner: The corner.
        following: Machine position at the end of the second move.

    Raises:
        GcodeError: ``corner-plane``, ``corner-too-large``.
    """
    i, j = corner.plane
    word = corner.word
    for one, other in ((corner.start, corner.end), (corner.end, following)):
        if any(a != b for n, (a, b) in enumerate(zip(one, other, strict=True)) if n not in (i, j)):
            raise out_of_plane(word)
    before = _direction(corner.start, corner.end, corner.plane)
    after = _direction(corner.end, following, corner.plane)
    if before is None or after is None:
        raise fault("corner-too-large", f"{word.written}: a move of the corner has no length", word)
    (ux, uy, first), (vx, vy, second) = before, after
    turn = math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
    if abs(math.sin(turn)) < _STRAIGHT:
        raise fault("corner-too-large", f"{word.written}: the moves have no corner", word)
    is_round = word.letter == ",R"
    length = corner.size * math.tan(abs(turn) / 2.0) if is_round else corner.size
    if word.letter == ",H":
        length = corner.size / (2.0 * math.cos(turn / 2.0))
    if length > min(first, second) + _ROUNDING:
        message = f"{word.written} needs {length:.6g} mm of both moves; they have {first:.6g} mm "
        message += f"and {second:.6g} mm"
        raise fault("corner-too-large", message, word, "make it smaller")
    begin, end = corner.end.copy(), corner.end.copy()
    begin[i], begin[j] = corner.end[i] - ux * length, corner.end[j] - uy * length
    end[i], end[j] = corner.end[i] + vx * length, corner.end[j] + vy * length
    if not is_round:
        return Cut(begin, end, None, 0.0)
    side = math.copysign(corner.size, turn)
    return Cut(begin, end, (begin[i] - uy * side, begin[j] + ux * side), turn / math.tau)


def out_of_plane(word: Word) -> GcodeError:
    """Return the error of a corner whose moves leave the plane."""
    message = f"{word.written}: both moves of a corner must lie in the plane"
    return fault("corner-plane", message, word, "move the other axes on lines of their own")


def not_followed(corner: Corner, what: str, *, arcs: bool) -> CncError:
    """Return the error of a corner that ``what`` follows; ``arcs``: whether arcs may follow."""
    wanted = "a G1, G2 or G3" if arcs else "a G1"
    message = f"{corner.word.written} needs {wanted} in the next line, not {what}"
    return fault("corner-next", message, corner.word).at(line=corner.line)


def _direction(
    start: list[float], end: list[float], plane: tuple[int, int]
) -> tuple[float, float, float] | None:
    """Return the unit vector and the length of a move in the plane; None for length 0."""
    x, y = end[plane[0]] - start[plane[0]], end[plane[1]] - start[plane[1]]
    length = math.hypot(x, y)
    return (x / length, y / length, length) if length else None


# Rounds and chamfers between two moves of a plane, of which at least one is an arc.
#
# The centre of a round of radius r lies at the distance r from both moves, on the inner side of the
# corner: on a parallel of a line, and on a circle around the centre of an arc. Points are complex
# numbers in mm.


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
    candidates: list[tuple[float, Round]] = []
    for centre in _meetings(_centres(first, side * radius), _centres(second, side * radius)):
        if any(isinstance(move, Arc) and centre == move.centre for move in (first, second)):
            continue
        begin, end = first.nearest(centre), second.nearest(centre)
        if not (first.holds(begin) and second.holds(end)):
            continue
        angle = cmath.phase((end - centre) / (begin - centre))
        if angle * side < 0.0:
            angle += side * math.tau
        candidates.append((abs(centre - corner), Round(begin, end, centre, angle / math.tau)))
    return min(candidates, key=lambda candidate: candidate[0])[1] if candidates else None


_Locus = tuple[complex, complex] | tuple[complex, float]
"""A point and a direction of a line, or centre and radius of a circle."""


def _centres(move: Move, offset: float) -> _Locus:
    """Return the places at a distance to the left of a move."""
    if isinstance(move, Line):
        along = move.direction(move.start)
        return move.start + 1j * offset * along, along
    return move.centre, abs(move.start - move.centre) - move.spin * offset


def _meetings(first: _Locus, second: _Locus) -> list[complex]:
    """Return the common points of two loci, of which at least one is a circle."""
    if isinstance(first[1], complex):
        first, second = second, first
    centre, radius = first
    if isinstance(radius, complex) or radius <= 0.0:
        return []
    point, size = second
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


class CornerMoves(Executor):
    """The corner of the last move, if it has one.

    Args:
        arcs: The arcs of the program, which know its plane.
        make_straight: Puts a straight move out: its end, feed and line.
        make_arc: Puts an arc out.

    Attributes:
        corner: The corner whose second move is not known yet.
    """

    def __init__(
        self,
        arcs: ArcMoves,
        make_straight: Callable[[list[float], float, int], None],
        make_arc: Callable[[ArcFeed], None],
    ) -> None:
        super().__init__(arcs.context)
        self.corner: Corner | None = None
        self._arcs, self._make_straight, self._make_arc = arcs, make_straight, make_arc
        self._corners = arcs.context.dialect.motion.corners

    def hold(
        self, word: Word, start: list[float], end: list[float], feed: float, line: int
    ) -> None:
        """Keep a straight move until the next one is known."""
        plane, size = self._size(word)
        self.corner = Corner(word, size, start, end, feed, line, plane)

    def hold_arc(self, word: Word, start: list[float], block: ArcFeed) -> None:
        """Keep an arc until the next move is known.

        Raises:
            GcodeError: ``corner-next``.
        """
        if not self._may_have_arc(word):
            message = f"{word.written} at an arc: it needs two straight moves"
            raise fault("corner-next", message, word)
        plane, size = self._size(word)
        end = block.end.tolist()
        self.corner = Corner(word, size, start, end, block.feed, block.line, plane, block)

    def _may_have_arc(self, word: Word) -> bool:
        """Whether one of the moves of a corner may be an arc."""
        return self._corners == "all" or (self._corners == "rounds" and word.letter == ",R")

    def _size(self, word: Word) -> tuple[tuple[int, int], float]:
        """Return the plane of a corner, and its size in mm."""
        plane = self._arcs.plane_columns(word, word.letter)
        factor = self._coordinates.transform.scale(plane)
        if factor is None:
            raise fault("scaling-arc", f"{word.written} under different factors of G51", word)
        return plane, word.number * self._state.scale * factor

    def finish(self, following: list[float]) -> list[float]:
        """Make the first move and the way round the corner; return the place behind it.

        Args:
            following: Machine position at the end of the straight second move.
        """
        corner = self._taken()
        if corner.arc is not None:
            line = self._line(corner, corner.end, following)
            return self._rounded(corner, self._round(corner, line))
        try:
            way = cut(corner, following)
        except GcodeError as error:
            raise error.at(line=corner.line) from None
        self._make_straight(way.begin, corner.feed, corner.line)
        if way.centre is None:
            self._make_straight(way.end, corner.feed, corner.line)
        else:
            self._make_arc(self._block(corner, way.centre, way.end, corner.size, way.turns))
        return way.end

    def finish_before_arc(self, block: ArcFeed) -> tuple[ArcFeed, list[float]]:
        """Make the first move and the round; return what is left of the arc, and its start.

        Raises:
            GcodeError: ``corner-next``, ``corner-plane``, ``corner-too-large``.
        """
        assert self.corner is not None
        if not self._may_have_arc(self.corner.word):
            raise self.fault("an arc")
        corner = self._taken()
        arc = self._arc(corner, corner.end, block)
        rounding = self._round(corner, arc)
        start = self._rounded(corner, rounding)
        left = arc.spin * max(0.0, abs(arc.turns) - arc.part(rounding.end))
        return replace(block, turns=left), start

    def _taken(self) -> Corner:
        corner = self.corner
        assert corner is not None
        self.corner = None
        return corner

    def _round(self, corner: Corner, second: Line | Arc) -> Round:
        first = (
            self._line(corner, corner.start, corner.end)
            if corner.arc is None
            else self._arc(corner, corner.start, corner.arc)
        )
        make = round_between if corner.word.letter == ",R" else chamfer_between
        rounding = make(first, second, corner.size)
        if rounding is None:
            message = f"{corner.word.written} does not fit between the two moves"
            hint = "make it smaller; tangential moves have no corner"
            raise fault("corner-too-large", message, corner.word, hint).at(line=corner.line)
        return rounding

    def _rounded(self, corner: Corner, rounding: Round) -> list[float]:
        """Make the first move and the round; return the place behind it."""
        begin, end = (self._at(corner, place) for place in (rounding.begin, rounding.end))
        if corner.arc is None:
            self._make_straight(begin, corner.feed, corner.line)
        else:
            arc = self._arc(corner, corner.start, corner.arc)
            turns = arc.spin * arc.part(rounding.begin)
            self._make_arc(replace(corner.arc, end=np.array(begin), turns=turns))
        if rounding.centre is None:
            self._make_straight(end, corner.feed, corner.line)
            return end
        centre = rounding.centre.real, rounding.centre.imag
        self._make_arc(self._block(corner, centre, end, corner.size, rounding.turns))
        return end

    def _block(
        self,
        corner: Corner,
        centre: tuple[float, float],
        end: list[float],
        radius: float,
        turns: float,
    ) -> ArcFeed:
        plane, file = self._state.plane, self._here.file
        return ArcFeed(file, corner.line, plane, centre, np.array(end), radius, turns, corner.feed)

    def _at(self, corner: Corner, place: complex) -> list[float]:
        """Return the machine position of a place in the plane of a corner."""
        position = corner.end.copy()
        position[corner.plane[0]], position[corner.plane[1]] = place.real, place.imag
        return position

    def _line(self, corner: Corner, start: list[float], end: list[float]) -> Line:
        self._check_plane(corner, start, end)
        i, j = corner.plane
        line = Line(complex(start[i], start[j]), complex(end[i], end[j]))
        if line.start == line.end:
            message = f"{corner.word.written}: a move of the corner has no length"
            raise fault("corner-too-large", message, corner.word).at(line=corner.line)
        return line

    def _arc(self, corner: Corner, start: list[float], block: ArcFeed) -> Arc:
        end = block.end.tolist()
        self._check_plane(corner, start, end)
        i, j = corner.plane
        begin, last = complex(start[i], start[j]), complex(end[i], end[j])
        return Arc(begin, last, complex(*block.center), block.turns)

    @staticmethod
    def _check_plane(corner: Corner, start: list[float], end: list[float]) -> None:
        others = (at for at in range(len(start)) if at not in corner.plane)
        if any(start[at] != end[at] for at in others):
            raise out_of_plane(corner.word).at(line=corner.line)

    def fault(self, what: str) -> CncError:
        """Return the error of a corner that ``what`` follows, and no feed move."""
        assert self.corner is not None
        return not_followed(self.corner, what, arcs=self._may_have_arc(self.corner.word))
