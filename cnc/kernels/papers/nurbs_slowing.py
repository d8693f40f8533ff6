"""Speeds from B down to A, where the look-ahead of Hui, Wei and Gao 2013 (section 4.2) goes back.

The drawing is in :mod:`cnc.kernels.papers.nurbs_lookahead`.
"""

from __future__ import annotations

import math

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats

TOLERANCE = 1e-6
"""By this part a speed may fall more than T A before the look-ahead goes back: rounding is no
reason.
"""


@njit
def periods_between(v: float, low: float, most: float) -> int:
    """Return the number of periods from v down to ``low``, by at most ``most`` each; at least 1."""
    return max(math.ceil((v - low) / most * (1.0 - TOLERANCE)), 1)


@njit
def slowing_distance(v: float, low: float, most: float, period: float) -> float:
    """Return the distance of these periods: steps of v - dv, v - 2 dv .. low."""
    n = periods_between(v, low, most)
    return period * (n * low + 0.5 * (n - 1) * (v - low)) if v > low else period * low


@njit
def fill_speeds(
    v: float, low: float, most: float, period: float, distance: float, arrives: bool, queue: Floats
) -> int:
    """Write speeds from v at B down to ``low`` at A, ``distance`` mm ahead, into ``queue``.

    The last speed comes first. arrives: A is the end of the curve.

    Returns:
        The number of speeds.
    """
    n = periods_between(v, low, most) if v > low else 0
    rest = distance - (slowing_distance(v, low, most, period) if n > 0 else 0.0)
    fast = max(v, low)
    whole = min(int(rest / (fast * period)), queue.shape[0] - n - 1) if rest > 0.0 else 0
    odd = rest / period - whole * fast
    count = 0
    placed = odd < (0.0 if arrives else low)
    for k in range(n):
        speed = low + k * (v - low) / n
        if not placed and odd <= speed:
            queue[count] = odd
            count += 1
            placed = True
        queue[count] = speed
        count += 1
    if not placed:
        queue[count] = odd
        count += 1
    for _ in range(whole):
        queue[count] = fast
        count += 1
    return count
