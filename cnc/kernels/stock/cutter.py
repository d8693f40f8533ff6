r"""Shape of a rotating tool, and the lowest surface that it leaves along a straight move.

A tool is a height h(r) of its cutting surface above its tip, for the distance r from its axis:

    FLAT        h = 0                                            r <= R
    BALL        h = R - sqrt(R^2 - r^2)                          r <= R
    BULL        h = 0 for r <= a = R - c, else                   r <= R, c the corner's radius
                h = c - sqrt(c^2 - (r - a)^2)
    CONE        h = k max(0, r - a)                              r <= R, k = 1 / tan(half angle)

The tool moves from its start with the slope -m, m >= 0 (downwards; an upward move is the same one
backwards). A cell lies u along the move and v beside it. With the tool at t the cell is at
r^2 = v^2 + (u - t)^2, and the surface left there is

    z(u, v) = min over t of  z0 - m t + h(r),        r <= R,  0 <= t <= L

h grows with r and is convex, so the sum is convex in t and has one minimum. Write s = t - u, the
lead of the tool. Without ends it lies where h'(r) s / r = m:

    FLAT        s = sqrt(R^2 - v^2)                  (the rim behind)
    BALL        s = m sqrt(R^2 - v^2) / sqrt(1 + m^2)
    CONE        s = m v / sqrt(k^2 - m^2), at least the edge of the tip, at most the rim
    BULL        s = sqrt(r^2 - v^2), r = a + c x, x the root in 0..1 of
                P(x) = (1 + m^2) x^2 r^2 - v^2 x^2 - m^2 r^2, by Newton's method

x is the sine of the slope of the surface at the contact. The iteration begins above the root, at
the lesser of two bounds: s is at most its largest share of the rim's, which it has at v = 0 or at
v = R; and x is at most (v - a) / c + cbrt(m^2 R / 2 c), the second term being that for v = a.

t = u + s is then limited to the move. If the tool does not reach the cell there, it does not reach
it at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.kernels.jit import njit

FLAT, BALL, BULL, CONE = range(4)
"""Shapes of a tool."""
ROUNDS = 3
"""Steps of Newton's method for a bull nose. Any lead lies on the tool's way. So an error of the
lead leaves material and never removes too much: less than 1e-5 of the radius for slopes from 0.001
to 100.
"""


class Cutter(NamedTuple):
    """A tool.

    Attributes:
        shape: FLAT, BALL, BULL or CONE.
        radius: radius R, mm.
        flat: radius of the flat part of the tip, mm: a of BULL and CONE.
        rise: corner radius c of BULL, mm; slope k of CONE.
    """

    shape: int
    radius: float
    flat: float
    rise: float


@njit
def height(cutter: Cutter, r: float) -> float:
    """Return the height (mm) of the cutting surface above the tip at ``r`` mm from the axis."""
    if cutter.shape == FLAT:
        return 0.0
    if cutter.shape == BALL:
        return cutter.radius - math.sqrt(max(0.0, cutter.radius * cutter.radius - r * r))
    beyond = max(0.0, r - cutter.flat)
    if cutter.shape == CONE:
        return cutter.rise * beyond
    return cutter.rise - math.sqrt(max(0.0, cutter.rise * cutter.rise - beyond * beyond))


@njit
def reach(cutter: Cutter, room: float) -> float:
    """Return the radius (mm) up to which the tool is at most ``room`` mm above its tip."""
    if cutter.shape == FLAT:
        return cutter.radius
    if cutter.shape == CONE:
        return min(cutter.radius, cutter.flat + room / cutter.rise)
    corner = cutter.radius if cutter.shape == BALL else cutter.rise
    if room >= corner:
        return cutter.radius
    return cutter.radius - corner + math.sqrt(room * (2.0 * corner - room))


@njit
def lead(cutter: Cutter, slope: float, v: float) -> float:
    """Return the lead s (mm) of the tool for a cell ``v`` mm beside a move with a slope m >= 0."""
    square = v * v
    rim = math.sqrt(max(0.0, cutter.radius * cutter.radius - square))
    if slope == 0.0:
        return 0.0
    if cutter.shape == FLAT:
        return rim
    if cutter.shape == BALL:
        return slope * rim / math.sqrt(1.0 + slope * slope)
    edge = math.sqrt(max(0.0, cutter.flat * cutter.flat - square))
    if cutter.shape == CONE:
        steep = cutter.rise * cutter.rise - slope * slope
        return rim if steep <= 0.0 else min(rim, max(edge, slope * abs(v) / math.sqrt(steep)))
    share, spread = first_bounds(cutter, slope)
    flat, rise, steep = cutter.flat, cutter.rise, slope * slope
    x = (math.sqrt(square + share * share * rim * rim) - flat) / rise
    x = max(0.0, min(x, max(0.0, (abs(v) - flat) / rise) + spread, 1.0))
    for _ in range(ROUNDS):
        r = flat + rise * x
        value = (1.0 + steep) * x * x * r * r - square * x * x - steep * r * r
        rate = (1.0 + steep) * x * r * (r + rise * x) - square * x - steep * rise * r
        x = max(0.0, x - max(0.0, 0.5 * value / rate if rate > 0.0 else 0.0))
    r = flat + rise * x
    return math.sqrt(max(0.0, r * r - square))


@njit
def first_bounds(cutter: Cutter, slope: float) -> tuple[float, float]:
    """Return the largest share of the rim's lead, and the bound of x at v = a, for a bull nose.

    The slope is greater than 0.
    """
    radius, rise = cutter.radius, cutter.rise
    steep = slope * slope
    middle = (cutter.flat + rise * slope / math.sqrt(1.0 + steep)) / radius
    at_rim = 1.0 / math.sqrt(1.0 + rise / (steep * radius))
    return max(middle, at_rim), (0.5 * steep * radius / rise) ** (1.0 / 3.0)
