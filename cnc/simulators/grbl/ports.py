"""Ports of the simulator: in this process, and at a pseudo-terminal.

The host's end of the cable is a :class:`cnc.boards.port.Port`. In virtual time a read advances the
simulator's clock to the next answer, or by the timeout; nothing sleeps. With the real clock, the
simulator is advanced whenever the host reads, writes or asks, ``factor`` times as fast as real
time.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
import time

from cnc.boards.port import port_lost
from cnc.simulators.grbl.grbl_simulator import BOOT_TIME, GrblSimulator
from cnc.simulators.terminal import READ_SIZE, Terminal

if sys.platform != "win32":
    import termios

NAME = "the GRBL simulator"


class VirtualTime:
    """The simulator's own clock, which advances only while the host waits."""

    def __init__(self, simulator: GrblSimulator) -> None:
        self._simulator = simulator

    def now(self) -> float:
        """Return the seconds since the simulator was made."""
        return self._simulator.now

    def sleep(self, seconds: float) -> None:
        """Advance the simulator."""
        self._simulator.advance(self._simulator.now + max(seconds, 0.0))

    def catch_up(self) -> None:
        """Do nothing: the simulator is at the time of its clock."""

    def await_answer(self, timeout: float) -> None:
        """Advance to the next answer, by at most ``timeout`` s."""
        self._simulator.advance(self._simulator.now + max(timeout, 0.0), answer=True)


class ScaledTime:
    """The real clock, ``factor`` times as fast."""

    def __init__(self, simulator: GrblSimulator, factor: float = 1.0) -> None:
        self._simulator = simulator
        self._factor = factor
        self._start = time.monotonic()
        self._origin = simulator.now

    def now(self) -> float:
        """Return the time of the simulator, s."""
        return self._origin + (time.monotonic() - self._start) * self._factor

    def sleep(self, seconds: float) -> None:
        """Wait for a time of the simulator's clock."""
        time.sleep(max(seconds, 0.0) / self._factor)
        self.catch_up()

    def catch_up(self) -> None:
        """Advance the simulator to the present time."""
        self._simulator.advance(max(self.now(), self._simulator.now))

    def await_answer(self, timeout: float) -> None:
        """Wait for an answer, for at most ``timeout`` s of the simulator's clock."""
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
            time.sleep(min(left, LONGEST_SLEEP) / self._factor)


LONGEST_SLEEP = 0.002
"""Seconds between two checks for an answer."""


class GrblSimulatorPort:
    """The host's end of the cable. Opening it raises DTR, which resets the board unless it was up.

    Args:
        simulator: The board.
        clock: Its clock; None for virtual time.
        boot_time: Seconds of the boot loader after a reset.
        hang_up: Whether closing the port drops DTR, as systems do until HUPCL is cleared.
        lowered: Whether DTR is down from the opening on, as our port has it on Windows.
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
        """Return the bytes that arrive within ``timeout`` s. PortLost after an unplugging."""
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
        """Put bytes onto the wire at once. PortLost after an unplugging."""
        with self._lock:
            self.clock.catch_up()
            self._refuse_if_lost()
            self.simulator.write(bytes(data))

    def raise_lines(self) -> bool:
        """Raise DTR; a reset if it was down. PortLost after an unplugging."""
        with self._lock:
            self.clock.catch_up()
            self._refuse_if_lost()
            low = not self.simulator.dtr
            self.simulator.raise_dtr(self._boot_time)
            return low

    def close(self) -> None:
        """Close the port; the board continues by itself."""
        if self._open and self.hang_up:
            self.simulator.drop_dtr()
        self._open = False

    def _refuse_if_lost(self) -> None:
        if not self._open:
            raise port_lost(NAME, "the port has been closed")
        if not self.simulator.plugged:
            raise port_lost(NAME, "device disconnected")


# The GRBL simulator at a pseudo-terminal.
#
# A pseudo-terminal has no modem lines, so DTR
# is modelled. While no host has the terminal open, the system reports a hang-up on our side. When
# that ends, a host has opened the terminal, which raises DTR: a reset, unless it was up. Closing
# drops DTR if the terminal's HUPCL is set, as it is at first, like that of a serial port.
# Unplugging the cable ends the terminal.

CFLAG = 2
"""Index of the control modes in the result of tcgetattr."""
UNREAD = 65536
"""Bytes that wait for a host that does not read; more are lost, as at a serial port."""


class PtyServer(Terminal):
    """The terminal of a simulated board.

    Attributes:
        is_open: Whether a host has the terminal open.

    Args:
        simulator: The board.
        factor: Speed of its clock relative to real time.
    """

    def __init__(self, simulator: GrblSimulator, factor: float = 1.0) -> None:
        self.simulator = simulator
        self._clock = ScaledTime(simulator, factor)
        super().__init__()
        assert self._theirs is not None
        settings = termios.tcgetattr(self._theirs)
        settings[CFLAG] |= termios.HUPCL
        termios.tcsetattr(self._theirs, termios.TCSANOW, settings)
        # The terminal is closed now: the next end of a hang-up is a host.
        os.close(self._theirs)
        self._theirs = None
        self.is_open = False
        self._unread = b""
        self._thread.start()

    def _serve(self) -> None:
        poll = select.poll()
        poll.register(self._ours, select.POLLIN)
        while not self._ended.wait(0.0 if self.is_open else LONGEST_SLEEP):
            events = dict(poll.poll(LONGEST_SLEEP * 1000.0 if self.is_open else 0)).get(
                self._ours, 0
            )
            was_open, is_open = self.is_open, not events & select.POLLHUP
            self._clock.catch_up()
            if is_open and not was_open:
                self.simulator.raise_dtr()
                self._unread = b""
            elif was_open and not is_open and self._hangs_up():
                self.simulator.drop_dtr()
            if events & select.POLLIN:
                self.simulator.write(self._receive())
            self.is_open = is_open
            self._send(is_open)
            if not self.simulator.plugged:
                break

    def _hangs_up(self) -> bool:
        """Return whether closing drops DTR, by the settings of the terminal, which remain."""
        return bool(termios.tcgetattr(self._ours)[CFLAG] & termios.HUPCL)

    def _receive(self) -> bytes:
        with contextlib.suppress(OSError):
            return os.read(self._ours, READ_SIZE)
        return b""

    def _send(self, is_open: bool) -> None:
        self._unread = (self._unread + self.simulator.read())[-UNREAD:] if is_open else b""
        if self._unread:
            with contextlib.suppress(BlockingIOError):
                self._unread = self._unread[os.write(self._ours, self._unread) :]
