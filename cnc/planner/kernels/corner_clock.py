"""A motion past corners as planned, and under a clock that slows to rest.

See :mod:`cnc.planner.kernels.corner_hold`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import METRIC, METRICS, Floats, curve_eval
from cnc.planner.kernels.arrays import PathArrays, PlanArrays
from cnc.planner.kernels.corner_places import state_at

HALVINGS = 60


class Planned(NamedTuple):
    """The rest of a motion past corners, in the directions of its legs.

    Attributes:
        path: timed pieces.
        plan: the phases.
        basis: (d, axes): the directions.
        origin: (axes,): the place of the first corner, mm.
    """

    path: PathArrays
    plan: PlanArrays
    basis: Floats
    origin: Floats


@njit
def planned_state(planned: Planned, t: float, r: Floats) -> None:
    """Write position, velocity and acceleration (3, d) at time ``t`` from the start."""
    path, plan = planned.path, planned.plan
    d, n = planned.basis.shape
    here = plan.t[0] + t
    end = plan.t[len(plan.j)]
    k = min(max(int(np.searchsorted(plan.t, here, side="right")) - 1, 0), len(plan.j) - 1)
    s, rate, change = state_at(min(here, end), k, plan)
    k = min(max(int(np.searchsorted(plan.piece_s, s, side="right")) - 1, 0), len(path.length) - 1)
    q = np.empty((4, n))
    at = path.pieces.at[k]
    u = min(max(s - plan.piece_s[k], 0.0), path.length[k])
    curve_eval(path.pieces.kind[k], path.pieces.data, at, u, q)
    for o in range(d):
        for order in range(3):
            r[order, o] = 0.0
        for m in range(int(path.pieces.data[at + METRICS])):
            i = int(path.pieces.data[at + METRIC + m])
            r[0, o] += planned.basis[o, i] * (q[0, i] - planned.origin[i])
            r[1, o] += planned.basis[o, i] * q[1, i] * rate
            r[2, o] += planned.basis[o, i] * (q[2, i] * rate * rate + q[1, i] * change)
    if here > end:
        for o in range(d):
            r[0, o] += r[1, o] * (here - end)
            r[2, o] = 0.0


@njit
def slowed(t: float, whole: float) -> tuple[float, float, float]:
    """Return the slowed clock at time ``t``, its rate and the change of that."""
    u = min(max(t / whole, 0.0), 1.0)
    return (
        whole * u * (1.0 - u * u * (1.0 - 0.5 * u)),
        1.0 - u * u * (3.0 - 2.0 * u),
        -6.0 * u * (1.0 - u) / whole,
    )


@njit
def time_of(clock: float, whole: float) -> float:
    """Return the time at which the slowed clock shows ``clock``."""
    low, high = 0.0, whole
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if slowed(middle, whole)[0] < clock:
            low = middle
        else:
            high = middle
    return high
