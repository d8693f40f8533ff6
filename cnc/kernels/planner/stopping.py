r"""The shortest ramp to rest on a path whose bounds vary.

The descent of :mod:`cnc.kernels.planner.fastest` finds the fastest motion to a given place. Here
the place of rest is free: the last cell is one phase of constant jerk to rest, and speed and
acceleration at its start are unknowns as at the other cuts. Where it ends follows from them:

      v |--+--+__
        |        `+_                  cuts at fixed places
        |           `+_
        |              \_             last cell
        +---------------`--_---- s
                            rest

As the ramp becomes shorter, the last cell does, until the motion can hardly rest any nearer. Then
the last cell is begun at an earlier cut. At first it takes a large part of the ramp, so that the
place of rest can move far. Its constant jerk costs time where the path bends, so it becomes smaller
with the weight of the time.

A search may begin with a ramp that exceeds limits: then the limits of all cells are raised by the
same share, and lowered as the motion comes back inside.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import Cells, duration_of, with_motion
from cnc.kernels.planner.cells import describe, place_rest
from cnc.kernels.planner.descent import centre
from cnc.kernels.planner.examination import Shares, examine
from cnc.kernels.planner.fastest import LAST_WEIGHT, after_violation, largest_share
from cnc.kernels.planner.intervals import Intervals, SumLimits
from cnc.kernels.planner.lifts import TOUCH
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.phases import PHASE, Phases
from cnc.kernels.planner.ramp_cells import SMALLER, cut_anew, with_end
from cnc.kernels.planner.refine import sum_limits, write_cells

CENTRINGS = 4
"""Descents in which a ramp has to get inside the limits."""

LIGHT, HEAVY = 0.2, 60.0
"""Weights of the time, as in the descent: while a ramp gets inside the limits, and the first one
while it becomes shorter.
"""

FAR, NEAR_BY = 0.5, 0.25
"""Parts of a ramp's time that the last cell takes at first."""

SHORT_END = 0.1
"""The last cell becomes smaller until it would take less than this part. The weight is inverse to
the cube of the part: the length of the last cell goes with that cube.
"""

GAIN = 0.15
"""The last cell is made smaller where a ramp becomes shorter by less than this part of the cube of
its part.
"""

TRIES = 6
"""Largest number of times that the cells of a ramp are cut for one weight."""

MOST = 60
"""Largest number of descents."""


@njit
def inside(cells: Cells, known: Intervals, limits: SumLimits) -> bool:
    """Bring a motion inside the limits at the points of its cells; return whether it is there."""
    for _ in range(CENTRINGS):
        if largest_share(cells, limits) <= 1.0:
            return True
        centre(0, len(cells.length), cells, limits, LIGHT, True)
        describe(cells, known)
    return largest_share(cells, limits) <= 1.0


@njit
def made_shorter(
    cells: Cells, weight: float, known: Intervals, limits: SumLimits
) -> tuple[bool, Cells]:
    """Bring a ramp near to the least time for one weight.

    Returns:
        Whether there is a legal one, and its cells, cut where it would exceed a limit between the
        points.
    """
    for _ in range(TRIES):
        if not inside(cells, known, limits):
            return False, cells
        kept = with_motion(cells, cells.v.copy(), cells.a.copy())
        if centre(0, len(cells.length), cells, limits, weight, True) > 1.0:
            return False, cells
        shares = Shares(np.empty(len(cells.length)), np.empty(len(cells.length)))
        if examine(cells, known, limits, shares) <= 1.0 + TOUCH:
            return True, cells
        cells = after_violation(kept, cells, shares, known, limits)
    return False, cells


@njit
def phases_of(cells: Cells) -> Phases:
    """Return the phases of the motion through cells."""
    out = np.empty(4 * len(cells.length), PHASE)
    return out[: write_cells(cells, 0, len(cells.length), out, 0)]


@njit
def shortest_ramp(
    phases: Phases, rest: float, before: float, part: float, known: Intervals, machine: LimitArrays
) -> tuple[bool, Phases, float]:
    """Return the shortest legal ramp to rest that the search finds.

    Args:
        phases: (p,): a ramp to start with. It may exceed limits.
        rest: arc length of its end, mm.
        before: place before which it has to rest, mm.
        part: of its time that the last cell takes at first: FAR where the place of rest may be far
            from the best one, NEAR_BY where the ramp is short already.
        known: the intervals from its start to the place before which it rests.
        machine: the limits.

    Returns:
        Whether there is one, its phases, and the arc length of its end.
    """
    limits = sum_limits(machine)
    cells = cut_anew(phases, rest, before, part, known, limits)
    time = math.inf
    for _ in range(MOST):
        weight = min(HEAVY * (FAR / part) ** 3, LAST_WEIGHT)
        legal, cells = made_shorter(cells, weight, known, limits)
        after = duration_of(cells) if legal else math.inf
        if after < time:
            place_rest(cells)
            phases, rest = phases_of(cells), cells.s[-1]
        elif time == math.inf:
            break
        if after > (1.0 - GAIN * part * part * part) * time:
            part *= SMALLER
            if part < SHORT_END:
                break
        time = min(after, time)
        if not legal:
            cells = cut_anew(phases, rest, before, part, known, limits)
        cells = with_end(cells, part, known, limits)
    return time < math.inf, phases, rest
