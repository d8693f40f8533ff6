"""The treatment of each corner between two straight moves that has a tolerance.

- Where the machine limits the jerk of an axis, the plan stops, and a fastest motion replaces the
  stops (:mod:`cnc.planner.kernels.corner_stops`): at turns from 5 to 179 degrees.
- Elsewhere the corner as it is and a blend are compared by their time. Where the blend is slower,
  the plan stops, and a motion replaces the stop if one is found. A blend is planned as any curve
  is. Where no axis limits the jerk, its curvature follows the speed
  (:mod:`cnc.planner.kernels.corner_bends`). Elsewhere it is a Bezier curve; beyond 135 degrees
  there is none.

The joints of a machine whose kinematics is not linear have no straight ramps beside a stop. There a
corner at which the motion would stop has a blend, up to turns of 175 degrees.

The Bezier curve is that of C - d u1, C, C, C + d u2, where C is the corner and u1, u2 are the
directions of the legs. Its curvature is 0 at both ends, and its distance from the corner is
d/4 sin(theta/2) for a turn by theta. Without it, polygons with turns of about 5 degrees take up to
1.9 times as long.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import MAX_ROWS, measure
from cnc.path.kernels.curve import (
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
from cnc.path.kernels.fit_spline import Flags
from cnc.planner.kernels.arrays import LimitArrays, PathArrays
from cnc.planner.kernels.corner_bends import (
    MOST_CUBICS,
    Bend,
    Blend,
    KeptBlends,
    Side,
    bend_of,
    corner_plane,
    cubics_of,
    fastest_blend,
    largest_speed,
    no_bend,
    no_blend,
    side_time,
    write_points,
)
from cnc.planner.kernels.legs import (
    LEGS_SHARE,
    REVERSED,
    SHARPEST,
    STRAIGHTEST,
    LineBounds,
    directions,
    line_bounds,
    write_line,
)
from cnc.planner.kernels.limits import piece_junction, speed_bounds
from cnc.planner.kernels.scurve import ramp_distance, ramp_time, reachable_speed
from cnc.planner.kernels.timed import TIMED_SIZE, TIMED_SIZE_PER_AXIS, write_cubic, write_turns

ACCURACY = 1e-12
"""mm; accuracy of the arc length of blends and its inverse."""

BLEND_POINTS = 9
"""Points at which the speed in a blend is bounded."""

LEFT_OVER = 0.5
"""Part of the acceleration and jerk of a straight line with which the speed changes in a blend."""


class Scratch(NamedTuple):
    """Arrays that are used again for each corner.

    Attributes:
        u: (2, axes): directions of the legs.
        q: (4, axes): derivatives of a curve.
        pair: (2, 4, axes): derivatives on both sides of a junction.
        ends: (4, axes): points of a blend.
        plane: (2, axes): two directions in the plane of a corner.
        v: (BLEND_POINTS,): speeds along a blend.
        s: (BLEND_POINTS,): distances of these places.
        kept: the last blends.
    """

    u: Floats
    q: Floats
    pair: Floats
    ends: Floats
    plane: Floats
    v: Floats
    s: Floats
    kept: KeptBlends


@njit
def half_time(v: float, distance: float, bounds: LineBounds) -> float:
    """Return the time from the middle of a move to the end of ``distance``, s.

    The motion has no acceleration in the middle; at the end its speed is ``v``.
    """
    top, a, j = bounds.v, bounds.a, bounds.j
    peak = max(v, min(top, reachable_speed(v, distance, a, j)))
    return ramp_time(v, peak, a, j) + max(distance - ramp_distance(v, peak, a, j), 0.0) / peak


@njit
def write_blend(
    data: Floats, a: int, b: int, d: float, out_data: Floats, at: int, scratch: Scratch
) -> None:
    """Write the record of a blend, without its table.

    Args:
        data: records that contain both lines.
        a: index of the record of the line before the corner.
        b: index of that of the line behind it.
        d: length that the blend takes off both, mm.
        out_data: the records that receive the blend.
        at: its index there.
        scratch: with the directions of the lines.
    """
    u, ends = scratch.u, scratch.ends
    for i in range(u.shape[1]):
        corner = data[b + START + i]
        ends[0, i] = corner - d * u[0, i]
        ends[1, i] = d * u[0, i]
        ends[2, i] = corner + d * u[1, i]
    write_cubic(out_data, at, a, ends[0], ends[1], ends[1], ends[2])


@njit
def cubic_time(
    data: Floats,
    at: int,
    d: float,
    lengths: tuple[float, float],
    feed: float,
    lines: tuple[LineBounds, LineBounds],
    limits: LimitArrays,
    scratch: Scratch,
) -> float:
    """Return about the time from the middle of the one line to the middle of the other, s.

    Args:
        data: the records.
        at: index of the blend's record.
        d: length that the blend takes off both lines, mm.
        lengths: of the lines, mm.
        feed: largest speed in the blend.
        lines: their bounds.
        limits: of the machine.
        scratch: scratch.
    """
    line1, line2 = lines
    line = LineBounds(0.0, min(line1.a, line2.a), min(line1.j, line2.j))
    fastest = (
        reachable_speed(0.0, lengths[0] - d, line1.a, line1.j),
        reachable_speed(0.0, lengths[1] - d, line2.a, line2.j),
    )
    time, v1, v2 = _blend_time(data, at, fastest, feed, line, limits, scratch)
    time += half_time(v1, 0.5 * lengths[0] - d, line1)
    return time + half_time(v2, 0.5 * lengths[1] - d, line2)


@njit
def _blend_time(
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


BETTER = 1e-3
"""A blend has to save this part of the time."""

BLEND_TABLE = 3 + ROW * (MAX_ROWS + 1)
"""Largest size of the arc-length table of a blend, in numbers."""

STAY, PASS, BLEND = 0, 1, 2
"""Treatments of a corner: as it is, a motion past the stop there, a curve."""

MOST_PIECES = 1 + MOST_CUBICS
"""Largest number of pieces that one piece becomes, with the blend behind it."""

SHARPEST_ALONE = math.sin(math.radians(175.0) / 2.0)
"""Sine of half the largest turn that a blend makes where the motion cannot pass a stop."""


LEAST_TURN = 1e-4
"""Sine of half the smallest turn of a blend whose curvature follows the speed. Below, the plane of
the corner is not known well.
"""


class Treatment(NamedTuple):
    """The treatment of a corner.

    Attributes:
        choice: STAY, PASS or BLEND.
        before: length that a blend takes off the line before the corner, mm.
        after: length that it takes off the line behind it.
        blend: a blend whose curvature follows the speed; without a time for none.
        bend: its least radius.
    """

    choice: int
    before: float
    after: float
    blend: Blend
    bend: Bend


@njit
def only_along(limits: LimitArrays) -> bool:
    """Return whether the jerk is limited along the path, and in no axis."""
    return bool(limits.tangential_jerk < math.inf and limits.axis_jerk.min() == math.inf)


@njit
def _side_of(length: float, rests: bool, line: LineBounds) -> Side:
    """Return a leg of a corner.

    Half of it belongs to the corner at its other end, which may be none; the whole leg where the
    motion rests there.
    """
    if rests:
        return Side(2.0 * LEGS_SHARE * length, length, True, line)
    return Side(LEGS_SHARE * length, 0.5 * length, False, line)


@njit
def _legs_of(
    path: PathArrays, k: int, bound: Floats, limits: LimitArrays, rests: bool, u: Floats
) -> tuple[Side, Side]:
    """Return the legs of the corner behind line ``k``, with their directions ``u`` (2, axes)."""
    before = path.stop_after[k - 1] if k > 0 else rests
    return (
        _side_of(path.length[k], before, line_bounds(u[0], bound[k], limits)),
        _side_of(
            path.length[k + 1], path.stop_after[k + 1], line_bounds(u[1], bound[k + 1], limits)
        ),
    )


@njit
def _blend_along(
    path: PathArrays,
    k: int,
    bound: Floats,
    limits: LimitArrays,
    sides: tuple[Side, Side],
    sine: float,
    scratch: Scratch,
) -> tuple[Blend, Bend]:
    """Return the fastest blend where no axis limits the jerk, and its least radius.

    Args:
        path: the path.
        k: the line before the corner.
        bound: largest feed of each piece, mm/s.
        limits: of the machine.
        sides: the legs.
        sine: of half the turn.
        scratch: with the directions of the legs; receives the plane of the corner.
    """
    eps = path.tolerance[k] / corner_plane(sine, scratch.u, scratch.plane)
    feed = min(bound[k], bound[k + 1], largest_speed(scratch.plane, limits))
    bend = bend_of(scratch.plane, eps, max(sides[0].line.a, sides[1].line.a), limits)
    return fastest_blend(sine, eps, feed, sides, bend, scratch.kept), bend


@njit
def choose(
    path: PathArrays,
    k: int,
    bound: Floats,
    limits: LimitArrays,
    out_data: Floats,
    at: int,
    scratch: Scratch,
    ramps: bool,
    rests: bool,
    together: bool,
) -> Treatment:
    """Choose the fastest treatment of the corner behind line ``k``.

    Each is rated by the time from the middle of the one line to the middle of the other, without
    acceleration at both.

    Args:
        path: the path.
        k: the line before the corner.
        bound: largest feed of each piece, mm/s.
        limits: of the machine.
        out_data: receives the record of a blend, without its table, at index ``at``.
        at: that index.
        scratch: scratch.
        ramps: whether the motion may pass stops.
        rests: whether the motion rests at the start of the path.
        together: whether the corner is to be passed with those beside it, if it would be a stop.
    """
    data, a, b = path.pieces.data, path.pieces.at[k], path.pieces.at[k + 1]
    length1, length2 = path.length[k], path.length[k + 1]
    u = scratch.u
    turn = directions(data, a, data, b, u)
    stays = Treatment(STAY, 0.0, 0.0, no_blend(), no_bend())
    if turn.sine > 1.0:
        return stays
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
        return stays
    straight = junction.speed
    passes = ramps and straight == 0.0 and STRAIGHTEST < turn.sine < REVERSED
    passed = Treatment(PASS, 0.0, 0.0, no_blend(), no_bend())
    along = only_along(limits)
    if passes and (together or not along):
        return passed
    if ramps and along:
        if LEAST_TURN < turn.sine < REVERSED:
            sides = _legs_of(path, k, bound, limits, rests, u)
            blend, bend = _blend_along(path, k, bound, limits, sides, turn.sine, scratch)
            best = side_time(straight, sides[0].length, sides[0])
            best += side_time(straight, sides[1].length, sides[1])
            if blend.time < best * (1.0 - BETTER):
                return Treatment(BLEND, blend.before.reach, blend.after.reach, blend, bend)
        # Where no axis limits the jerk, other motions are not always found.
        return passed if passes else stays
    line1 = line_bounds(u[0], bound[k], limits)
    line2 = line_bounds(u[1], bound[k + 1], limits)
    eps = path.tolerance[k]
    feed = min(bound[k], bound[k + 1])
    best = half_time(straight, 0.5 * length1, line1) + half_time(straight, 0.5 * length2, line2)
    if turn.sine <= (SHARPEST if ramps else SHARPEST_ALONE):
        d = min(4.0 * eps / turn.widest, LEGS_SHARE * length1, LEGS_SHARE * length2)
        lines, lengths = (line1, line2), (length1, length2)
        write_blend(data, a, b, d, out_data, at, scratch)
        time = cubic_time(out_data, at, d, lengths, feed, lines, limits, scratch)
        # A stop inside the tolerance takes longer than its blend: the same way with two rests.
        if (not ramps and straight == 0.0) or time < best * (1.0 - BETTER):
            return Treatment(BLEND, d, d, no_blend(), no_bend())
    return stays


@njit
def append_cubics(
    path: PathArrays,
    k: int,
    treatment: Treatment,
    scratch: Scratch,
    out: PathArrays,
    count: int,
    used: int,
) -> tuple[int, int]:
    """Append the cubics of a blend whose curvature follows the speed.

    Args:
        path: the path.
        k: the line before the corner.
        treatment: the blend.
        scratch: with the directions of the legs and the plane of the corner.
        out: receives the pieces, without what does not depend on the shape.
        count: the pieces so far.
        used: the numbers of records so far.

    Returns:
        The new numbers of both; (-1, 0) if ``out`` has no space.
    """
    data, ends, n = out.pieces.data, scratch.ends, scratch.u.shape[1]
    corner, like = path.pieces.at[k + 1] + START, out.pieces.at[count - 1]
    cubics = cubics_of(treatment.blend, treatment.bend)
    points = np.empty((cubics, 4, 2))
    write_points(treatment.blend, treatment.bend, points)
    for i in range(n):
        ends[3, i] = path.pieces.data[corner + i] - treatment.before * scratch.u[0, i]
    for c in range(cubics):
        if used + BLEND_TABLE + TIMED_SIZE + n * TIMED_SIZE_PER_AXIS > len(data):
            return -1, 0
        for i in range(n):
            ends[0, i] = ends[3, i]
            e1, e2 = scratch.plane[0, i], scratch.plane[1, i]
            begin = points[c, 0, 0] * e1 + points[c, 0, 1] * e2
            end = points[c, 3, 0] * e1 + points[c, 3, 1] * e2
            ends[3, i] = path.pieces.data[corner + i] + end
            if c + 1 == cubics:
                ends[3, i] = path.pieces.data[corner + i] + treatment.after * scratch.u[1, i]
            ends[1, i] = points[c, 1, 0] * e1 + points[c, 1, 1] * e2 - begin
            ends[2, i] = ends[3, i] - ends[0, i]
            ends[2, i] += points[c, 2, 0] * e1 + points[c, 2, 1] * e2 - end
        out.pieces.kind[count], out.pieces.at[count] = SPAN, used
        table = write_cubic(data, used, like, ends[0], ends[1], ends[2], ends[3])
        end_of_table = measure(SPAN, data, used, table, ACCURACY, scratch.q)
        used = write_turns(data, used, end_of_table)
        count += 1
    return count, used


@njit
def round_corners(
    own: int,
    path: PathArrays,
    bound: Floats,
    taken: float,
    limits: LimitArrays,
    ramps: bool,
    rests: bool,
    together: Flags,
    kept: KeptBlends,
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
        ramps: whether the motion may pass stops.
        rests: whether the motion rests at the start.
        together: (own,): whether the corner behind each is to be passed with those beside it.
        kept: the last blends.
        out: space for MOST_PIECES for each piece, and for their records.

    Returns:
        The numbers of pieces and of numbers of the result, and the length taken off the piece
        behind it, mm; (-1, 0, 0) if ``out`` has no space for the records.
    """
    n = len(limits.axis_velocity)
    scratch = Scratch(
        np.zeros((2, n)),
        np.zeros((4, n)),
        np.zeros((2, 4, n)),
        np.zeros((4, n)),
        np.zeros((2, n)),
        np.zeros(BLEND_POINTS),
        np.zeros(BLEND_POINTS),
        kept,
    )
    pieces, data, at = out.pieces, out.pieces.data, out.pieces.at
    used = len(path.pieces.data)
    for i in range(used):
        data[i] = path.pieces.data[i]
    count = 0
    for k in range(own):
        if used + BLEND_TABLE + TIMED_SIZE + n * TIMED_SIZE_PER_AXIS + START + 2 * n > len(data):
            return -1, 0, 0.0
        treatment = Treatment(STAY, 0.0, 0.0, no_blend(), no_bend())
        blend = used + START + 2 * n
        if (
            path.tolerance[k] > 0.0
            and not path.stop_after[k]
            and k + 1 < len(path.pieces.kind)
            and path.pieces.kind[k] == LINE
            and path.pieces.kind[k + 1] == LINE
        ):
            treatment = choose(
                path, k, bound, limits, data, blend, scratch, ramps, rests, together[k]
            )
        choice, reach = treatment.choice, treatment.before
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
            taken = treatment.after
            first = count
            if treatment.blend.time < math.inf:
                count, used = append_cubics(path, k, treatment, scratch, out, count, used)
                if count < 0:
                    return -1, 0, 0.0
            else:
                table = blend + START + 2 * n + SPAN_BODY + 4 * (n + 1)
                end = measure(SPAN, data, blend, table, ACCURACY, scratch.q)
                pieces.kind[count], at[count] = SPAN, blend
                used = write_turns(data, blend, end)
                count += 1
            slower = bound[k] <= bound[k + 1]
            for p in range(first, count):
                out.feed[p] = path.feed[k] if slower else path.feed[k + 1]
                out.length[p] = data[at[p] + LENGTH]
                out.line[p] = path.line[k]
                out.stop_after[p] = False
                out.tolerance[p] = 0.0
    return count, used, taken
