"""Steps of one motor as runs for its queue on the board (``queue_step``)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.klipper import step_runs as kernel
from cnc.kernels.klipper.step_runs import Fit, Runs

ROWS = 16384
"""Most steps in one call of the kernel."""


class StepEncoder:
    """Encodes the steps of one motor, part by part. Times are ticks of the board's clock, 64 bits.

    Args:
        tolerance: Largest deviation of a step from its time, ticks.
        last: Time from which the first interval counts, ticks.
        least: Least time between two steps, ticks. It protects the step after a part.

    Attributes:
        last: Time of the last step, ticks.
    """

    def __init__(self, tolerance: int, last: int = 0, least: int = 0) -> None:
        self.tolerance = tolerance
        self._least = least
        self.last = last
        self._runs = Runs(*(np.empty(ROWS, np.int64) for _ in range(6)))
        self._fit = Fit(
            np.empty(ROWS),
            np.empty(ROWS),
            1.0 / np.arange(1.0, ROWS + 1.0),
            np.zeros(2, np.int64),
        )

    def encode(self, due: NDArray[np.int64], sign: NDArray[np.int8]) -> Runs:
        """Return the runs of steps.

        Args:
            due: Time of each step (n,), ticks, increasing.
            sign: Direction of each step (n,), 1 or -1.

        Raises:
            ValueError: The times do not increase, or a step is 2**32 ticks after the last one.
        """
        parts: list[Runs] = []
        for at in range(0, len(due), ROWS):
            status, made, last = kernel.encode_steps(
                due[at : at + ROWS],
                sign[at : at + ROWS],
                self.tolerance,
                self._least,
                self.last,
                self._runs,
                self._fit,
            )
            if status != kernel.OK:
                reason = "do not increase" if status == kernel.NOT_RISING else "are too far apart"
                raise ValueError(f"The times of the steps {reason}.")
            self.last = last
            parts.append(Runs(*(column[:made].copy() for column in self._runs)))
        if len(parts) == 1:
            return parts[0]
        return (
            Runs(*(np.concatenate(column) for column in zip(*parts, strict=True)))
            if parts
            else (Runs(*(np.empty(0, np.int64) for _ in range(6))))
        )


def step_times(runs: Runs, last: int) -> NDArray[np.int64]:
    """Return the time of each step (n,) of runs that follow ``last``, ticks."""
    times: list[NDArray[np.int64]] = []
    for interval, count, add in zip(
        runs.interval.tolist(), runs.length.tolist(), runs.add.tolist(), strict=True
    ):
        k = np.arange(count, dtype=np.int64)
        times.append(last + (k + 1) * interval + add * (k * (k + 1) // 2))
        last = int(times[-1][-1])
    return np.concatenate(times) if times else np.empty(0, np.int64)
