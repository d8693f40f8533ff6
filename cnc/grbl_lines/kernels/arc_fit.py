r"""The fewest lines and arcs through points of a path, found greedily.

Each line or arc is as long as the tolerance allows. It begins and ends at points of the path. An
arc lies in one of the planes XY, ZX, YZ and may climb along the axis across it. Of all arcs from
point S to point E, the arc nearest to the points between and to their midpoints is chosen:

           n ^   . P        The origin is midway between S and E, a is half their distance, and
             |.     .       the centre is (0, h). P = (x, y) lies on the circle where
    S -------+------- E     x^2 + y^2 - a^2 - 2 h y = 0. This is 2 r times the distance from the
        a   h|    a         circle. Its sum of squares over all P is least for
             C                  h = sum(y (x^2 + y^2 - a^2)) / (2 sum(y^2)).

The board replaces an arc by chords. For a sweep phi it makes n = floor(phi r / (2 sqrt(c (2 r -
c)))) chords, at least one, with c its own tolerance (GRBL's $12). They lie up to r (1 - cos(phi /
2n)) inside the arc, for a short arc much more than c. From one chord to the next it turns by cos t
= 1 - t^2 / 2 and sin t = t - t^3 / 6, twelve times before it computes them exactly
(motion_control.c, mc_arc). This makes small circles smaller. All of this counts as deviation.

The length of the next move is doubled until nothing fits twice in a row, because a longer arc may
fit where a shorter one does not (n changes). Then the interval of doubt is halved. Every accepted
move has been measured at all points and midpoints: in the plane, across it, and that the angle
never runs backwards by more than the tolerance. An arc must also keep within the limits of travel
where it turns back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

STRAIGHT, UNFIT = -1, -2
"""In place of a plane: a line; nothing that fits."""

LARGEST_RADIUS = 1000.0
"""mm. The board computes with 32-bit floats; a larger circle loses more than a micrometre."""
SMALLEST_SWEEP = 2e-3
"""rad. A move that turns by less is a line."""
TURNS_UNTIL_EXACT = 12.0
EVEN = 1.0 - 1e-5
"""Part of a chord below which 32-bit floats may make one chord less."""


class FitLimits(NamedTuple):
    """What lines and arcs must keep.

    tolerance: largest distance from the points, mm. chord: largest distance of the board's own
    chords from an arc, mm. low, high (3,): positions beyond which no arc may turn back, mm.
    """

    tolerance: float
    chord: float
    low: Floats
    high: Floats


@njit
def line_fits(points: Floats, first: int, last: int, tolerance: float) -> bool:
    """Return whether the points from first to last lie along the line between these two.

    They stay within the tolerance, mm, and never go backwards by more than it.
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
        # distance from the line, or from its end
        share = min(max(along / square, 0.0), 1.0)
        x -= share * dx
        y -= share * dy
        z -= share * dz
        if x * x + y * y + z * z > limit:
            return False
    return True


@njit
def board_chord(radius: float, sweep: float, chord: float) -> float:
    """Return how far inside an arc the board moves, mm, with its own tolerance ``chord``."""
    count = 1.0
    if chord < 2.0 * radius:
        # where the count is whole, 32-bit floats may make it one less
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
def arc_stays_inside(
    plane: tuple[int, int],
    center: tuple[float, float],
    spoke: tuple[float, float],
    sweep: float,
    low: Floats,
    high: Floats,
) -> bool:
    """Return whether an arc stays between low and high (3,) where it turns back along an axis.

    plane: columns of its two axes. center, spoke: its centre, and its start from there, mm. sweep:
    rad, positive for counter-clockwise. Its ends are not checked.
    """
    i, j = plane
    cx, cy = center
    x, y = spoke
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
        # angle from the start to the extreme point in this direction, in the sense of the arc
        angle = 0.5 * math.pi * quarter - begin
        if sweep < 0.0:
            angle = -angle
        angle %= 2.0 * math.pi
        if angle < abs(sweep):
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
def fit_circle(
    points: Floats, first: int, last: int, i: int, j: int, tolerance: float, out: Floats
) -> bool:
    """Fit the circle through the first and the last point that is nearest to the others.

    i, j: columns of its plane. out (3,): set to centre and radius. Returns whether there is one.
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
        # points, and the midpoints between them
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
    out[0] = cx
    out[1] = cy
    out[2] = radius
    return True


@njit
def arc_fits(
    points: Floats,
    first: int,
    last: int,
    columns: tuple[int, int, int],
    limits: FitLimits,
    out: Floats,
) -> bool:
    """Return whether an arc fits the points from first to last.

    columns: first and second axis of its plane, and the axis across. out (3,): set to centre and
    signed sweep.
    """
    i, j, across = columns
    tolerance = limits.tolerance
    if not fit_circle(points, first, last, i, j, tolerance, out):
        return False
    cx, cy, radius = out[0], out[1], out[2]
    # the side of the chord on which the path runs gives the sense: below it (y < 0) is
    # counter-clockwise
    ahead = 0.5 * (points[first + 1, i] + points[first, i]) - points[first, i]
    aside = 0.5 * (points[first + 1, j] + points[first, j]) - points[first, j]
    ex = (points[first, i] - cx) / radius
    ey = (points[first, j] - cy) / radius
    turn = 1.0 if ex * aside - ey * ahead > 0.0 else -1.0
    fx = (points[last, i] - cx) / radius
    fy = (points[last, j] - cy) / radius
    sweep = math.atan2(turn * (ex * fy - ey * fx), ex * fx + ey * fy)
    if sweep < SMALLEST_SWEEP:
        return False
    inside = board_chord(radius, sweep, limits.chord)
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
        # distance from the arc, or from its end
        share = min(max(angle / sweep, 0.0), 1.0)
        beyond = radius * (angle - share * sweep)
        rise = (
            0.5 * (points[here, across] + points[next_one, across])
            - points[first, across]
            - share * climb
        )
        if off * off + rise * rise + beyond * beyond > limit:
            return False
    if not arc_stays_inside(
        (i, j), (cx, cy), (radius * ex, radius * ey), turn * sweep, limits.low, limits.high
    ):
        return False
    out[0] = cx
    out[1] = cy
    out[2] = turn * sweep
    return True


@njit
def best_fit(
    points: Floats, first: int, last: int, arcs: bool, limits: FitLimits, out: Floats
) -> int:
    """Return the move that fits the points from first to last.

    It is STRAIGHT, or the number of an arc's plane with the arc in out (3,), or UNFIT.
    """
    if line_fits(points, first, last, limits.tolerance):
        return STRAIGHT
    if arcs and last > first + 1:
        if arc_fits(points, first, last, (0, 1, 2), limits, out):
            return 0
        if arc_fits(points, first, last, (2, 0, 1), limits, out):
            return 1
        if arc_fits(points, first, last, (1, 2, 0), limits, out):
            return 2
    return UNFIT


@njit
def fit_fewest(
    points: Floats,
    cut: Flags,
    arcs: Flags,
    limits: FitLimits,
    end: Ints,
    plane: Ints,
    arc: Floats,
) -> int:
    """Fit lines and arcs through points (k + 1, 3) and return their number.

    cut (k + 1,): points at which a move must end. arcs (k,): whether an interval may be part of an
    arc. Set for each move: its last point, end (k,); its plane or STRAIGHT, plane (k,); centre and
    sweep, arc (k, 3).
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
            trial = min(here + length, border)
            fit = best_fit(points, here, trial, arcs[here], limits, found)
            if fit != UNFIT:
                good = trial
                bad = border + 1
                kind = fit
                arc[count] = found
            elif bad <= border:
                break
            else:
                bad = trial
            if trial == border:
                break
            length *= 2
        while bad - good > 1:
            trial = (good + bad) // 2
            if trial > border:
                break
            fit = best_fit(points, here, trial, arcs[here], limits, found)
            if fit == UNFIT:
                bad = trial
            else:
                good = trial
                kind = fit
                arc[count] = found
        end[count] = good
        plane[count] = kind
        count += 1
        here = good
    return count
