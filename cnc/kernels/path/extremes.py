"""Turning points of pieces in each axis, and the boxes around pieces."""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    AXES,
    LINE,
    MAX_TURNING_POINTS,
    SPAN,
    START,
    U0,
    U1,
    Floats,
    Ints,
    curve_eval,
)


@njit
def curve_turning_points(kind: int, data: Floats, at: int, axis: int, out: Floats) -> int:
    """Write the u inside a piece where the derivative of ``axis`` changes sign, in order, into out.

    ``out`` takes MAX_TURNING_POINTS numbers.

    Returns:
        Their number.
    """
    if kind == LINE:
        return 0
    n = int(data[at + AXES])
    body = at + START + 2 * n
    if kind == SPAN:
        r = at + int(data[body + 1])
        first = r + n
        for i in range(axis):
            first += int(data[r + i])
        count = int(data[r + axis])
        for k in range(count):
            out[k] = data[first + k]
        return count
    if axis != int(data[body]) and axis != int(data[body + 1]):
        return 0
    # Along the first axis rho cos(theta) turns where tan(theta) = g / rho, g = d rho / d theta,
    # that is where h(theta) = theta - atan(g / rho) is a multiple of pi. h rises with a slope
    # between 1 and 2 whatever the spiral, so each multiple is met once and Newton finds it. The
    # second axis is the first, turned by 90 degrees.
    sweep = data[body + 4]
    radius = data[body + 2]
    g = data[body + 3] / sweep
    theta = data[body + 5] - (0.5 * math.pi if axis == int(data[body + 1]) else 0.0)
    h0 = theta - math.atan2(g, radius)
    h1 = theta + sweep - math.atan2(g, radius + data[body + 3])
    step = 1 if sweep > 0.0 else -1
    multiple = math.floor(h0 / math.pi) if sweep > 0.0 else math.ceil(h0 / math.pi)
    last = math.ceil(h1 / math.pi) if sweep > 0.0 else math.floor(h1 / math.pi)
    u0 = data[at + U0]
    u1 = data[at + U1]
    count = 0
    while (last - multiple) * step >= 0 and count < MAX_TURNING_POINTS:
        target = multiple * math.pi - theta
        phi = min(max(target, min(0.0, sweep)), max(0.0, sweep))
        if g == 0.0:
            phi = target
        else:
            for _ in range(30):
                rho = radius + g * phi
                change = (target - phi + math.atan2(g, rho)) / (1.0 + g * g / (rho * rho + g * g))
                phi += change
                if abs(change) < 1e-15 * (1.0 + abs(phi)):
                    break
        part = phi / sweep
        if abs(phi) > 1e-14 and abs(sweep - phi) > 1e-14 and 0.0 < part < 1.0:
            out[count] = u0 + part * (u1 - u0)
            count += 1
        multiple += step
    return count


@njit
def piece_boxes(kind: Ints, at: Ints, data: Floats, low: Floats, high: Floats) -> None:
    """Write the smallest and the largest coordinate of each piece into low and high (m, n), mm."""
    n = low.shape[1]
    turning = np.empty(MAX_TURNING_POINTS)
    point = np.empty((4, n))
    for m in range(at.shape[0]):
        a = at[m]
        start = a + START
        for i in range(n):
            low[m, i] = min(data[start + i], data[start + n + i])
            high[m, i] = max(data[start + i], data[start + n + i])
        k = kind[m]
        if k == LINE:
            continue
        for i in range(n):
            for j in range(curve_turning_points(k, data, a, i, turning)):
                curve_eval(k, data, a, turning[j], point)
                low[m, i] = min(low[m, i], point[0, i])
                high[m, i] = max(high[m, i], point[0, i])
