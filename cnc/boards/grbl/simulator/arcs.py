"""Arcs as chords whose middle is at most ``$12`` from the circle (settings.md, ``$12``).

Sagitta e of a chord over the angle 2b on radius r: e = r (1 - cos b), so that
chord^2 = 4 (2 r e - e^2).
"""

from __future__ import annotations

import math

from cnc.boards.grbl.simulator.planner import Point

FULL_TURN = 2.0 * math.pi
SAME_ANGLE = 5e-7
"""rad between start and end below which the arc is a full circle."""


def chords(
    start: Point,
    end: Point,
    center: tuple[float, float],
    plane: tuple[int, int, int],
    clockwise: bool,
    tolerance: float,
) -> list[Point]:
    """Return the ends of the chords of an arc or helix.

    Args:
        start: Start point, mm.
        end: End point, mm.
        center: Centre from the start along the two axes of the plane, mm.
        plane: First, second and normal axis.
        clockwise: Sense of the arc.
        tolerance: ``$12``, mm.
    """
    first, second, _ = plane
    i, j = center
    radius = math.hypot(i, j)
    middle = (start[first] + i, start[second] + j)
    begin = math.atan2(-j, -i)
    turn = math.atan2(end[second] - middle[1], end[first] - middle[0]) - begin
    if clockwise:
        while turn >= -SAME_ANGLE:
            turn -= FULL_TURN
        while turn < -FULL_TURN - SAME_ANGLE:
            turn += FULL_TURN
    else:
        while turn <= SAME_ANGLE:
            turn += FULL_TURN
        while turn > FULL_TURN + SAME_ANGLE:
            turn -= FULL_TURN
    half = 2.0 * radius * tolerance - tolerance * tolerance
    pieces = int(0.5 * abs(turn) * radius / math.sqrt(half)) if half > 0.0 else 0
    points: list[Point] = []
    for piece in range(1, pieces):
        share = piece / pieces
        point = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
        point[first] = middle[0] + radius * math.cos(begin + share * turn)
        point[second] = middle[1] + radius * math.sin(begin + share * turn)
        points.append(tuple(point))
    points.append(end)
    return points
