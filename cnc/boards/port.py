"""Protocols of a serial port and of its clock, so that tests can replace both.

A driver reads and writes in one thread. It waits only in :meth:`Port.read`. Therefore an in-process
board may answer in virtual time: its port advances the clock by the time waited.
"""

from __future__ import annotations

import time
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
