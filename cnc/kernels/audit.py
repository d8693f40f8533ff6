"""Largest values that a plan reaches, from the plan itself and from the positions it gives at a fixed period.

Two ways, neither of which shares a formula with the planner:

- at points throughout every phase, each axis's velocity, acceleration and jerk by the chain rule from the curve and the phase;
- at the sampling period T, the differences of successive positions, which see jumps at junctions as well.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.curve import METRIC, METRICS, curve_eval, curve_eval_s, curve_inv_arclen
from cnc.kernels.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FEED, ACCEL, JERK, NORMAL_ACCEL, CHORD_ERROR, STEP_DEVIATION, OVERSPEED = range(7)
"""Entries of ``largest``; OVERSPEED is the largest ratio of speed to the feed that the piece may have."""

POINTS = 8
"""Least number of points looked at in a phase."""

CLOSE = 1e-3
"""mm; motion so slow that it covers less than this in many periods is looked at this often along the path instead."""

JOINT = 1e-9
"""mm; a phase that starts this little before a junction starts at it, one that ends this little after it ends there."""


@njit
def phase_at(dt: float, s: float, v: float, a: float, j: float) -> tuple[float, float, float]:
    """Arc length, speed and acceleration after ``dt`` in a constant-jerk phase."""
    return s + dt * (v + dt * (0.5 * a + dt * j / 6.0)), v + dt * (a + 0.5 * dt * j), a + dt * j


@njit
def audit_phases(
    kind: Ints, at: Ints, data: Floats, feed: Floats, piece_s: Floats, phase_t: Floats, phase_s: Floats, phase_v: Floats,
    phase_a: Floats, phase_j: Floats, period: float, largest: Floats, axis_v: Floats, axis_a: Floats, axis_j: Floats,
) -> None:  # fmt: skip
    """Raise ``largest`` and the axes' maxima (n,) to what the plan reaches at points throughout its phases."""
    n = len(axis_v)
    q = np.zeros((4, n))
    piece = 0
    for k in range(len(phase_j)):
        duration = phase_t[k + 1] - phase_t[k]
        points = max(POINTS, int(min(duration / period, (phase_s[k + 1] - phase_s[k]) / CLOSE)))
        j = phase_j[k]
        largest[JERK] = max(largest[JERK], abs(j))
        for m in range(points + 1):
            s, v, a = phase_at(duration * m / points, phase_s[k], phase_v[k], phase_a[k], j)
            # At a junction the phase that starts there belongs to the piece after it, the one that ends there to the piece before.
            ahead = JOINT if m == 0 else -JOINT
            while piece + 1 < len(kind) and s + ahead > piece_s[piece + 1]:
                piece += 1
            local = min(max(s - piece_s[piece], 0.0), piece_s[piece + 1] - piece_s[piece])
            here = kind[piece]
            curve_eval_s(here, data, at[piece], curve_inv_arclen(here, data, at[piece], local), q)
            largest[FEED] = max(largest[FEED], v)
            largest[ACCEL] = max(largest[ACCEL], abs(a))
            largest[OVERSPEED] = max(largest[OVERSPEED], v / feed[piece])
            squared = 0.0
            for i in range(int(data[at[piece] + METRICS])):
                squared += q[2, int(data[at[piece] + METRIC + i])] ** 2
            largest[NORMAL_ACCEL] = max(largest[NORMAL_ACCEL], v * v * math.sqrt(squared))
            for i in range(n):
                axis_v[i] = max(axis_v[i], abs(q[1, i] * v))
                axis_a[i] = max(axis_a[i], abs(q[2, i] * v * v + q[1, i] * a))
                axis_j[i] = max(axis_j[i], abs(q[3, i] * v * v * v + 3.0 * q[2, i] * v * a + q[1, i] * j))


@njit
def audit_samples(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats,
    phase_j: Floats, t0: float, period: float, shortest: float, index: int, known: int, last: Floats, largest: Floats,
    axis_v: Floats, axis_a: Floats, axis_j: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Raise the maxima to what differences of positions show at the instants ``index * period`` on, up to the plan's end.

    last (5, n): positions at the instants before, newest in row 0, of which ``known`` are valid; row 4 is scratch. The
    step deviation counts in steps longer than ``shortest``: on a shorter one it is no length to speak of. Returns the next index
    and the number of valid rows.
    """
    n = len(axis_v)
    q = np.zeros((4, n))
    piece = 0
    phase = 0
    s_before = -1.0
    piece_before = 0
    end = t0 + phase_t[-1]
    while index * period <= end:
        t = max(index * period - t0, 0.0)
        while phase + 1 < len(phase_j) and t > phase_t[phase + 1]:
            phase += 1
        s = phase_at(t - phase_t[phase], phase_s[phase], phase_v[phase], phase_a[phase], phase_j[phase])[0]
        while piece + 1 < len(kind) and s > piece_s[piece + 1]:
            piece += 1
        local = min(max(s - piece_s[piece], 0.0), piece_s[piece + 1] - piece_s[piece])
        here = kind[piece]
        curve_eval(here, data, at[piece], curve_inv_arclen(here, data, at[piece], local), q)
        chord = 0.0
        for m in range(int(data[at[piece] + METRICS])):
            i = int(data[at[piece] + METRIC + m])
            chord += (q[0, i] - last[0, i]) ** 2
        chord = math.sqrt(chord)
        for i in range(n):
            p = q[0, i]
            if known > 0:
                axis_v[i] = max(axis_v[i], abs(p - last[0, i]) / period)
            if known > 1:
                axis_a[i] = max(axis_a[i], abs(p - 2.0 * last[0, i] + last[1, i]) / period**2)
            if known > 2:
                axis_j[i] = max(axis_j[i], abs(p - 3.0 * last[0, i] + 3.0 * last[1, i] - last[2, i]) / period**3)
            last[4, i] = p
        if known > 0 and s_before >= 0.0 and s - s_before > 1e-9:
            if s - s_before > shortest:
                largest[STEP_DEVIATION] = max(largest[STEP_DEVIATION], abs(chord - (s - s_before)) / (s - s_before))
            # The curve's distance from its chord, in the middle of the step and at any junction inside it.
            for k in range(piece_before, piece + 1):
                middle = piece_s[k + 1] if k < piece else 0.5 * (s + s_before)
                m = min(max(k, piece_before), piece)
                while m > piece_before and middle < piece_s[m]:
                    m -= 1
                inside = min(max(middle - piece_s[m], 0.0), piece_s[m + 1] - piece_s[m])
                there = kind[m]
                curve_eval(there, data, at[m], curve_inv_arclen(there, data, at[m], inside), q)
                along = 0.0
                apart = 0.0
                for i in range(int(data[at[m] + METRICS])):
                    c = int(data[at[m] + METRIC + i])
                    along += (q[0, c] - last[0, c]) * (last[4, c] - last[0, c])
                    apart += (q[0, c] - last[0, c]) ** 2
                if chord > 0.0:
                    apart -= (along / chord) ** 2
                largest[CHORD_ERROR] = max(largest[CHORD_ERROR], math.sqrt(max(apart, 0.0)))
        for m in range(2, 0, -1):
            last[m] = last[m - 1]
        last[0] = last[4]
        s_before = s
        piece_before = piece
        known = min(known + 1, 3)
        index += 1
        if known == 3 and phase_a[phase] == 0.0 and phase_j[phase] == 0.0 and phase_v[phase] > 0.0:
            # A crawl shows the same differences over and over: look at a few instants, then go on to where the path may have changed.
            skipped = int(CLOSE / (phase_v[phase] * period)) - 2 * POINTS
            left = int((phase_t[phase + 1] + t0 - index * period) / period) - 2 * POINTS
            if min(skipped, left) > 0:
                index += min(skipped, left)
                known = 0
                s_before = -1.0
    return index, known
