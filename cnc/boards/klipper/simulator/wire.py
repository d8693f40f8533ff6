"""The cable: bytes take time, and may be damaged, lost or doubled."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass

BITS_A_BYTE = 10
USB_BYTES_PER_S = 800_000.0
"""Throughput of a full-speed USB serial device."""
USB_LATENCY_S = 0.001
"""Frame of a full-speed USB bus."""


@dataclass(slots=True)
class Noise:
    """Chance of each fault for a byte, in both directions, after a time."""

    damaged: float = 0.0
    dropped: float = 0.0
    doubled: float = 0.0
    after: float = 0.0


class Cable:
    """Both directions of the cable. Times are in s.

    Args:
        baud: Speed of a serial line, bits/s; 0 for USB.
        seed: Seed of the faults.

    Attributes:
        noise: Faults.
        plugged: Whether bytes pass at all.
    """

    def __init__(self, baud: int, seed: int = 0) -> None:
        self.byte_s = BITS_A_BYTE / baud if baud else 1.0 / USB_BYTES_PER_S
        self.latency_s = 0.0 if baud else USB_LATENCY_S
        self.noise = Noise()
        self.plugged = True
        self._random = random.Random(seed)
        self._free_down = self._free_up = 0.0
        self._up: deque[tuple[float, bytes]] = deque()

    def down(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Send bytes to the board; return parts of them with the times of their arrival."""
        if not self.plugged or not data:
            return []
        begin = max(now, self._free_down)
        self._free_down = begin + len(data) * self.byte_s
        parts: list[tuple[float, bytes]] = []
        at = 0
        while at < len(data):
            # A block ends with a sync byte, so nothing happens between two of them.
            sync = data.find(b"\x7e", at)
            end = len(data) if sync < 0 else sync + 1
            arrival = begin + end * self.byte_s + self.latency_s
            parts.append((arrival, self._spoilt(data[at:end], now)))
            at = end
        return parts

    def up(self, data: bytes, now: float) -> None:
        """Send bytes to the host."""
        if self.plugged:
            begin = max(now, self._free_up)
            self._free_up = begin + len(data) * self.byte_s
            self._up.append((self._free_up + self.latency_s, self._spoilt(data, now)))

    @property
    def arrival(self) -> float | None:
        """When the host can read the next bytes; None if there are none."""
        return self._up[0][0] if self._up else None

    def received(self, now: float) -> bytes:
        """Return the bytes that the host can read now."""
        parts = []
        while self._up and self._up[0][0] <= now:
            parts.append(self._up.popleft()[1])
        return b"".join(parts)

    def unplug(self) -> None:
        """Pull the cable."""
        self.plugged = False
        self._up.clear()

    def _spoilt(self, data: bytes, now: float) -> bytes:
        noise = self.noise
        if now < noise.after or not (noise.damaged or noise.dropped or noise.doubled):
            return data
        out = bytearray()
        for byte in data:
            draw = self._random.random()
            if draw < noise.damaged:
                out.append(byte ^ self._random.randint(1, 255))
            elif draw < noise.damaged + noise.dropped:
                continue
            elif draw < noise.damaged + noise.dropped + noise.doubled:
                out += bytes((byte, byte))
            else:
                out.append(byte)
        return bytes(out)
