"""The emergency ramp: motion that is stretched in time, so that it comes to rest on its path.

At the time t of a ramp of T seconds, the motion has the fraction ``1 - 3u^2 + 2u^3`` of its planned
speed, with ``u = t / T``. It covers ``T / 2`` seconds of the plan.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine

STEEPEST = 1.5
"""Ratio of the steepest to the mean slope of the ramp."""
LEAST_S, MOST_S, UNKNOWN_S = 0.02, 0.5, 0.2
"""Bounds of a ramp, and its length for a machine without accelerations of the axes."""
POINTS = 513


def ramp_seconds(machine: Machine, feed: float = math.inf) -> float:
    """Return the length of a ramp from a speed within the accelerations of the axes, s.

    Args:
        machine: The machine.
        feed: The speed, mm/s; that of an axis is at most its highest.
    """
    stops = [
        min(axis.max_velocity, feed) / axis.max_acceleration
        for axis in machine.axes.values()
        if axis.max_acceleration
    ]
    return min(max(STEEPEST * max(stops, default=UNKNOWN_S / STEEPEST), LEAST_S), MOST_S)


def stretched(time_ns: NDArray[np.int64], from_ns: int, seconds: float) -> NDArray[np.int64]:
    """Return the times of moves in a ramp, for those that come before its end.

    Args:
        time_ns: Planned time of each move (n,), ns, not before ``from_ns``.
        from_ns: Begin of the ramp, ns.
        seconds: Length of the ramp, s.
    """
    u = np.linspace(0.0, 1.0, POINTS)
    covered = seconds * (u - u**3 + 0.5 * u**4)
    planned = (time_ns - from_ns) * 1e-9
    within = planned[planned < covered[-1]]
    # The table is inverted by interpolation, which keeps the order of the moves.
    late = np.interp(within, covered, seconds * u)
    times: NDArray[np.int64] = from_ns + np.round(late * 1e9).astype(np.int64)
    return times
