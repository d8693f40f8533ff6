"""The clock of a run: machine time since its first motion, dwells included."""

from __future__ import annotations

from cnc.model.blocks import Block, Dwell
from cnc.planner.plan import PlanChunk


class RunClock:
    """Machine time after the items of a plan that were added so far.

    A plan chunk sets the clock to its end, because each chunk carries its own start time. A dwell
    adds its duration. Holds and other blocks take no machine time.

    Attributes:
        seconds: The machine time, s.
    """

    __slots__ = ("seconds",)

    def __init__(self) -> None:
        self.seconds = 0.0

    def add(self, item: PlanChunk | Block) -> None:
        """Advance the clock to the end of the next item of the plan."""
        if isinstance(item, PlanChunk):
            self.seconds = item.t0 + item.duration
        elif isinstance(item, Dwell):
            self.seconds += item.seconds
