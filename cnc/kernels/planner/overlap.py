r"""The ramps at a stop on a corner overlap in time: the ramp from rest begins while the ramp to
rest still runs.

        v |``\                  ,--     A stop takes the ramp down and the ramp up one after the other. Where both end and begin with
          |   \  before        /        constant jerk (J1, J2) the second may begin tau early: the motion cuts the corner by
          |    `.           ,-'
          |______`-.____,-'______ t          e(x) = | -d1 (1-x)^3 u1 + d2 x^3 u2 |,   d = J tau^3 / 6,   x = t / tau.
          |``\     ,--
          |   \   /    after         At the x where both distances are the same, J1 J2 / (c1 + c2)^3 tau^3 / 6 with c = J^(1/3), e is
          |    `./                   2 sin(theta/2) times that (theta: the turn): no less than what separates corner and motion, and more
          |____,'`._____________ t   than what separates motion and corner's legs. With e = eps and equal jerks

                                             tau = (24 eps / (J sin(theta/2)))^(1/3).

In common every axis has the jerk J1 u1 + J2 u2: constant, so that the common part is a timed piece
(:mod:`cnc.kernels.planner.timed`). Speeds and accelerations of an axis are means of those of the
two ramps, with weights whose sum is no more than 1; its jerk is a sum, and has to be looked at. So
have the tangential jerk (about J (4 sin^2(theta/2) / cos(theta/2) + 2 cos(theta/2)) in the middle:
never less than 2 J) and accelerations along the path where the machine limits them.

Before that each ramp may be made to run past the corner (:mod:`cnc.kernels.planner.overshoot`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LENGTH, LINE, SPAN, START, Floats, Ints
from cnc.kernels.planner.legs import LEGS_SHARE, REST, SHARPEST, directions, record_end, write_line
from cnc.kernels.planner.overshoot import BACK, PHASE_SHARE, SPLIT, time_remaining
from cnc.kernels.planner.timed import ROOM_OF_TIMED, ROOM_OF_TIMED_PER_AXIS, write_timed

Flags = NDArray[np.bool_]
Lines = NDArray[np.int32]

SHORTEST = 1e-6
"""mm; corners that are cut by less are stops."""

LOOKS = 33
"""Places at which a motion in common is compared with the limits along the path."""

CLOSER = 4
"""Times that as many places again are looked at between the neighbours of the highest: a sharp
corner's jerk has a sharp peak.
"""

ROOM_OF_CORNER = 3
"""Timed pieces that a corner may have."""


@njit
def overlap_time(
    u: Floats, sine: float, widest: float, j1: float, j2: float, t1: float, t2: float, room1: float, room2: float, eps: float,
    rules: Floats, axis_j: Floats,
) -> float:  # fmt: skip
    """How long the ramps of two lines may have in common, s; 0 where that breaks a limit or saves
    nothing.

    u, sine, widest: from :func:`directions`. j1, j2: the jerks beside the corner, t1, t2: how long
    they last. room1, room2: how much of each line may be used, mm. eps: how far the motion may stay
    away from the corner, mm.
    """
    if sine > SHARPEST or sine == 0.0:
        return 0.0
    for i in range(u.shape[1]):
        if abs(j1 * u[0, i] + j2 * u[1, i]) > axis_j[i]:
            return 0.0
    roots = j1 ** (1.0 / 3.0) + j2 ** (1.0 / 3.0)
    tau = (3.0 * eps / (j1 * j2 * widest)) ** (1.0 / 3.0) * roots
    tau = min(
        tau,
        PHASE_SHARE * t1,
        PHASE_SHARE * t2,
        (6.0 * room1 / j1) ** (1.0 / 3.0),
        (6.0 * room2 / j2) ** (1.0 / 3.0),
    )
    if (
        min(rules[0], rules[1], rules[2]) < math.inf
        or rules[3] < rules[4] * rules[4] / 8.0 * max(j1, j2) * tau
    ):
        most, pull, bend = along_in_common(j1, j2, 1.0 - 2.0 * sine * sine)
        if most > rules[1]:
            return 0.0
        tau = min(
            tau, rules[0] / pull, rules[2] / bend, 8.0 * rules[3] / (rules[4] * rules[4] * bend)
        )
    return tau if min(j1, j2) * tau**3 / 6.0 > SHORTEST else 0.0


@njit
def along_in_common(j1: float, j2: float, cos: float) -> tuple[float, float, float]:
    """Largest tangential jerk, tangential and normal acceleration while two ramps with jerks j1, j2
    have a time of 1 in common.

    cos: of the turn. The jerk is the same for any time, the accelerations grow with it. The motion
    is that of :func:`timed_motion` there.
    """
    most = np.zeros(3)
    values = np.zeros(3)
    for m in range(3):
        low = 0.0
        high = 1.0
        for _ in range(CLOSER):
            best = 0
            for k in range(LOOKS):
                x = low + (high - low) * k / (LOOKS - 1.0)
                a1 = -j1 * (1.0 - x)
                a2 = j2 * x
                v1 = 0.5 * j1 * (1.0 - x) ** 2
                v2 = 0.5 * j2 * x * x
                speed = math.sqrt(v1 * v1 + v2 * v2 + 2.0 * v1 * v2 * cos)
                squared = a1 * a1 + a2 * a2 + 2.0 * a1 * a2 * cos
                along = (v1 * a1 + v2 * a2 + (v1 * a2 + v2 * a1) * cos) / speed
                values[0] = abs(
                    (squared + v1 * j1 + v2 * j2 + (v1 * j2 + v2 * j1) * cos - along * along)
                    / speed
                )
                values[1] = abs(along)
                values[2] = math.sqrt(max(squared - along * along, 0.0))
                if values[m] > most[m]:
                    most[m] = values[m]
                    best = k
            width = (high - low) / (LOOKS - 1.0)
            low, high = max(low + (best - 1) * width, 0.0), min(low + (best + 1) * width, 1.0)
    return most[0], most[1], most[2]


@njit
def at_time(
    t: float,
    k: int,
    phase_t: Floats,
    phase_s: Floats,
    phase_v: Floats,
    phase_a: Floats,
    phase_j: Floats,
    out: Floats,
) -> None:
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

    kind .. phase_j: a plan, as in PlanChunk; past: overshoots at the ends of its pieces
    (:func:`overshoot`). out_*: room for the new one: four times the pieces, phases and four for
    each piece and one more, and for the data that of all records and :func:`overlap_room` for each
    piece. Returns how many (pieces, phases, numbers) that has; (0, 0, 0) if nothing changes, (-1,
    0, 0) if an overshoot isn't possible.
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
        if (
            b + 1 >= pieces
            or stop_after[b]
            or not tolerance[b] > 0.0
            or kind[b] != LINE
            or kind[b + 1] != LINE
        ):
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
            common = min(
                time_remaining(near / j1, e) + time_remaining(near / j2, e),
                PHASE_SHARE * t1,
                PHASE_SHARE * t2,
            )
            common = min(
                common, 8.0 * rules[3] / (rules[4] * rules[4] * math.sqrt(j1 * j1 + j2 * j2))
            )
        elif j1 > 0.0 and j2 > 0.0 and abs(phase_a[k - 1] + j1 * t1) <= SPLIT * j1:
            room1 = min(LEGS_SHARE * length[b], phase_s[k] - phase_s[k - 1])
            room2 = min(LEGS_SHARE * length[b + 1], phase_s[k + 1] - phase_s[k])
            common = overlap_time(
                u, sine, widest, j1, j2, t1, t2, room1, room2, tolerance[b], rules, axis_j
            )
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
                ends[3, i] = (
                    data[corner + i] + (a[0] - phase_s[r]) * u[0, i] + (c[0] - phase_s[r]) * u[1, i]
                )
                if until == common:
                    ends[3, i] = data[corner + i] + before[b + 1] * u[1, i]
            out_kind[count] = SPAN
            out_at[count] = used
            used = write_timed(out_data, used, left, ends[0], ends[1], ends[2], ends[3], q)
            out_length[count] = out_data[out_at[count] + LENGTH]
            out_feed[count] = (
                max(feed[b], feed[b + 1])
                if feed[b] == feed[b] and feed[b + 1] == feed[b + 1]
                else math.nan
            )
            # that of the faster move: a traverse's speed is not laid to a feed move
            faster = feed[b] < feed[b + 1] or (feed[b] == feed[b] and feed[b + 1] != feed[b + 1])
            out_line[count] = line[b + 1] if faster else line[b]
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
