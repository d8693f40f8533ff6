"""The time of the motion along a path, for the choice of a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import START
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk


def motion_time(machine: Machine) -> Callable[[PathChunk], float] | None:
    """Return a function of a path that returns the time of its motion from rest to rest, s.

    Corners have the treatment that they have without a choice, which takes half the computing
    time. The time is infinite where no motion was found. None where the joints are not a linear
    function of the axes: the time depends on the pose.
    """
    joints = Joints(machine)

    def duration(chunk: PathChunk) -> float:
        start = chunk.data[chunk.at[0] + START :][: len(chunk.axes)]
        stream: Iterator[PathChunk | Block] = iter((chunk,))
        try:
            plans = list(LookAhead(machine, chooses=False).plan(joints.path(stream, start)))
        except MotionLimitError:
            return math.inf
        return sum(plan.duration for plan in plans if isinstance(plan, PlanChunk))

    return duration if joints.linear else None
