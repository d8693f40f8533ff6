r"""A ramp to rest or from rest that runs past its corner by a little and comes back.

Where the two legs move different axes each may run past the corner by a little and come back: jerks
+J, -J at the end of the ramp to rest instead of +J alone, the last for a time e. That costs 2 e a
ramp, and lets the motion in common last about 6 e longer: near its end a ramp that overshoots is
closer to the corner than one that doesn't. It is a ramp to the speed -J e^2 at J e^3 behind the
corner and a way back of 2 e, and it passes the corner by 1.943 J e^3, which is to be within the
tolerance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import LINE, Floats, Ints
from cnc.kernels.planner.legs import REST, SHARPEST, directions, line_bounds
from cnc.kernels.planner.scurve import peak_speed, ramp_distance, ramp_shape

Flags = NDArray[np.bool_]

PHASE_SHARE = 0.999
"""The part of a ramp's last phase that may be overlapped: something is left of it, so that phases
remain where they are.
"""

SPLIT = 1e-12
"""s: what rounding leaves of a time of nothing."""

PAST = 1.943
"""A ramp of jerk J passes the corner by this times J e^3: what :func:`remaining` has at its lowest,
at t = e (2 + sqrt 2).
"""

BACK = 4.85
"""A ramp to rest is beyond the corner for the last this times e: :func:`remaining` is negative
there.
"""

TRIES = 4
"""Overshoots that are compared: the largest that the tolerance allows, and parts of it."""

PHASES = 9
"""A move that overshoots has up to so many phases."""

GAIN = 1e-5
"""s; an overshoot has to save this."""


@njit
def remaining(t: float, e: float) -> float:
    """Distance that a ramp to rest of jerk 1 has left a time ``t`` before its end, t >= e, if it
    ends with an overshoot of ``e``.
    """
    x = t - e
    return ((x / 3.0 - e) * x - e * e) * x / 2.0 - e * e * e / 6.0


@njit
def time_remaining(distance: float, e: float) -> float:
    """The time before its end at which the ramp of :func:`remaining` has ``distance`` > 0 left for
    the last time.
    """
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
    """Write the phases of a move from rest to rest that overshoots for times ``e1`` and ``e2`` at
    its ends; returns the new count.

    s, t: where and when it begins; length mm; top, a, j: bounds.
    """
    v1 = -j * e1 * e1
    v2 = -j * e2 * e2
    distance = length + j * (e1**3 + e2**3)
    peak = peak_speed(v1, v2, distance, top, a, j)
    t1, c1, _ = ramp_shape(peak - v1, a, j)
    t2, c2, _ = ramp_shape(peak - v2, a, j)
    cruise = (
        max(distance - ramp_distance(v1, peak, a, j) - ramp_distance(peak, v2, a, j), 0.0) / peak
    )
    v = 0.0
    acc = 0.0
    here = s
    for m in range(PHASES):
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

    kind .. phase_j: a plan, as in PlanChunk; bound: largest feed of each piece. past (pieces,): the
    time of the overshoot at the end of each, or 0. out_*: room for the new phases, PHASES more for
    each piece. Returns how many phases there are; 0 if nothing changes.
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
            if (
                kind[b] == LINE
                and abs(piece_s[b] - phase_s[rest]) <= REST
                and abs(piece_s[b + 1] - phase_s[k]) <= REST
            ):
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
        if (
            first[b] < 0
            or first[b + 1] < 0
            or stop_after[b]
            or not tolerance[b] > 0.0
            or end[b] != first[b + 1]
        ):
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
            elif (
                gain > best
                and common > 2.1 * BACK * e
                and max(j1 / accel[b], j2 / accel[b + 1]) * e < 0.5
            ):
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
