"""A line of bytes to a board, and the clock that goes with it: what a driver needs of the world, so
that tests can give it another.

A driver reads and writes from one thread. It waits in :meth:`Port.read` and nowhere else, so an
in-process board may answer in virtual time: its port then moves the clock on by what it waited.
"""

from __future__ import annotations

import time
from typing import Protocol

from cnc.model.diagnostics import BoardError, Diagnostic


class Port(Protocol):
    """Both directions of a link."""

    def read(self, timeout: float) -> bytes:
        """What has arrived, after ``timeout`` s at most (0: what is there already); empty if
        nothing did. PortLost if the link is gone.
        """

    def write(self, data: bytes) -> None:
        """Hand over at once. PortLost if the link is gone."""

    def raise_lines(self) -> None:
        """Raise DTR and RTS where the opening has left them down: some boards send only then,
        others are reset. PortLost.
        """

    def close(self) -> None:
        """Let go of the link; never fails, and may be called again."""


class Clock(Protocol):
    """Time as a driver sees it."""

    def now(self) -> float:
        """Seconds since some moment."""

    def sleep(self, seconds: float) -> None:
        """Return ``seconds`` later."""


class SystemClock:
    """The computer's own."""

    def now(self) -> float:
        """Seconds; never set back."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)


class PortLost(BoardError):
    """The link broke off while it was open: a cable pulled, a supply that failed, a peer that
    closed.
    """


def port_lost(name: str, reason: str) -> PortLost:
    """The link called ``name`` is gone, for a reason that the system gave."""
    hint = "check the cable and the board's supply; where the machine stands is not known any more, so home it before the next run"
    return PortLost(Diagnostic("port-lost", f"the link to {name} broke off: {reason}", hint=hint))
