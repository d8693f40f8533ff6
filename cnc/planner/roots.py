"""Roots of many functions of one variable at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ACCURACY = 1e-9
"""Value of a function that counts as 0."""
PASSES = 60
"""Most passes."""


def roots(function: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    """Return the places (m,) between two others at which values are 0.

    The values at ``low`` and ``high`` have different signs. The method is that of Ridders (IEEE
    Transactions on Circuits and Systems 26, 1979), which stays between the two places.

    Args:
        function: Values (m,) at places (m,).
        low: Places (m,).
        high: Other places (m,).
    """
    a, b = low.copy(), high.copy()
    of_a, of_b = function(a), function(b)
    best = a
    for _ in range(PASSES):
        middle = 0.5 * (a + b)
        of_middle = function(middle)
        root = np.sqrt(np.maximum(of_middle**2 - of_a * of_b, np.finfo(float).tiny))
        best = middle + (middle - a) * np.sign(of_a - of_b) * of_middle / root
        best = np.clip(best, np.minimum(a, b), np.maximum(a, b))
        of_best = function(best)
        if np.abs(of_best).max(initial=0.0) < ACCURACY:
            break
        # The root lies between the middle and the best place, or between one of these and an end.
        for place, value in ((middle, of_middle), (best, of_best)):
            same = np.sign(value) == np.sign(of_a)
            inside = (place - a) * (place - b) <= 0.0
            a, of_a = np.where(same & inside, place, a), np.where(same & inside, value, of_a)
            b, of_b = np.where(~same & inside, place, b), np.where(~same & inside, value, of_b)
    return best
