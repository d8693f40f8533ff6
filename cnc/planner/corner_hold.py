"""A stop for a hold inside a motion past corners (:mod:`cnc.kernels.planner.corner_hold`)."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from cnc.kernels.planner.corner_hold import Chained, stop_within
from cnc.kernels.planner.corner_legs import MOST_STEPS
from cnc.kernels.planner.corner_pieces import steps_size
from cnc.path.chunk import PathChunk
from cnc.planner.corners import empty_path, new_chunk, numbered, path_arrays
from cnc.planner.finished import ChainLeft
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk
from cnc.planner.plan_parts import empty_plan


class CornerStop(NamedTuple):
    """A motion to rest on a leg.

    Attributes:
        plan: the motion.
        leg: the leg, counted from the first one of the chain.
        place: from the start of that leg, mm.
    """

    plan: PlanChunk
    leg: int
    place: float


def stop_inside(left: ChainLeft, legs: PathChunk, limits: Limits) -> CornerStop | None:
    """Return the fastest motion to rest that is found; None for none.

    Args:
        left: the rest of a motion past a chain of corners.
        legs: the legs of that chain.
        limits: of the machine.
    """
    path, axes = numbered(legs), len(legs.axes)
    out = empty_path(MOST_STEPS, len(legs.data) + steps_size(MOST_STEPS + 1, axes))
    out_plan = empty_plan(MOST_STEPS, MOST_STEPS)
    chained = Chained(
        path,
        limits.feeds(legs),
        limits.arrays,
        limits.travel,
        path_arrays(left.plan.path),
        left.plan.arrays,
        left.leg,
    )
    count, numbers, leg, place = stop_within(chained, out, out_plan)
    if leg < 0:
        return None
    passed = legs.part(0, leg + 1)
    if passed.commands is not None:
        # What takes effect at the start of the leg that is under way has done so.
        commands = passed.commands.copy()
        commands[: left.leg + 1] = None
        passed = replace(passed, commands=commands)
    plan = PlanChunk(
        path=new_chunk(passed, out, count, numbers),
        piece_s=out_plan.piece_s[: count + 1],
        t0=left.plan.t0,
        s0=left.plan.s0 + float(left.plan.phase_s[0]),
        phase_t=out_plan.t[: count + 1],
        phase_s=out_plan.s[: count + 1],
        phase_v=out_plan.v[: count + 1],
        phase_a=out_plan.a[: count + 1],
        phase_j=out_plan.j[:count],
    )
    return CornerStop(plan, leg, place)
