r"""Least distance between the path of the tool's centre and a move of the contour, exact.

A corner can be possible, although the tool does not fit farther along the moves: an arc may lead
back to the move before it, into a pocket that is narrower at its mouth than at the corner.

           a
        .------P      The tool fits into the corner at Q and along both moves there, but not past P:
     .'    o    \     its centre is beside b along the whole arc, and comes nearer to P than its
     b '.       a     radius.
          `- - -Q

The distance from a move is least at an end of the path, beside an end of the move, where both are
perpendicular to the line between them, or where they cross. Each of these points is tested by its
distance from the move. A point that is slightly wrong is harmless: the tool does come to the
distance there.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

from cnc.gcode.geometry.offset_curves import SLACK, Curve, OffsetArc, OffsetLine, meet, programmed


def is_clear(path: Curve, start: float, stop: float, offset: Curve, radius: float) -> bool:
    """Return whether no point of a part of a path is nearer to a move than the tool radius.

    Two straight moves with a corner never are.

    Args:
        path: Path of the tool's centre.
        start: Start of the part, in the units of the path.
        stop: End of the part.
        offset: Offset curve of the move.
        radius: Tool radius, mm.
    """
    if isinstance(path, OffsetLine) and isinstance(offset, OffsetLine):
        return True
    return clearance(path, start, stop, programmed(offset)) >= radius - SLACK


def clearance(path: Curve, start: float, stop: float, move: Curve) -> float:
    """Return the least distance of a part of a path from a whole move, mm.

    Args:
        path: Path of the tool's centre.
        start: Start of the part, in the units of the path.
        stop: End of the part.
        move: The move.
    """
    stop = max(start, stop)
    least = min(distance(place(path, start), move), distance(place(path, stop), move))
    for point in _least(path, move):
        along = path.distance_along(point)
        if isinstance(path, OffsetArc):
            along = start + (along - start) % math.tau
        if start < along < stop:
            least = min(least, distance(point, move))
    return least


def place(curve: Curve, along: float) -> complex:
    """Return the point at a distance, in the units of the curve, after its start."""
    if isinstance(curve, OffsetLine):
        return curve.first + along * curve.heading
    return curve.center + (curve.first - curve.center) * cmath.rect(1.0, curve.spin * along)


def distance(point: complex, move: Curve) -> float:
    """Return the distance of a point from a move, mm."""
    if isinstance(move, OffsetLine):
        along = min(max(move.distance_along(point), 0.0), move.length)
        return abs(point - move.first - along * move.heading)
    if move.distance_along(point) % math.tau <= move.length:
        return abs(abs(point - move.center) - move.radius)
    return min(abs(point - move.first), abs(point - move.last))


def _least(path: Curve, move: Curve) -> Iterator[complex]:
    """Points at which the distance of a path from a move may be least.

    They are those of curves without ends, and the points beside the ends of the move.
    """
    centers = (
        (move.first, move.last, move.center)
        if isinstance(move, OffsetArc)
        else (move.first, move.last)
    )
    if isinstance(path, OffsetLine):
        for center in centers:
            yield place(path, path.distance_along(center))
    else:
        across = [center - path.center for center in centers]
        if isinstance(move, OffsetLine):
            across.append(1j * move.heading)
        for direction in across:
            if direction != 0.0:
                out = direction / abs(direction) * path.radius
                yield path.center + out
                yield path.center - out
    for left in (1, -1):
        crossing = meet(path, move, left)
        if crossing is not None:
            yield crossing
