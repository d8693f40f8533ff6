r"""Cells of a plan under refinement, and the motion through one.

      s0      s1      s2
      +---+---+---+---+---
       j1  j2  j1  j2
       h   h   h   h

Cells lie between cuts at fixed arc lengths. Speed and acceleration at the cuts determine the
motion: two phases of equal duration h and constant jerk lead through a cell. With d = s1 - s0 they
follow in closed form:

    h (v0 + v1) - h^2 (a1 - a0) / 3 = d,
    j1 = (v1 - v0) / h^2 - 2 a0 / h - (a1 - a0) / (2 h),   j2 = (a1 - a0) / h - j1.

So any values at the cuts are a continuous motion with exact constant-jerk phases.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]


H, J1, J2, V_MIDDLE, A_MIDDLE = range(5)
"""Entries of the solution of a cell: half its duration, the jerks of its two phases, speed and
acceleration between them.
"""


OPEN = 0.0
"""Stands for the length of a cell that leads to rest by one phase, wherever that ends."""

CLOSED = -math.inf
"""Stands for a fixed place of the last cut."""


class Cells(NamedTuple):
    """A row of cells, and the motion through them.

    Attributes:
        s: (n + 1,): arc length at the cuts, mm.
        v: (n + 1,): speed there, mm/s.
        a: (n + 1,): acceleration there, mm/s^2.
        length: (n,): mm.
        top: (n, 2): speed bounds in the middle and at the end of each cell, mm/s.
        share: (n,): share of the limits of acceleration and jerk that a cell may use.
        pace: (n,): share of its speed bounds that it may use; ``top`` includes it.
        q: (n, 3, 3, axes + 1): q', q'', q''' at the start, in the middle and at the end; the last
            column is for the path itself.
        rest_before: CLOSED where the last cut has a fixed place. Else the last cell is one phase of
            constant jerk to rest: its length is OPEN, ``s[n]`` follows from the motion, and this
            is the place before which it rests, mm.
    """

    s: Floats
    v: Floats
    a: Floats
    length: Floats
    top: Floats
    share: Floats
    pace: Floats
    q: Floats
    rest_before: float


@njit
def phase_to_rest(v: float, a: float, x: Floats, slope: Floats) -> bool:
    """Compute one phase of constant jerk to rest, as :func:`cell_phases` does two phases.

    Args:
        v: speed at its start, mm/s.
        a: acceleration there.
        x: (5,): receives the entries H, J1, J2, V_MIDDLE, A_MIDDLE.
        slope: (5, 4): receives the derivatives of x by v and a. Those by the state at rest are 0.

    Returns:
        Whether there is such a phase: the motion has to slow.
    """
    if not v > 0.0 > a:
        return False
    for i in range(5):
        for k in range(4):
            slope[i, k] = 0.0
    x[H], slope[H, 0], slope[H, 1] = -v / a, -1.0 / a, v / (a * a)
    x[J1], slope[J1, 0], slope[J1, 1] = 0.5 * a * a / v, -0.5 * a * a / (v * v), a / v
    x[J2], slope[J2, 0], slope[J2, 1] = x[J1], slope[J1, 0], slope[J1, 1]
    x[V_MIDDLE], slope[V_MIDDLE, 0] = 0.25 * v, 0.25
    x[A_MIDDLE], slope[A_MIDDLE, 1] = 0.5 * a, 0.5
    return True


@njit
def length_to_rest(v: float, a: float) -> float:
    """Return the length of the phase of :func:`phase_to_rest`, mm."""
    return -2.0 / 3.0 * v * v / a


@njit
def cell_phases(
    v0: float, a0: float, v1: float, a1: float, d: float, x: Floats, slope: Floats
) -> bool:
    """Compute the two phases through a cell of length ``d``.

    Args:
        v0: speed at its start, mm/s.
        a0: acceleration there.
        v1: speed at its end.
        a1: acceleration there.
        d: mm; OPEN for a phase to rest.
        x: (5,): receives the entries H, J1, J2, V_MIDDLE, A_MIDDLE.
        slope: (5, 4): receives the derivatives of x by v0, a0, v1, a1.

    Returns:
        Whether the motion exists and goes forward throughout.
    """
    if d == OPEN:
        return phase_to_rest(v0, a0, x, slope)
    da = a1 - a0
    total = v0 + v1
    square = total * total - 4.0 / 3.0 * d * da
    if not (square > 0.0 and total > 0.0):
        return False
    root = math.sqrt(square)
    h = 2.0 * d / (total + root)
    r = 1.0 / h
    slope[H, 0] = slope[H, 2] = -h / root
    slope[H, 3] = h * h / (3.0 * root)
    slope[H, 1] = -slope[H, 3]
    dv = v1 - v0
    j1 = (dv * r - 2.0 * a0 - 0.5 * da) * r
    j2 = da * r - j1
    by_h = (-2.0 * dv * r + 2.0 * a0 + 0.5 * da) * r * r
    for i in range(4):
        slope[J1, i] = by_h * slope[H, i]
    slope[J1, 0] -= r * r
    slope[J1, 1] -= 1.5 * r
    slope[J1, 2] += r * r
    slope[J1, 3] -= 0.5 * r
    for i in range(4):
        slope[J2, i] = -da * r * r * slope[H, i] - slope[J1, i]
    slope[J2, 1] -= r
    slope[J2, 3] += r
    middle = a0 + h * j1
    for i in range(4):
        slope[V_MIDDLE, i] = middle * slope[H, i] + 0.5 * h * h * slope[J1, i]
        slope[A_MIDDLE, i] = j1 * slope[H, i] + h * slope[J1, i]
    slope[V_MIDDLE, 0] += 1.0
    slope[V_MIDDLE, 1] += h
    slope[A_MIDDLE, 1] += 1.0
    v_middle = v0 + h * (a0 + 0.5 * h * j1)
    x[H] = h
    x[J1] = j1
    x[J2] = j2
    x[V_MIDDLE] = v_middle
    x[A_MIDDLE] = middle
    # The speed is lowest where the acceleration rises through 0.
    lowest = v_middle
    if a0 < 0.0 < middle:
        lowest = v0 - a0 * a0 / (2.0 * j1)
    elif middle < 0.0 < a1:
        lowest = v_middle - middle * middle / (2.0 * j2)
    return lowest > 0.0


@njit
def empty_cells(n: int, columns: int, rest_before: float = CLOSED) -> Cells:
    """Return arrays for ``n`` cells; each may use all of the limits.

    ``columns``: number of axes, and 1 for the path. ``rest_before``: as of :class:`Cells`.
    """
    return Cells(
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty(n + 1),
        np.empty(n),
        np.empty((n, 2)),
        np.ones(n),
        np.ones(n),
        np.empty((n, 3, 3, columns)),
        rest_before,
    )


@njit
def copy_part(source: Floats, first: int, count: int, target: Floats, at: int) -> None:
    """Copy ``count`` numbers from ``first`` on to ``target``, from ``at`` on.

    An assignment of arrays would compile several times as much.
    """
    for k in range(count):
        target[at + k] = source[first + k]


@njit
def with_motion(cells: Cells, v: Floats, a: Floats) -> Cells:
    """Return the same cells with another motion."""
    share, pace = cells.share, cells.pace
    return Cells(cells.s, v, a, cells.length, cells.top, share, pace, cells.q, cells.rest_before)


@njit
def duration_of(cells: Cells) -> float:
    """Return the duration of the motion through all cells, s; infinite if there is none."""
    x = np.empty(5)
    slope = np.empty((5, 4))
    v, a = cells.v, cells.a
    total = 0.0
    for m in range(len(cells.length)):
        if not cell_phases(v[m], a[m], v[m + 1], a[m + 1], cells.length[m], x, slope):
            return math.inf
        total += 2.0 * x[H]
    return total
