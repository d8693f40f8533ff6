"""A line with whole-number coefficients through as many windows as it can meet, one after the
other.

value                    All (x, y) for which x + w y lies in given windows are a convex polygon. A line from its middle is
  |           _|_        tried; the first window that it misses cuts the polygon smaller, and the next line is taken from
  |      _|_   |         what is left, until there is nothing: then no line meets the windows up to there. Windows that no
  | _|_   |  ,'          line misses never cost more than a look.
  |  | ,-'|'
  | ,|'                  The lines are: the times of a segment's slots (after k slots, k (x + (k - 1) / 2 y)), and the places
  +------------- w       of an axis's steps among the slots (the j-th step at x + j y).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]

CORNERS = 64
"""Room for the corners of a polygon; one that would need more counts as empty."""


@njit
def longest(
    w: Floats, low: Floats, high: Floats, count: int, x0: float, x1: float, y0: float, y1: float, px: Floats, py: Floats,
) -> tuple[int, int, int]:  # fmt: skip
    """How many of the first ``count`` windows low <= x + w y <= high one line can meet, and its x
    and y, whole numbers.

    x is between x0 and x1, y between y0 and y1. px, py (2, CORNERS): scratch.
    """
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
        corners = narrow(corners, w[missed], low[missed], high[missed], px, py)
        found, new_x, new_y = whole(corners, px, py)
        if not found or (new_x == x and new_y == y):
            break
        x, y = new_x, new_y
    return met, met_x, met_y


@njit
def narrow(corners: int, w: float, low: float, high: float, px: Floats, py: Floats) -> int:
    """Keep the part of the polygon where low <= x + w y <= high; returns the number of its corners,
    0 if nothing is left.

    px, py (2, CORNERS): the corners in order, in the first row; the second is scratch.
    """
    corners = _cut(corners, 1.0, w, low, px, py)
    return _cut(corners, -1.0, -w, -high, px, py)


@njit
def _cut(corners: int, v: float, w: float, low: float, px: Floats, py: Floats) -> int:
    """Keep the part where v x + w y >= low."""
    if corners == 0 or corners == CORNERS:
        return 0
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
def whole(corners: int, px: Floats, py: Floats) -> tuple[bool, int, int]:
    """Whether whole numbers x, y were found in the polygon, near its middle, and the two."""
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
