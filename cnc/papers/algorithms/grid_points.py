"""Grid points of the experiments on lines and circles."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points: TypeAlias = NDArray[np.int64]

FARTHEST = 2**28
"""BLU: squares and products of coordinates stay within 64 bits."""


def checked_end(end: ArrayLike, axes: int | None = None) -> Points:
    """Return the end of a line from the origin as integers.

    Raises:
        ValueError: if it is no grid point in ``axes`` axes, is the origin, or is too far from it.
    """
    given = np.asarray(end)
    whole: Points = np.rint(given).astype(np.int64)
    if whole.ndim != 1 or (axes is not None and len(whole) != axes) or (whole != given).any():
        raise ValueError(f"the end must be a grid point of {axes or 'some'} integers")
    if not 0 < np.abs(whole).max(initial=0) < FARTHEST:
        raise ValueError(f"the end must lie off the origin and within {FARTHEST} BLU of it")
    return whole


def checked_radius(radius: int) -> int:
    """Return the radius; ValueError if it is not positive or too large."""
    if not 0 < radius < FARTHEST:
        raise ValueError(f"the radius must be positive and less than {FARTHEST} BLU")
    return radius


def points(first: Points, step: NDArray[np.int8]) -> Points:
    """Return the grid points (m + 1, n) along the steps (m, n), with the first."""
    return first + np.concatenate(
        (np.zeros((1, len(first)), np.int64), np.cumsum(step, axis=0, dtype=np.int64))
    )
