"""Motor drivers of the simulator: registers behind a UART or SPI."""

from __future__ import annotations

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


@dataclass(slots=True)
class DriverModel:
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
