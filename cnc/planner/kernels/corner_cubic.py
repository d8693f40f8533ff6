r"""The blend at a corner where an axis limits the jerk: one Bezier curve.

It is that of C - d u1, C, C, C + d u2, where C is the corner and u1, u2 are the directions of the
legs. Its curvature is 0 at both ends, and its distance from the corner is d/4 sin(theta/2) for a
turn by theta.

Without this blend, polygons with turns of about 5 degrees take up to 1.76 times as long.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import SPAN, START, TABLE, Floats, curve_eval_s, curve_speed
from cnc.planner.kernels.arrays import LimitArrays
from cnc.planner.kernels.legs import LineBounds
from cnc.planner.kernels.limits import speed_bounds
from cnc.planner.kernels.scurve import ramp_distance, ramp_time, reachable_speed
from cnc.planner.kernels.timed import write_cubic

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
    """

    u: Floats
    q: Floats
    pair: Floats
    ends: Floats
    plane: Floats
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
