"""Where the time of a run goes: watches around the stages, each of which draws its input through
the one before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ReferencePulse

Item = TypeVar("Item")


class Stopwatch:
    """Adds up the time that is spent inside an iterator."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def inside(self, source: Iterable[Item]) -> Iterator[Item]:
        """The same items."""
        iterator = iter(source)
        while True:
            began = perf_counter()
            try:
                item = next(iterator)
            except StopIteration:
                return
            finally:
                self.seconds += perf_counter() - began
            yield item


class TimedPulses:
    """An interpolator with a stopwatch: what the executor asks of one."""

    def __init__(self, interpolator: ReferencePulse, watch: Stopwatch) -> None:
        self._interpolator = interpolator
        self._watch = watch

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at which the program begins (axes,)."""
        return self._interpolator.origin_steps

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after the pulses made so far (axes,)."""
        return self._interpolator.position_steps

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """The grid moves of a stretch of the plan."""
        return self._watch.inside(self._interpolator.pulses(chunk))

    def settle(self) -> Iterator[PulseChunk]:
        """The last grid move at the end of the path."""
        return self._interpolator.settle()

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """The machine stands at a grid point that was not planned."""
        self._interpolator.stand_at(grid)
