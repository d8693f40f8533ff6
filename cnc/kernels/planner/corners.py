"""The way round each corner between two straight moves under a tolerance: as it is, ramps that
overlap, or a blend.

A blend is the Bezier curve of C - d u1, C, C, C + d u2, C being the corner: its curvature is
nothing at both ends, and its distance from the corner is d/4 sin(theta/2) for a turn by theta. It
is planned as any curve is. Small turns are blended, sharp ones are stops whose ramps overlap
(:mod:`cnc.kernels.planner.overlap`), and beyond 135 degrees the motion stops on the corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    Ints,
    curve_eval_s,
)
from cnc.kernels.planner.legs import LEGS_SHARE, SHARPEST, directions, line_bounds, write_line
from cnc.kernels.planner.limits import joint, speed_bounds
from cnc.kernels.planner.overlap import overlap_time
from cnc.kernels.planner.scurve import ramp_distance, ramp_shape, ramp_time, reachable_speed
from cnc.kernels.planner.timed import (
    ROOM_OF_TIMED,
    ROOM_OF_TIMED_PER_AXIS,
    timed_length,
    write_cubic,
    write_turns,
)

Flags = NDArray[np.bool_]
Lines = NDArray[np.int32]

BLEND_LOOKS = 9
"""Places at which the speed in a blend is looked at."""

BETTER = 1e-3
"""The part of the time that a blend has to save."""

BLEND_ROOM = 3 + ROW * (MAX_ROWS + 1)
"""Numbers that the table of a blend may take."""

STAY, OVERLAP, BLEND = 0, 1, 2
"""Ways round a corner: as it is, ramps that overlap, a curve."""


@njit
def half_time(v: float, distance: float, top: float, a: float, j: float) -> float:
    """Time from the middle of a move to the end of ``distance`` where the speed is ``v``: its ramp,
    and what the top speed leaves of it.
    """
    peak = max(v, min(top, reachable_speed(v, distance, a, j)))
    return ramp_time(v, peak, a, j) + max(distance - ramp_distance(v, peak, a, j), 0.0) / peak


@njit
def blend_speed(
    data: Floats,
    at: int,
    feed: float,
    rules: Floats,
    axis_v: Floats,
    axis_a: Floats,
    axis_j: Floats,
    q: Floats,
) -> float:
    """The constant speed at which the cubic at ``at`` can be crossed. q: scratch (4, n)."""
    data[at + TABLE] = 1.0  # derivatives by arc length, please
    v = feed
    for k in range(BLEND_LOOKS):
        curve_eval_s(SPAN, data, at, k / (BLEND_LOOKS - 1.0), q)
        v = min(v, speed_bounds(data, at, q, feed, rules, axis_v, axis_a, axis_j)[0])
    data[at + TABLE] = 0.0
    return v


@njit
def choose(
    kind: Ints, at: Ints, data: Floats, length: Floats, bound: Floats, k: int, eps: float, rules: Floats, axis_v: Floats, axis_a: Floats,
    axis_j: Floats, blend: int, out_data: Floats, u: Floats, q: Floats, pair: Floats, ends: Floats,
) -> tuple[int, float]:  # fmt: skip
    """The fastest way round the corner behind line k and what a blend takes off both lines, mm; the
    blend is written at out_data[blend].

    Each way is given the time from the middle of the one line to the middle of the other, with no
    acceleration there. u (2, n), q (4, n), pair (2, 4, n), ends (3, n): scratch.
    """
    n = len(axis_v)
    a = at[k]
    b = at[k + 1]
    sine, widest = directions(data, a, data, b, u)
    if sine > 1.0:
        return STAY, 0.0
    straight, flat = joint(
        kind[k],
        data,
        a,
        length[k],
        bound[k],
        kind[k + 1],
        data,
        b,
        length[k + 1],
        bound[k + 1],
        rules,
        axis_v,
        axis_a,
        axis_j,
        pair,
    )
    if not flat:
        return STAY, 0.0
    v1, a1, j1 = line_bounds(u[0], bound[k], rules, axis_v, axis_a, axis_j)
    v2, a2, j2 = line_bounds(u[1], bound[k + 1], rules, axis_v, axis_a, axis_j)
    half1 = 0.5 * length[k]
    half2 = 0.5 * length[k + 1]
    best = half_time(straight, half1, v1, a1, j1) + half_time(straight, half2, v2, a2, j2)
    choice = STAY
    if straight == 0.0:
        t1 = ramp_shape(min(v1, reachable_speed(0.0, half1, a1, j1)), a1, j1)[0]
        t2 = ramp_shape(min(v2, reachable_speed(0.0, half2, a2, j2)), a2, j2)[0]
        room1 = LEGS_SHARE * length[k]
        room2 = LEGS_SHARE * length[k + 1]
        saved = overlap_time(u, sine, widest, j1, j2, t1, t2, room1, room2, eps, rules, axis_j)
        if saved > 0.0:
            best -= saved
            choice = OVERLAP
    taken = 0.0
    if sine <= SHARPEST:
        d = min(4.0 * eps / widest, LEGS_SHARE * length[k], LEGS_SHARE * length[k + 1])
        for i in range(n):
            corner = data[b + START + i]
            ends[0, i] = corner - d * u[0, i]
            ends[1, i] = d * u[0, i]
            ends[2, i] = corner + d * u[1, i]
        write_cubic(out_data, blend, a, ends[0], ends[1], ends[1], ends[2])
        v = min(
            reachable_speed(0.0, length[k] - d, a1, j1),
            reachable_speed(0.0, length[k + 1] - d, a2, j2),
        )
        v = blend_speed(
            out_data, blend, min(v, bound[k], bound[k + 1]), rules, axis_v, axis_a, axis_j, q
        )
        time = half_time(v, half1 - d, v1, a1, j1) + half_time(v, half2 - d, v2, a2, j2)
        time += timed_length(SPAN, out_data, blend, 1.0, q) / v
        if time < best * (1.0 - BETTER):
            choice = BLEND
            taken = d
    return choice, taken


@njit
def round_corners(
    own: int, kind: Ints, at: Ints, data: Floats, length: Floats, bound: Floats, feed: Floats, line: Lines, stop_after: Flags,
    tolerance: Floats, taken: float, rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats, accuracy: float,
    out_kind: Ints, out_at: Ints, out_data: Floats, out_length: Floats, out_feed: Floats, out_line: Lines, out_stop: Flags,
    out_tolerance: Floats,
) -> tuple[int, int, float]:  # fmt: skip
    """Choose the fastest way round each corner of a chunk of path, and put in the blends.

    kind .. tolerance: its pieces, as in PathChunk, ``own`` of them, and maybe the one that follows;
    bound: largest feed of each, infinite for a traverse. taken: mm that a blend has taken off the
    first. accuracy: largest error of the inverse arc length of blends, mm. out_*: room for twice
    the pieces, and for data. Where ramps shall overlap the tolerance stays, elsewhere it becomes 0.
    Returns (pieces, numbers, mm taken off the piece that follows); (-1, 0, 0) where there was no
    room for the data.
    """
    n = len(axis_v)
    u = np.zeros((2, n))
    q = np.zeros((4, n))
    pair = np.zeros((2, 4, n))
    ends = np.zeros((3, n))
    used = len(data)
    out_data[:used] = data
    count = 0
    for k in range(own):
        if used + BLEND_ROOM + ROOM_OF_TIMED + n * ROOM_OF_TIMED_PER_AXIS + START + 2 * n > len(
            out_data
        ):
            return -1, 0, 0.0
        choice = STAY
        reach = 0.0
        cornered = (
            tolerance[k] > 0.0
            and not stop_after[k]
            and k + 1 < len(kind)
            and kind[k] == LINE
            and kind[k + 1] == LINE
        )
        blend = used + START + 2 * n
        if cornered:
            choice, reach = choose(
                kind,
                at,
                data,
                length,
                bound,
                k,
                tolerance[k],
                rules,
                axis_v,
                axis_a,
                axis_j,
                blend,
                out_data,
                u,
                q,
                pair,
                ends,
            )
        out_kind[count] = kind[k]
        out_at[count] = at[k]
        if taken > 0.0 or reach > 0.0:
            out_at[count] = used
            used = write_line(out_data, used, at[k], taken, reach)
        out_length[count] = out_data[out_at[count] + LENGTH]
        out_feed[count] = feed[k]
        out_line[count] = line[k]
        out_stop[count] = stop_after[k]
        out_tolerance[count] = tolerance[k] if choice == OVERLAP else 0.0
        count += 1
        taken = 0.0
        if choice == BLEND:
            taken = reach
            out_kind[count] = SPAN
            out_at[count] = blend
            end = measure(
                SPAN, out_data, blend, blend + START + 2 * n + SPAN_BODY + 4 * (n + 1), accuracy, q
            )
            used = write_turns(out_data, blend, end)
            out_length[count] = out_data[blend + LENGTH]
            slower = bound[k] <= bound[k + 1]
            out_feed[count] = feed[k] if slower else feed[k + 1]
            out_line[count] = line[k]
            out_stop[count] = False
            out_tolerance[count] = 0.0
            count += 1
    return count, used, taken
