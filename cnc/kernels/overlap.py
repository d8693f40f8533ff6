r"""The ramps at a stop on a corner overlap in time: the ramp from rest begins while the ramp to rest still runs.

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

Where the two legs move different axes each may run past the corner by a little and come back: jerks +J, -J at the end of the ramp to rest
instead of +J alone, the last for a time e. That costs 2 e a ramp, and lets the motion in common last about 6 e longer: near its end a ramp
that overshoots is closer to the corner than one that doesn't. It is a ramp to the speed -J e^2 at J e^3 behind the corner and a way back
of 2 e, and it passes the corner by 1.943 J e^3, which is to be within the tolerance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.curve import ARC, ARC_BODY, LENGTH, LINE, METRIC, METRICS, ROW, SPAN, START, TABLE, U1, Floats, Ints
from cnc.kernels.jit import njit
from cnc.kernels.limits import UNSEEN
from cnc.kernels.scurve import peak_speed, ramp_distance, ramp_shape
from cnc.kernels.timed import ROOM_OF_TIMED, ROOM_OF_TIMED_PER_AXIS, write_timed

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

REST = 1e-9
"""mm, mm/s: what rounding leaves of a distance and a speed of nothing."""

SPLIT = 1e-12
"""s: what rounding leaves of a time of nothing."""

PAST = 1.943
"""A ramp of jerk J passes the corner by this times J e^3: what :func:`remaining` has at its lowest, at t = e (2 + sqrt 2)."""

BACK = 4.85
"""A ramp to rest is beyond the corner for the last this times e: :func:`remaining` is negative there."""

TRIES = 4
"""Overshoots that are compared: the largest that the tolerance allows, and parts of it."""

GAIN = 1e-5
"""s; an overshoot has to save this."""

ROOM_OF_CORNER = 3
"""Timed pieces that a corner may have."""


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
    rules: Floats, axis_j: Floats,
) -> float:  # fmt: skip
    """How long the ramps of two lines may have in common, s; 0 where that breaks a limit or saves nothing.

    u, sine, widest: from :func:`directions`. j1, j2: the jerks beside the corner, t1, t2: how long they last. room1, room2: how much of
    each line may be used, mm. eps: how far the motion may stay away from the corner, mm.
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
    return v, a * (1.0 - UNSEEN), j * (1.0 - 2.0 * UNSEEN)


@njit
def remaining(t: float, e: float) -> float:
    """Distance that a ramp to rest of jerk 1 has left a time ``t`` before its end, t >= e, if it ends with an overshoot of ``e``."""
    x = t - e
    return ((x / 3.0 - e) * x - e * e) * x / 2.0 - e * e * e / 6.0


@njit
def time_remaining(distance: float, e: float) -> float:
    """The time before its end at which the ramp of :func:`remaining` has ``distance`` > 0 left for the last time."""
    low = 3.0 * e
    high = 4.0 * e + 2.0 * (6.0 * distance) ** (1.0 / 3.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if remaining(middle, e) < distance:
            low = middle
        else:
            high = middle
    return low


@njit
def write_leg(
    s: float, length: float, e1: float, e2: float, top: float, a: float, j: float, t: float,
    out_t: Floats, out_s: Floats, out_v: Floats, out_a: Floats, out_j: Floats, written: int,
) -> int:  # fmt: skip
    """Write the phases of a move from rest to rest that overshoots for times ``e1`` and ``e2`` at its ends; returns the new count.

    s, t: where and when it begins; length mm; top, a, j: bounds.
    """
    v1 = -j * e1 * e1
    v2 = -j * e2 * e2
    distance = length + j * (e1**3 + e2**3)
    peak = peak_speed(v1, v2, distance, top, a, j)
    t1, c1, _ = ramp_shape(peak - v1, a, j)
    t2, c2, _ = ramp_shape(peak - v2, a, j)
    cruise = max(distance - ramp_distance(v1, peak, a, j) - ramp_distance(peak, v2, a, j), 0.0) / peak
    v = 0.0
    acc = 0.0
    here = s
    for m in range(9):
        dt = e1 if m == 0 else e1 + t1 if m == 1 else c1 if m == 2 else t1 if m == 3 else cruise
        if m > 4:
            dt = t2 if m == 5 else c2 if m == 6 else t2 + e2 if m == 7 else e2
        jerk = -j if m == 0 or m == 3 or m == 5 or m == 8 else j if m == 1 or m == 7 else 0.0
        if dt <= 0.0:
            continue
        out_t[written] = t
        out_s[written] = here
        out_v[written] = v
        out_a[written] = acc
        out_j[written] = jerk
        written += 1
        t += dt
        here += dt * (v + dt * (0.5 * acc + dt * jerk / 6.0))
        v += dt * (acc + 0.5 * dt * jerk)
        acc += dt * jerk
        if m == 3 or m == 4:
            v = peak
            acc = 0.0
    out_t[written] = t
    out_s[written] = s + length
    out_v[written] = 0.0
    out_a[written] = 0.0
    return written


@njit
def overshoot(
    kind: Ints, at: Ints, data: Floats, length: Floats, bound: Floats, stop_after: Flags, tolerance: Floats, piece_s: Floats,
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats,
    rules: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats, past: Floats, out_t: Floats, out_s: Floats, out_v: Floats, out_a: Floats,
    out_j: Floats,
) -> int:  # fmt: skip
    """Let straight moves between two rests run past their corners where that saves time.

    kind .. phase_j: a plan, as in PlanChunk; bound: largest feed of each piece. past (pieces,): the time of the overshoot at the end of
    each, or 0. out_*: room for the new phases, 4 more for each piece. Returns how many phases there are; 0 if nothing changes.
    """
    pieces = len(kind)
    phases = len(phase_j)
    n = len(axis_j)
    u = np.zeros((2, n))
    first = np.full(pieces, -1)  # phases of a move from rest to rest, from this one
    end = np.zeros(pieces, np.int64)  # to the one before this
    top = np.zeros(pieces)
    accel = np.zeros(pieces)
    jerk = np.zeros(pieces)
    most = min(rules[0], rules[1], rules[2])
    if most < math.inf:
        return 0
    rest = -1
    b = 0
    for k in range(phases + 1):
        if phase_v[k] != 0.0 or abs(phase_a[k]) > SPLIT * abs(phase_j[max(k - 1, 0)]):
            continue
        if rest >= 0:
            while b + 1 < pieces and piece_s[b + 1] <= phase_s[rest] + REST:
                b += 1
            if kind[b] == LINE and abs(piece_s[b] - phase_s[rest]) <= REST and abs(piece_s[b + 1] - phase_s[k]) <= REST:
                directions(data, at[b], data, at[b], u)
                first[b] = rest
                end[b] = k
                top[b], accel[b], _ = line_bounds(u[0], bound[b], rules, axis_v, axis_a, axis_j)
                for m in range(rest, k):
                    jerk[b] = max(jerk[b], abs(phase_j[m]))
                    if phase_j[m] == 0.0:
                        # what holds the plan's speed or acceleration down here holds the new one's
                        if phase_a[m] != 0.0:
                            accel[b] = min(accel[b], abs(phase_a[m]))
                        elif (phase_t[m + 1] - phase_t[m]) * phase_v[m] > 1e-6 * length[b]:
                            top[b] = min(top[b], phase_v[m])
                for m in range(rest, k):
                    if phase_j[m] != 0.0 and abs(abs(phase_j[m]) - jerk[b]) > 1e-9 * jerk[b]:
                        first[b] = -1
        rest = k
    found = False
    for b in range(pieces - 1):
        past[b] = 0.0
        if first[b] < 0 or first[b + 1] < 0 or stop_after[b] or not tolerance[b] > 0.0 or end[b] != first[b + 1]:
            continue
        sine, _ = directions(data, at[b], data, at[b + 1], u)
        j1 = jerk[b]
        j2 = jerk[b + 1]
        legal = sine < SHARPEST
        for i in range(n):
            legal = legal and j1 * abs(u[0, i]) + j2 * abs(u[1, i]) <= axis_j[i]
        if not legal:
            continue
        near = tolerance[b] / math.sqrt(2.0)
        largest = (0.999 * tolerance[b] / (PAST * max(j1, j2))) ** (1.0 / 3.0)
        peak1 = phase_v[first[b] : end[b]].max()
        peak2 = phase_v[first[b + 1] : end[b + 1]].max()
        t1 = ramp_shape(peak1, accel[b], j1)[0]
        t2 = ramp_shape(peak2, accel[b + 1], j2)[0]
        best = GAIN
        for m in range(TRIES + 1):
            e = largest * m / TRIES
            common = time_remaining(near / j1, e) + time_remaining(near / j2, e)
            common = min(common, PHASE_SHARE * (t1 + 2.0 * e), PHASE_SHARE * (t2 + 2.0 * e))
            gain = common - 4.0 * e - (j1 / accel[b] + j2 / accel[b + 1]) * e * e
            gain -= 0.5 * (accel[b] / peak1 + accel[b + 1] / peak2) * e * e
            if m == 0:
                best += gain
            elif gain > best and common > 2.1 * BACK * e and max(j1 / accel[b], j2 / accel[b + 1]) * e < 0.5:
                best = gain
                past[b] = e
        found = found or past[b] > 0.0
    if not found:
        return 0
    written = 0
    later = 0.0
    b = 0
    k = 0
    while k < phases:
        while b < pieces and first[b] < k:
            b += 1
        begins = b < pieces and first[b] == k
        before = past[b - 1] if begins and b > 0 else 0.0
        after = past[b] if begins else 0.0
        if before > 0.0 or after > 0.0:
            t = phase_t[k] + later
            written = write_leg(
                piece_s[b], piece_s[b + 1] - piece_s[b], before, after, top[b], accel[b], jerk[b], t,
                out_t, out_s, out_v, out_a, out_j, written,
            )  # fmt: skip
            k = end[b]
            later = out_t[written] - phase_t[k]
        else:
            out_t[written] = phase_t[k] + later
            out_s[written] = phase_s[k]
            out_v[written] = phase_v[k]
            out_a[written] = phase_a[k]
            out_j[written] = phase_j[k]
            written += 1
            k += 1
    out_t[written] = phase_t[k] + later
    out_s[written] = phase_s[k]
    out_v[written] = phase_v[k]
    out_a[written] = phase_a[k]
    return written


@njit
def at_time(t: float, k: int, phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats, out: Floats) -> None:
    """Write s, v, a at time ``t`` of phase ``k``, and its jerk."""
    dt = t - phase_t[k]
    j = phase_j[k]
    out[0] = phase_s[k] + dt * (phase_v[k] + dt * (0.5 * phase_a[k] + dt * j / 6.0))
    out[1] = phase_v[k] + dt * (phase_a[k] + 0.5 * dt * j)
    out[2] = phase_a[k] + dt * j
    out[3] = j


@njit
def overlap_stops(
    kind: Ints, at: Ints, data: Floats, length: Floats, feed: Floats, line: Lines, stop_after: Flags, tolerance: Floats, piece_s: Floats,
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats, past: Floats, rules: Floats, axis_j: Floats,
    out_kind: Ints, out_at: Ints, out_data: Floats, out_length: Floats, out_feed: Floats, out_line: Lines, out_stop: Flags,
    out_tolerance: Floats, out_piece_s: Floats,
    out_t: Floats, out_s: Floats, out_v: Floats, out_a: Floats, out_j: Floats,
) -> tuple[int, int, int]:  # fmt: skip
    """Let the ramps at the stops on corners of a plan overlap.

    kind .. phase_j: a plan, as in PlanChunk; past: overshoots at the ends of its pieces (:func:`overshoot`). out_*: room for the new one:
    four times the pieces, phases and four for each piece and one more, and for the data that of all records and :func:`overlap_room` for
    each piece. Returns how many (pieces, phases, numbers) that has; (0, 0, 0) if nothing changes, (-1, 0, 0) if an overshoot isn't
    possible.
    """
    n = len(axis_j)
    pieces = len(kind)
    u = np.zeros((2, n))
    q = np.zeros((4, n))
    tau = np.zeros(pieces)  # at the end of a piece
    before = np.zeros(pieces)
    after = np.zeros(pieces)  # mm in common with the piece before, with the piece after
    rest = np.zeros(pieces, np.int64)  # the phase that begins at its end
    ends = np.zeros((4, n))
    a = np.zeros(4)
    c = np.zeros(4)
    found = False
    b = 0
    for k in range(1, len(phase_j)):
        if phase_v[k] != 0.0 or phase_a[k] != 0.0:
            continue
        while b + 1 < pieces and piece_s[b + 1] < phase_s[k] - REST:
            b += 1
        if b + 1 >= pieces or stop_after[b] or not tolerance[b] > 0.0 or kind[b] != LINE or kind[b + 1] != LINE:
            continue
        if abs(phase_s[k] - piece_s[b + 1]) > REST:
            continue
        e = past[b]
        # the phases that reach into the motion in common: one on either side, two with an overshoot
        m = 1 if e == 0.0 else 2
        if k < m or k + m > len(phase_j):
            continue
        j1 = phase_j[k - m]
        j2 = phase_j[k + m - 1]
        t1 = phase_t[k] - phase_t[k - m]
        t2 = phase_t[k + m] - phase_t[k]
        sine, widest = directions(data, at[b], data, at[b + 1], u)
        common = 0.0
        if e > 0.0:
            near = tolerance[b] / math.sqrt(2.0)
            common = min(time_remaining(near / j1, e) + time_remaining(near / j2, e), PHASE_SHARE * t1, PHASE_SHARE * t2)
            common = min(common, 8.0 * rules[3] / (rules[4] * rules[4] * math.sqrt(j1 * j1 + j2 * j2)))
        elif j1 > 0.0 and j2 > 0.0 and abs(phase_a[k - 1] + j1 * t1) <= SPLIT * j1:
            room1 = min(LEGS_SHARE * length[b], phase_s[k] - phase_s[k - 1])
            room2 = min(LEGS_SHARE * length[b + 1], phase_s[k + 1] - phase_s[k])
            common = overlap_time(u, sine, widest, j1, j2, t1, t2, room1, room2, tolerance[b], rules, axis_j)
        if common > 0.0:
            at_time(phase_t[k] - common, k - m, phase_t, phase_s, phase_v, phase_a, phase_j, a)
            at_time(phase_t[k] + common, k + m - 1, phase_t, phase_s, phase_v, phase_a, phase_j, c)
            after[b] = phase_s[k] - a[0]
            before[b + 1] = c[0] - phase_s[k]
        most = max(after[b] / length[b], before[b + 1] / length[b + 1])
        if e > 0.0 and (common <= 2.0 * BACK * e or most > LEGS_SHARE):
            return -1, 0, 0
        if common > 0.0:
            found = True
            tau[b] = common
            rest[b] = k
    for b in range(pieces):
        if past[b] > 0.0 and tau[b] == 0.0:
            return -1, 0, 0
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
    written = 0
    k = 0
    s = 0.0
    earlier = 0.0
    shift = 0.0
    for b in range(pieces):
        out_kind[count] = kind[b]
        out_at[count] = at[b] - lowest
        out_length[count] = length[b]
        if before[b] > 0.0 or after[b] > 0.0:
            out_at[count] = used
            used = write_line(out_data, used, at[b] - lowest, before[b], after[b])
            out_length[count] = out_data[out_at[count] + LENGTH]
        out_feed[count] = feed[b]
        out_line[count] = line[b]
        out_stop[count] = stop_after[b]
        out_tolerance[count] = 0.0 if tau[b] > 0.0 else tolerance[b]
        out_piece_s[count] = s
        s += out_length[count]
        count += 1
        if tau[b] == 0.0:
            continue
        common = tau[b]
        r = rest[b]
        m = 1 if past[b] == 0.0 else 2
        begin = phase_t[r] - common
        # the phases up to where the second ramp begins
        while k < r - m + 1:
            out_t[written] = phase_t[k] - earlier
            out_s[written] = phase_s[k] + shift
            out_v[written] = phase_v[k]
            out_a[written] = phase_a[k]
            out_j[written] = phase_j[k]
            written += 1
            k += 1
        directions(data, at[b], data, at[b + 1], u)
        left = out_at[count - 1]
        corner = at[b + 1] + START
        for i in range(n):
            ends[0, i] = out_data[left + START + n + i]
        # both motions go on with constant jerks up to the next end of a phase of either
        ka = r - m
        kb = r
        t = 0.0
        while t < common:
            until = min(common, phase_t[ka + 1] - begin, phase_t[kb + 1] - phase_t[r])
            if ka + 1 == r and kb + 1 == r + m:
                until = common
            dt = until - t
            at_time(begin + t, ka, phase_t, phase_s, phase_v, phase_a, phase_j, a)
            at_time(phase_t[r] + t, kb, phase_t, phase_s, phase_v, phase_a, phase_j, c)
            for i in range(n):
                v = a[1] * u[0, i] + c[1] * u[1, i]
                acc = a[2] * u[0, i] + c[2] * u[1, i]
                ends[1, i] = v * dt / 3.0
                ends[2, i] = 2.0 * v * dt / 3.0 + acc * dt * dt / 6.0
            at_time(begin + until, ka, phase_t, phase_s, phase_v, phase_a, phase_j, a)
            at_time(phase_t[r] + until, kb, phase_t, phase_s, phase_v, phase_a, phase_j, c)
            for i in range(n):
                ends[3, i] = data[corner + i] + (a[0] - phase_s[r]) * u[0, i] + (c[0] - phase_s[r]) * u[1, i]
                if until == common:
                    ends[3, i] = data[corner + i] + before[b + 1] * u[1, i]
            out_kind[count] = SPAN
            out_at[count] = used
            used = write_timed(out_data, used, left, ends[0], ends[1], ends[2], ends[3], q)
            out_length[count] = out_data[out_at[count] + LENGTH]
            out_feed[count] = max(feed[b], feed[b + 1]) if feed[b] == feed[b] and feed[b + 1] == feed[b + 1] else math.nan
            out_line[count] = line[b]
            out_stop[count] = False
            out_tolerance[count] = 0.0
            out_piece_s[count] = s
            out_t[written] = begin + t - earlier
            out_s[written] = s
            out_v[written] = out_length[count] / dt
            out_a[written] = 0.0
            out_j[written] = 0.0
            written += 1
            s += out_length[count]
            count += 1
            ends[0] = ends[3]
            t = until
            if phase_t[ka + 1] - begin <= t and ka + 1 < r:
                ka += 1
            if phase_t[kb + 1] - phase_t[r] <= t and kb + 1 < r + m:
                kb += 1
        # the second ramp from there on
        k = r + m - 1
        earlier += common
        shift = s - (phase_s[r] + before[b + 1])
        out_t[written] = begin + common - (earlier - common)
        out_s[written] = s
        out_v[written] = c[1]
        out_a[written] = c[2]
        out_j[written] = phase_j[k]
        written += 1
        k += 1
    out_piece_s[count] = s
    while k <= len(phase_j):
        out_t[written] = phase_t[k] - earlier
        out_s[written] = phase_s[k] + shift
        out_v[written] = phase_v[k]
        out_a[written] = phase_a[k]
        if k < len(phase_j):
            out_j[written] = phase_j[k]
            written += 1
        k += 1
    return count, written, used


@njit
def overlap_room(axes: int) -> int:
    """Numbers that the timed pieces of a corner and what is left of the line before it may take."""
    return ROOM_OF_CORNER * (ROOM_OF_TIMED + axes * ROOM_OF_TIMED_PER_AXIS) + START + 2 * axes
