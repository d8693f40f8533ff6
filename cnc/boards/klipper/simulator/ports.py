"""The host's end of the simulator's cable in the same process, and its clock.

In virtual time a read advances the time to the next answer, or by the timeout; nothing sleeps. In
real time the simulator is advanced whenever the host reads, writes or asks for the time.
"""

from __future__ import annotations

import time

from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator
from cnc.boards.port import port_lost

NAME = "the Klipper simulator"
UNPLUGGED, VANISHED = "the cable was pulled", "the device was reset"
LONGEST_SLEEP = 0.002
"""Time between two checks for an answer, s."""


class KlipperSimulatorPort:
    """Port and clock of a simulator (:mod:`cnc.boards.port`), in virtual time.

    Raises:
        PortLost: The board restarts, and its USB device is not there yet.
    """

    def __init__(self, simulator: KlipperSimulator) -> None:
        self.simulator = simulator
        self.closed = False
        self._resets = simulator.resets
        if simulator.has_usb and simulator.now < simulator.boots_until:
            raise port_lost(NAME, VANISHED)

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s of virtual time."""
        self._check()
        simulator = self.simulator
        data = simulator.read()
        if not data and timeout > 0.0:
            simulator.advance(simulator.now + timeout, answer=True)
            self._check()
            data = simulator.read()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._check()
        self.simulator.write(data)

    def raise_lines(self) -> bool:
        """Return that the lines were high already."""
        return False

    def close(self) -> None:
        """Close the port."""
        self.closed = True

    def now(self) -> float:
        """Return the virtual time, s."""
        return self.simulator.now

    def sleep(self, seconds: float) -> None:
        """Advance the virtual time."""
        self.simulator.advance(self.simulator.now + seconds)

    def _check(self) -> None:
        if self.closed or not self.simulator.cable.plugged:
            raise port_lost(NAME, UNPLUGGED)
        if self.simulator.has_usb and self._resets != self.simulator.resets:
            raise port_lost(NAME, VANISHED)


class RealTimePort(KlipperSimulatorPort):
    """The same by the clock of this computer."""

    def __init__(self, simulator: KlipperSimulator) -> None:
        super().__init__(simulator)
        self._zero = time.monotonic() - simulator.now

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s."""
        end = self.now() + timeout
        while True:
            self._catch_up()
            data = super().read(0.0)
            left = end - self.now()
            if data or left <= 0.0:
                return data
            time.sleep(min(left, LONGEST_SLEEP))

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._catch_up()
        super().write(data)

    def now(self) -> float:
        """Return the time of the simulator, s."""
        return time.monotonic() - self._zero

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(max(seconds, 0.0))
        self._catch_up()

    def _catch_up(self) -> None:
        self.simulator.advance(max(self.now(), self.simulator.now))
