"""Reference pulses of a plan: every grid move of a path, in any number of axes, with its time.

:mod:`cnc.pulses.kernels.reference_pulse` explains the algorithms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.model.choices import Algorithm
from cnc.model.streams import PulseChunk
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import curve_eval, curve_range
from cnc.planner.plan import PlanChunk
from cnc.pulses.arrays import pieces_of, plan_arrays, source_lines
from cnc.pulses.kernels import reference_pulse as kernel
from cnc.pulses.kernels.grid_moves import Grid, Moves
from cnc.pulses.kernels.reference_pulse import Buffers

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

    Each grid point is one nearest to the path where its move is due. Of two equally near ones, it
    is the one from which the axis came while the path goes on, and the even one where the path ends
    (:meth:`settle`).

    Args:
        steps_per_mm: (axes,): scale of each axis; its inverse is the BLU.
        start: (axes,) mm: start of the path, on the grid or not.
        min_pulse_ns: least time between two moves that the board allows. An axis that turns back
            sooner after a step makes neither step.
        algorithm: None, or half steps, for half steps on lines and arcs and enclosing lines on all
            other curves.
        tip_columns: columns of the path in front of those that step. They belong to the tool tip of
            a machine whose joints are not its axes.
        separate_axes: moves of different axes may be as close as they fall due.
    """

    def __init__(
        self,
        steps_per_mm: ArrayLike,
        start: ArrayLike,
        min_pulse_ns: float = 0.0,
        *,
        algorithm: Algorithm | None = None,
        tip_columns: int = 0,
        separate_axes: bool = False,
    ) -> None:
        # A column without a scale stays at grid point 0.
        still = np.zeros(tip_columns)
        self.steps_per_mm = np.concatenate((still, np.asarray(steps_per_mm, dtype=np.float64)))
        self._stepping = slice(tip_columns, None)
        begin = np.concatenate((still, np.asarray(start, dtype=np.float64)))
        self._grid = np.rint(begin * self.steps_per_mm).astype(np.int64)
        self._origin = self._grid.copy()
        self.min_pulse_ns = min_pulse_ns
        self._min_row_ns = 0.0 if separate_axes else min_pulse_ns
        self._algorithm, self._chosen = CODES[algorithm], algorithm
        self._last_ns = 0
        self._released_ns = -(2**62)
        self._latest: PlanChunk | None = None
        self._left: NDArray[np.float64] | None = None
        self._error = 0.0
        self._filled = 0
        axes = len(self._grid)
        self._buffers = Buffers(
            Moves(np.empty((ROWS, axes), dtype=np.int8), np.empty(ROWS)),
            np.empty(ROWS, dtype=np.int64),
            np.empty(ROWS, dtype=np.int32),
            np.full(axes, -1, dtype=np.int64),
            np.zeros(axes, dtype=np.int64),
        )

    def of_joints(self) -> ReferencePulse:
        """Return a new interpolator for a path that has the columns of the joints alone."""
        return ReferencePulse(
            self.steps_per_mm[self._stepping],
            np.zeros(len(self.origin_steps)),
            self.min_pulse_ns,
            algorithm=self._chosen,
            separate_axes=self._min_row_ns < self.min_pulse_ns,
        )

    @property
    def origin_steps(self) -> NDArray[np.int64]:
        """Grid point at the start of the program (axes,)."""
        return self._origin[self._stepping].copy()

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point after all pulses so far (axes,)."""
        return self._grid[self._stepping].copy()

    @property
    def steps_made(self) -> NDArray[np.int64]:
        """Number of steps of each axis (axes,) in all pulses so far."""
        return self._buffers.made[self._stepping].copy()

    @property
    def error_blu(self) -> float:
        """Largest distance in any axis of a grid point from the path, at the place of its move.

        It is at most 0.5 + 1e-9 BLU.
        """
        return self._error

    def pulses(self, chunk: PlanChunk) -> Iterator[PulseChunk]:
        """Yield the grid moves of a chunk of the plan, at most ROWS at a time.

        Chunks must come in order. Moves that a later one could still take back wait for the next
        chunk, unless this one ends at rest.
        """
        pieces, plan, lines = pieces_of(chunk.path), plan_arrays(chunk), source_lines(chunk.path)
        grid = Grid(self.steps_per_mm, self._grid)
        buffers = self._buffers
        self._latest = chunk
        state = np.zeros(1, dtype=kernel.STATE)
        whole = int(np.floor(chunk.t0))
        state["whole_ns"], state["seconds"] = whole * 1_000_000_000, chunk.t0 - whole
        state["last_ns"], state["released_ns"] = self._last_ns, self._released_ns
        state["error"] = self._error
        while state["piece"][0] < len(chunk.path):
            rows = kernel.pulses(
                pieces,
                plan,
                lines,
                self._algorithm,
                grid,
                state,
                buffers,
                self._filled,
                self.min_pulse_ns,
                self._min_row_ns,
            )
            self._last_ns = int(state["last_ns"][0])
            self._error = float(state["error"][0])
            done = state["piece"][0] == len(chunk.path)
            ready = self._released(rows, at_rest=done and chunk.phase_v[-1] <= kernel.REST)
            self._filled = rows - ready
            buffers.recent[:] = np.maximum(buffers.recent - ready, -1)
            if ready:
                self._released_ns = int(buffers.time_ns[ready - 1])
                state["released_ns"] = self._released_ns
                yield PulseChunk(
                    buffers.time_ns[:ready].copy(),
                    buffers.moves.step[:ready, self._stepping].copy(),
                    buffers.line[:ready].copy(),
                )
                for buffer in (buffers.time_ns, buffers.moves.step, buffers.line):
                    buffer[: self._filled] = buffer[ready:rows].copy()

    def _released(self, rows: int, *, at_rest: bool) -> int:
        """Return how many of the rows no later move can take back; all of them at rest."""
        if at_rest:
            return rows
        # An integer: numpy would convert all times to the type of a float.
        safe_ns = math.floor(self._last_ns - self.min_pulse_ns)
        ready = int(np.searchsorted(self._buffers.time_ns[:rows], safe_ns, side="right"))
        return rows if ready == 0 and rows == ROWS else ready

    def stand_at(self, grid: NDArray[np.int64]) -> None:
        """Set the grid point (axes,) where the machine stands, which was not planned.

        The next chunk begins within half a BLU of it. The rest of the path that led here is not
        made up for.
        """
        self._grid[self._stepping] = grid
        self._left, self._latest = self.end, None

    @property
    def end(self) -> NDArray[np.float64] | None:
        """All columns of the path where its plan ends so far (columns,); None before a plan."""
        return self._left if self._latest is None else _end_of(self._latest)

    def settle(self) -> Iterator[PulseChunk]:
        """Yield the last move, after the end of the path.

        It is for axes that stand on the odd one of two equally near grid points, or were stopped
        halfway.
        """
        chunk = self._latest
        if chunk is None:
            return
        target = np.rint(_end_of(chunk) * self.steps_per_mm).astype(np.int64)
        while (self._grid != target).any():
            step = np.sign(target - self._grid)
            self._grid += step
            self._buffers.made[:] += np.abs(step)
            earliest = self._released_ns + int(self._min_row_ns)
            self._last_ns = self._released_ns = max(
                self._last_ns, round((chunk.t0 + chunk.duration) * 1e9), earliest
            )
            yield PulseChunk(
                np.array([self._last_ns]),
                step[None, self._stepping].astype(np.int8),
                chunk.path.line[-1:].copy(),
            )


def _end_of(chunk: PlanChunk) -> NDArray[np.float64]:
    """Return the columns of the path at the end of a chunk of the plan (columns,)."""
    kind, at = int(chunk.path.kind[-1]), int(chunk.path.at[-1])
    end = np.empty((4, len(chunk.path.axes)))
    u = curve_range(kind, chunk.path.data, at)[1]
    if chunk.phase_s[-1] < chunk.piece_s[-1] - kernel.SNAP:
        # The motion was stopped inside the piece.
        u = curve_inv_arclen(kind, chunk.path.data, at, chunk.phase_s[-1] - chunk.piece_s[-2])
    curve_eval(kind, chunk.path.data, at, u, end)
    columns: NDArray[np.float64] = end[0]
    return columns
