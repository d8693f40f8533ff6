"""The plan of the window at present."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.kernels.planner.phases import Phases
from cnc.planner.limits import Limits


@dataclass(slots=True)
class CurrentPlan:
    """The plan from where the next slice begins.

    Attributes:
        phases: they lead to rest.
        rest_at: where the motion rests, mm.
        settled: number of phases that may be sent on.
        unsettled: number of intervals behind them, at the time of planning.
        arrived: number of intervals that arrived since.
        follow: where no new plan begins, at least so many phases are followed; twice as many each
            time, since each attempt costs a whole plan.
        slow_from: from here on the limits in effect hold, mm.
        slowing: the limits before.
    """

    phases: Phases
    rest_at: float
    settled: int
    unsettled: int
    arrived: int
    follow: int
    slow_from: float
    slowing: Limits
