"""Motor drivers of the simulator: registers behind a UART or SPI."""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc.boards.klipper.trinamic.frames import (
    HOST,
    SPI_BYTES,
    SYNC,
    WRITE,
    crc8,
    from_bits,
    to_bits,
)
from cnc.boards.klipper.trinamic.settings import GSTAT, IFCNT

WRITE_BYTES, READ_BYTES = 8, 4


@dataclass(slots=True)
class DriverModel:
    """A driver: its registers, and those that it ignores, as a broken one."""

    registers: dict[int, int] = field(default_factory=dict)
    ignored: set[int] = field(default_factory=set)
    powered: bool = True
    _answer: int = 0

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
        return answer


class UartModel:
    """A UART wire with drivers by their addresses."""

    def __init__(self) -> None:
        self.drivers: dict[int, DriverModel] = {}

    def send(self, bits: bytes, size: int) -> bytes:
        """Take a datagram as bits; return ``size`` bytes of bits."""
        data = from_bits(bits)
        silent = b"\xff" * size
        if data is None or len(data) not in (READ_BYTES, WRITE_BYTES) or data[0] != SYNC:
            return silent
        driver = self.drivers.get(data[1])
        if driver is None or not driver.powered or crc8(data[:-1]) != data[-1]:
            return silent
        register = data[2] & ~WRITE
        if len(data) == WRITE_BYTES:
            driver.write(register, int.from_bytes(data[3:7], "big"))
            return silent
        body = bytes((SYNC, HOST, register)) + driver.registers.get(register, 0).to_bytes(4, "big")
        return to_bits(body + bytes((crc8(body),)))[:size]
