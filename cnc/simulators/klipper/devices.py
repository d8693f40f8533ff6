"""The cable of the simulated board, and its motor drivers: registers behind a UART or SPI."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import dataclass, field

from cnc.boards.klipper.trinamic import (
    DRV_STATUS,
    GSTAT,
    HOST,
    IFCNT,
    SPI_BYTES,
    SYNC,
    WRITE,
    crc8,
    from_bits,
    to_bits,
)

WRITE_BYTES, READ_BYTES = 8, 4
AT_POWER_UP = {GSTAT: 1, DRV_STATUS: 31 << 16}
"""A reset is noted, and DRV_STATUS has the scale of the current."""


class SpiDevice:
    """A device behind a chip select; this one drives nothing, so the line stays low."""

    __slots__ = ()

    def transfer(self, data: bytes) -> bytes:
        """Exchange bytes."""
        return bytes(len(data))


class Reader:
    """Reads a sensor; this one has none."""

    def query(self, rest_ticks: int) -> None:
        """Begin to read it every so many ticks, or end with 0."""

    def status(self) -> None:
        """Tell how many samples there were; without a sensor there is no answer."""


@dataclass(slots=True)
class DriverModel(SpiDevice):
    """A driver.

    Attributes:
        kind: Its kind, as in a machine file.
        registers: Its registers.
        ignored: Registers that it ignores, as a broken driver.
        powered: Whether its supply is on.
    """

    kind: str = "tmc2209"
    registers: dict[int, int] = field(default_factory=lambda: dict(AT_POWER_UP))
    ignored: set[int] = field(default_factory=set)
    powered: bool = True
    _answer: int = 0

    def reset(self) -> None:
        """Lose all settings, as after a failure of the supply."""
        self.registers = dict(AT_POWER_UP)

    def read(self, register: int) -> int:
        """Return a register; GSTAT of a tmc2130 is cleared by that."""
        value = self.registers.get(register, 0)
        if register == GSTAT and self.kind == "tmc2130":
            self.registers[GSTAT] = 0
        return value

    def write(self, register: int, value: int) -> None:
        """Write a register; ones clear the flags of GSTAT."""
        if register == GSTAT:
            value = self.registers.get(GSTAT, 0) & ~value
        if register not in self.ignored:
            self.registers[register] = value
        self.registers[IFCNT] = self.registers.get(IFCNT, 0) + 1 & 0xFF

    def transfer(self, data: bytes) -> bytes:
        """Exchange an SPI datagram; the answer is that to the datagram before."""
        if not self.powered or len(data) != SPI_BYTES:
            return bytes(len(data))
        answer = bytes((0,)) + self._answer.to_bytes(4, "big")
        register = data[0] & ~WRITE
        if data[0] & WRITE:
            self.write(register, int.from_bytes(data[1:], "big"))
            self._answer = self.registers.get(register, 0)
        else:
            self._answer = self.read(register)
        return answer


class UartModel:
    """A UART wire with drivers by their addresses."""

    def __init__(self) -> None:
        self.drivers: dict[int, DriverModel] = {}

    def send(self, bits: bytes, size: int) -> bytes:
        """Take a datagram as bits; return ``size`` bytes of bits."""
        data = from_bits(bits)
        silent = b"\xff" * size
        if data is None or len(data) not in (READ_BYTES, WRITE_BYTES) or data[0] & 0x0F != SYNC:
            return silent
        driver = self.drivers.get(data[1])
        if driver is None or not driver.powered or crc8(data[:-1]) != data[-1]:
            return silent
        register = data[2] & ~WRITE
        if len(data) == WRITE_BYTES:
            driver.write(register, int.from_bytes(data[3:7], "big"))
            return silent
        body = bytes((SYNC, HOST, register)) + driver.read(register).to_bytes(4, "big")
        return to_bits(body + bytes((crc8(body),)))[:size]


# The cable: bytes take time, and may be damaged, lost or doubled.

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
