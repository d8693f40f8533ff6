"""A line with whole-number coefficients through as many consecutive windows as possible.

value                    The points (x, y) for which x + w y lies in given windows form a convex
  |           _|_        polygon. A line from its middle is tried. The first window that the line
  |      _|_   |         misses cuts the polygon, and the next line is taken from the rest, until
  | _|_   |  ,'          nothing remains: then no line passes all windows up to there. A window
  |  | ,-'|'             that no line misses costs only one comparison.
  | ,|'
  +------------- w

The lines are the times of the slots of a segment (after k slots: k (x + (k - 1) / 2 y)), and the
positions of the steps of an axis among the slots (step j: x + j y).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]

MAX_CORNERS = 64
"""Capacity of a polygon; a polygon with more corners counts as empty."""


class Windows(NamedTuple):
    """Windows low <= x + w y <= high, each array (n,)."""

    w: Floats
    low: Floats
    high: Floats


class Bounds(NamedTuple):
    """Bounds of x and y."""

    min_x: float
    max_x: float
    min_y: float
    max_y: float


class Polygon(NamedTuple):
    """Corners of a polygon in order, each array (2, MAX_CORNERS); the second row is scratch."""

    x: Floats
    y: Floats


@njit
def longest(windows: Windows, count: int, bounds: Bounds, polygon: Polygon) -> tuple[int, int, int]:
    """Find the line that passes most windows from the first one on.

    Args:
        windows: The windows.
        count: Number of windows.
        bounds: Bounds of x and y.
        polygon: Scratch.

    Returns:
        Number of windows that the line passes, and its x and y.
    """
    w, low, high = windows.w, windows.low, windows.high
    px, py = polygon.x, polygon.y
    x0, x1, y0, y1 = bounds.min_x, bounds.max_x, bounds.min_y, bounds.max_y
    px[0, 0], px[0, 1], px[0, 2], px[0, 3] = x0, x1, x1, x0
    py[0, 0], py[0, 1], py[0, 2], py[0, 3] = y0, y0, y1, y1
    corners = 4
    met, met_x, met_y = 0, 0, 0
    x, y = x0, min(max(0.0, y0), y1)
    while True:
        missed = 0
        while missed < count and low[missed] <= x + w[missed] * y <= high[missed]:
            missed += 1
        if missed > met:
            met, met_x, met_y = missed, int(x), int(y)
        if missed == count:
            break
        corners = _cut(corners, 1.0, w[missed], low[missed], polygon)
        corners = _cut(corners, -1.0, -w[missed], -high[missed], polygon)
        found, new_x, new_y = _whole_point(corners, polygon)
        if not found or (new_x == x and new_y == y):
            break
        x, y = float(new_x), float(new_y)
    return met, met_x, met_y


@njit
def _cut(corners: int, v: float, w: float, low: float, polygon: Polygon) -> int:
    """Keep the part of the polygon where v x + w y >= low; return its number of corners."""
    if corners == 0 or corners == MAX_CORNERS:
        return 0
    px, py = polygon.x, polygon.y
    kept = 0
    last = corners - 1
    before = v * px[0, last] + w * py[0, last] - low
    for i in range(corners):
        here = v * px[0, i] + w * py[0, i] - low
        if (before < 0.0) != (here < 0.0):
            part = before / (before - here)
            px[1, kept] = px[0, last] + part * (px[0, i] - px[0, last])
            py[1, kept] = py[0, last] + part * (py[0, i] - py[0, last])
            kept += 1
        if here >= 0.0:
            px[1, kept] = px[0, i]
            py[1, kept] = py[0, i]
            kept += 1
        before = here
        last = i
    for i in range(kept):
        px[0, i] = px[1, i]
        py[0, i] = py[1, i]
    return kept


@njit
def _whole_point(corners: int, polygon: Polygon) -> tuple[bool, int, int]:
    """Return whether there are whole x, y in the polygon near its middle, and the two."""
    px, py = polygon.x, polygon.y
    low, high, mean = math.inf, -math.inf, 0.0
    for i in range(corners):
        low = min(low, py[0, i])
        high = max(high, py[0, i])
        mean += py[0, i] / corners
    y = math.floor(mean + 0.5) if corners > 0 else 0.0
    if not low <= y <= high and high > -math.inf:
        y = math.floor(high)
    left, right = math.inf, -math.inf
    last = corners - 1
    for i in range(corners):
        if (py[0, last] <= y <= py[0, i]) or (py[0, i] <= y <= py[0, last]):
            part = (y - py[0, last]) / (py[0, i] - py[0, last]) if py[0, i] != py[0, last] else 0.0
            crossing = px[0, last] + part * (px[0, i] - px[0, last])
            left = min(left, crossing)
            right = max(right, crossing)
        last = i
    x = 0.0
    found = left <= right
    if found:
        x = math.floor(0.5 * (left + right) + 0.5)
        if not left <= x <= right:
            x = math.floor(right)
        found = left <= x
    return found, int(x), int(y)
