"""Ramps to rest by slowing the clock, inside of motions past corners.

The third derivative of their path jumps at the end of each step, where they change their jerk.
"""

from dataclasses import replace

import numpy as np

from benchmarks import corners, holds
from cnc.kernels.planner.timed import is_timed
from cnc.planner.detour import detour
from cnc.planner.known_path import KnownPath
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk
from cnc.planner.plan_parts import cut_at_time, part
from cnc.planner.stop_ramp import ramp_by_clock
from tests.support.soak import share


def motions_past_corners(seed):
    """Return the limits of a random machine, and its motions past the corners of a polygon."""
    rng = np.random.default_rng(seed)
    polygon = corners.random_case(corners.FAMILIES[seed % len(corners.FAMILIES)], rng)
    program = holds.Program(holds.POLYGONS, corners.blocks_of(polygon), polygon.machine)
    found = []
    for plan in holds.motion(program):
        if not isinstance(plan, PlanChunk):
            continue
        path = plan.path
        timed = np.array(
            [
                is_timed(int(kind), path.data, int(at))
                for kind, at in zip(path.kind, path.at, strict=True)
            ]
        )
        ends = np.flatnonzero(np.diff(timed, prepend=False, append=False)).reshape(-1, 2)
        for first, last in np.searchsorted(plan.phase_s, plan.piece_s[ends] - 1e-9).tolist():
            found.append(part(plan, first, last))
    return Limits.of(polygon.machine), found


def ramp_from(motion, share_of_time, limits):
    """Return the ramp from a moment of a motion past corners."""
    first, cut = cut_at_time(motion, share_of_time * motion.duration)
    curve, phases = detour(part(cut, first, len(cut.phase_j)), limits)
    fastest = float(phases["v"].max())
    path = KnownPath(replace(limits, slowing_from=fastest * (1.0 + 1e-8), feed_factor=0.0))
    end = path.add(curve, None, None).end
    near = path.intervals(path.limits, float(phases[0]["s"]), end)
    return ramp_by_clock(phases, near, near, path.limits.arrays)


def test_most_motions_past_corners_may_be_slowed_to_rest():
    found = []
    for seed in range(share(200, 5)):
        limits, motions = motions_past_corners(seed)
        for motion in motions:
            for moment in (0.11, 0.22, 0.33, 0.44, 0.56):
                found.append(ramp_from(motion, moment, limits) is not None)
    assert len(found) >= share(400, 20)
    assert np.mean(found) >= 0.64
