r"""The shortest ramp to rest where the bounds on acceleration and jerk hardly vary.

      a |\ a0
        |  \          t
      --+---\--------------/----
        |     \          /
        |      \________/  -peak

From any acceleration, the jerk -J leads to the largest deceleration, and J from there to rest. That
is the fastest motion to rest under one bound on acceleration and one on jerk.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from cnc.kernels.planner.intervals import Intervals
from cnc.kernels.planner.phases import PHASE, Phases, phase_at

EVEN = 0.98
"""A bound varies by less than 2 % over the ramp, else a search may find a shorter one."""

SHORT = 1e-12
"""s; shorter phases are left out."""


def ramp_to_rest(s: float, v: float, a: float, accel: float, jerk: float) -> Phases | None:
    """Return the fastest motion to rest from a speed and an acceleration.

    Args:
        s: arc length at the start, mm.
        v: speed there, mm/s.
        a: acceleration there, mm/s^2.
        accel: largest acceleration.
        jerk: largest jerk, mm/s^3.

    Returns:
        The phases; None where the motion would go back, or exceeds the acceleration already.
    """
    if abs(a) > accel or v <= 0.0 or (a < 0.0 and v < 0.5 * a * a / jerk):
        return None
    peak = min(accel, sqrt(jerk * v + 0.5 * a * a))
    cruise = max(v + 0.5 * a * a / jerk - peak * peak / jerk, 0.0) / peak
    steps = [(max(a, 0.0) / jerk, -jerk), ((min(a, 0.0) + peak) / jerk, -jerk)]
    steps += [(cruise, 0.0), (peak / jerk, jerk)]
    rows = []
    for duration, j in steps:
        if duration > SHORT:
            rows.append((duration, s, v, a, j))
            s, v, a = phase_at(duration, s, v, a, j)
    return np.array(rows, PHASE)


def even_ramp(known: Intervals, s: float, v: float, a: float) -> Phases | None:
    """Return the fastest motion to rest over intervals whose bounds hardly vary.

    Args:
        known: the intervals from ``s`` on.
        s: arc length, mm.
        v: speed, mm/s.
        a: acceleration, mm/s^2.

    Returns:
        The phases; None where the bounds vary more, or a junction needs a constant speed.
    """
    count = 1
    while count <= len(known.end):
        accel = float(known.accel[:count, 0].min())
        jerk = float(known.jerk[:count, 0].min())
        phases = ramp_to_rest(s, v, a, accel, jerk)
        if phases is None:
            return None
        needed = int(np.searchsorted(known.end, phase_at(*phases[-1].tolist())[0])) + 1
        if needed <= count:
            break
        count = needed
    else:
        return None
    within = slice(0, count)
    fastest = v + 0.5 * max(a, 0.0) ** 2 / jerk
    even = (
        accel >= EVEN * known.accel[within, 0].max()
        and jerk >= EVEN * known.jerk[within, 0].max()
        and fastest <= known.speed[within].min()
        and not known.flat[within].any()
    )
    return phases if even else None
