"""The GRBL simulator at a pseudo-terminal, which any sender can open as a serial port (Unix only).

A thread advances the simulator with the real clock. A pseudo-terminal has no modem lines, so DTR is
modelled. While no host has the terminal open, the system reports a hang-up on our side. When that
ends, a host has opened the terminal, which raises DTR: a reset, unless it was up. Closing drops DTR
if the terminal's HUPCL is set, as it is at first, like that of a serial port. Unplugging the cable
ends the terminal.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading

from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.boards.grbl.simulator.ports import LONGEST_SLEEP, ScaledTime

READ_SIZE = 4096
CFLAG = 2
"""Index of the control modes in the result of tcgetattr."""
UNREAD = 65536
"""Bytes that wait for a host that does not read; more are lost, as at a serial port."""


class PtyServer:
    """A terminal with the name ``name``; ``with`` closes it.

    Attributes:
        is_open: Whether a host has the terminal open.

    Args:
        simulator: The board.
        factor: Speed of its clock relative to real time.
    """

    def __init__(self, simulator: GrblSimulator, factor: float = 1.0) -> None:
        import termios
        import tty

        self.simulator = simulator
        self._clock = ScaledTime(simulator, factor)
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        settings = termios.tcgetattr(theirs)
        settings[CFLAG] |= termios.HUPCL
        termios.tcsetattr(theirs, termios.TCSANOW, settings)
        self.name = os.ttyname(theirs)
        # The terminal is closed now: the next end of a hang-up is a host.
        os.close(theirs)
        os.set_blocking(self._ours, False)
        self.is_open = False
        self._unread = b""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="grbl-simulator", daemon=True)
        self._thread.start()

    def __enter__(self) -> PtyServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the thread and the terminal."""
        self._ended.set()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the terminal has ended (an unplugging), and return whether it has."""
        return self._ended.wait(timeout)

    def _serve(self) -> None:
        poll = select.poll()
        poll.register(self._ours, select.POLLIN)
        try:
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
        finally:
            os.close(self._ours)
            self._ended.set()

    def _hangs_up(self) -> bool:
        """Return whether closing drops DTR, by the settings of the terminal, which remain."""
        import termios

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
