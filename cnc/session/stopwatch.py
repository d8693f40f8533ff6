"""Computing time of the stages of a session.

Each stage draws its input through the stage before it. So a stopwatch around an iterator includes
the stages that feed it.
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
    """Adds up the time spent inside iterators, s."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def inside(self, source: Iterable[Item]) -> Iterator[Item]:
        """Yield the items of ``source`` and time it."""
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


class TimedInterpolator:
    """An interpolator with a stopwatch, with the methods that the executor calls."""

    def __init__(self, interpolator: ReferencePulse, stopwatch: Stopwatch) -> None:
        self._interpolator = interpolator
        self._stopwatch = stopwatch

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at which the program begins (axes,)."""
        return self._interpolator.origin_steps

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after the pulses made so far (axes,)."""
        return self._interpolator.position_steps

    @property
    def steps_made(self) -> NDArray[np.int64]:
        """Number of steps of each axis (axes,) in the pulses made so far."""
        return self._interpolator.steps_made

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """Yield the grid moves of a chunk of the plan."""
        return self._stopwatch.inside(self._interpolator.pulses(chunk))

    def settle(self) -> Iterator[PulseChunk]:
        """Yield the last grid move at the end of the path."""
        return self._interpolator.settle()

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """Continue from a grid point (axes,) that was not planned, such as a probe contact."""
        self._interpolator.stand_at(grid)
