"""The best treatment of each corner between two straight moves that has a tolerance.

Three are compared by their time: the corner as it is, ramps that overlap, and a blend.

- A blend is a curve in place of the corner (:mod:`cnc.kernels.planner.blend`). It is planned as any
  curve is. Blends of several sizes are compared: a larger one is faster and takes more of the legs.
- At a sharp turn the motion stops, and the ramps on both sides of the stop overlap
  (:mod:`cnc.kernels.planner.overlap`).
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
    MAX_TURNING_POINTS,
    ROW,
    SPAN,
    SPAN_BODY,
    START,
    Floats,
)
from cnc.kernels.planner.blend import (
    DEGREE,
    Blend,
    blend_speed,
    fitted_blend,
    largest_reach,
    write_blend,
    write_blend_turns,
)
from cnc.kernels.planner.legs import (
    LEGS_SHARE,
    SHARPEST,
    LineBounds,
    directions,
    line_bounds,
    write_line,
)
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.limits import piece_junction
from cnc.kernels.planner.overlap import (
    Leg,
    common_jerk,
    overlap_time,
    softening_time,
    time_saved,
)
from cnc.kernels.planner.path_arrays import PathArrays
from cnc.kernels.planner.scurve import (
    peak_speed,
    ramp_distance,
    ramp_shape,
    ramp_time,
    reachable_speed,
)

BETTER = 1e-3
"""A blend has to save this part of the time."""

ALONE_SHARE = 0.9
"""The part of a move that a blend may take if the move has no other corner."""

SIZES = 4
"""Blends that are compared."""

SMALLER = 0.55
"""Ratio of their sizes. The largest without a swing has 0.23 of the size of the largest of all."""

BLEND_SIZE = START + SPAN_BODY + DEGREE + 1 + 3 + ROW * (MAX_ROWS + 1)
BLEND_SIZE_PER_AXIS = 2 + DEGREE + 1 + 1 + MAX_TURNING_POINTS
"""A record of a blend of n axes has at most BLEND_SIZE + n BLEND_SIZE_PER_AXIS numbers."""

STAY, OVERLAP, BLEND = 0, 1, 2
"""Treatments of a corner: as it is, ramps that overlap, a curve."""


class Scratch(NamedTuple):
    """Arrays that are used again for each corner.

    Attributes:
        u: (2, axes): directions of the legs.
        q: (4, axes): derivatives of a curve.
        pair: (2, 4, axes): derivatives on both sides of a junction.
    """

    u: Floats
    q: Floats
    pair: Floats


@njit
def side_time(v: float, taken: float, length: float, alone: bool, bounds: LineBounds) -> float:
    """Return the time of a move up to ``taken`` mm before its corner, where its speed is ``v``, s.

    The move begins at rest if its corner is ``alone``, the only one of the move. Else half of it is
    counted, from the middle without acceleration there.
    """
    top, a, j = bounds.v, bounds.a, bounds.j
    if alone:
        distance = length - taken
        peak = peak_speed(0.0, v, distance, max(top, v), a, j)
        ramps = ramp_distance(0.0, peak, a, j) + ramp_distance(peak, v, a, j)
        time = ramp_time(0.0, peak, a, j) + ramp_time(peak, v, a, j)
        return time + max(distance - ramps, 0.0) / peak
    distance = 0.5 * length - taken
    peak = max(v, min(top, reachable_speed(v, distance, a, j)))
    return ramp_time(v, peak, a, j) + max(distance - ramp_distance(v, peak, a, j), 0.0) / peak


@njit
def choose(
    path: PathArrays,
    k: int,
    alone: tuple[bool, bool],
    bound: Floats,
    limits: LimitArrays,
    scratch: Scratch,
) -> tuple[int, Blend]:
    """Choose the fastest treatment of the corner behind line ``k``.

    Each is rated by the time from the middle of the one line to the middle of the other, or from
    rest to rest where there is no other corner: :func:`side_time`.

    Args:
        path: the path.
        k: the line before the corner.
        alone: whether this is the only corner of line k, and of line k + 1.
        bound: largest feed of each piece, mm/s.
        limits: of the machine.
        scratch: receives the directions of the legs in ``u``.

    Returns:
        STAY, OVERLAP or BLEND, and the blend.
    """
    data, a, b = path.pieces.data, path.pieces.at[k], path.pieces.at[k + 1]
    length1, length2 = path.length[k], path.length[k + 1]
    u = scratch.u
    turn = directions(data, a, data, b, u)
    chosen = Blend(0.0, 0.0)
    if turn.sine > 1.0:
        return STAY, chosen
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
        return STAY, chosen
    line1 = line_bounds(u[0], bound[k], limits)
    line2 = line_bounds(u[1], bound[k + 1], limits)
    best = side_time(junction.speed, 0.0, length1, alone[0], line1)
    best += side_time(junction.speed, 0.0, length2, alone[1], line2)
    choice = STAY
    eps = path.tolerance[k]
    if junction.speed == 0.0:
        v1 = min(line1.v, reachable_speed(0.0, 0.5 * length1, line1.a, line1.j))
        v2 = min(line2.v, reachable_speed(0.0, 0.5 * length2, line2.a, line2.j))
        t1 = ramp_shape(v1, line1.a, line1.j)[0]
        t2 = ramp_shape(v2, line2.a, line2.j)[0]
        part = common_jerk(u, turn, line1.j, line2.j, limits)
        end1 = softening_time(v1, line1.a, line1.j, part)
        end2 = softening_time(v2, line2.a, line2.j, part)
        before = Leg(part * line1.j, end1, LEGS_SHARE * length1)
        after = Leg(part * line2.j, end2, LEGS_SHARE * length2)
        common = overlap_time(turn, before, after, eps, limits)
        if common > 0.0:
            saved = time_saved(common, part, t1, t2)
            if saved > 0.0:
                best -= saved
                choice = OVERLAP
    if turn.sine > SHARPEST:
        return choice, chosen
    best *= 1.0 - BETTER
    longest = (ALONE_SHARE if alone[0] else LEGS_SHARE) * length1
    longest = min(longest, (ALONE_SHARE if alone[1] else LEGS_SHARE) * length2)
    cosine = math.sqrt(1.0 - turn.sine * turn.sine)
    per_axis = False
    for i in range(len(limits.axis_jerk)):
        per_axis = per_axis or min(limits.axis_acceleration[i], limits.axis_jerk[i]) < math.inf
    largest = min(longest, largest_reach(eps, turn, 0.0 if per_axis else 1.0))
    for m in range(SIZES):
        blend = fitted_blend(largest * SMALLER**m, eps, turn)
        d = blend.reach
        v = min(blend_speed(blend, turn, u, limits), line1.v, line2.v)
        # The speed is lowest in the middle. With limits along the path alone it may change all the
        # way; limits of an axis leave nothing for that where the blend takes all of them.
        slowest = min(
            v * cosine,
            reachable_speed(0.0, length1, line1.a, line1.j),
            reachable_speed(0.0, length2, line2.a, line2.j),
        )
        time = side_time(slowest, 0.0, length1, alone[0], line1)
        time += side_time(slowest, 0.0, length2, alone[1], line2)
        if per_axis:
            v = min(v, reachable_speed(0.0, length1 - d, line1.a, line1.j))
            v = min(v, reachable_speed(0.0, length2 - d, line2.a, line2.j))
            steady = 2.0 * d * (1.0 + 2.0 * cosine) / (3.0 * v)
            steady += side_time(v, d, length1, alone[0], line1)
            time = max(time, steady + side_time(v, d, length2, alone[1], line2))
        if time < best:
            best = time
            choice = BLEND
            chosen = blend
    return choice, chosen


@njit
def round_corners(
    own: int,
    path: PathArrays,
    bound: Floats,
    taken: float,
    at_rest: bool,
    limits: LimitArrays,
    accuracy: float,
    out: PathArrays,
) -> tuple[int, int, float]:
    """Choose the treatment of each corner of a chunk of path, and insert the blends.

    Where ramps shall overlap, the tolerance stays; elsewhere it becomes 0.

    Args:
        own: number of pieces of the chunk.
        path: these pieces, and perhaps the one behind them.
        bound: largest feed of each, mm/s; infinite for a traverse.
        taken: length that a blend has taken off the first piece, mm.
        at_rest: whether the motion begins at rest there.
        limits: of the machine.
        accuracy: largest error of the inverse arc length of blends, mm.
        out: space for twice the pieces, and for their records.

    Returns:
        The numbers of pieces and of numbers of the result, and the length taken off the piece
        behind it, mm; (-1, 0, 0) if ``out`` has no space for the records.
    """
    n = len(limits.axis_velocity)
    scratch = Scratch(np.zeros((2, n)), np.zeros((4, n)), np.zeros((2, 4, n)))
    pieces, data, at = out.pieces, out.pieces.data, out.pieces.at
    used = len(path.pieces.data)
    for i in range(used):
        data[i] = path.pieces.data[i]
    count = 0
    for k in range(own):
        if used + BLEND_SIZE + n * BLEND_SIZE_PER_AXIS + START + 2 * n > len(data):
            return -1, 0, 0.0
        choice = STAY
        blend = Blend(0.0, 0.0)
        record = used + START + 2 * n
        if (
            path.tolerance[k] > 0.0
            and not path.stop_after[k]
            and k + 1 < len(path.pieces.kind)
            and path.pieces.kind[k] == LINE
            and path.pieces.kind[k + 1] == LINE
        ):
            begins = path.stop_after[k - 1] if k > 0 else at_rest
            ends = k + 1 < own and path.stop_after[k + 1]
            choice, blend = choose(path, k, (begins, ends), bound, limits, scratch)
        pieces.kind[count] = path.pieces.kind[k]
        at[count] = path.pieces.at[k]
        if taken > 0.0 or blend.reach > 0.0:
            at[count] = used
            used = write_line(data, used, path.pieces.at[k], taken, blend.reach)
        out.length[count] = data[at[count] + LENGTH]
        out.feed[count] = path.feed[k]
        out.line[count] = path.line[k]
        out.stop_after[count] = path.stop_after[k]
        out.tolerance[count] = path.tolerance[k] if choice == OVERLAP else 0.0
        count += 1
        taken = 0.0
        if choice == BLEND:
            taken = blend.reach
            pieces.kind[count] = SPAN
            at[count] = record
            corner = path.pieces.at[k + 1] + START
            table = write_blend(data, record, path.pieces.at[k], corner, scratch.u, blend)
            end = measure(SPAN, data, record, table, accuracy, scratch.q)
            used = write_blend_turns(data, record, end)
            out.length[count] = data[record + LENGTH]
            slower = bound[k] <= bound[k + 1]
            out.feed[count] = path.feed[k] if slower else path.feed[k + 1]
            out.line[count] = path.line[k]
            out.stop_after[count] = False
            out.tolerance[count] = 0.0
            count += 1
    return count, used, taken
