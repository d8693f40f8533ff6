"""Half-step deviation (Shu et al. 2019) on the bare data of the paper: a line from the origin and a
circle about it, both on the grid.

Lines and arcs of a path, wherever they lie, are done by the kernel of the same name, which does
this line, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.kernels.papers import comparison
from cnc.kernels.path.curve import LINE
from cnc.kernels.pulses.half_step import half_step_rows
from cnc.papers.algorithms.grid_points import Points, checked_end, checked_radius, points
from cnc.path.records import line_records


def line(end: ArrayLike) -> Points:
    """From the origin to ``end`` (n,), integers: the grid points (m + 1, n), one for each step of
    the longest axis (equations 8 to 10).
    """
    target = checked_end(end)
    record = line_records(
        np.zeros(len(target)), target[None].astype(np.float64), np.zeros(len(target), np.int64)
    )
    step = np.empty((int(np.abs(target).max()), len(target)), np.int8)
    grid = np.zeros(len(target), np.int64)
    length = float(record.length[0])
    rows, _, _ = half_step_rows(
        LINE,
        record.data,
        0,
        0.0,
        length,
        0.0,
        np.ones(len(target)),
        grid,
        np.zeros(32),
        0,
        step,
        np.empty(len(step)),
    )
    return points(np.zeros(len(target), np.int64), step[:rows])


def circle(radius: int, *, clockwise: bool = False) -> Points:
    """A full turn about the origin from (radius, 0): the grid points (m + 1, 2), each the nearer
    one of its octant's two candidates.
    """
    step: NDArray[np.int8] = np.empty((8 * checked_radius(radius), 2), np.int8)
    rows = comparison.circle_by_half_steps(radius, -1 if clockwise else 1, step)
    return points(np.array([radius, 0]), step[:rows])
