"""Random NURBS with tight bends, and the duration of their plans."""

import numpy as np

from cnc.model.blocks import Block, PathMode
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from tests.support.planner.motions import machine, nurbs, path_of


def hairpins(seed: int, *, backwards: bool = False) -> list[Block]:
    """Return an exact NURBS with tight bends."""
    rng = np.random.default_rng(seed)
    step = rng.normal(0.0, 8.0, (12, 3))
    for k in range(2, 12, 3):
        step[k] = -rng.uniform(0.7, 1.0) * step[k - 1]
    points = np.concatenate((np.zeros((1, 3)), np.cumsum(step, axis=0)))
    if backwards:
        points = points[::-1] - points[-1]
    return [PathMode("t.nc", 1, "exact-path"), nurbs(points, degree=3, feed=250.0)]


def duration(seed: int, *, backwards: bool = False) -> float:
    """Return the duration of the plan on a machine with limits of each axis, s."""
    mill = machine(axis=(1500.0, 40_000.0), tangential=None, normal=None, jerk=None, period=1e-4)
    plans = [
        plan
        for plan in LookAhead(mill).plan(path_of(hairpins(seed, backwards=backwards)))
        if isinstance(plan, PlanChunk)
    ]
    return plans[-1].t0 + plans[-1].duration
