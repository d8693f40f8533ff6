r"""Offset curves in a plane, and their joins at corners.

The centre of a tool of radius r moves beside the programmed contour: the offset of a line is a
line, that of an arc an arc about the same centre. Points are complex numbers, first + second axis
of the plane * 1j, in mm. ``side`` is 1 for a tool on the left of the path and -1 for one on its
right. A turn, a curvature or a radius is positive towards the tool.

Source: T. Kramer, F. Proctor, E. Messina, "The NIST RS274NGC Interpreter, version 3" (NISTIR 6556),
appendix A. The corners are those of LinuxCNC, "Cutter radius compensation", except for arcs that
join at an angle: LinuxCNC takes them as smooth up to 0.05 rad.

            outside corner                inside corner
       ----E1.                                   |     |
             `.  arc of radius r about P     ----X..E1 |    both moves end where their
       ------P |                                       |    offsets cross
              \ E2                          ----------P
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

SLACK = 1e-9
"""mm. Rounding error that is allowed where the tool just fits."""
NEAR = 1e-6
"""mm. Moves that meet this near to their ends touch there."""
TANGENT = 1e-10
"""mm. Two moves are tangent if the tool comes nearer than its radius by less than this."""
MITRE = 0.05
"""rad.

At smaller outside corners the offset curves extend until they cross. The part is the same, and the
path has no very short arc.
"""


@dataclass(slots=True)
class OffsetLine:
    """The offset of a line that ends at ``corner``.

    It leads from ``first`` to ``last``, without the first ``begin`` mm.
    """

    corner: complex
    first: complex
    last: complex
    heading: complex
    length: float
    begin: float = 0.0

    curvature = 0.0
    scale = 1.0
    """mm of a unit of ``length`` and ``begin``."""

    @property
    def end_heading(self) -> complex:
        """Unit vector of the direction at the end; ``heading`` is that at the start."""
        return self.heading

    def distance_along(self, point: complex) -> float:
        """Return the position of a point along the curve, from ``first``."""
        return _dot(point - self.first, self.heading)

    def distance_to_end(self, point: complex) -> float:
        """Return the distance along the curve from a point to ``last``."""
        return _dot(self.last - point, self.heading)


@dataclass(slots=True)
class OffsetArc:
    """The offset of an arc that ends at ``corner``.

    ``spin`` is 1 for counter-clockwise and -1 for clockwise. ``length`` and ``begin`` are angles in
    rad. ``curvature`` is that of the programmed arc.
    """

    corner: complex
    first: complex
    last: complex
    center: complex
    radius: float
    spin: int
    length: float
    curvature: float
    begin: float = 0.0

    @property
    def scale(self) -> float:
        """Mm of a unit of ``length`` and ``begin``."""
        return self.radius

    @property
    def heading(self) -> complex:
        """Unit vector of the direction at the start."""
        return 1j * self.spin * (self.first - self.center) / self.radius

    @property
    def end_heading(self) -> complex:
        """Unit vector of the direction at the end."""
        return 1j * self.spin * (self.last - self.center) / self.radius

    def distance_along(self, point: complex) -> float:
        """Return the angle from ``first`` to a point, -pi to pi."""
        return self.spin * angle((point - self.center) * (self.first - self.center).conjugate())

    def distance_to_end(self, point: complex) -> float:
        """Return the angle from a point to ``last``, -pi to pi."""
        return self.spin * angle((self.last - self.center) * (point - self.center).conjugate())


Curve = OffsetLine | OffsetArc


def straight_offset(start: complex, end: complex, side: int, radius: float) -> OffsetLine:
    """Return the offset of a line, whose length must not be 0."""
    length = abs(end - start)
    heading = (end - start) / length
    beside = 1j * side * radius * heading
    return OffsetLine(end, start + beside, end + beside, heading, length)


@dataclass(frozen=True, slots=True)
class TrueArc:
    """An arc with both ends at the same distance from ``center``.

    ``share`` is the part of the programmed arc before its end.
    """

    end: complex
    center: complex
    turns: float
    share: float


def true_arcs(start: complex, end: complex, center: complex, turns: float) -> Iterator[TrueArc]:
    """Yield a programmed arc as exact arcs of circles; nearly always it is one.

    A programmed centre may be nearer to one end than to the other by the dialect's tolerance. The
    curve is not a circle then, and its offset has no simple form. So the centre is moved to the
    nearest point at the same distance from both ends, which moves no point of the arc by more than
    twice the tolerance. If the ends of a nearly full circle are so close that this point is far
    away, the arc is first cut into arcs of at most half a turn.
    """
    reach = abs(start - center)
    grown = abs(end - center) - reach
    if abs(grown) <= SLACK:
        yield TrueArc(end, center, turns, 1.0)
        return
    pieces = math.ceil(2 * abs(turns)) if is_nearly_closed(start, end, center, turns) else 1
    here = start
    for piece in range(1, pieces + 1):
        share = piece / pieces
        there = (
            end
            if piece == pieces
            else center
            + (start - center) * cmath.rect(1.0 + grown * share / reach, math.tau * turns * share)
        )
        along = (there - here) / abs(there - here)
        moved = center + along * _dot((here + there) / 2 - center, along)
        swept = angle((there - moved) * (here - moved).conjugate()) / math.tau
        yield TrueArc(there, moved, swept + round(turns / pieces - swept), share)
        here = there


def is_nearly_closed(start: complex, end: complex, center: complex, turns: float) -> bool:
    """Return whether an arc ends close to its start after a turn."""
    return abs(turns) > 0.5 and abs(end - start) < abs(start - center) / 2


def round_offset(start: complex, arc: TrueArc, side: int, radius: float) -> OffsetArc | None:
    """Return the offset of an arc; None if the tool does not fit into it."""
    spin = 1 if arc.turns > 0 else -1
    out, end_out = start - arc.center, arc.end - arc.center
    reach = abs(out)
    offset = reach - side * spin * radius
    if offset <= SLACK:
        return None
    first, last = arc.center + out / reach * offset, arc.center + end_out / abs(end_out) * offset
    return OffsetArc(
        arc.end,
        first,
        last,
        arc.center,
        offset,
        spin,
        math.tau * abs(arc.turns),
        side * spin / reach,
    )


def lead_in_arc(start: complex, arc: OffsetArc) -> OffsetArc | None:
    """Return the tangential arc from an uncompensated point to the end of an offset arc.

    None if there is none. As in LinuxCNC.
    """
    back = start - arc.last
    inwards = (arc.center - arc.last) / arc.radius
    across = _dot(back, inwards)
    if across <= 0.0:
        return None
    radius = _dot(back, back) / (2.0 * across)
    center = arc.last + radius * inwards
    sweep = arc.spin * angle((arc.last - center) * (start - center).conjugate()) % math.tau
    return OffsetArc(arc.corner, start, arc.last, center, radius, arc.spin, sweep, arc.curvature)


@dataclass(frozen=True, slots=True)
class Join:
    """Path of the tool from one curve to the next.

    It leaves the first at ``leave``, ``cut`` of its units before its end, and enters the second at
    ``enter``, ``begin`` of its units after its start. The two points differ if it goes ``around``
    an outside corner.
    """

    leave: complex
    enter: complex
    cut: float
    begin: float
    around: bool = False


def join(a: Curve, b: Curve, side: int, radius: float, *, entry: bool = False) -> Join | None:
    """Return the join of the offset curves of two consecutive moves.

    Args:
        a: The first curve.
        b: The second curve.
        side: Side of the tool.
        radius: Tool radius, mm.
        entry: The first curve leads in, and may come from any direction.

    Returns:
        None if the tool does not fit into the corner.
    """
    turn = side * angle(b.heading * a.end_heading.conjugate())
    if (math.pi - abs(turn)) * min(a.length * a.scale, b.length * b.scale) <= SLACK:
        # The path reverses: around its end, or into a cusp where it curves back to the tool's side.
        turn = math.pi if a.curvature + b.curvature < -SLACK * abs(a.curvature) else -math.pi
    elif radius * turn * turn * max(1.0, _stretch(a), _stretch(b)) <= 2.0 * TANGENT:
        return Join(a.last, a.last, 0.0, b.distance_along(a.last))
    elif not entry and _loop(a, b, -1 if side * turn > 0 else 1):
        # In a cusp the moves may cross just before the reversal because of rounding.
        if turn > MITRE - math.pi:
            return None
        turn = math.pi
    if turn > -MITRE:
        crossing = _crossing(a, b, 1 if side * turn > 0 else -1, inside=turn > 0)
        if crossing is None:
            return None if turn > 0 else Join(a.last, b.first, 0.0, 0.0, around=True)
        far = 2.0 * radius * math.tan(MITRE / 2)
        if turn > 0 or (_runs_on(a, crossing.cut, far) and _runs_on(b, crossing.begin, far)):
            return crossing
    return Join(a.last, b.first, 0.0, 0.0, around=True)


def _runs_on(curve: Curve, distance: float, far: float) -> bool:
    """Whether a curve can extend to a crossing ``distance`` units from its end.

    The crossing must be at most ``far`` mm away, along an arc also at a small angle.
    """
    return abs(distance) * curve.scale <= far and (
        isinstance(curve, OffsetLine) or abs(distance) <= MITRE
    )


def _loop(a: Curve, b: Curve, left: int) -> bool:
    """Whether a move crosses the move before it again after their corner.

    The tool has cut there then. The crossing is to the left of the first move for ``left`` 1, to
    its right for -1.
    """
    if isinstance(a, OffsetLine) and isinstance(b, OffsetLine):
        return False
    a, b = programmed(a), programmed(b)
    point = meet(a, b, left)
    if point is None:
        return False
    cut, begin = (
        _onwards(a, a.distance_to_end(point)) * a.scale,
        _onwards(b, b.distance_along(point)) * b.scale,
    )
    return NEAR < cut < a.length * a.scale - NEAR and NEAR < begin < b.length * b.scale - NEAR


def programmed(curve: Curve) -> Curve:
    """Return the move of an offset curve; not valid for one that leads in."""
    if isinstance(curve, OffsetLine):
        back = curve.corner - curve.last
        return replace(curve, first=curve.first + back, last=curve.corner)
    reach = 1.0 / abs(curve.curvature)
    out = curve.center + (curve.first - curve.center) * (reach / curve.radius)
    return replace(curve, first=out, last=curve.corner, radius=reach)


def _crossing(a: Curve, b: Curve, left: int, *, inside: bool) -> Join | None:
    """The join at the crossing of two curves.

    b leads to the left of a (``left`` 1) or to its right (-1). Two circles have two crossings, one
    of each kind. As the tool radius grows from 0, the crossing moves from the corner without a
    change of kind, so the kind identifies it.
    """
    point = meet(a, b, left)
    if point is None:
        return None
    cut, begin = a.distance_to_end(point), b.distance_along(point)
    if inside:
        cut, begin = _onwards(a, cut), _onwards(b, begin)
    return Join(point, point, cut, begin)


def meet(a: Curve, b: Curve, left: int) -> complex | None:
    """Return the crossing of two curves if neither had ends; None if they do not cross.

    There b leads to the left of a (``left`` 1) or to its right (-1).
    """
    if isinstance(a, OffsetLine):
        if isinstance(b, OffsetLine):
            across = _cross(a.heading, b.heading)
            return (
                None
                if across == 0.0
                else a.last + a.heading * (_cross(b.first - a.last, b.heading) / across)
            )
        return _line_and_circle(a.last, a.heading, b, left * b.spin)
    if isinstance(b, OffsetLine):
        return _line_and_circle(b.first, b.heading, a, -left * a.spin)
    if a.radius > b.radius:
        # The smaller circle comes first: the rounding error of the larger radius would be greater.
        return meet(b, a, -left)
    apart = b.center - a.center
    distance = abs(apart)
    if distance == 0.0 or b.radius - a.radius > 2.0 * distance:
        return None
    along = 0.5 * (distance + (a.radius - b.radius) * (a.radius + b.radius) / distance)
    square = (a.radius - along) * (a.radius + along)
    if square < 0.0:
        return None
    return a.center + complex(along, left * a.spin * b.spin * math.sqrt(square)) * apart / distance


def _line_and_circle(
    point: complex, heading: complex, circle: OffsetArc, sign: int
) -> complex | None:
    """The crossing at which the line leaves the circle (``sign`` 1) or enters it (-1)."""
    foot = point + heading * _dot(circle.center - point, heading)
    distance = abs(_cross(heading, circle.center - point))
    square = (circle.radius - distance) * (circle.radius + distance)
    return None if square < 0.0 else foot + heading * (sign * math.sqrt(square))


def _onwards(curve: Curve, distance: float) -> float:
    """The distance that an inside corner cuts off a curve; of an arc up to a full turn."""
    if isinstance(curve, OffsetArc) and distance < -1e-6:
        return distance + math.tau
    return distance


def _stretch(curve: Curve) -> float:
    """Ratio of the programmed radius to that of the offset."""
    return 1.0 / abs(curve.curvature * curve.radius) if isinstance(curve, OffsetArc) else 1.0


def angle(direction: complex) -> float:
    """Return the angle from -pi to pi.

    ``cmath.phase`` raises OverflowError if the result is close to 0.
    """
    return math.atan2(direction.imag, direction.real)


def _dot(a: complex, b: complex) -> float:
    return a.real * b.real + a.imag * b.imag


def _cross(a: complex, b: complex) -> float:
    return a.real * b.imag - a.imag * b.real
