"""Protocols of a serial port and of its clock, and the log of what passes a port.

The protocols let tests replace both.

A driver reads and writes in one thread. It waits only in :meth:`Port.read`. Therefore an in-process
board may answer in virtual time: its port advances the clock by the time waited.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Protocol

from cnc.model.diagnostics import BoardError, Diagnostic


class Port(Protocol):
    """A connection in both directions."""

    def read(self, timeout: float) -> bytes:
        """Return the received bytes, empty if there are none.

        Args:
            timeout: Longest wait, s; 0 returns only bytes that are there already.

        Raises:
            PortLost: The connection is lost.
        """

    def write(self, data: bytes) -> None:
        """Send bytes at once.

        Raises:
            PortLost: The connection is lost.
        """

    def raise_lines(self) -> bool:
        """Raise DTR and RTS if they are low: some boards send only then, others are reset.

        Returns:
            Whether they were low.

        Raises:
            PortLost: The connection is lost.
        """

    def close(self) -> None:
        """Close the connection. Never fails; further calls do nothing."""


class Clock(Protocol):
    """The clock of a driver."""

    def now(self) -> float:
        """Return the time since a fixed moment, s."""

    def sleep(self, seconds: float) -> None:
        """Wait for ``seconds``."""


class SystemClock:
    """The clock of this computer."""

    now = staticmethod(time.monotonic)
    """The monotonic time, s."""

    sleep = staticmethod(time.sleep)
    """Wait for a number of seconds."""


class PortLost(BoardError):
    """The connection was lost: cable, supply, or closed by the other end."""


def port_lost(name: str, reason: str) -> PortLost:
    """Return the fault of a lost connection, with the operating system's reason."""
    hint = (
        "check the cable and the board's supply. The position of the machine is lost: "
        "home it before the next run"
    )
    message = f"the connection to {name} was lost: {reason}"
    return PortLost(Diagnostic("port-lost", message, hint=hint))


# Log of a connection: each line or frame in both directions, at level DEBUG.
#
#     /dev/ttyUSB0 -> G1X10F600
#     /dev/ttyUSB0 <- ok
#
# Bytes that are not printable are escaped. Binary protocols are logged in hexadecimal, as they are
# written and read.


class LoggedPort:
    """A port that logs what passes it.

    Args:
        port: The port, which stays reachable as an attribute.
        name: Name of the port.
        log: The logger.
        text: Whether the bytes are lines of text.

    Attributes:
        on_line: Called with the direction (``->`` or ``<-``) and the text of each line; None for
            no call.
    """

    def __init__(self, port: Port, name: str, log: logging.Logger, *, text: bool) -> None:
        self.port = port
        self._name, self._log, self._text = name, log, text
        self._partial_line = b""
        self.on_line: Callable[[str, str], None] | None = None

    @property
    def logs(self) -> bool:
        """Whether anybody reads the log. If not, the port itself is quicker."""
        return self.on_line is not None or self._log.isEnabledFor(logging.DEBUG)

    def read(self, timeout: float) -> bytes:
        """Return the received bytes; see :meth:`Port.read`."""
        data = self.port.read(timeout)
        if data and self.logs:
            self._log_received(data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes at once; see :meth:`Port.write`."""
        if self.logs:
            for line in data.splitlines() if self._text else [data]:
                self._log_line("->", line)
        self.port.write(data)

    def raise_lines(self) -> bool:
        """Raise DTR and RTS; see :meth:`Port.raise_lines`."""
        self._log.debug("%s: raise DTR and RTS", self._name)
        return self.port.raise_lines()

    def close(self) -> None:
        """Close the connection."""
        self._log.debug("%s: close", self._name)
        self.port.close()

    def _log_received(self, data: bytes) -> None:
        """Log complete lines; the rest waits for its end."""
        if not self._text:
            self._log_line("<-", data)
            return
        *lines, self._partial_line = (self._partial_line + data).split(b"\n")
        for line in lines:
            self._log_line("<-", line.rstrip(b"\r"))

    def _log_line(self, arrow: str, data: bytes) -> None:
        shown = ascii(data.decode("latin-1"))[1:-1] if self._text else data.hex(" ")
        if shown:
            self._log.debug("%s %s %s", self._name, arrow, shown)
            if self.on_line is not None:
                self.on_line(arrow, shown)
