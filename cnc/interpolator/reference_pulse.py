"""Plan to pulses: every grid move of a whole path, in any number of axes, with its time. The kernel of the same name tells how."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.interpolator.arrays import kernel_arrays
from cnc.kernels import reference_pulse as kernel
from cnc.planner.plan import PlanChunk
from cnc.stream import PulseChunk

ROWS = 65536
"""Most rows in a chunk of pulses."""


class ReferencePulse:
    """Turns a plan, chunk by chunk, into grid moves.

    steps_per_mm (axes,): each axis's own, its inverse is the BLU. start (axes,) mm: where the path begins, on the grid or not. The grid
    point of an axis is the integer nearest to its position in BLU; of two equally near ones, the one that it came from.
    """

    def __init__(self, steps_per_mm: ArrayLike, start: ArrayLike) -> None:
        self.steps_per_mm = np.array(steps_per_mm, dtype=np.float64)
        self._grid = np.rint(np.asarray(start, dtype=np.float64) * self.steps_per_mm).astype(np.int64)
        self._origin = self._grid.copy()
        self._last_ns = 0
        self._error = 0.0
        self._time_ns = np.empty(ROWS, dtype=np.int64)
        self._step = np.empty((ROWS, len(self._grid)), dtype=np.int8)
        self._line = np.empty(ROWS, dtype=np.int32)

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at the start of the program (axes,)."""
        return self._origin.copy()

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after all pulses so far (axes,)."""
        return self._grid.copy()

    @property
    def error_blu(self) -> float:
        """Largest distance, in any axis and at the moment of any grid move, of the grid point from the path: at most 0.5 + 1e-9 BLU."""
        return self._error

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """The grid moves of a stretch of the plan, at most ROWS at a time; stretches must come in order."""
        arrays = kernel_arrays(chunk)
        whole = int(np.floor(chunk.t0))
        integers = np.zeros(kernel.INTEGERS, dtype=np.int64)
        integers[kernel.LAST_NS] = self._last_ns
        floats = np.zeros(kernel.FLOATS)
        floats[kernel.ERROR] = self._error
        rows = ROWS
        while rows == ROWS:
            rows = kernel.pulses(
                *arrays, whole * 1_000_000_000, chunk.t0 - whole, self.steps_per_mm, self._grid, integers, floats,
                self._time_ns, self._step, self._line,
            )  # fmt: skip
            self._last_ns = int(integers[kernel.LAST_NS])
            self._error = float(floats[kernel.ERROR])
            if rows:
                yield PulseChunk(self._time_ns[:rows].copy(), self._step[:rows].copy(), self._line[:rows].copy())
