r"""How near the tool's centre comes to a move of the contour, exactly, between lines and arcs.

A corner says that the tool fits where two moves meet, and nothing of what is farther along them: an
arc may lead back to the move before it, into a pocket that is narrower at its mouth than where they
met.

           a
        .------P      The tool fits into the corner at Q and along both moves there, but not past P:
     .'    o    \     its centre is beside b all the way, and comes nearer to P than its radius.
     b '.       a
          `- - -Q

The distance from a move is least at an end of the path, beside an end of the move, where both are
square to the line between them, or where they cross: these few places are tried, each by its
distance from the move. That is why none of them has to be known well: the distance from a place
that is a little off is still one that the tool does come to.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

from cnc.gcode.geometry.offset_curves import Curve, OffsetArc, OffsetLine, meet


def clearance(path: Curve, start: float, stop: float, move: Curve) -> float:
    """The least distance of a path, from ``start`` to ``stop`` in its own units after its start,
    from a whole move; all in mm.
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
    """The point so many of its units after a curve's start."""
    if isinstance(curve, OffsetLine):
        return curve.first + along * curve.heading
    return curve.center + (curve.first - curve.center) * cmath.rect(1.0, curve.spin * along)


def distance(point: complex, move: Curve) -> float:
    """A point's distance from a move, mm."""
    if isinstance(move, OffsetLine):
        along = min(max(move.distance_along(point), 0.0), move.length)
        return abs(point - move.first - along * move.heading)
    if move.distance_along(point) % math.tau <= move.length:
        return abs(abs(point - move.center) - move.radius)
    return min(abs(point - move.first), abs(point - move.last))


def _least(path: Curve, move: Curve) -> Iterator[complex]:
    """Where a path's distance from a move may be least, if neither had ends; and beside the ends of
    the move.
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
