"""Point-by-point comparison (Shu et al. 2019) on the data of the paper.

They are a line from the origin and a circle about it. The method is the baseline of the paper.

:mod:`cnc.kernels.pulses.point_by_point` interpolates pieces of a path, within half a BLU instead of
one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cnc.kernels.papers.point_by_point import circle_by_points, line_by_points
from cnc.papers.algorithms.grid_points import Points, checked_end, checked_radius, points


def line(end: ArrayLike) -> Points:
    """Return the grid points (m + 1, 2) from the origin to ``end`` (2,), integers.

    Each step is of one axis (equations 6 and 7).
    """
    xe, ye = checked_end(end, 2).tolist()
    step = np.empty((abs(xe) + abs(ye), 2), np.int8)
    rows = line_by_points(xe, ye, step)
    return points(np.zeros(2, np.int64), step[:rows])


def circle(radius: int, *, clockwise: bool = False, inward_on_circle: bool = True) -> Points:
    """Return the grid points (m + 1, 2) of a full turn about the origin from (radius, 0).

    inward_on_circle: direction of the step from a point on the circle.
    """
    step = np.empty((8 * checked_radius(radius), 2), np.int8)
    rows = circle_by_points(radius, -1 if clockwise else 1, inward_on_circle, step)
    return points(np.array([radius, 0]), step[:rows])
