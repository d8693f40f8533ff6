r"""The fewest lines and arcs through points on a path, greedily: each as long as it stays within
the tolerance.

Lines and arcs begin and end at points of the path. An arc lies in one of the planes XY, ZX, YZ and
may climb along the axis across it. Of all arcs from point S to point E the one is taken that the
points between, and the middles between those, are nearest to:

               n ^   . P              With the origin in the middle of S and E, a half their distance and the centre (0, h):
                 |.     .             P = (x, y) lies on the circle where x^2 + y^2 - a^2 - 2 h y = 0. Of that, which is 2 r times the
        S -------+------- E           distance from the circle, the sum of squares over all P is least for
            a   h|    a
                 C                        h = sum(y (x^2 + y^2 - a^2)) / (2 sum(y^2)).

The board makes chords of an arc: of one with sweep phi it makes n = floor(phi r / (2 sqrt(c (2 r -
c)))), one at least, with c its own tolerance (GRBL's $12), which are up to r (1 - cos(phi / 2n))
inside: of a short arc by much more than c. It turns from one to the next by cos t = 1 - t^2 / 2 and
sin t = t - t^3 / 6, twelve times before it computes them well (motion_control.c, mc_arc), which
makes small circles smaller. All that counts as a deviation, too.

How far the next one reaches is found by doubling its length until nothing fits (twice in a row:
because of n a longer arc may fit where a shorter one does not), and then by halving the doubt. All
that is accepted has been measured: every point and every middle between two, in the plane and
across it, and that the angle never runs backwards by more than the tolerance. Of an arc also where
it bulges to: never out of the travel that is left to it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

STRAIGHT, FIXED = -1, -2
"""In place of a plane: a line, or an interval that is what it is."""

LARGEST_RADIUS = 1000.0
"""mm. The board computes with 32-bit floats: of a larger circle it loses more than a thousandth of
a millimetre.
"""
LEAST_SWEEP = 2e-3
"""rad. What turns less is a line."""
TURNS_UNTIL_EXACT = 12.0
EVEN = 1.0 - 1e-5
"""How much of a chord has to be missing for one less."""


@njit
def line_fits(points: Floats, first: int, last: int, tolerance: float) -> bool:
    """Whether the points between two stay within the tolerance of the line from the one to the
    other, and go forward along it.
    """
    dx = points[last, 0] - points[first, 0]
    dy = points[last, 1] - points[first, 1]
    dz = points[last, 2] - points[first, 2]
    square = dx * dx + dy * dy + dz * dz
    limit = tolerance * tolerance
    if square == 0.0:
        return False
    slack = tolerance * math.sqrt(square)
    before = 0.0
    for k in range(first + 1, last):
        x = points[k, 0] - points[first, 0]
        y = points[k, 1] - points[first, 1]
        z = points[k, 2] - points[first, 2]
        along = x * dx + y * dy + z * dz
        if along < before - slack or along > square + slack:
            return False
        before = max(before, along)
        # from the line, or from its end
        share = min(max(along / square, 0.0), 1.0)
        x -= share * dx
        y -= share * dy
        z -= share * dz
        if x * x + y * y + z * z > limit:
            return False
    return True


@njit
def board_chord(radius: float, sweep: float, chord: float) -> float:
    """How far inside an arc the motion is that the board makes of it with its tolerance
    ``chord``.
    """
    count = 1.0
    if chord < 2.0 * radius:
        # where it comes out even, 32-bit floats may make it one less
        count = max(
            1.0, math.floor(EVEN * 0.5 * sweep * radius / math.sqrt(chord * (2.0 * radius - chord)))
        )
    turn = sweep / count
    if turn >= 2.0 * math.pi:
        return 2.0 * radius
    cos = 1.0 - 0.5 * turn * turn
    sin = turn * (cos + 2.0) / 3.0
    drift = math.sqrt((cos - math.cos(turn)) ** 2 + (sin - math.sin(turn)) ** 2)
    return radius * (1.0 - math.cos(0.5 * turn) + drift * min(count - 1.0, TURNS_UNTIL_EXACT))


@njit
def arc_stays(
    i: int,
    j: int,
    cx: float,
    cy: float,
    x: float,
    y: float,
    sweep: float,
    low: Floats,
    high: Floats,
) -> bool:
    """Whether an arc about (cx, cy) in the plane of two columns keeps between low and high (3,)
    where it turns back along one of them.

    x, y: from the centre to its start; sweep: rad, counter-clockwise positive. Its ends are not
    looked at.
    """
    radius = math.sqrt(x * x + y * y)
    if (
        cx - radius >= low[i]
        and cx + radius <= high[i]
        and cy - radius >= low[j]
        and cy + radius <= high[j]
    ):
        return True
    begin = math.atan2(y, x)
    for quarter in range(4):
        # how far it is, the way the arc turns, from its start to where it is farthest out in this
        # direction
        way = 0.5 * math.pi * quarter - begin
        if sweep < 0.0:
            way = -way
        way %= 2.0 * math.pi
        if way < abs(sweep):
            if quarter == 0 and cx + radius > high[i]:
                return False
            if quarter == 1 and cy + radius > high[j]:
                return False
            if quarter == 2 and cx - radius < low[i]:
                return False
            if quarter == 3 and cy - radius < low[j]:
                return False
    return True


@njit
def arc_fits(
    points: Floats,
    first: int,
    last: int,
    i: int,
    j: int,
    across: int,
    tolerance: float,
    chord: float,
    low: Floats,
    high: Floats,
    out: Floats,
) -> bool:
    """Whether an arc in the plane of two columns fits the points; its centre and signed sweep into
    out (3,).
    """
    mx = 0.5 * (points[first, i] + points[last, i])
    my = 0.5 * (points[first, j] + points[last, j])
    tx = points[last, i] - mx
    ty = points[last, j] - my
    a = math.sqrt(tx * tx + ty * ty)
    if a <= tolerance:
        return False
    tx /= a
    ty /= a
    above = 0.0
    squares = 0.0
    for k in range(2 * first + 1, 2 * last):
        # points, and the middles between them
        here = k // 2
        next_one = (k + 1) // 2
        px = 0.5 * (points[here, i] + points[next_one, i]) - mx
        py = 0.5 * (points[here, j] + points[next_one, j]) - my
        x = px * tx + py * ty
        y = py * tx - px * ty
        above += y * (x * x + y * y - a * a)
        squares += y * y
    if squares == 0.0:
        return False
    h = 0.5 * above / squares
    radius = math.sqrt(a * a + h * h)
    if radius > LARGEST_RADIUS:
        return False
    cx = mx - h * ty
    cy = my + h * tx
    # the side on which the path runs says which way round: below the chord (y < 0) is
    # counter-clockwise
    ahead = 0.5 * (points[first + 1, i] + points[first, i]) - points[first, i]
    aside = 0.5 * (points[first + 1, j] + points[first, j]) - points[first, j]
    ex = (points[first, i] - cx) / radius
    ey = (points[first, j] - cy) / radius
    turn = 1.0 if ex * aside - ey * ahead > 0.0 else -1.0
    fx = (points[last, i] - cx) / radius
    fy = (points[last, j] - cy) / radius
    sweep = math.atan2(turn * (ex * fy - ey * fx), ex * fx + ey * fy)
    if sweep < LEAST_SWEEP:
        return False
    inside = board_chord(radius, sweep, chord)
    climb = points[last, across] - points[first, across]
    limit = tolerance * tolerance
    slack = tolerance / radius
    before = 0.0
    for k in range(2 * first + 1, 2 * last):
        here = k // 2
        next_one = (k + 1) // 2
        x = 0.5 * (points[here, i] + points[next_one, i]) - cx
        y = 0.5 * (points[here, j] + points[next_one, j]) - cy
        off = math.sqrt(x * x + y * y) - radius
        off = max(off + inside, -off)
        if off > tolerance:
            return False
        angle = math.atan2(turn * (ex * y - ey * x), ex * x + ey * y)
        if angle < before - slack or angle > sweep + slack:
            return False
        before = max(before, angle)
        # from the arc, or from its end
        share = min(max(angle / sweep, 0.0), 1.0)
        beyond = radius * (angle - share * sweep)
        rise = (
            0.5 * (points[here, across] + points[next_one, across])
            - points[first, across]
            - share * climb
        )
        if off * off + rise * rise + beyond * beyond > limit:
            return False
    if not arc_stays(i, j, cx, cy, radius * ex, radius * ey, turn * sweep, low, high):
        return False
    out[0] = cx
    out[1] = cy
    out[2] = turn * sweep
    return True


@njit
def best_fit(
    points: Floats,
    first: int,
    last: int,
    arcs: bool,
    tolerance: float,
    chord: float,
    low: Floats,
    high: Floats,
    out: Floats,
) -> int:
    """What fits the points from ``first`` to ``last``: STRAIGHT, or the number of the arc's plane
    with the arc in out (3,), or FIXED.
    """
    if line_fits(points, first, last, tolerance):
        return STRAIGHT
    if arcs and last > first + 1:
        if arc_fits(points, first, last, 0, 1, 2, tolerance, chord, low, high, out):
            return 0
        if arc_fits(points, first, last, 2, 0, 1, tolerance, chord, low, high, out):
            return 1
        if arc_fits(points, first, last, 1, 2, 0, tolerance, chord, low, high, out):
            return 2
    return FIXED


@njit
def fewest(
    points: Floats,
    cut: Flags,
    arcs: Flags,
    tolerance: float,
    chord: float,
    low: Floats,
    high: Floats,
    end: Ints,
    plane: Ints,
    arc: Floats,
) -> int:
    """Lines and arcs through points (k + 1, 3): where each ends, end (k,), its plane (k,) or
    STRAIGHT, its centre and sweep (k, 3).

    cut (k + 1,): points that they end in. arcs (k,): whether the interval may be part of an arc.
    chord: mm, how far from an arc the board's own chords may be. low, high (3,): beyond which no
    arc may bulge. Returns how many there are.
    """
    count = 0
    here = 0
    last = len(points) - 1
    found = np.zeros(3)
    while here < last:
        border = here + 1
        while border < last and not cut[border] and arcs[border] == arcs[here]:
            border += 1
        good = here + 1
        kind = STRAIGHT
        bad = border + 1
        length = 2
        while good < border:
            look = min(here + length, border)
            what = best_fit(points, here, look, arcs[here], tolerance, chord, low, high, found)
            if what != FIXED:
                good = look
                bad = border + 1
                kind = what
                arc[count] = found
            elif bad <= border:
                break
            else:
                bad = look
            if look == border:
                break
            length *= 2
        while bad - good > 1:
            look = (good + bad) // 2
            if look > border:
                break
            what = best_fit(points, here, look, arcs[here], tolerance, chord, low, high, found)
            if what == FIXED:
                bad = look
            else:
                good = look
                kind = what
                arc[count] = found
        end[count] = good
        plane[count] = kind
        count += 1
        here = good
    return count
