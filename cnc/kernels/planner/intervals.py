"""Where motion is on the intervals of a path, how the path runs there, and what part of the limits
a phase takes up.

end, top (n,): where each interval ends (arc length, mm) and the speed, mm/s, that no motion over it
exceeds. sampled (n, 2): from where to where its ``samples`` (n, 5, 3, axes) of the path's first
three derivatives reach. limit_a mm/s^2, limit_j mm/s^3 (axes + 1,): of each axis, and last of the
motion along the path.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.planner.scurve import phase_time

Floats = NDArray[np.float64]

DENSE = 4
"""Equal parts of a phase at whose ends it is looked at."""


@njit
def interval_at(s: float, start: int, end: Floats) -> int:
    """The interval that arc length ``s`` lies in, searched from interval ``start`` on, or back from
    there.
    """
    k = min(start, len(end) - 1)
    while k > 0 and s < end[k - 1]:
        k -= 1
    while k + 1 < len(end) and s >= end[k]:
        k += 1
    return k


@njit
def derivatives(k: int, s: float, sampled: Floats, samples: Floats, out: Floats) -> None:
    """q', q'', q''' at ``s`` in interval ``k``, from the quartic through its five samples; the last
    column stands for the path itself.
    """
    axes = samples.shape[3]
    extent = sampled[k, 1] - sampled[k, 0]
    x = min(max((s - sampled[k, 0]) / extent, 0.0), 1.0) if extent > 0.0 else 0.0
    x *= 4.0
    w0 = (x - 1.0) * (x - 2.0) * (x - 3.0) * (x - 4.0) / 24.0
    w1 = -x * (x - 2.0) * (x - 3.0) * (x - 4.0) / 6.0
    w2 = x * (x - 1.0) * (x - 3.0) * (x - 4.0) / 4.0
    w3 = -x * (x - 1.0) * (x - 2.0) * (x - 4.0) / 6.0
    w4 = x * (x - 1.0) * (x - 2.0) * (x - 3.0) / 24.0
    for order in range(3):
        for i in range(axes):
            out[order, i] = (
                w0 * samples[k, 0, order, i]
                + w1 * samples[k, 1, order, i]
                + w2 * samples[k, 2, order, i]
                + w3 * samples[k, 3, order, i]
                + w4 * samples[k, 4, order, i]
            )
        out[order, axes] = 1.0 if order == 0 else 0.0


@njit
def phase_worst(
    duration: float, s: float, v: float, a: float, j: float, s_end: float, k: int, end: Floats, top: Floats, sampled: Floats,
    samples: Floats, limit_a: Floats, limit_j: Floats, q: Floats,
) -> tuple[float, float, int]:  # fmt: skip
    """The largest part of a limit that a phase takes up, at points throughout it and on both sides
    of each end of an interval.

    The speed is looked at where it is greatest, too: at the instant without acceleration, which may
    lie between the points.

    Returns that of the limits of acceleration and jerk, that of the speed bounds, and the interval
    in which the phase ends. q: scratch.
    """
    worst = 0.0
    fastest = 0.0
    t_before = 0.0
    s_before = s
    turn = -a / j if a * j < 0.0 else math.inf
    k = interval_at(s, k, end)
    m = 0
    while m <= DENSE:
        t_next = duration * m / DENSE
        turns = turn < t_next
        if turns:
            t_next = turn
        s_next = (
            s_end
            if m == DENSE and not turns
            else s + t_next * (v + t_next * (0.5 * a + t_next * j / 6.0))
        )
        t = t_next
        here = s_next
        crossing = k + 1 < len(end) and end[k] < s_next
        if crossing:
            here = end[k]
            speed = v + t_before * (a + 0.5 * t_before * j)
            t = t_before + phase_time(
                speed, a + t_before * j, j, t_next - t_before, here - s_before
            )
        else:
            t_before = t_next
            s_before = s_next
            if turns:
                turn = math.inf
            else:
                m += 1
        speed = v + t * (a + 0.5 * t * j)
        accel = a + t * j
        for side in range(2):
            if side == 1:
                if not crossing:
                    break
                k += 1
            fastest = max(fastest, speed / top[k])
            derivatives(k, here, sampled, samples, q)
            for i in range(q.shape[1]):
                worst = max(worst, abs(q[0, i] * accel + q[1, i] * speed * speed) / limit_a[i])
                worst = max(
                    worst,
                    abs(
                        q[0, i] * j
                        + 3.0 * q[1, i] * speed * accel
                        + q[2, i] * speed * speed * speed
                    )
                    / limit_j[i],
                )
    return worst, fastest, k
