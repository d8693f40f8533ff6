"""The host's end of the simulator's cable in the same process, and its clock.

A read advances the time to the next answer, or by the timeout; nothing sleeps.
"""

from __future__ import annotations

from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator
from cnc.boards.port import port_lost

NAME = "the Klipper simulator"
UNPLUGGED, VANISHED = "the cable was pulled", "the device was reset"


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
