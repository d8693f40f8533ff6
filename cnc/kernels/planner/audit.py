"""Largest values that a plan reaches, from the plan itself and from the positions it gives at a
fixed period.

Two ways, neither of which shares a formula with the planner:

- at points throughout every phase, each axis's velocity, acceleration and jerk by the chain rule from the curve and the phase;
- at the sampling period T, the differences of successive positions, which see jumps at junctions as well.

Where the hull of a piece's control points (:mod:`cnc.kernels.planner.hull`) shows that its
derivatives can't raise any maximum seen before, they are not looked at inside the piece: the maxima
are the same as if they were. Positions are looked at everywhere.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    AXES,
    LINE,
    METRIC,
    METRICS,
    SPAN,
    SPAN_BODY,
    START,
    U0,
    U1,
    curve_eval,
    curve_eval_s,
    curve_inv_arclen,
)
from cnc.kernels.planner.hull import BOUNDS, derivative_bounds
from cnc.kernels.planner.timed import is_timed, timed_motion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FEED, ACCEL, JERK, NORMAL_ACCEL, CHORD_ERROR, STEP_DEVIATION, OVERSPEED = range(7)
"""Entries of ``largest``; OVERSPEED is the largest ratio of speed to the feed that the piece may
have.
"""
ENTRIES = 7

POINTS = 8
"""Least number of points looked at in a phase."""

TIMED_POINTS = 64
"""The same in a timed piece, where the jerk along the path may have a sharp peak."""

CLOSE = 1e-3
"""mm; motion so slow that it covers less than this in many periods is looked at this often along
the path instead.
"""

JOINT = 1e-9
"""mm; a phase that starts this little before a junction starts at it, one that ends this little
after it ends there: what rounding may leave of the arc lengths in a window of many metres, and far
less than anything that moves can show.
"""


@njit
def phase_at(dt: float, s: float, v: float, a: float, j: float) -> tuple[float, float, float]:
    """Arc length, speed and acceleration after ``dt`` in a constant-jerk phase."""
    return s + dt * (v + dt * (0.5 * a + dt * j / 6.0)), v + dt * (a + 0.5 * dt * j), a + dt * j


@njit
def audit_phases(
    kind: Ints, at: Ints, data: Floats, feed: Floats, piece_s: Floats, phase_t: Floats, phase_s: Floats, phase_v: Floats,
    phase_a: Floats, phase_j: Floats, period: float, largest: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats,
) -> None:  # fmt: skip
    """Raise ``largest`` and the axes' maxima (n,) to what the plan reaches at points throughout its
    phases.
    """
    n = len(axis_v)
    q = np.zeros((4, n))
    bounds = np.zeros((n + 1, BOUNDS))
    piece = 0
    bounded = -1
    for k in range(len(phase_j)):
        duration = phase_t[k + 1] - phase_t[k]
        j = phase_j[k]
        v_most = max(phase_v[k], phase_v[k + 1])
        a_most = max(abs(phase_a[k]), abs(phase_a[k] + duration * j))
        if phase_a[k] * j < 0.0:
            v_most = max(v_most, phase_v[k] - 0.5 * phase_a[k] * phase_a[k] / j)
        steady = phase_a[k] == 0.0 and j == 0.0
        # A whole phase may lie that near to a junction.
        inside = min(JOINT, 0.5 * (phase_s[k + 1] - phase_s[k]))
        while piece + 1 < len(kind) and phase_s[k] + inside > piece_s[piece + 1]:
            piece += 1
        least = TIMED_POINTS if is_timed(kind[piece], data, at[piece]) else POINTS
        points = max(least, int(min(duration / period, (phase_s[k + 1] - phase_s[k]) / CLOSE)))
        looked_at = -1
        dull = False
        for m in range(points + 1):
            s, v, a = phase_at(duration * m / points, phase_s[k], phase_v[k], phase_a[k], j)
            if m == points:
                # as exact as the junction that may be there
                s = phase_s[k + 1]
            # At a junction the phase that starts there belongs to the piece after it, the one that
            # ends there to the piece before.
            ahead = inside if m == 0 else -inside
            while piece + 1 < len(kind) and s + ahead > piece_s[piece + 1]:
                piece += 1
            here = kind[piece]
            where = at[piece]
            if looked_at != piece:
                looked_at = piece
                if bounded != piece:
                    bounded = piece
                    derivative_bounds(here, data, where, bounds)
                dull = (
                    not is_timed(here, data, where)
                    and v_most <= largest[FEED]
                    and a_most <= largest[ACCEL]
                    and abs(j) <= largest[JERK]
                    and v_most <= largest[OVERSPEED] * feed[piece]
                    and bounds[n, 1] * v_most * v_most <= largest[NORMAL_ACCEL]
                )
                for i in range(n):
                    d1 = bounds[i, 0]
                    d2 = bounds[i, 1] * v_most
                    d3 = bounds[i, 2] * v_most * v_most
                    dull = (
                        dull
                        and d1 * v_most <= axis_v[i]
                        and d2 * v_most + d1 * a_most <= axis_a[i]
                        and d3 * v_most + 3.0 * d2 * a_most + d1 * abs(j) <= axis_j[i]
                    )
            elif dull and m < points:
                continue
            local = min(max(s - piece_s[piece], 0.0), piece_s[piece + 1] - piece_s[piece])
            curve_eval_s(here, data, where, curve_inv_arclen(here, data, where, local), q)
            if is_timed(here, data, where):
                speed, along, change, normal = timed_motion(data, where, q, v)
            else:
                squared = 0.0
                for i in range(int(data[where + METRICS])):
                    squared += q[2, int(data[where + METRIC + i])] ** 2
                speed, along, change, normal = v, a, j, v * v * math.sqrt(squared)
            largest[FEED] = max(largest[FEED], speed)
            largest[ACCEL] = max(largest[ACCEL], abs(along))
            largest[JERK] = max(largest[JERK], abs(change))
            largest[OVERSPEED] = max(largest[OVERSPEED], speed / feed[piece])
            largest[NORMAL_ACCEL] = max(largest[NORMAL_ACCEL], normal)
            for i in range(n):
                axis_v[i] = max(axis_v[i], abs(q[1, i] * v))
                axis_a[i] = max(axis_a[i], abs(q[2, i] * v * v + q[1, i] * a))
                axis_j[i] = max(
                    axis_j[i], abs(q[3, i] * v * v * v + 3.0 * q[2, i] * v * a + q[1, i] * j)
                )
            # a line at constant speed is the same all along
            dull = dull or (here == LINE and steady)


@njit
def _cubic_point(data: Floats, at: int, u: float, out: Floats) -> None:
    """Position at u of a span of degree 3 into the last row of out: without the derivatives, which
    take most of the time.
    """
    n = out.shape[1]
    start = at + START
    x = (u - data[at + U0]) / (data[at + U1] - data[at + U0])
    y = 1.0 - x
    c0 = y * y * y
    c1 = 3.0 * y * y * x
    c2 = 3.0 * y * x * x
    c3 = x * x * x
    k = start + 2 * n + SPAN_BODY
    inverse = 1.0 / (c0 * data[k] + c1 * data[k + 1] + c2 * data[k + 2] + c3 * data[k + 3])
    row = out.shape[0] - 1
    for i in range(n):
        k += 4
        out[row, i] = (
            data[start + i]
            + (c0 * data[k] + c1 * data[k + 1] + c2 * data[k + 2] + c3 * data[k + 3]) * inverse
        )


@njit
def _step_and_sagitta(
    kind: Ints,
    at: Ints,
    data: Floats,
    piece_s: Floats,
    first: int,
    piece: int,
    s_before: float,
    s: float,
    last: Floats,
    q: Floats,
) -> tuple[float, float]:
    """Length of the step from last[0] to last[4] through the junctions between them, and how far
    the curve leaves the chord of the two.
    """
    length = 0.0
    apart = 0.0
    chord = 0.0
    for m in range(int(data[at[piece] + METRICS])):
        c = int(data[at[piece] + METRIC + m])
        chord += (last[4, c] - last[0, c]) ** 2
        last[3, c] = last[0, c]
    for k in range(first, piece + 1):
        # In the middle of the step's part on this piece, then at the piece's end.
        begin = max(s_before, piece_s[k])
        end = min(s, piece_s[k + 1])
        for half in range(2):
            inside = 0.5 * (begin + end) if half == 0 else end
            curve_eval(
                kind[k], data, at[k], curve_inv_arclen(kind[k], data, at[k], inside - piece_s[k]), q
            )
            along = 0.0
            squared = 0.0
            step = 0.0
            for m in range(int(data[at[k] + METRICS])):
                c = int(data[at[k] + METRIC + m])
                along += (q[0, c] - last[0, c]) * (last[4, c] - last[0, c])
                squared += (q[0, c] - last[0, c]) ** 2
                step += (q[0, c] - last[3, c]) ** 2
            if chord > 0.0:
                squared -= along * along / chord
            apart = max(apart, squared)
            if half == 1:
                length += math.sqrt(step)
                for m in range(int(data[at[k] + METRICS])):
                    c = int(data[at[k] + METRIC + m])
                    last[3, c] = q[0, c]
    return length, math.sqrt(apart)


@njit
def audit_samples(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats,
    phase_j: Floats, t0: float, period: float, shortest: float, index: int, known: int, last: Floats, largest: Floats,
    axis_v: Floats, axis_a: Floats, axis_j: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Raise the maxima to what differences of positions show at the instants ``index * period`` on,
    up to the plan's end.

    last (5, n): positions at the instants before, newest in row 0, of which ``known`` are valid;
    rows 3 and 4 are scratch. The step deviation and the chord error count in steps longer than
    ``shortest`` (on a shorter one they are no length to speak of) within which the motion doesn't
    stop: a stop is a corner, and there a sample belongs to neither side. For the same reason the
    step deviation doesn't count where the ramps at a corner overlap. Returns the next index and the
    number of valid rows.
    """
    n = len(axis_v)
    q = np.zeros((4, n))
    bounds = np.zeros((n + 1, BOUNDS))
    per_v = 1.0 / period
    per_a = per_v * per_v
    per_j = per_a * per_v
    bent = math.inf
    bounded = -1
    piece = 0
    phase = 0
    s_before = -1.0
    piece_before = 0
    end = t0 + phase_t[-1]
    while index * period <= end:
        t = max(index * period - t0, 0.0)
        stopped = False
        while phase + 1 < len(phase_j) and t > phase_t[phase + 1]:
            phase += 1
            stopped = stopped or phase_v[phase] == 0.0
        s = phase_at(
            t - phase_t[phase], phase_s[phase], phase_v[phase], phase_a[phase], phase_j[phase]
        )[0]
        while piece + 1 < len(kind) and s > piece_s[piece + 1]:
            piece += 1
        local = min(max(s - piece_s[piece], 0.0), piece_s[piece + 1] - piece_s[piece])
        here = kind[piece]
        where = at[piece]
        u = curve_inv_arclen(here, data, where, local)
        if here == SPAN and data[where + START + 2 * n] == 3.0:
            _cubic_point(data, where, u, last)
        else:
            curve_eval(here, data, where, u, q)
            for i in range(n):
                last[4, i] = q[0, i]
        for i in range(n):
            v = last[4, i] - last[0, i]
            a = v - (last[0, i] - last[1, i])
            j = a - (last[0, i] - 2.0 * last[1, i] + last[2, i])
            if known > 0:
                axis_v[i] = max(axis_v[i], abs(v) * per_v)
            if known > 1:
                axis_a[i] = max(axis_a[i], abs(a) * per_a)
            if known > 2:
                axis_j[i] = max(axis_j[i], abs(j) * per_j)
        step = s - s_before
        if s_before >= 0.0 and not stopped and step > shortest:
            if piece != bounded:
                bounded = piece
                derivative_bounds(here, data, where, bounds)
                bent = bounds[n, 1] / 8.0
            if piece == piece_before and step * step * bent <= largest[CHORD_ERROR]:
                # the chord alone: a curve bent no more than that leaves it by less than what was
                # seen before
                chord = 0.0
                for m in range(int(data[where + METRICS])):
                    c = int(data[where + METRIC + m])
                    chord += (last[4, c] - last[0, c]) * (last[4, c] - last[0, c])
                largest[STEP_DEVIATION] = max(
                    largest[STEP_DEVIATION], abs(math.sqrt(chord) - step) / step
                )
            else:
                chord, apart = _step_and_sagitta(
                    kind, at, data, piece_s, piece_before, piece, s_before, s, last, q
                )
                corner = False
                for k in range(piece_before, piece + 1):
                    corner = corner or is_timed(kind[k], data, at[k])
                if not corner:
                    largest[STEP_DEVIATION] = max(largest[STEP_DEVIATION], abs(chord - step) / step)
                largest[CHORD_ERROR] = max(largest[CHORD_ERROR], apart)
        for i in range(n):
            last[2, i] = last[1, i]
            last[1, i] = last[0, i]
            last[0, i] = last[4, i]
        s_before = s
        piece_before = piece
        known = min(known + 1, 3)
        index += 1
        steady = (
            phase_a[phase] == 0.0
            and phase_j[phase] == 0.0
            and phase_v[phase] > 0.0
            and not is_timed(here, data, where)
        )
        if known == 3 and steady:
            # A crawl shows the same differences over and over: look at a few instants, then go on
            # to where the path may have changed.
            skipped = int(CLOSE / (phase_v[phase] * period)) - 2 * POINTS
            left = int((phase_t[phase + 1] + t0 - index * period) / period) - 2 * POINTS
            if min(skipped, left) > 0:
                index += min(skipped, left)
                known = 0
                s_before = -1.0
    return index, known


@njit
def continuity(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats,
    phase_j: Floats, gaps: Floats,
) -> None:  # fmt: skip
    """Integrate each phase and compare its end with the start of the next.

    gaps (5,): raised to the largest jumps of position, speed and acceleration, and to how far a
    duration and a speed lie below zero; what is NaN stays NaN.

    The plan's coordinate changes its meaning at the ends of timed pieces: its rate may jump where
    the motion doesn't. There velocity and acceleration are compared in every axis.
    """
    n = int(data[at[0] + AXES])
    q = np.zeros((2, 4, n))
    gap = np.zeros(5)
    last = len(phase_j)
    piece = 0
    for k in range(last + 1):
        gap[4] = -phase_v[k]
        if k > 0:
            dt = phase_t[k] - phase_t[k - 1]
            s_end, v_end, a_end = phase_at(
                dt, phase_s[k - 1], phase_v[k - 1], phase_a[k - 1], phase_j[k - 1]
            )
            gap[0] = abs(s_end - phase_s[k])
            gap[1] = abs(v_end - phase_v[k])
            gap[2] = abs(a_end - phase_a[k])
            gap[3] = -dt
            s = phase_s[k]
            while piece + 1 < len(kind) and s - JOINT > piece_s[piece + 1]:
                piece += 1
            after = piece
            while after + 1 < len(kind) and s + JOINT > piece_s[after + 1]:
                after += 1
            if k < last and (
                is_timed(kind[piece], data, at[piece]) or is_timed(kind[after], data, at[after])
            ):
                gap[1] = 0.0
                gap[2] = 0.0
                for side in range(2):
                    here = piece if side == 0 else after
                    v = v_end if side == 0 else phase_v[k]
                    a = a_end if side == 0 else phase_a[k]
                    local = min(max(s - piece_s[here], 0.0), piece_s[here + 1] - piece_s[here])
                    curve_eval_s(
                        kind[here],
                        data,
                        at[here],
                        curve_inv_arclen(kind[here], data, at[here], local),
                        q[side],
                    )
                    for i in range(n):
                        q[side, 2, i] = q[side, 2, i] * v * v + q[side, 1, i] * a
                        q[side, 1, i] *= v
                for order in range(3):
                    for i in range(n):
                        gap[order] = max(gap[order], abs(q[1, order, i] - q[0, order, i]))
        for m in range(5):
            if gaps[m] == gaps[m] and not gap[m] <= gaps[m]:
                gaps[m] = gap[m]
