"""The time that the serial wire takes for the bytes that were written."""

from __future__ import annotations

BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""
USUAL_BAUD = 115200
"""bit/s: the speed of GRBL 1.1."""


class WireTime:
    """Follows the bytes on the wire to the board.

    A computer takes bytes at once, and sends them at the speed of the wire.

    Args:
        baud: Speed of the wire, bit/s.

    Attributes:
        byte_time: Time of a byte, s.
        idle_from: Time from which on the wire is idle, s.
    """

    def __init__(self, baud: int = USUAL_BAUD) -> None:
        self.byte_time = BITS_PER_BYTE / baud
        self.idle_from = 0.0

    def written(self, count: int, now: float) -> None:
        """Note that ``count`` bytes were written at a time, s."""
        self.idle_from = max(self.idle_from, now) + count * self.byte_time
