"""The treatment of each corner between two straight moves that has a tolerance.

- Where the machine limits the jerk of an axis, the plan stops, and a fastest motion replaces the
  stops (:mod:`cnc.kernels.planner.corner_stops`): at turns from 5 to 179 degrees.
- Elsewhere the corner as it is and a blend are compared by their time. Where the blend is slower,
  the plan stops, and a motion replaces the stop if one is found. A blend is the Bezier curve of
  C - d u1, C, C, C + d u2, where C is the corner and u1, u2 are the directions. Its curvature is
  0 at both ends, and its distance from the corner is d/4 sin(theta/2) for a turn by theta. It is
  planned as any curve is. Beyond 135 degrees there is none.

The joints of a machine whose kinematics is not linear have no straight ramps beside a stop. There a
corner at which the motion would stop has a blend, up to turns of 175 degrees.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import MAX_ROWS, measure
from cnc.kernels.path.curve import (
    LENGTH,
    LINE,
    ROW,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    Floats,
    curve_eval_s,
    curve_speed,
)
from cnc.kernels.planner.legs import (
    LEGS_SHARE,
    REVERSED,
    SHARPEST,
    STRAIGHTEST,
    LineBounds,
    directions,
    line_bounds,
    write_line,
)
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import piece_junction, speed_bounds
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.scurve import ramp_distance, ramp_time, reachable_speed
from cnc.kernels.planner.timed import (
    TIMED_SIZE,
    TIMED_SIZE_PER_AXIS,
    write_cubic,
    write_turns,
)

BLEND_POINTS = 9
"""Points at which the speed in a blend is bounded."""

LEFT_OVER = 0.5
"""Part of the acceleration and jerk of a straight line with which the speed changes in a blend."""

BETTER = 1e-3
"""A blend has to save this part of the time."""

BLEND_TABLE = 3 + ROW * (MAX_ROWS + 1)
"""Largest size of the arc-length table of a blend, in numbers."""

STAY, PASS, BLEND = 0, 1, 2
"""Treatments of a corner: as it is, a motion past the stop there, a curve."""

SHARPEST_ALONE = math.sin(math.radians(175.0) / 2.0)
"""Sine of half the largest turn that a blend makes where the motion cannot pass a stop."""


class Scratch(NamedTuple):
    """Arrays that are used again for each corner.

    Attributes:
        u: (2, axes): directions of the legs.
        q: (4, axes): derivatives of a curve.
        pair: (2, 4, axes): derivatives on both sides of a junction.
        ends: (3, axes): start, middle (measured from the start) and end of a blend.
        v: (BLEND_POINTS,): speeds along a blend.
        s: (BLEND_POINTS,): distances of these places.
    """

    u: Floats
    q: Floats
    pair: Floats
    ends: Floats
    v: Floats
    s: Floats


@njit
def half_time(v: float, distance: float, bounds: LineBounds) -> float:
    """Return the time from the middle of a move to the end of ``distance``, s.

    The motion has no acceleration in the middle; at the end its speed is ``v``.
    """
    top, a, j = bounds.v, bounds.a, bounds.j
    peak = max(v, min(top, reachable_speed(v, distance, a, j)))
    return ramp_time(v, peak, a, j) + max(distance - ramp_distance(v, peak, a, j), 0.0) / peak


@njit
def blend_time(
    data: Floats,
    at: int,
    ends: tuple[float, float],
    feed: float,
    bounds: LineBounds,
    limits: LimitArrays,
    scratch: Scratch,
) -> tuple[float, float, float]:
    """Return about the time of the cubic at ``at``, and the speeds at its ends, s and mm/s.

    The speed is limited at some points, and rises between them by a part of the acceleration and
    jerk of a straight line: the bend takes the rest.

    Args:
        data: the records.
        at: index of the cubic's record.
        ends: largest speeds at its start and its end, mm/s.
        feed: largest speed.
        bounds: of a straight line.
        limits: of the machine.
        scratch: scratch.
    """
    v, s, q = scratch.v, scratch.s, scratch.q
    data[at + TABLE] = 1.0  # selects derivatives by arc length
    before = 0.0
    for k in range(BLEND_POINTS):
        u = k / (BLEND_POINTS - 1.0)
        curve_eval_s(SPAN, data, at, u, q)
        v[k] = speed_bounds(data, at, q, feed, limits)[0]
        rate = curve_speed(SPAN, data, at, u)
        s[k] = 0.5 * (before + rate) / (BLEND_POINTS - 1.0)
        before = rate
    data[at + TABLE] = 0.0
    v[0] = min(v[0], ends[0])
    v[BLEND_POINTS - 1] = min(v[BLEND_POINTS - 1], ends[1])
    a, j = LEFT_OVER * bounds.a, LEFT_OVER * bounds.j
    for k in range(1, BLEND_POINTS):
        v[k] = min(v[k], reachable_speed(v[k - 1], s[k], a, j))
    for k in range(BLEND_POINTS - 1, 0, -1):
        v[k - 1] = min(v[k - 1], reachable_speed(v[k], s[k], a, j))
    time = 0.0
    for k in range(1, BLEND_POINTS):
        time += 2.0 * s[k] / (v[k - 1] + v[k])
    return time, v[0], v[BLEND_POINTS - 1]


@njit
def only_along(limits: LimitArrays) -> bool:
    """Return whether the jerk is limited along the path, and in no axis."""
    return bool(limits.tangential_jerk < math.inf and limits.axis_jerk.min() == math.inf)


@njit
def choose(
    path: PathArrays,
    k: int,
    bound: Floats,
    limits: LimitArrays,
    out_data: Floats,
    blend: int,
    scratch: Scratch,
    ramps: bool,
) -> tuple[int, float]:
    """Choose the fastest treatment of the corner behind line ``k``.

    Each is rated by the time from the middle of the one line to the middle of the other, without
    acceleration at both.

    Args:
        path: the path.
        k: the line before the corner.
        bound: largest feed of each piece, mm/s.
        limits: of the machine.
        out_data: receives the record of a blend, without its table, at index ``blend``.
        blend: that index.
        scratch: scratch.
        ramps: whether the motion may pass stops.

    Returns:
        STAY, PASS or BLEND, and the length that a blend takes off both lines, mm.
    """
    data, a, b = path.pieces.data, path.pieces.at[k], path.pieces.at[k + 1]
    length1, length2 = path.length[k], path.length[k + 1]
    u = scratch.u
    turn = directions(data, a, data, b, u)
    if turn.sine > 1.0:
        return STAY, 0.0
    junction = piece_junction(
        path.pieces,
        k,
        bound[k],
        path.pieces,
        k + 1,
        bound[k + 1],
        min(length1, length2),
        limits,
        scratch.pair,
    )
    if not junction.flat:
        return STAY, 0.0
    straight = junction.speed
    line1 = line_bounds(u[0], bound[k], limits)
    line2 = line_bounds(u[1], bound[k + 1], limits)
    half1 = 0.5 * length1
    half2 = 0.5 * length2
    best = half_time(straight, half1, line1) + half_time(straight, half2, line2)
    choice = STAY
    eps = path.tolerance[k]
    passes = ramps and straight == 0.0 and STRAIGHTEST < turn.sine < REVERSED
    if passes and not only_along(limits):
        return PASS, 0.0
    taken = 0.0
    if turn.sine <= (SHARPEST if ramps else SHARPEST_ALONE):
        ends = scratch.ends
        d = min(4.0 * eps / turn.widest, LEGS_SHARE * length1, LEGS_SHARE * length2)
        for i in range(u.shape[1]):
            corner = data[b + START + i]
            ends[0, i] = corner - d * u[0, i]
            ends[1, i] = d * u[0, i]
            ends[2, i] = corner + d * u[1, i]
        write_cubic(out_data, blend, a, ends[0], ends[1], ends[1], ends[2])
        line = LineBounds(0.0, min(line1.a, line2.a), min(line1.j, line2.j))
        fastest = (
            reachable_speed(0.0, length1 - d, line1.a, line1.j),
            reachable_speed(0.0, length2 - d, line2.a, line2.j),
        )
        feed = min(bound[k], bound[k + 1])
        time, v1, v2 = blend_time(out_data, blend, fastest, feed, line, limits, scratch)
        time += half_time(v1, half1 - d, line1) + half_time(v2, half2 - d, line2)
        # A stop inside the tolerance takes longer than its blend: the same way with two rests.
        if (not ramps and straight == 0.0) or time < best * (1.0 - BETTER):
            choice = BLEND
            taken = d
    if passes and choice == STAY:
        # Without limits of the axes' jerk blends are good, and other motions not always found.
        choice = PASS
    return choice, taken


@njit
def round_corners(
    own: int,
    path: PathArrays,
    bound: Floats,
    taken: float,
    limits: LimitArrays,
    accuracy: float,
    ramps: bool,
    out: PathArrays,
) -> tuple[int, int, float]:
    """Choose the treatment of each corner of a chunk of path, and insert the blends.

    Where the motion passes a stop, the tolerance stays; elsewhere it becomes 0.

    Args:
        own: number of pieces of the chunk.
        path: these pieces, and perhaps the one behind them.
        bound: largest feed of each, mm/s; infinite for a traverse.
        taken: length that a blend has taken off the first piece, mm.
        limits: of the machine.
        accuracy: largest error of the inverse arc length of blends, mm.
        ramps: whether the motion may pass stops.
        out: space for twice the pieces, and for their records.

    Returns:
        The numbers of pieces and of numbers of the result, and the length taken off the piece
        behind it, mm; (-1, 0, 0) if ``out`` has no space for the records.
    """
    n = len(limits.axis_velocity)
    scratch = Scratch(
        np.zeros((2, n)),
        np.zeros((4, n)),
        np.zeros((2, 4, n)),
        np.zeros((3, n)),
        np.zeros(BLEND_POINTS),
        np.zeros(BLEND_POINTS),
    )
    pieces, data, at = out.pieces, out.pieces.data, out.pieces.at
    used = len(path.pieces.data)
    for i in range(used):
        data[i] = path.pieces.data[i]
    count = 0
    for k in range(own):
        if used + BLEND_TABLE + TIMED_SIZE + n * TIMED_SIZE_PER_AXIS + START + 2 * n > len(data):
            return -1, 0, 0.0
        choice = STAY
        reach = 0.0
        blend = used + START + 2 * n
        if (
            path.tolerance[k] > 0.0
            and not path.stop_after[k]
            and k + 1 < len(path.pieces.kind)
            and path.pieces.kind[k] == LINE
            and path.pieces.kind[k + 1] == LINE
        ):
            choice, reach = choose(path, k, bound, limits, data, blend, scratch, ramps)
        pieces.kind[count] = path.pieces.kind[k]
        at[count] = path.pieces.at[k]
        if taken > 0.0 or reach > 0.0:
            at[count] = used
            used = write_line(data, used, path.pieces.at[k], taken, reach)
        out.length[count] = data[at[count] + LENGTH]
        out.feed[count] = path.feed[k]
        out.line[count] = path.line[k]
        out.stop_after[count] = path.stop_after[k]
        out.tolerance[count] = path.tolerance[k] if choice == PASS else 0.0
        count += 1
        taken = 0.0
        if choice == BLEND:
            taken = reach
            pieces.kind[count] = SPAN
            at[count] = blend
            table = blend + START + 2 * n + SPAN_BODY + 4 * (n + 1)
            end = measure(SPAN, data, blend, table, accuracy, scratch.q)
            used = write_turns(data, blend, end)
            out.length[count] = data[blend + LENGTH]
            slower = bound[k] <= bound[k + 1]
            out.feed[count] = path.feed[k] if slower else path.feed[k + 1]
            out.line[count] = path.line[k]
            out.stop_after[count] = False
            out.tolerance[count] = 0.0
            count += 1
    return count, used, taken
