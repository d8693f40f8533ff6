"""Points of a drawn motion, as arrays with names."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Points(NamedTuple):
    """Points of a motion, in order of time.

    Attributes:
        t: (n,) time, s.
        position: (n, 3) x, y and z, mm.
        s: (n,) path length, mm.
        accel: (n,) tangential acceleration from there to the next point, mm/s^2.
        jerk: (n,) tangential jerk from there to the next point, mm/s^3.
        rapid: (n,) whether a traverse leads to the next point.
    """

    t: Floats
    position: Floats
    s: Floats
    accel: Floats
    jerk: Floats
    rapid: NDArray[np.bool_]

    def part(self, first: int, last: int | None = None) -> Points:
        """Return the points from ``first`` up to ``last`` as views."""
        part = slice(first, last)
        return Points(
            self.t[part],
            self.position[part],
            self.s[part],
            self.accel[part],
            self.jerk[part],
            self.rapid[part],
        )


def new_points(count: int) -> Points:
    """Return ``count`` points without values."""
    return Points(
        np.empty(count),
        np.empty((count, 3)),
        np.empty(count),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.bool_),
    )


class Followed(NamedTuple):
    """Points along a plan, with more about each of them.

    Attributes:
        points: the points.
        speed: (n,) speed along the path, mm/s.
        mark: (n,) sum of PHASE and ENTERED.
        piece: (n,) index of the piece in the chunk.
    """

    points: Points
    speed: Floats
    mark: Ints
    piece: Ints


PHASE, ENTERED = 1, 2
"""Marks: a phase of the plan begins here; a piece of the path begins here."""


def new_followed(count: int) -> Followed:
    """Return ``count`` points along a plan without values."""
    return Followed(
        new_points(count),
        np.empty(count),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
    )
