"""Data that the generators of grid moves share, and the rule that gives the next grid point.

A grid move is one row of a buffer: the axes that step together, each by one BLU.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats, Ints

Steps = NDArray[np.int8]
Lines = NDArray[np.int32]

SLACK = 5e-10
"""BLU. Far below any distance that matters, and above the rounding of positions up to 100 000
BLU.
"""
SLACK_PER_BLU = 2e-15
"""Added to SLACK for each BLU of distance from the origin, since rounding grows with the position.
"""


class Piece(NamedTuple):
    """One piece of a path.

    Attributes:
        kind: LINE, ARC or SPAN.
        data: float64: the records of the path.
        at: index in ``data`` at which the record of the piece begins.
        s0: path coordinate at the start of the piece, mm.
    """

    kind: int
    data: Floats
    at: int
    s0: float


class Grid(NamedTuple):
    """The grid of a machine and the grid point reached.

    Attributes:
        scale: (n,): steps per mm.
        point: (n,) int64: the grid point in steps. Generators move it along.
    """

    scale: Floats
    point: Ints


class Moves(NamedTuple):
    """A buffer of grid moves.

    Attributes:
        step: (rows, n) int8: -1, 0 or 1 for each axis.
        s: (rows,): path coordinate at which the move is due, mm.
    """

    step: Steps
    s: Floats


@njit
def slack(p: float) -> float:
    """Return the largest rounding error (BLU) that a position of p BLU may have."""
    return SLACK + SLACK_PER_BLU * abs(p)


@njit
def grid_after(g: int, p: float) -> int:
    """Return the grid point of an axis that was at grid point g and has moved to p BLU.

    It is g unless p is beyond the half-grid line next to g by more than the slack.
    """
    margin = 0.5 + slack(p)
    if p > g + margin:
        return math.ceil(p - margin)
    if p < g - margin:
        return math.floor(p + margin)
    return g
