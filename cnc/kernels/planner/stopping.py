r"""The shortest ramp to rest on a path whose bounds vary.

The descent of :mod:`cnc.kernels.planner.fastest` needs a fixed end. So the search takes a legal
ramp, makes it shorter in length and time at the same speeds, and brings it back inside the limits:

      v |----.__
        |  \    `--.__        the ramp of before
        |   `\_       `--.
        |      `\_        \   shorter by the same part everywhere
        +---------`--------`-- s

A ramp that does not get back inside is shortened by less, until the difference is small.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.planner.cell_motion import Cells, duration_of, empty_cells
from cnc.kernels.planner.cells import describe, part_of, with_knots
from cnc.kernels.planner.descent import centre
from cnc.kernels.planner.examination import passable
from cnc.kernels.planner.fastest import fastest
from cnc.kernels.planner.intervals import Intervals, SumLimits
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.phases import PHASE, Phases, phase_at
from cnc.kernels.planner.refine import sum_limits, write_cells
from cnc.kernels.planner.stretches import Stretch

SHORTER = 0.88
"""Part of its length to which a ramp is shortened at first."""

LEAST = 0.99
"""The search ends where a ramp would be shortened by less than this part."""

CELLS = 48
"""Cells of a ramp at first; more where the path needs them."""

MOST = 40
"""Largest number of ramps that are tried."""

CENTRINGS = 4
"""Descents in which a ramp has to get inside the limits."""

LIGHT = 0.2
"""Weight of the time, as in the descent, while a ramp gets inside the limits."""

GAIN = 0.999
"""A shorter ramp takes less than this part of the time."""


@njit
def even_cells(stretch: Stretch, columns: int) -> Cells:
    """Return cells of equal duration with the motion of a stretch, and nothing else set.

    ``columns``: as of :func:`cnc.kernels.planner.cell_motion.empty_cells`.
    """
    rows = stretch.rows
    cells = empty_cells(CELLS, columns)
    whole = 0.0
    for r in range(stretch.first, stretch.last):
        whole += rows[r]["duration"]
    r = stretch.first
    begun = 0.0
    for m in range(CELLS):
        t = whole * m / CELLS - begun
        while r + 1 < stretch.last and t > rows[r]["duration"]:
            t -= rows[r]["duration"]
            begun += rows[r]["duration"]
            r += 1
        cells.s[m], cells.v[m], cells.a[m] = phase_at(
            t, rows[r]["s"], rows[r]["v"], rows[r]["a"], rows[r]["j"]
        )
    cells.s[CELLS], cells.v[CELLS], cells.a[CELLS] = stretch.end_s, stretch.end_v, 0.0
    for m in range(CELLS):
        cells.length[m] = cells.s[m + 1] - cells.s[m]
    return cells


@njit
def shortened(cells: Cells, part: float, known: Intervals) -> Cells:
    """Return the motion over ``part`` of its length at the same speeds.

    The state at the start stays the same.
    """
    n = len(cells.length)
    out = part_of(cells, 0, n)
    for m in range(n + 1):
        out.s[m] = cells.s[0] + part * (cells.s[m] - cells.s[0])
        if m > 0:
            out.a[m] = cells.a[m] / part
    for m in range(n):
        out.share[m], out.pace[m] = cells.share[m], cells.pace[m]
    describe(out, known)
    return passable(out, known)


@njit
def inside(cells: Cells, limits: SumLimits) -> bool:
    """Bring a motion inside the limits at the points of its cells; return whether it is there."""
    worst = math.inf
    for _ in range(CENTRINGS):
        if worst > 1.0:
            worst = centre(0, len(cells.length), cells, limits, LIGHT)
    return worst <= 1.0


@njit
def shortest_ramp(
    phases: Phases, rest: float, known: Intervals, machine: LimitArrays
) -> tuple[bool, Phases, float]:
    """Return the shortest legal ramp to rest that the search finds.

    Args:
        phases: (p,): a ramp to start with. It may exceed limits a little.
        rest: arc length of its end, mm.
        known: the intervals from its start to its end or farther.
        machine: the limits.

    Returns:
        Whether there is one, its phases, and the arc length of its end.
    """
    limits = sum_limits(machine)
    stretch = Stretch(phases, 0, len(phases), rest, 0.0, True)
    best = with_knots(even_cells(stretch, len(limits.a)), stretch, known, limits)
    describe(best, known)
    best = passable(best, known)
    solved = inside(best, limits)
    if solved:
        solved, best = fastest(best, known, limits)
    if not solved:
        return False, phases, rest
    time = duration_of(best)
    part = SHORTER
    for _ in range(MOST):
        if part > LEAST:
            break
        trial = shortened(best, part, known)
        solved = inside(trial, limits)
        if solved:
            solved, trial = fastest(trial, known, limits)
            after = duration_of(trial)
            solved = solved and after < GAIN * time
        if solved:
            best, time = trial, after
        else:
            part = math.sqrt(part)
    out = np.empty(4 * len(best.length), PHASE)
    return True, out[: write_cells(best, 0, len(best.length), out, 0)], best.s[-1]
