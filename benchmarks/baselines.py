"""Two planners of polygons for comparison, written from published descriptions.

:func:`capped` looks ahead over 50 segments. It crosses no joint faster than the peak speed of a
segment beside it from rest to rest, as LinuxCNC's S-curve planner is reported to do.
:func:`trapezoid` has unlimited jerk and makes two passes over the whole path: a lower bound for
planners with limited jerk. Both cross bends as fast as the normal acceleration allows, and stop at
corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AHEAD = 50
CORNER = 0.7
"""rad; the motion stops at a sharper turn."""


@dataclass(frozen=True)
class Bounds:
    """Speed, acceleration along and across the path, and jerk, in mm and s."""

    feed: float
    accel: float
    normal: float
    jerk: float = inf

    def ramp_time(self, change: float) -> float:
        """Return the time from one constant speed to another."""
        if change * self.jerk >= self.accel**2:
            return change / self.accel + self.accel / self.jerk
        return 2.0 * sqrt(change / self.jerk)

    def ramp(self, v0: float, v1: float) -> float:
        """Return the length of a ramp."""
        return 0.5 * (v0 + v1) * self.ramp_time(abs(v1 - v0))

    def reach(self, v0: float, length: float, most: float) -> float:
        """Return the highest speed up to ``most`` that a ramp from ``v0`` reaches in a length."""
        if self.ramp(v0, max(v0, most)) <= length:
            return most
        low, high = v0, most
        for _ in range(40):
            v = 0.5 * (low + high)
            low, high = (v, high) if self.ramp(v0, v) <= length else (low, v)
        return min(low, most)


def joint_speeds(points: Floats, bounds: Bounds) -> Floats:
    """Return the speed at each point from the circle through it and its neighbours.

    It is 0 at both ends and at corners.
    """
    step = np.diff(points, axis=0)
    length = np.sqrt((step**2).sum(axis=1))
    cosine = (step[1:] * step[:-1]).sum(axis=1) / (length[1:] * length[:-1])
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    across = np.sqrt(((points[2:] - points[:-2]) ** 2).sum(axis=1))
    sine = np.sin(turn)
    radius = np.divide(across, 2.0 * sine, out=np.full(len(sine), inf), where=sine > 0.0)
    speeds = np.where(turn > CORNER, 0.0, np.minimum(bounds.feed, np.sqrt(bounds.normal * radius)))
    return np.concatenate(([0.0], speeds, [0.0]))


def planned(points: Floats, bounds: Bounds, speeds: Floats) -> float:
    """Return the time of a path whose points may be crossed at ``speeds``.

    A backward and a forward pass lower the speeds; every segment has the fastest ramps.
    """
    length = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1)).tolist()
    v = speeds.tolist()
    for k in range(len(length) - 1, -1, -1):
        v[k] = bounds.reach(v[k + 1], length[k], v[k]) if v[k] > v[k + 1] else v[k]
    for k in range(len(length)):
        v[k + 1] = bounds.reach(v[k], length[k], v[k + 1]) if v[k + 1] > v[k] else v[k + 1]
    total = 0.0
    for k, whole in enumerate(length):
        low, high = max(v[k], v[k + 1]), bounds.feed
        for _ in range(40):
            top = 0.5 * (low + high)
            low, high = (
                (top, high)
                if bounds.ramp(v[k], top) + bounds.ramp(top, v[k + 1]) <= whole
                else (low, top)
            )
        ramps = bounds.ramp_time(low - v[k]) + bounds.ramp_time(low - v[k + 1])
        left = whole - bounds.ramp(v[k], low) - bounds.ramp(low, v[k + 1])
        total += ramps + max(0.0, left) / max(low, 1e-12)
    return total


def trapezoid(points: Floats, bounds: Bounds) -> float:
    """Return the time with unlimited jerk."""
    free = Bounds(bounds.feed, bounds.accel, bounds.normal)
    return planned(points, free, joint_speeds(points, free))


def capped(points: Floats, bounds: Bounds) -> float:
    """Return the time with speeds limited by the peaks of segments, and by a stop within AHEAD."""
    speeds = joint_speeds(points, bounds)
    length = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    peak = np.array([bounds.reach(0.0, 0.5 * each, bounds.feed) for each in length])
    s = np.concatenate(([0.0], np.cumsum(length)))
    known = s[np.minimum(np.arange(len(s)) + AHEAD, len(s) - 1)] - s
    stopping = np.array([bounds.reach(0.0, each, bounds.feed) for each in known])
    speeds[1:-1] = np.minimum.reduce((speeds[1:-1], peak[:-1], peak[1:], stopping[1:-1]))
    return planned(points, bounds, speeds)
