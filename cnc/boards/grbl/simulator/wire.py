"""The two directions of the cable: bytes take time, rings have a capacity.

A byte is 10 bit times on the wire (8N1): at 115200 baud 11 520 bytes/s. Towards the board:

    write(t) --> | . . . . | --> the UART's two bytes --> real-time byte? --> carried out at once
                  10 bits         (only these while the         |
                  each            EEPROM is written)            +------> RX ring; if it is full,
                                                                         the byte is lost unnoticed

Towards the host, bytes leave the TX ring one after another; a program that prints into a full ring
waits. The host's USB collects the bytes of a frame of 1 ms.
"""

from __future__ import annotations

import math
from collections import deque

BITS_A_BYTE = 10
"""Start bit, eight data bits, stop bit."""
USB_FRAME = 0.001
"""Seconds between two polls of a full-speed USB device by the host (USB 2.0, 5.3)."""
UART_BYTES = 2
"""Bytes that the AVR's receiver keeps while interrupts are off.

ATmega328P data sheet, 20.7: a two-level FIFO.
"""
EEPROM_BYTE_TIME = 0.0034
"""Seconds to erase and write a byte of EEPROM (ATmega328P data sheet, table 8-2)."""


class Receiver:
    """Host to board: the bytes on the wire, then those in the ring.

    Counters for tests: ``received``, ``overflowed`` (lost to a full ring), ``blinded`` (lost during
    EEPROM writes), ``fullest``.
    """

    def __init__(self, baud: float, capacity: int) -> None:
        self.byte_time = BITS_A_BYTE / baud
        self.capacity = capacity
        self.ring: deque[int] = deque()
        self.received = 0
        self.overflowed = 0
        self.blinded = 0
        self.fullest = 0
        self._wire: deque[tuple[float, bytes]] = deque()
        self._next = 0
        self._line_free = -math.inf
        self._blind_from = -math.inf
        self._blind_until = -math.inf
        self._window = -1
        self._kept = 0

    @property
    def lost(self) -> int:
        """Number of bytes that were lost after the wire."""
        return self.overflowed + self.blinded

    @property
    def arrival(self) -> float:
        """When the next byte will be off the wire, s."""
        if not self._wire:
            return math.inf
        return self._wire[0][0] + (self._next + 1) * self.byte_time

    def write(self, data: bytes, now: float) -> None:
        """Send bytes from the host."""
        if data:
            start = max(now, self._line_free)
            self._line_free = start + len(data) * self.byte_time
            self._wire.append((start, data))

    def take(self) -> int:
        """Take the next byte off the wire."""
        _, data = self._wire[0]
        byte = data[self._next]
        self._next += 1
        if self._next == len(data):
            self._wire.popleft()
            self._next = 0
        self.received += 1
        return byte

    def unplug(self) -> None:
        """Drop the bytes on the wire."""
        self._wire.clear()
        self._next = 0

    def blind(self, bytes_written: int, now: float) -> float:
        """Write bytes of EEPROM from ``now`` on, with interrupts off for each.

        Returns:
            The time of the end, s.
        """
        self._blind_from, self._blind_until = now, now + bytes_written * EEPROM_BYTE_TIME
        self._window, self._kept = -1, 0
        return self._blind_until

    def seen(self, now: float) -> bool:
        """Return whether a byte that arrives now is taken from the UART.

        During an EEPROM write only the first two bytes in the time of each written byte are.
        """
        if now >= self._blind_until:
            return True
        window = int((now - self._blind_from) / EEPROM_BYTE_TIME)
        if window != self._window:
            self._window, self._kept = window, 0
        self._kept += 1
        if self._kept > UART_BYTES:
            self.blinded += 1
            return False
        return True

    def store(self, byte: int) -> None:
        """Put a byte into the ring; it is lost if the ring is full."""
        if len(self.ring) >= self.capacity:
            self.overflowed += 1
            return
        self.ring.append(byte)
        self.fullest = max(self.fullest, len(self.ring))


class Transmitter:
    """Board to host."""

    def __init__(self, baud: float, capacity: int) -> None:
        self.byte_time = BITS_A_BYTE / baud
        self.capacity = capacity
        self.sent = 0
        self._free = -math.inf
        self._out: deque[tuple[float, bytes]] = deque()

    @property
    def arrival(self) -> float:
        """When the host can read the next bytes, s."""
        return self._out[0][0] if self._out else math.inf

    def send(self, data: bytes, now: float) -> float:
        """Print bytes.

        Returns:
            When the printing program can continue, s: the ring has space for the last byte.
        """
        start = max(now, self._free)
        self._free = start + len(data) * self.byte_time
        self.sent += len(data)
        first = 0
        while first < len(data):
            frame = math.ceil((start + (first + 1) * self.byte_time) / USB_FRAME - 1e-6)
            last = min(
                len(data), max(first + 1, int((frame * USB_FRAME - start) / self.byte_time + 1e-6))
            )
            self._out.append((frame * USB_FRAME, data[first:last]))
            first = last
        return max(now, self._free - self.capacity * self.byte_time)

    def collect(self, now: float) -> bytes:
        """Return all bytes that the host can read now."""
        parts = []
        while self._out and self._out[0][0] <= now:
            parts.append(self._out.popleft()[1])
        return b"".join(parts)

    def unplug(self) -> None:
        """Drop the bytes on the wire."""
        self._out.clear()
