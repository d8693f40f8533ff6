"""The host's end of the simulator's cable, in the same process: :class:`cnc.boards.port.Port` and the
clock that goes with it.

In virtual time a read moves the simulator's clock to the next answer, or by the time-out if there is
none; nothing sleeps. Against the wall's clock, the simulator is taken along whenever the host reads,
writes or asks, ``factor`` times as fast as the wall.
"""

from __future__ import annotations

import threading
import time

from cnc.boards.grbl.simulator.grbl_simulator import BOOT_TIME, GrblSimulator
from cnc.boards.port import port_lost

NAME = "the board in the simulator"


class VirtualTime:
    """The simulator's own clock, which only moves when somebody waits."""

    def __init__(self, simulator: GrblSimulator) -> None:
        self._simulator = simulator

    def now(self) -> float:
        """Seconds since the simulator was made."""
        return self._simulator.now

    def sleep(self, seconds: float) -> None:
        """Let the simulator run on."""
        self._simulator.advance(self._simulator.now + max(seconds, 0.0))

    def catch_up(self) -> None:
        """Nothing to do: the simulator is where its clock is."""

    def await_answer(self, timeout: float) -> None:
        """To the next answer, ``timeout`` s at most."""
        self._simulator.advance(self._simulator.now + max(timeout, 0.0), answer=True)


class ScaledTime:
    """The wall's clock, ``factor`` times as fast."""

    def __init__(self, simulator: GrblSimulator, factor: float = 1.0) -> None:
        self._simulator = simulator
        self._factor = factor
        self._start = time.monotonic()
        self._origin = simulator.now

    def now(self) -> float:
        """Seconds of the simulator."""
        return self._origin + (time.monotonic() - self._start) * self._factor

    def sleep(self, seconds: float) -> None:
        """Wait that long by the simulator's clock."""
        time.sleep(max(seconds, 0.0) / self._factor)
        self.catch_up()

    def catch_up(self) -> None:
        """Bring the simulator to now."""
        self._simulator.advance(max(self.now(), self._simulator.now))

    def await_answer(self, timeout: float) -> None:
        """Until there is an answer, ``timeout`` s of the simulator at most. The wall is slept away in
        steps that the simulator's next answer allows.
        """
        end = self.now() + max(timeout, 0.0)
        while True:
            self.catch_up()
            left = end - self.now()
            if (
                left <= 0.0
                or self._simulator.core.transmitter.arrival <= self._simulator.now
                or not self._simulator.plugged
            ):
                return
            time.sleep(min(left, LONGEST_NAP) / self._factor)


LONGEST_NAP = 0.002
"""Seconds between two looks for an answer."""


class GrblSimulatorPort:
    """The host's end. Opening it raises DTR, which resets the board unless the line was left up.

    boot_time: seconds of the boot loader after a reset. hang_up: closing the port drops DTR, as
    systems do until HUPCL is cleared. lowered: DTR is down from the opening on, as our port has it
    on Windows.
    """

    def __init__(
        self,
        simulator: GrblSimulator,
        clock: VirtualTime | ScaledTime | None = None,
        *,
        boot_time: float = BOOT_TIME,
        hang_up: bool = True,
        lowered: bool = False,
    ) -> None:
        self.simulator = simulator
        self.hang_up = hang_up
        self.clock = clock or VirtualTime(simulator)
        self._lock = threading.Lock()
        self._open = True
        self._boot_time = boot_time
        if lowered:
            simulator.drop_dtr()
        else:
            simulator.raise_dtr(boot_time)

    def read(self, timeout: float) -> bytes:
        """What has arrived, after ``timeout`` s at most. PortLost after an unplugging."""
        with self._lock:
            self.clock.catch_up()
            self._refuse_if_lost()
            data = self.simulator.read()
            if not data and timeout > 0.0:
                self.clock.await_answer(timeout)
                data = self.simulator.read()
                if not data:
                    self._refuse_if_lost()
            return data

    def write(self, data: bytes) -> None:
        """Onto the wire at once. PortLost after an unplugging."""
        with self._lock:
            self.clock.catch_up()
            self._refuse_if_lost()
            self.simulator.write(bytes(data))

    def raise_lines(self) -> None:
        """Raise DTR; a reset if it was down. PortLost after an unplugging."""
        with self._lock:
            self.clock.catch_up()
            self._refuse_if_lost()
            self.simulator.raise_dtr(self._boot_time)

    def close(self) -> None:
        """Let go of the board, which goes on by itself."""
        if self._open and self.hang_up:
            self.simulator.drop_dtr()
        self._open = False

    def _refuse_if_lost(self) -> None:
        if not self._open:
            raise port_lost(NAME, "the port has been closed")
        if not self.simulator.plugged:
            raise port_lost(NAME, "device disconnected")
