"""Plan to samples: the position at every period, for controllers that close their loops at a fixed
rate and for the trace file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from cnc.kernels.pulses import sampled as kernel
from cnc.model.streams import SampleChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses.arrays import kernel_arrays

ROWS = 16384
"""Most rows in a chunk of samples."""
GAP = 1e-9
"""s: a chunk that begins this much after the last one's end follows it without a rest (clocks are
sums of floats).
"""


class Sampled:
    """Turns a plan, chunk by chunk, into rows at the times k * period, k = 0, 1, 2...

    period s. start (axes,) mm: where the path begins. Where nothing moves (a dwell, the end) rows
    are at rest. The corrector goes to rounding, so ``step_deviation`` of a row is the bend of the
    path within one period: the step along it against the chord.
    """

    def __init__(self, period: float, start: ArrayLike) -> None:
        self.period = period
        self._next = 0
        self._line = 0
        self._time = 0.0
        self._s = 0.0
        self._vertex = np.array(start, dtype=np.float64)
        self._floats = np.zeros(kernel.FLOATS)

    def samples(self, chunk: PlanChunk) -> Iterator[SampleChunk]:
        """The rows up to the end of a stretch of the plan, without the one that may fall on its
        end; stretches must come in order.
        """
        yield from self._rest(self._count_before(chunk.t0 - GAP))
        arrays = kernel_arrays(chunk)
        place = np.zeros(3, dtype=np.int64)
        history = np.zeros(2)
        begin = self._next
        end = self._count_before(chunk.t0 + chunk.duration)
        while True:
            rows = min(end - self._next, ROWS)
            last = self._next + rows >= end
            out = self._empty(max(rows, 0))
            kernel.samples(
                *arrays, chunk.s0, begin * self.period - chunk.t0, self._next - begin, self.period, place, history, self._floats,
                self._vertex, last, out.position, out.s, out.feed, out.accel, out.jerk, out.step_deviation, out.line,
            )  # fmt: skip
            self._next += len(out.s)
            if len(out.s):
                yield out
            if last:
                break
        self._time = chunk.t0 + chunk.duration
        self._s = chunk.s0 + float(chunk.phase_s[-1])
        self._line = int(chunk.path.line[-1])

    def finish(self, t_end: float) -> Iterator[SampleChunk]:
        """Rows at rest until ``t_end`` (s), the last one at or just after it: the end point."""
        end = max(t_end, self._time)
        yield from self._rest(self._count_before(end - GAP) + 1)

    def _count_before(self, time: float) -> int:
        """How many of the times k * period lie before ``time``."""
        count = max(math.ceil(time / self.period), 0)
        while count > 0 and (count - 1) * self.period >= time:
            count -= 1
        while count * self.period < time:
            count += 1
        return count

    def _rest(self, end: int) -> Iterator[SampleChunk]:
        """Rows at rest up to number ``end``."""
        while self._next < end:
            out = self._empty(min(end - self._next, ROWS))
            for column in (out.feed, out.accel, out.jerk, out.step_deviation):
                column[:] = 0.0
            out.step_deviation[0] = kernel.deviation(
                float(self._floats[kernel.CHORD]), self._s - float(self._floats[kernel.S])
            )
            self._floats[kernel.CHORD] = 0.0
            self._floats[kernel.S] = self._s
            out.position[:] = self._vertex
            out.s[:] = self._s
            out.line[:] = self._line
            self._next += len(out.s)
            yield out

    def _empty(self, rows: int) -> SampleChunk:
        """Outputs of ``rows`` rows, to be filled."""
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
