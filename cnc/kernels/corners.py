r"""Corners of straight moves under a tolerance: the ramp from rest begins while the ramp to rest still runs.

        v |``\                  ,--     A stop takes the ramp down and the ramp up one after the other. Where both end and begin with
          |   \  before        /        constant jerk (J1, J2) the second may begin tau early: the motion cuts the corner by
          |    `.           ,-'
          |______`-.____,-'______ t          e(x) = | -d1 (1-x)^3 u1 + d2 x^3 u2 |,   d = J tau^3 / 6,   x = t / tau.
          |``\     ,--
          |   \   /    after         At the x where both distances are the same, J1 J2 / (c1 + c2)^3 tau^3 / 6 with c = J^(1/3), e is
          |    `./                   2 sin(theta/2) times that (theta: the turn): no less than what separates corner and motion, and more
          |____,'`._____________ t   than what separates motion and corner's legs. With e = eps and equal jerks

                                             tau = (24 eps / (J sin(theta/2)))^(1/3).

In common every axis has the jerk J1 u1 + J2 u2: constant, so that the common part is a timed piece (:mod:`cnc.kernels.timed`). Speeds and
accelerations of an axis are means of those of the two ramps, with weights whose sum is no more than 1; its jerk is a sum, and has to be
looked at. So have the tangential jerk (about J (4 sin^2(theta/2) / cos(theta/2) + 2 cos(theta/2)) in the middle: never less than 2 J)
and accelerations along the path where the machine limits them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.arclength import MAX_ROWS, measure
from cnc.kernels.curve import (
    ARC,
    ARC_BODY,
    LENGTH,
    LINE,
    METRIC,
    METRICS,
    ROW,
    SPAN,
    SPAN_BODY,
    START,
    TABLE,
    U1,
    Floats,
    Ints,
    curve_eval_s,
)
from cnc.kernels.jit import njit
from cnc.kernels.limits import UNSEEN, joint, speed_bound
from cnc.kernels.scurve import ramp_distance, ramp_shape, ramp_time, reachable_speed
from cnc.kernels.timed import ROOM_OF_TIMED, ROOM_OF_TIMED_PER_AXIS, timed_length, write_cubic, write_timed, write_turns

Flags = NDArray[np.bool_]
Lines = NDArray[np.int32]

SHARPEST = math.sin(math.radians(135.0) / 2.0)
"""Sine of half the largest turn at which the motion doesn't stop on the corner."""

LEGS_SHARE = 0.49
"""The part of a move that either of its corners may take."""

PHASE_SHARE = 0.999
"""The part of a ramp's last phase that may be overlapped: something is left of it, so that phases remain where they are."""

SHORTEST = 1e-6
"""mm; corners that are cut by less are stops."""

LOOKS = 33
"""Places at which a motion in common is compared with the limits along the path."""

BLEND_LOOKS = 9
"""Places at which the speed in a blend is looked at."""

BETTER = 1e-3
"""The part of the time that a blend has to save."""

BLEND_ROOM = 3 + ROW * (MAX_ROWS + 1)
"""Numbers that the table of a blend may take."""

STAY, OVERLAP, BLEND = 0, 1, 2
"""Ways round a corner: as it is, ramps that overlap, a curve."""

REST = 1e-9
"""mm, mm/s: what rounding leaves of a distance and a speed of nothing."""

SPLIT = 1e-12
"""s: what rounding leaves of a time of nothing."""


@njit
def directions(data_a: Floats, at_a: int, data_b: Floats, at_b: int, u: Floats) -> tuple[float, float]:
    """Directions of two lines, per mm of path, into ``u`` (2, n).

    Returns sin(theta/2) and the sine that counts for the tolerance: no less than the former, more where axes that don't measure the path
    turn more; both 2 where the lines are measured over different axes.
    """
    n = u.shape[1]
    for i in range(n):
        u[0, i] = (data_a[at_a + START + n + i] - data_a[at_a + START + i]) / data_a[at_a + LENGTH]
        u[1, i] = (data_b[at_b + START + n + i] - data_b[at_b + START + i]) / data_b[at_b + LENGTH]
    squared = 0.0
    same = data_a[at_a + METRICS] == data_b[at_b + METRICS]
    for m in range(int(data_a[at_a + METRICS])):
        same = same and data_a[at_a + METRIC + m] == data_b[at_b + METRIC + m]
        i = int(data_a[at_a + METRIC + m])
        squared += (u[1, i] - u[0, i]) ** 2
    if not same:
        return 2.0, 2.0
    sine = 0.5 * math.sqrt(squared)
    widest = sine
    for i in range(n):
        widest = max(widest, 0.5 * abs(u[1, i] - u[0, i]))
    return sine, widest


@njit
def overlap_time(
    u: Floats, sine: float, widest: float, j1: float, j2: float, t1: float, t2: float, room1: float, room2: float, eps: float,
    data: Floats, at: int, rules: Floats, axis_j: Floats,
) -> float:  # fmt: skip
    """How long the ramps of two lines may have in common, s; 0 where that breaks a limit or saves nothing.

    u, sine, widest: from :func:`directions`. j1, j2: the jerks beside the corner, t1, t2: how long they last. room1, room2: how much of
    each line may be used, mm. eps: how far the motion may stay away from the corner, mm. data, at: either record, for its metric axes.
    """
    if sine > SHARPEST or sine == 0.0:
        return 0.0
    for i in range(u.shape[1]):
        if abs(j1 * u[0, i] + j2 * u[1, i]) > axis_j[i]:
            return 0.0
    roots = j1 ** (1.0 / 3.0) + j2 ** (1.0 / 3.0)
    tau = (3.0 * eps / (j1 * j2 * widest)) ** (1.0 / 3.0) * roots
    tau = min(tau, PHASE_SHARE * t1, PHASE_SHARE * t2, (6.0 * room1 / j1) ** (1.0 / 3.0), (6.0 * room2 / j2) ** (1.0 / 3.0))
    if min(rules[0], rules[1], rules[2]) < math.inf or rules[3] < rules[4] * rules[4] / 8.0 * max(j1, j2) * tau:
        # From the middle of a mean's two ends: d/dt |r'| etc. as in timed_motion, with tau = 1.
        cos = 1.0 - 2.0 * sine * sine
        most = 0.0
        pull = 0.0
        bend = 0.0
        for k in range(LOOKS):
            x = k / (LOOKS - 1.0)
            a1 = -j1 * (1.0 - x)
            a2 = j2 * x
            v1 = 0.5 * j1 * (1.0 - x) ** 2
            v2 = 0.5 * j2 * x * x
            speed = math.sqrt(v1 * v1 + v2 * v2 + 2.0 * v1 * v2 * cos)
            squared = a1 * a1 + a2 * a2 + 2.0 * a1 * a2 * cos
            along = (v1 * a1 + v2 * a2 + (v1 * a2 + v2 * a1) * cos) / speed
            jerk = (squared + v1 * j1 + v2 * j2 + (v1 * j2 + v2 * j1) * cos - along * along) / speed
            most = max(most, abs(jerk))
            pull = max(pull, abs(along))
            bend = max(bend, math.sqrt(max(squared - along * along, 0.0)))
        if most > rules[1]:
            return 0.0
        tau = min(tau, rules[0] / pull, rules[2] / bend, 8.0 * rules[3] / (rules[4] * rules[4] * bend))
    return tau if min(j1, j2) * tau**3 / 6.0 > SHORTEST else 0.0


@njit
def record_end(kind: int, data: Floats, at: int) -> int:
    """Index behind the record of a piece."""
    n = int(data[at])
    body = at + START + 2 * n
    end = body
    if kind == ARC:
        end = body + ARC_BODY
        if data[at + TABLE] != 0.0:
            end += 3 + ROW * int(data[end])
    elif kind == SPAN:
        turning = at + int(data[body + 1])
        end = turning + n
        for i in range(n):
            end += int(data[turning + i])
    return end


@njit
def write_line(data: Floats, at: int, like: int, from_start: float, from_end: float) -> int:
    """Write what is left of the line at ``like`` without so much at its start and end (mm); returns the index behind the record."""
    n = int(data[like])
    length = data[like + LENGTH]
    for k in range(START):
        data[at + k] = data[like + k]
    for i in range(n):
        start = data[like + START + i]
        end = data[like + START + n + i]
        rate = (end - start) / length
        data[at + START + i] = start + from_start * rate if from_start > 0.0 else start
        data[at + START + n + i] = end - from_end * rate if from_end > 0.0 else end
    data[at + LENGTH] = data[at + U1] = length - from_start - from_end
    return at + START + 2 * n


@njit
def overlap_stops(
    kind: Ints, at: Ints, data: Floats, length: Floats, feed: Floats, line: Lines, stop_after: Flags, tolerance: Floats, piece_s: Floats,
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats, rules: Floats, axis_j: Floats,
    out_kind: Ints, out_at: Ints, out_data: Floats, out_length: Floats, out_feed: Floats, out_line: Lines, out_stop: Flags,
    out_tolerance: Floats, out_piece_s: Floats,
    out_t: Floats, out_s: Floats, out_v: Floats, out_a: Floats, out_j: Floats,
) -> tuple[int, int, int]:  # fmt: skip
    """Let the ramps at the stops on corners of a plan overlap.

    kind .. phase_j: a plan, as in PlanChunk. out_*: room for the new one: twice the pieces, phases and one more, and for the data that of
    all records and :func:`overlap_room` for each piece. Returns how many (pieces, phases, numbers) that has; (0, 0, 0) if nothing changes.
    """
    n = len(axis_j)
    pieces = len(kind)
    u = np.zeros((2, n))
    q = np.zeros((4, n))
    tau = np.zeros(pieces)  # at the end of a piece
    before = np.zeros(pieces)
    after = np.zeros(pieces)  # mm in common with the piece before, with the piece after
    place = np.zeros(pieces, np.int64)  # of the timed piece behind it
    ends = np.zeros((3, n))
    ending = np.full(len(phase_j), -1)  # the piece at whose end a phase comes to rest
    found = False
    b = 0
    for k in range(1, len(phase_j)):
        if phase_v[k] != 0.0 or phase_a[k] != 0.0:
            continue
        while b + 1 < pieces and piece_s[b + 1] < phase_s[k] - REST:
            b += 1
        if b + 1 >= pieces or stop_after[b] or not tolerance[b] > 0.0 or kind[b] != LINE or kind[b + 1] != LINE:
            continue
        j1 = phase_j[k - 1]
        j2 = phase_j[k]
        t1 = phase_t[k] - phase_t[k - 1]
        if j1 <= 0.0 or j2 <= 0.0 or abs(phase_s[k] - piece_s[b + 1]) > REST or abs(phase_a[k - 1] + j1 * t1) > SPLIT * j1:
            continue
        sine, widest = directions(data, at[b], data, at[b + 1], u)
        room1 = min(LEGS_SHARE * length[b], phase_s[k] - phase_s[k - 1])
        room2 = min(LEGS_SHARE * length[b + 1], phase_s[k + 1] - phase_s[k])
        tau[b] = overlap_time(
            u, sine, widest, j1, j2, t1, phase_t[k + 1] - phase_t[k], room1, room2, tolerance[b], data, at[b], rules, axis_j
        )
        if tau[b] > 0.0:
            found = True
            ending[k - 1] = b
            after[b] = j1 * tau[b] ** 3 / 6.0
            before[b + 1] = j2 * tau[b] ** 3 / 6.0
    if not found:
        return 0, 0, 0
    # the records, then those of what has changed
    lowest = at[0]
    used = 0
    for k in range(pieces):
        lowest = min(lowest, at[k])
        used = max(used, record_end(kind[k], data, at[k]))
    used -= lowest
    out_data[:used] = data[lowest : lowest + used]
    count = 0
    s = 0.0
    for k in range(pieces):
        out_kind[count] = kind[k]
        out_at[count] = at[k] - lowest
        out_length[count] = length[k]
        if before[k] > 0.0 or after[k] > 0.0:
            out_at[count] = used
            used = write_line(out_data, used, at[k] - lowest, before[k], after[k])
            out_length[count] = out_data[out_at[count] + LENGTH]
        out_feed[count] = feed[k]
        out_line[count] = line[k]
        out_stop[count] = stop_after[k]
        out_tolerance[count] = 0.0 if tau[k] > 0.0 else tolerance[k]
        out_piece_s[count] = s
        s += out_length[count]
        count += 1
        if tau[k] > 0.0:
            directions(data, at[k], data, at[k + 1], u)
            left = out_at[count - 1] + START + n
            corner = at[k + 1] + START
            for i in range(n):
                ends[0, i] = out_data[left + i]
                ends[1, i] = data[corner + i] - ends[0, i]
                ends[2, i] = data[corner + i] + before[k + 1] * u[1, i]
            place[k] = count
            out_kind[count] = SPAN
            out_at[count] = used
            used = write_timed(out_data, used, out_at[count - 1], ends[0], ends[1], ends[1], ends[2], q)
            out_length[count] = out_data[out_at[count] + LENGTH]
            out_feed[count] = max(feed[k], feed[k + 1]) if feed[k] == feed[k] and feed[k + 1] == feed[k + 1] else math.nan
            out_line[count] = line[k]
            out_stop[count] = False
            out_tolerance[count] = 0.0
            out_piece_s[count] = s
            s += out_length[count]
            count += 1
    out_piece_s[count] = s
    written = 0
    earlier = 0.0
    shift = 0.0
    begun = -1
    for k in range(len(phase_j) + 1):
        out_t[written] = phase_t[k] - earlier
        out_s[written] = phase_s[k] + shift
        out_v[written] = phase_v[k]
        out_a[written] = phase_a[k]
        if begun >= 0:
            # the ramp from rest, from where the ramp to rest has ended
            j = phase_j[k]
            out_t[written] = out_t[written - 1] + tau[begun]
            out_s[written] = out_piece_s[place[begun] + 1]
            out_v[written] = 0.5 * j * tau[begun] ** 2
            out_a[written] = j * tau[begun]
            earlier += tau[begun]
            shift = out_s[written] - (piece_s[begun + 1] + before[begun + 1])
            begun = -1
        if k == len(phase_j):
            break
        out_j[written] = phase_j[k]
        written += 1
        begun = ending[k]
        if begun >= 0:
            out_t[written] = phase_t[k + 1] - earlier - tau[begun]
            out_s[written] = out_piece_s[place[begun]]
            out_v[written] = out_length[place[begun]] / tau[begun]
            out_a[written] = 0.0
            out_j[written] = 0.0
            written += 1
    return count, written, used


@njit
def half_time(v: float, distance: float, top: float, a: float, j: float) -> float:
    """Time from the middle of a move to the end of ``distance`` where the speed is ``v``: its ramp, and what the top speed leaves of it."""
    peak = max(v, min(top, reachable_speed(v, distance, a, j)))
    return ramp_time(v, peak, a, j) + max(distance - ramp_distance(v, peak, a, j), 0.0) / peak


@njit
def line_bounds(u: Floats, feed: float, rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats) -> tuple[float, float, float]:
    """Speed, acceleration and jerk along a line of direction ``u`` (n,)."""
    v = feed
    a = rules[0]
    j = rules[1]
    for i in range(len(u)):
        if u[i] != 0.0:
            v = min(v, axis_v[i] / abs(u[i]))
            a = min(a, axis_a[i] / abs(u[i]))
            j = min(j, axis_j[i] / abs(u[i]))
    return v, a, j * (1.0 - 2.0 * UNSEEN)


@njit
def blend_speed(data: Floats, at: int, feed: float, rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats, q: Floats) -> float:
    """The constant speed at which the cubic at ``at`` can be crossed. q: scratch (4, n)."""
    data[at + TABLE] = 1.0  # derivatives by arc length, please
    v = feed
    for k in range(BLEND_LOOKS):
        curve_eval_s(SPAN, data, at, k / (BLEND_LOOKS - 1.0), q)
        v = min(v, speed_bound(data, at, q, feed, rules, axis_v, axis_a, axis_j))
    data[at + TABLE] = 0.0
    return v


@njit
def choose(
    kind: Ints, at: Ints, data: Floats, length: Floats, bound: Floats, k: int, eps: float, rules: Floats, axis_v: Floats, axis_a: Floats,
    axis_j: Floats, blend: int, out_data: Floats, u: Floats, q: Floats, pair: Floats, ends: Floats,
) -> tuple[int, float]:  # fmt: skip
    """The fastest way round the corner behind line k and what a blend takes off both lines, mm; the blend is written at out_data[blend].

    Each way is given the time from the middle of the one line to the middle of the other, with no acceleration there. u (2, n), q (4, n),
    pair (2, 4, n), ends (3, n): scratch.
    """
    n = len(axis_v)
    a = at[k]
    b = at[k + 1]
    sine, widest = directions(data, a, data, b, u)
    if sine > 1.0:
        return STAY, 0.0
    straight, flat = joint(
        kind[k], data, a, length[k], bound[k], kind[k + 1], data, b, length[k + 1], bound[k + 1], rules, axis_v, axis_a, axis_j, pair
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
        saved = overlap_time(u, sine, widest, j1, j2, t1, t2, room1, room2, eps, data, a, rules, axis_j)
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
        v = min(reachable_speed(0.0, length[k] - d, a1, j1), reachable_speed(0.0, length[k + 1] - d, a2, j2))
        v = blend_speed(out_data, blend, min(v, bound[k], bound[k + 1]), rules, axis_v, axis_a, axis_j, q)
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

    kind .. tolerance: its pieces, as in PathChunk, ``own`` of them, and maybe the one that follows; bound: largest feed of each, infinite
    for a traverse. taken: mm that a blend has taken off the first. accuracy: largest error of the inverse arc length of blends, mm. out_*:
    room for twice the pieces, and for data. Where ramps shall overlap the tolerance stays, elsewhere it becomes 0. Returns (pieces,
    numbers, mm taken off the piece that follows); (-1, 0, 0) where there was no room for the data.
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
        if used + BLEND_ROOM + ROOM_OF_TIMED + n * ROOM_OF_TIMED_PER_AXIS + START + 2 * n > len(out_data):
            return -1, 0, 0.0
        choice = STAY
        reach = 0.0
        cornered = tolerance[k] > 0.0 and not stop_after[k] and k + 1 < len(kind) and kind[k] == LINE and kind[k + 1] == LINE
        blend = used + START + 2 * n
        if cornered:
            choice, reach = choose(
                kind, at, data, length, bound, k, tolerance[k], rules, axis_v, axis_a, axis_j, blend, out_data, u, q, pair, ends
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
            end = measure(SPAN, out_data, blend, blend + START + 2 * n + SPAN_BODY + 4 * (n + 1), accuracy, q)
            used = write_turns(out_data, blend, end)
            out_length[count] = out_data[blend + LENGTH]
            slower = bound[k] <= bound[k + 1]
            out_feed[count] = feed[k] if slower else feed[k + 1]
            out_line[count] = line[k]
            out_stop[count] = False
            out_tolerance[count] = 0.0
            count += 1
    return count, used, taken


@njit
def overlap_room(axes: int) -> int:
    """Numbers that a timed piece and what is left of the line before it may take."""
    return ROOM_OF_TIMED + axes * ROOM_OF_TIMED_PER_AXIS + START + 2 * axes
