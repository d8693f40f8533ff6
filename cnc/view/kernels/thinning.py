r"""Thinning of points: a point is left out where its neighbours show it well enough.

      x                 ,o   The tool is drawn at a steady speed between the points kept. A point
      |            ,-'` .    can be left out as long as one line from the last point kept (A) meets
      |      ,-|'`  .  |     the windows p +- tolerance of all points since then. Each window leaves
      |   ,-'` |.  |         a fan of slopes. The next point must lie in the remaining fan;
      A -----------+----- t  otherwise the point before it is kept, and a new fan begins there.

Each axis has its own fan with tolerance / sqrt(3), so that the distance in space stays within the
tolerance.

This is the swinging door of process historians (Bristol, US patent 4669097, 1987), ending on points
of the data. It takes one pass and keeps one point in memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.view.kernels.motion import Floats, Points, new_points

ANCHOR, LAST = 0, 1
"""Rows of ``Fan.ends``: the point kept last, the point seen last."""
STATE = np.dtype(
    [
        ("accel", np.float64),
        ("jerk", np.float64),
        ("rapid", np.bool_),
        ("started", np.bool_),
        ("open", np.bool_),
    ]
)
"""Since the point kept last: the acceleration and jerk of largest magnitude, and whether the motion
is a traverse; whether there is any point; whether there is a point since then."""


class Fan(NamedTuple):
    """State of :func:`thin`.

    Attributes:
        ends: (2 points) the point kept last, the point seen last.
        low: (3,) least slope of each axis that meets all windows, mm/s.
        high: (3,) greatest slope, mm/s.
        state: (1,) STATE.
    """

    ends: Points
    low: Floats
    high: Floats
    state: NDArray[np.void]


def new_fan() -> Fan:
    """Return the state before the first point."""
    return Fan(new_points(2), np.empty(3), np.empty(3), np.zeros(1, STATE))


@njit
def _copy(source: Points, row: int, target: Points, to: int) -> None:
    """Copy a point."""
    target.t[to] = source.t[row]
    target.position[to] = source.position[row]
    target.s[to] = source.s[row]
    target.accel[to] = source.accel[row]
    target.jerk[to] = source.jerk[row]
    target.rapid[to] = source.rapid[row]


@njit
def _widen(fan: Fan) -> None:
    """Begin a new fan, in which every slope is possible."""
    fan.low[:] = -math.inf
    fan.high[:] = math.inf


@njit
def _keep(fan: Fan, out: Points, count: int) -> int:
    """Write the anchor with the extremes since then; the point seen last becomes the anchor."""
    state = fan.state[0]
    _copy(fan.ends, ANCHOR, out, count)
    out.accel[count] = state["accel"]
    out.jerk[count] = state["jerk"]
    out.rapid[count] = state["rapid"]
    _copy(fan.ends, LAST, fan.ends, ANCHOR)
    _widen(fan)
    state["accel"] = 0.0
    state["jerk"] = 0.0
    state["open"] = False
    return count + 1


@njit
def _must_keep(points: Points, row: int, tolerance: float, fan: Fan) -> bool:
    """Return whether the point seen last must be kept before the point ``row``."""
    state = fan.state[0]
    if not state["open"]:
        return False
    ends = fan.ends
    span = points.t[row] - ends.t[ANCHOR]
    fits = True
    moved = 0.0
    for i in range(3):
        slope = (points.position[row, i] - ends.position[ANCHOR, i]) / span
        fits = fits and fan.low[i] <= slope <= fan.high[i]
        moved += (ends.position[LAST, i] - ends.position[ANCHOR, i]) ** 2
    other = state["rapid"] != ends.rapid[LAST] and moved > tolerance * tolerance
    return other or not fits


@njit
def thin(points: Points, exact: bool, tolerance: float, fan: Fan, out: Points) -> int:
    """Keep the points that the others need to stay within ``tolerance`` at any time.

    A traverse begins and ends at a point kept, unless it is shorter than the tolerance.

    Args:
        points: (n) points.
        exact: whether the acceleration is that at a point and changes with the jerk. Otherwise it
            is the greatest up to the next point.
        tolerance: largest distance of the drawn tool from each point, mm.
        fan: the state, kept from call to call.
        out: (n + 1 or more) receives the points kept. Their acceleration and jerk are those of
            largest magnitude up to the next point kept, with their signs.

    Returns:
        The number of points kept. The last point is held back in the state.
    """
    reach = tolerance / math.sqrt(3.0)
    state = fan.state[0]
    ends = fan.ends
    count = 0
    for row in range(len(points.t)):
        if not state["started"]:
            state["started"] = True
            _copy(points, row, ends, LAST)
            _copy(points, row, ends, ANCHOR)
            _widen(fan)
            continue
        step = points.t[row] - ends.t[LAST]
        if step > 0.0:
            if _must_keep(points, row, tolerance, fan):
                count = _keep(fan, out, count)
            span = points.t[row] - ends.t[ANCHOR]
            for i in range(3):
                change = points.position[row, i] - ends.position[ANCHOR, i]
                fan.low[i] = max(fan.low[i], (change - reach) / span)
                fan.high[i] = min(fan.high[i], (change + reach) / span)
            state["open"] = True
            state["rapid"] = ends.rapid[LAST]
            a = ends.accel[LAST]
            later = a + ends.jerk[LAST] * step if exact else a
            a = later if abs(later) > abs(a) else a
            if abs(a) > abs(state["accel"]):
                state["accel"] = a
            if abs(ends.jerk[LAST]) > abs(state["jerk"]):
                state["jerk"] = ends.jerk[LAST]
        _copy(points, row, ends, LAST)
    return count


@njit
def thin_end(fan: Fan, out: Points) -> int:
    """Write the points that were held back, at most 2, and return their number."""
    state = fan.state[0]
    if not state["started"]:
        return 0
    count = 0
    if state["open"]:
        count = _keep(fan, out, count)
    _copy(fan.ends, LAST, out, count)
    out.accel[count] = 0.0
    out.jerk[count] = 0.0
    out.rapid[count] = False
    return count + 1
