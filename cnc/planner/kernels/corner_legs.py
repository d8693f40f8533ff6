"""The legs of a chain of corners, and their limits, in the directions that they span."""

from __future__ import annotations

import math

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import METRIC, METRICS, START, Floats, Ints
from cnc.planner.kernels.arrays import LimitArrays, PathArrays
from cnc.planner.kernels.corner_places import MOST_CORNERS, Chain
from cnc.planner.kernels.corner_rows import ROOM
from cnc.planner.kernels.corner_tube import Tube
from cnc.planner.kernels.legs import directions
from cnc.planner.kernels.limits import UNSEEN

GROUPS = 3
STEPS = (4, 4, 4)
"""Groups of a leg, and steps of each: behind a corner, in the middle, before the next corner."""

LEG_STEPS = 12
MOST_STEPS = (MOST_CORNERS + 1) * LEG_STEPS

WITHIN = 1.0 - 4e-4
"""Part of the tolerance that is used. A stop from inside of a motion needs some room."""

FLAT = 1e-10
"""mm per mm; a leg with no more than this in another direction has none there."""

MOST_DIRECTIONS = 3


@njit
def basis_of(path: PathArrays, first: int, last: int, along: Floats) -> Floats:
    """Return the directions (d, axes) that legs ``first`` to ``last`` + 1 span.

    They are at right angles in the metric axes. ``along`` (legs, MOST_DIRECTIONS) receives the
    components of the legs. There are none where the legs span more than MOST_DIRECTIONS, or are
    measured over different axes.
    """
    data = path.pieces.data
    n = int(data[path.pieces.at[first]])
    basis = np.zeros((MOST_DIRECTIONS, n))
    u = np.empty((2, n))
    d = 0
    for leg in range(last - first + 2):
        at = path.pieces.at[first + leg]
        if directions(data, path.pieces.at[first], data, at, u).sine > 1.0:
            return basis[:0]
        rest = u[1].copy()
        along[leg, :] = 0.0
        for q in range(d):
            for m in range(int(data[at + METRICS])):
                i = int(data[at + METRIC + m])
                along[leg, q] += u[1, i] * basis[q, i]
            for i in range(n):
                rest[i] -= along[leg, q] * basis[q, i]
        square, most = 0.0, 0.0
        for m in range(int(data[at + METRICS])):
            square += rest[int(data[at + METRIC + m])] ** 2
        for i in range(n):
            most = max(most, abs(rest[i]))
        size = math.sqrt(square)
        if size <= FLAT:
            if most > FLAT:
                return basis[:0]
            continue
        if d == MOST_DIRECTIONS:
            return basis[:0]
        along[leg, d] = size
        for i in range(n):
            basis[d, i] = rest[i] / size
        d += 1
    return basis[:d].copy()


@njit
def steps_of_legs(legs: int) -> tuple[Ints, Ints, Floats]:
    """Return leg, group and part of its group's duration (steps,) of each step of so many legs."""
    leg_of = np.empty(legs * LEG_STEPS, np.int64)
    group, part = leg_of.copy(), np.empty(legs * LEG_STEPS)
    k = 0
    for leg in range(legs):
        for g in range(GROUPS):
            for _ in range(STEPS[g]):
                leg_of[k], group[k], part[k] = leg, GROUPS * leg + g, 1.0 / STEPS[g]
                k += 1
    return leg_of, group, part


@njit
def tube_of(
    path: PathArrays,
    chain: Chain,
    bound: Floats,
    limits: LimitArrays,
    travel: Floats,
    basis: Floats,
    along: Floats,
) -> Tube:
    """Return the legs of a chain; the states at its ends are to be written."""
    legs, (d, n) = chain.last - chain.first + 2, basis.shape
    data, at = path.pieces.data, path.pieces.at
    start, reach = np.zeros((legs, d)), np.zeros((legs, 2))
    reach[0, 0] = -math.inf
    reach[legs - 1, 1] = math.inf
    for leg in range(1, legs):
        before = reach[leg - 1, 1]
        for q in range(d):
            start[leg, q] = start[leg - 1, q] + before * along[leg - 1, q]
        if leg + 1 < legs:
            reach[leg, 1] = path.length[chain.first + leg]
    widest = 1.0
    space = np.empty((2, n))
    for i in range(n):
        wide = 0.0
        for q in range(d):
            wide += basis[q, i] ** 2
        widest = max(widest, math.sqrt(wide))
        corner = data[at[chain.first + 1] + START + i]
        for side in range(2):
            space[side, i] = travel[side, i] - corner
    eps = math.inf
    for b in range(chain.first, chain.last + 1):
        eps = min(eps, path.tolerance[b])
    _leave_out_far_ends(space, basis, start, reach, along, eps)
    bend = 8.0 * limits.chord_error / limits.period**2
    leg_of, group, part = steps_of_legs(legs)
    return Tube(
        np.ascontiguousarray(basis.T),
        limits.axis_velocity * (1.0 - UNSEEN),
        limits.axis_acceleration * (1.0 - UNSEEN),
        np.minimum(limits.axis_jerk, 4.0 * limits.tangential_jerk) * (1.0 - 2.0 * UNSEEN),
        space,
        bound[chain.first : chain.last + 2].copy(),
        limits.tangential_acceleration * (1.0 - UNSEEN),
        min(limits.normal_acceleration, bend) * (1.0 - UNSEEN),
        limits.tangential_jerk * (1.0 - UNSEEN),
        WITHIN * eps / widest,
        start,
        along[:legs, :d].copy(),
        reach,
        leg_of,
        group,
        part,
        np.zeros((2, 3, d)),
        0.0,
    )


@njit
def _leave_out_far_ends(
    space: Floats, basis: Floats, start: Floats, reach: Floats, along: Floats, eps: float
) -> None:
    """Make those ends of the travel infinite that no corner is close to.

    So the input of equal corners is the same wherever they are.
    """
    d, n = basis.shape
    for i in range(n):
        wide = 0.0
        for q in range(d):
            wide += basis[q, i] ** 2
        for side in range(2):
            sign = 1.0 if side else -1.0
            farthest = -math.inf
            for leg in range(1, len(start)):
                at = 0.0
                for q in range(d):
                    at += sign * start[leg, q] * basis[q, i]
                farthest = max(farthest, at)
            if sign * space[side, i] - farthest >= ROOM * eps * math.sqrt(wide):
                space[side, i] = sign * math.inf
