"""Chamfers and rounds between two moves: ``,C`` and ``,R``. Those at arcs: corner_rounds.

The corner between the move of the line and the next one is cut by a chamfer, C from the corner on
both moves, or rounded by an arc of radius R that touches both. Source: FANUC Series 0i operator's
manual, "Optional chamfering and corner R"; Haas, "Mill Operator's Manual", G01.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.gcode.syntax.words import LineWords, Word, fault, positive
from cnc.model.blocks import ArcFeed
from cnc.model.diagnostics import CncError, GcodeError

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
    (known,) = given
    (other,) = (index for index in plane if index != known)
    angle, found = math.radians(word.number), end.copy()
    first, second = math.cos(angle), math.sin(angle)
    along, across = (first, second) if known == plane[0] else (second, first)
    if abs(along) < _STRAIGHT:
        message = f"{word.written} is at right angles to the axis that the line gives"
        raise fault("corner-angle", message, word, "give the other axis of the plane")
    found[other] = start[other] + (end[known] - start[known]) * across / along
    return found


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
