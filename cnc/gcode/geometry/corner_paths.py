"""Paths of the tool's centre around outside corners."""

from __future__ import annotations

import cmath
import math

from cnc.gcode.geometry.offset_curves import Curve, OffsetArc, angle, straight_offset


def around_corner(
    corner: complex, ends: tuple[complex, complex], side: int, radius: float, *, rapid: bool
) -> tuple[Curve, ...]:
    """Return the path around an outside corner.

    Args:
        corner: The corner, mm.
        ends: Start and end of the path.
        side: Side of the tool, 1 for left and -1 for right.
        radius: Tool radius, mm.
        rapid: Return the lines of a polygon outside the arc, in steps of at most 45 degrees.

    Returns:
        An arc, or lines.
    """
    leave, enter = ends
    ray = leave - corner
    turned = abs(angle((enter - corner) * ray.conjugate()))
    if not rapid:
        return (OffsetArc(corner, leave, enter, corner, radius, -side, turned, 0.0),)
    steps = math.ceil(turned / (math.pi / 4))
    far = 1.0 / math.cos(turned / steps / 2)
    corners = [
        corner + ray * cmath.rect(far, -side * turned * (step + 0.5) / steps)
        for step in range(steps)
    ]
    return tuple(
        straight_offset(start, end, 0, 0.0)
        for start, end in zip([leave, *corners], [*corners, enter], strict=True)
    )
