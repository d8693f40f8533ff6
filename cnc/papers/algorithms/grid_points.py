"""Grid points as the experiments on bare lines and circles take and give them."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points: TypeAlias = NDArray[np.int64]

FARTHEST = 2**28
"""BLU: squares and products of coordinates stay within 64 bits."""


def checked_end(end: ArrayLike, axes: int | None = None) -> Points:
    """The end of a line from the origin, if it is a grid point off the origin, in reach, in
    ``axes`` axes.
    """
    given = np.asarray(end)
    whole: Points = np.rint(given).astype(np.int64)
    if whole.ndim != 1 or (axes is not None and len(whole) != axes) or (whole != given).any():
        raise ValueError(f"a grid point of {axes or 'some'} integers is needed")
    if not 0 < np.abs(whole).max(initial=0) < FARTHEST:
        raise ValueError(f"the end must lie off the origin and within {FARTHEST} BLU of it")
    return whole


def checked_radius(radius: int) -> int:
    """The radius, if it is one."""
    if not 0 < radius < FARTHEST:
        raise ValueError(f"the radius must be positive and less than {FARTHEST} BLU")
    return radius


def points(first: Points, step: NDArray[np.int8]) -> Points:
    """The grid points (m + 1, n) that the steps (m, n) lead to, with the first."""
    return first + np.concatenate(
        (np.zeros((1, len(first)), np.int64), np.cumsum(step, axis=0, dtype=np.int64))
    )
