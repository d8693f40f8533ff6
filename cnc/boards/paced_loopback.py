"""The loopback board in real time: it takes pulses no faster than a machine would play them.

The console uses it where the machine file names the loopback board, so that an operator can jog,
hold and override without a machine.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.boards.loopback import Loopback
from cnc.boards.port import Clock, SystemClock
from cnc.boards.protocols import Capabilities, MotionState
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell
from cnc.model.streams import PulseChunk

HORIZON = 0.04
"""Motion that the board accepts ahead of its clock, s."""
STOP_LATENCY = HORIZON + 0.02
"""Latency of a stop, s: the horizon and two slices."""
SLICE = 0.01
"""Length of a slice, s."""
ABORT_POLL = 0.05
"""Longest wait until an abort takes effect, s."""


class PacedLoopback(Loopback):
    """A loopback board with a clock, which keeps its position between programs.

    Args:
        machine: The machine, whose axes are the joints.
        start: Position when it is switched on (axes,), mm.
        clock: The clock.
    """

    def __init__(
        self, machine: Machine, start: Sequence[float], clock: Clock | None = None
    ) -> None:
        super().__init__(len(machine.axes), 1e9 / machine.board.max_step_rate)
        self._steps_per_mm = machine.steps_per_mm
        self._position = np.rint(np.asarray(start) * self._steps_per_mm).astype(np.int64)
        self._clock = clock or SystemClock()
        self._zero = self._clock.now()
        self._aborted = threading.Event()
        self._end_ns = 0
        self._sent: deque[tuple[int, int, NDArray[np.int64]]] = deque()
        self._played: tuple[int, NDArray[np.int64]] = (0, self._position.copy())

    @property
    def capabilities(self) -> Capabilities:
        """Those of the loopback board, with slices for an operator."""
        return replace(super().capabilities, slice_s=SLICE, stop_latency_s=STOP_LATENCY)

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis (axes,)."""
        return tuple(self._position.tolist())

    @property
    def motion_state(self) -> MotionState:
        """State of the motion by the clock."""
        now_ns = (self._clock.now() - self._zero) * 1e9
        sent = self._sent
        while sent and sent[0][0] <= now_ns:
            _, line, point = sent.popleft()
            self._played = line, point
        line, point = self._played
        ahead = max(0.0, (self._end_ns - now_ns) * 1e-9) if self.state == "running" else 0.0
        return MotionState(line, tuple((point / self._steps_per_mm).tolist()), ahead)

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Begin at a grid point; the clock begins at 0."""
        super().start(origin_steps)
        self._aborted.clear()
        self._zero, self._end_ns = self._clock.now(), 0
        self._sent.clear()
        self._played = 0, self._position.copy()

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when the clock is near their end."""
        if len(chunk.time_ns):
            self._begin(int(chunk.time_ns[0]))
        super().send(chunk)
        if len(chunk.time_ns):
            self._end_ns = int(chunk.time_ns[-1])
            self._sent.append((self._end_ns, int(chunk.line[-1]), self._position.copy()))
            self._wait(self._end_ns * 1e-9 - HORIZON)

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block at its time by the clock."""
        self._begin(time_ns)
        answer = super().execute(block, time_ns)
        seconds = block.seconds if isinstance(block, Dwell) else 0.0
        self._end_ns = max(self._end_ns, time_ns + math.ceil(seconds * 1e9))
        self._wait(self._end_ns * 1e-9 - HORIZON)
        return answer

    def finish(self) -> None:
        """Return when the clock has reached the end."""
        self._wait(self._end_ns * 1e-9)
        super().finish()
        self._sent.clear()
        self._played = self._line, self._position.copy()

    def stop(self) -> None:
        """Return when the clock has reached the end of the motion; refuse later calls."""
        self._wait(self._end_ns * 1e-9)
        super().stop()

    def abort(self) -> None:
        """Stop at once."""
        self._aborted.set()
        super().abort()

    def _begin(self, time_ns: int) -> None:
        """Move the clock back where the motion waited: for the operator, or for the computer."""
        late = self._clock.now() - self._zero - time_ns * 1e-9
        if late > 0.0:
            self._zero += late

    def _wait(self, until: float) -> None:
        while not self._aborted.is_set():
            left = until - (self._clock.now() - self._zero)
            if left <= 0.0:
                return
            self._clock.sleep(min(left, ABORT_POLL))
