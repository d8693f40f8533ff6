"""Samples of a plan: the position at every period.

They are for controllers that close their loops at a fixed rate, and for the trace file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from cnc.compiled.jit import interpreted
from cnc.model.streams import SampleChunk
from cnc.path.kernels.curve import START
from cnc.planner.plan import PlanChunk
from cnc.pulses.arrays import pieces_of, plan_arrays, source_lines
from cnc.pulses.kernels import sampled as kernel

ROWS = 16384
"""Most rows in a chunk of samples."""
GAP = 1e-9
"""s: a chunk that begins at most this much after the end of the last one follows it without a rest,
since clocks are sums of floats.
"""

JUMP = 1e-6
"""mm or degrees: a larger step of the position is one of coordinates, not of motion."""


class Sampled:
    """Turns a plan, chunk by chunk, into rows at the times k * period, k = 0, 1, 2...

    Where nothing moves (a dwell, the end) rows are at rest. The corrector goes to rounding. So
    ``step_deviation`` of a row is the bend of the path within one period: the step along the path
    against its chord.

    Args:
        period: time from row to row, s.
        start: (axes,) mm: start of the path.
    """

    def __init__(self, period: float, start: ArrayLike) -> None:
        self.period = period
        self._next = 0
        self._line = 0
        self._time = 0.0
        self._s = 0.0
        self._vertex = np.array(start, dtype=np.float64)
        self._state = np.zeros(1, dtype=kernel.STATE)

    def samples(self, chunk: PlanChunk) -> Iterator[SampleChunk]:
        """Yield the rows up to the end of a chunk of the plan.

        A row on the end itself belongs to the next chunk. Chunks must come in order.
        """
        yield from self._rest(self._count_before(chunk.t0 - GAP))
        pieces, plan, lines = pieces_of(chunk.path), plan_arrays(chunk), source_lines(chunk.path)
        self._take_jump(chunk)
        clock = kernel.Clock(chunk.s0, self._next * self.period - chunk.t0, self.period)
        for name in ("done", "piece", "begun", "made", "u", "phase"):
            self._state[name] = 0
        end = self._count_before(chunk.t0 + chunk.duration)
        while True:
            rows = min(end - self._next, ROWS)
            last = self._next + rows >= end
            out = self._empty(max(rows, 0))
            columns = kernel.Samples(
                out.position,
                out.s,
                out.feed,
                out.accel,
                out.jerk,
                out.step_deviation,
                out.line,
            )
            kernel.samples(pieces, plan, lines, clock, self._state, self._vertex, last, columns)
            self._next += len(out.s)
            if len(out.s):
                yield out
            if last:
                break
        self._time = chunk.t0 + chunk.duration
        self._s = chunk.s0 + float(chunk.phase_s[-1])
        self._line = int(chunk.path.line[-1])

    def _take_jump(self, chunk: PlanChunk) -> None:
        """Begin where a chunk begins: tool-tip control gives the resting tip other coordinates."""
        if chunk.phase_s[0] == 0.0:
            at = int(chunk.path.at[0]) + START
            start = chunk.path.data[at : at + len(self._vertex)]
            if np.abs(start - self._vertex).max() > JUMP:
                self._vertex[:] = start

    def finish(self, t_end: float) -> Iterator[SampleChunk]:
        """Yield rows at rest up to ``t_end`` (s).

        The last one, at or just after ``t_end``, is the end point.
        """
        end = max(t_end, self._time)
        yield from self._rest(self._count_before(end - GAP) + 1)

    def _count_before(self, time: float) -> int:
        """Return how many of the times k * period lie before ``time``."""
        count = max(math.ceil(time / self.period), 0)
        while count > 0 and (count - 1) * self.period >= time:
            count -= 1
        while count * self.period < time:
            count += 1
        return count

    def _rest(self, end: int) -> Iterator[SampleChunk]:
        """Yield rows at rest up to number ``end``."""
        while self._next < end:
            out = self._empty(min(end - self._next, ROWS))
            for column in (out.feed, out.accel, out.jerk, out.step_deviation):
                column[:] = 0.0
            chord, s = float(self._state["chord"][0]), float(self._state["s"][0])
            out.step_deviation[0] = interpreted(kernel.deviation)(chord, self._s - s)
            self._state["chord"], self._state["s"] = 0.0, self._s
            out.position[:] = self._vertex
            out.s[:] = self._s
            out.line[:] = self._line
            self._next += len(out.s)
            yield out

    def _empty(self, rows: int) -> SampleChunk:
        """Return a chunk of ``rows`` rows to be filled."""
        position = np.empty((rows, len(self._vertex)))
        s, feed, accel, jerk, step_deviation = np.empty((5, rows))
        return SampleChunk(
            self._next,
            self.period,
            position,
            s,
            feed,
            accel,
            jerk,
            step_deviation,
            np.empty(rows, dtype=np.int32),
        )
