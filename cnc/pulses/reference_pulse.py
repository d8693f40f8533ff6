"""Plan to pulses: every grid move of a whole path, in any number of axes, with its time. The kernel
of the same name tells how.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.kernels.path.curve import curve_eval, curve_inv_arclen, curve_range
from cnc.kernels.pulses import reference_pulse as kernel
from cnc.model.choices import Algorithm
from cnc.model.streams import PulseChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses.arrays import kernel_arrays

ROWS = 65536
"""Most rows in a chunk of pulses."""
ALGORITHMS: tuple[Algorithm, ...] = get_args(Algorithm)
CODES: dict[Algorithm | None, int] = {
    None: kernel.BY_PIECE,
    "enclosing-line": kernel.ENCLOSING_LINE,
    "half-step": kernel.HALF_STEP,
    "point-by-point": kernel.POINT_BY_POINT,
    "kiritsis": kernel.KIRITSIS,
    "crossings": kernel.CROSSINGS,
}


class ReferencePulse:
    """Turns a plan, chunk by chunk, into grid moves.

    steps_per_mm (axes,): each axis's own, its inverse is the BLU. start (axes,) mm: where the path
    begins, on the grid or not. Each grid point is one nearest to the path where its move is due; of
    two equally near ones, the one that the axis came from while the path goes on, the even one
    where it ends (:meth:`settle`). min_pulse_ns: the board's least time between two moves; an axis
    that turns back sooner after a step makes neither. algorithm: None for half steps on lines and
    arcs and enclosing lines on all other curves; half steps, if named, are the same (see the
    kernel).
    """

    def __init__(
        self,
        steps_per_mm: ArrayLike,
        start: ArrayLike,
        min_pulse_ns: float = 0.0,
        *,
        algorithm: Algorithm | None = None,
    ) -> None:
        self.steps_per_mm = np.array(steps_per_mm, dtype=np.float64)
        self._grid = np.rint(np.asarray(start, dtype=np.float64) * self.steps_per_mm).astype(
            np.int64
        )
        self._origin = self._grid.copy()
        self.min_pulse_ns = min_pulse_ns
        self._algorithm = CODES[algorithm]
        self._last_ns = 0
        self._released_ns = -(2**62)
        self._latest: PlanChunk | None = None
        self._error = 0.0
        self._filled = 0
        self._recent = np.full(len(self._grid), -1, dtype=np.int64)
        self._time_ns = np.empty(ROWS, dtype=np.int64)
        self._step = np.empty((ROWS, len(self._grid)), dtype=np.int8)
        self._line = np.empty(ROWS, dtype=np.int32)
        self._reach = np.empty(ROWS)

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
        """Largest distance, in any axis and at the place of any grid move, of the grid point from
        the path: at most 0.5 + 1e-9 BLU.
        """
        return self._error

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """The grid moves of a stretch of the plan, at most ROWS at a time; stretches must come in
        order.

        Moves that a later one could still take back wait for the next stretch, unless this one ends
        at rest.
        """
        arrays = kernel_arrays(chunk)
        self._latest = chunk
        whole = int(np.floor(chunk.t0))
        integers = np.zeros(kernel.INTEGERS, dtype=np.int64)
        integers[kernel.LAST_NS] = self._last_ns
        integers[kernel.RELEASED_NS] = self._released_ns
        floats = np.zeros(kernel.FLOATS)
        floats[kernel.ERROR] = self._error
        while integers[kernel.PIECE] < len(chunk.path):
            rows = kernel.pulses(
                *arrays, whole * 1_000_000_000, chunk.t0 - whole, self._algorithm, self.steps_per_mm, self._grid, integers, floats,
                self._time_ns, self._step, self._line, self._reach, self._filled, self._recent, self.min_pulse_ns,
            )  # fmt: skip
            self._last_ns = int(integers[kernel.LAST_NS])
            self._error = float(floats[kernel.ERROR])
            at_rest = integers[kernel.PIECE] == len(chunk.path) and chunk.phase_v[-1] <= kernel.REST
            ready = (
                rows
                if at_rest
                else int(
                    np.searchsorted(
                        self._time_ns[:rows], self._last_ns - self.min_pulse_ns, side="right"
                    )
                )
            )
            if ready == 0 and rows == ROWS:
                ready = rows
            self._filled = rows - ready
            self._recent = np.maximum(self._recent - ready, -1)
            if ready:
                self._released_ns = integers[kernel.RELEASED_NS] = int(self._time_ns[ready - 1])
                yield PulseChunk(
                    self._time_ns[:ready].copy(),
                    self._step[:ready].copy(),
                    self._line[:ready].copy(),
                )
                for buffer in (self._time_ns, self._step, self._line):
                    buffer[: self._filled] = buffer[ready:rows].copy()

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """The machine stands at a grid point (axes,) that was not planned: the next stretch begins
        within half a BLU of it.

        The rest of the path that led here is not to be made up for.
        """
        self._grid[:] = grid
        self._latest = None

    def settle(self) -> Iterator[PulseChunk]:
        """The path is over: the last move, of axes that stand on the odd one of two equally near
        grid points, or were stopped halfway.
        """
        chunk = self._latest
        if chunk is None:
            return
        kind, at = int(chunk.path.kind[-1]), int(chunk.path.at[-1])
        end = np.empty((4, len(self._grid)))
        u = curve_range(kind, chunk.path.data, at)[1]
        if chunk.phase_s[-1] < chunk.piece_s[-1] - kernel.SNAP:
            # The motion was stopped inside the piece.
            u = curve_inv_arclen(kind, chunk.path.data, at, chunk.phase_s[-1] - chunk.piece_s[-2])
        curve_eval(kind, chunk.path.data, at, u, end)
        target = np.rint(end[0] * self.steps_per_mm).astype(np.int64)
        while (self._grid != target).any():
            step = np.sign(target - self._grid)
            self._grid += step
            earliest = self._released_ns + int(self.min_pulse_ns)
            self._last_ns = self._released_ns = max(
                self._last_ns, round((chunk.t0 + chunk.duration) * 1e9), earliest
            )
            yield PulseChunk(
                np.array([self._last_ns]), step[None].astype(np.int8), chunk.path.line[-1:].copy()
            )
