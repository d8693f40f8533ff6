"""Motor drivers by Trinamic (TMC2208, TMC2209, TMC2130, TMC5160) behind a Klipper board.

Datagrams, registers for a machine file, their writing and check, and the watch during motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from cnc.boards.klipper.connection import POLL_S, Connection, Pump
from cnc.boards.klipper.layout import Layout, section
from cnc.boards.klipper.protocol import Message
from cnc.boards.protocols import board_error
from cnc.machine.klipper import TrinamicDriver
from cnc.machine.load import error_in
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError

# Datagrams of the drivers: UART (TMC2209 data sheet, chapter 4) and SPI (TMC5160 data sheet, 4).
#
#       UART write   0xF5 | address | 0x80 + register | 4 bytes of data | CRC-8
#            read    0xF5 | address | register | CRC-8
#            answer  0x05 | 0xFF | register | 4 bytes of data | CRC-8
#       SPI          0x80 + register or register | 4 bytes of data; the answer to a read comes with
#                    the next datagram: status | 4 bytes of data
#
# The board's firmware sends and receives the UART as bits: a start bit, 8 bits, a stop bit.

SYNC, HOST, WRITE = 0x05, 0xFF, 0x80
CALL = 0xF0 | SYNC
"""First byte to a driver. It ignores the high bits. With them, Klipper's firmware times the sync
nibble, by which the driver measures the speed, and follows it: other interrupts may delay bits.
"""
ANSWER_BYTES = 8
"""Bytes of an answer of the UART."""
SPI_BYTES = 5


def crc8(data: bytes) -> int:
    """Return the CRC of a UART datagram: polynomial 0x07, the bits of each byte lowest first."""
    crc = 0
    for byte in data:
        for _ in range(8):
            crc = (crc << 1) ^ (0x07 if (crc >> 7) ^ (byte & 1) else 0) & 0xFF
            crc &= 0xFF
            byte >>= 1
    return crc


def uart_write(address: int, register: int, value: int) -> bytes:
    """Return the datagram that writes a register."""
    body = bytes((CALL, address, register | WRITE)) + value.to_bytes(4, "big")
    return body + bytes((crc8(body),))


def uart_read(address: int, register: int) -> bytes:
    """Return the datagram that asks for a register."""
    body = bytes((CALL, address, register))
    return body + bytes((crc8(body),))


def uart_answer(data: bytes, register: int) -> int | None:
    """Return the value in the answer for a register, None if it is no such answer."""
    right = len(data) == ANSWER_BYTES and data[:3] == bytes((SYNC, HOST, register))
    if not right or crc8(data[:-1]) != data[-1]:
        return None
    return int.from_bytes(data[3:7], "big")


def to_bits(data: bytes) -> bytes:
    """Return bytes with start and stop bits, packed from the lowest bit on; the rest is 1."""
    bits, size = 0, 0
    for byte in data:
        bits |= (byte << 1 | 0x200) << size
        size += 10
    total = -(-size // 8)
    bits |= (1 << 8 * total) - (1 << size)
    return bits.to_bytes(total, "little")


def from_bits(data: bytes) -> bytes | None:
    """Return the bytes between start and stop bits, None if these are wrong."""
    bits, decoded = int.from_bytes(data, "little"), bytearray()
    for k in range(len(data) * 8 // 10):
        part = bits >> 10 * k & 0x3FF
        if part & 1 or not part & 0x200:
            return None
        decoded.append(part >> 1 & 0xFF)
    return bytes(decoded)


# Registers of the drivers and their values for a machine file.
#
# Register maps and formulas of the currents: data sheets of TMC2209 (chapters 5 and 9), TMC2130
# (chapters 6 and 9) and TMC5160 (chapters 6 and 9).

GCONF, GSTAT, IFCNT, GLOBALSCALER = 0x00, 0x01, 0x02, 0x0B
IHOLD_IRUN, TPOWERDOWN, TPWMTHRS, TCOOLTHRS, SGTHRS = 0x10, 0x11, 0x13, 0x14, 0x40
CHOPCONF, COOLCONF, DRV_STATUS = 0x6C, 0x6D, 0x6F
SQRT2 = math.sqrt(2.0)
HIGH_V, LOW_V = {"tmc2208": 0.325, "tmc2209": 0.325, "tmc2130": 0.32, "tmc5160": 0.325}, 0.18
"""Full-scale voltage at the sense resistor, V, for vsense 0 and 1."""
SERIES_OHM = 0.02
"""Resistance inside the driver in series with its sense resistor, ohm; not for TMC5160."""
CLOCK = 12e6
"""Internal clock of the drivers, Hz, in which TSTEP counts the time of a 256th of a full step."""
SEEN = 0.7
"""Share of the speed of a move from which a stall counts."""
STEPS = 32
"""Steps of the current."""


@dataclass(frozen=True, slots=True)
class Setting:
    """The value of a register, and whether the driver gives it back."""

    register: int
    value: int
    readable: bool


@dataclass(frozen=True, slots=True)
class Currents:
    """Settings of the currents: global scaler (0 for none), vsense, and scales of run and hold."""

    scaler: int
    sensitive: bool
    run: int
    hold: int


class CurrentOutOfRange(ValueError):
    """A current that the driver cannot set; its text names the range."""


def currents(driver: TrinamicDriver) -> Currents:
    """Return the settings for the currents of a driver.

    Raises:
        CurrentOutOfRange: The driver cannot give them.
    """
    run = driver.run_current
    hold = run if driver.hold_current is None else driver.hold_current
    if driver.kind == "tmc5160":
        full = HIGH_V[driver.kind] / driver.resistor / SQRT2
        most, least = full, full * 32 / 256
        if not least <= run <= most:
            raise CurrentOutOfRange(f"{least:.2g} to {most:.2g} A")
        scaler = min(round(256 * run / full), 255)
        return Currents(scaler, False, STEPS - 1, _scale(hold / run))
    resistor = driver.resistor + SERIES_OHM
    high, low = (volt / resistor / SQRT2 for volt in (HIGH_V[driver.kind], LOW_V))
    if not high / STEPS / 2 <= run <= high:
        raise CurrentOutOfRange(f"{low / STEPS:.2g} to {high:.2g} A")
    # The lower voltage is finer and wastes less heat.
    sensitive = max(run, hold) <= low
    full = low if sensitive else high
    return Currents(0, sensitive, _scale(run / full), _scale(hold / full))


def _scale(share: float) -> int:
    return min(max(round(STEPS * share) - 1, 0), STEPS - 1)


def settings(driver: TrinamicDriver) -> Iterator[Setting]:
    """Yield the registers of a driver in the order in which they are written.

    Raises:
        CurrentOutOfRange: The driver cannot give the currents.
    """
    amps = currents(driver)
    stall = driver.stallguard
    yield Setting(GCONF, general(driver, silent=driver.stealthchop), True)
    if amps.scaler:
        yield Setting(GLOBALSCALER, amps.scaler, False)
    yield Setting(IHOLD_IRUN, amps.hold | amps.run << 8 | 6 << 16, False)
    yield Setting(TPOWERDOWN, 20, False)
    resolution = 8 - driver.microsteps.bit_length() + 1
    # Off time 3, hysteresis 5 and 2, blank time 2: the data sheets' start values.
    chop = 3 | 4 << 4 | 1 << 7 | 2 << 15 | resolution << 24 | 1 << 28
    yield Setting(CHOPCONF, chop | (1 << 17 if amps.sensitive else 0), True)
    yield Setting(TPWMTHRS, 0, False)
    if stall is not None:
        # DIAG tells a stall only while the axis homes (stall_settings).
        yield Setting(TCOOLTHRS, 0, False)
        if driver.has_uart:
            yield Setting(SGTHRS, stall, False)
        else:
            yield Setting(COOLCONF, (stall & 0x7F) << 16, False)


def general(driver: TrinamicDriver, *, silent: bool) -> int:
    """Return GCONF in the silent mode (stealthChop) or in the other one (spreadCycle)."""
    if driver.has_uart:
        # Currents by register instead of a voltage; microsteps by register; the UART stays on.
        return 1 << 6 | 1 << 7 | (0 if silent else 1 << 2)
    value = 1 << 2 if silent else 0
    if driver.stallguard is not None:
        value |= 1 << 8 | 1 << 13
    return value


def stall_settings(driver: TrinamicDriver, speed: float) -> list[Setting]:
    """Return the registers for a move that ends at a hard stop.

    StallGuard4 (tmc2209) needs stealthChop, StallGuard2 (tmc2130, tmc5160) needs spreadCycle. A
    slow motor has no back EMF that could be measured, so a stall counts only near full speed.

    Args:
        driver: The driver.
        speed: Speed of the move, steps/s.
    """
    ticks = CLOCK / (SEEN * speed * 256 / driver.microsteps)
    return [
        Setting(GCONF, general(driver, silent=driver.has_uart), True),
        Setting(TCOOLTHRS, min(round(ticks), 0xFFFFF), False),
    ]


def motion_settings(driver: TrinamicDriver) -> list[Setting]:
    """Return the registers that end the measurement of stalls."""
    return [
        Setting(TCOOLTHRS, 0, False),
        Setting(GCONF, general(driver, silent=driver.stealthchop), True),
    ]


UART_FAULTS = {
    1: "it is too hot",
    2: "short circuit to ground at coil A",
    3: "short circuit to ground at coil B",
    4: "short circuit at coil A",
    5: "short circuit at coil B",
}
SPI_FAULTS = {
    25: "it is too hot",
    27: "short circuit to ground at coil A",
    28: "short circuit to ground at coil B",
    12: "short circuit at coil A",
    13: "short circuit at coil B",
}
"""Faults by their bits in DRV_STATUS."""


def reset_of(value: int) -> str:
    """Return the fault in GSTAT, "" if there is none."""
    if value & 1:
        return "it was reset, because its supply failed, so its settings are lost"
    return "its charge pump has too low a voltage" if value & 4 else ""


def fault_of(driver: TrinamicDriver, status: int) -> str:
    """Return the fault in DRV_STATUS, "" if there is none."""
    faults = UART_FAULTS if driver.has_uart else SPI_FAULTS
    if driver.kind == "tmc2130":
        faults = {bit: text for bit, text in faults.items() if bit > 20}
    return "; ".join(text for bit, text in faults.items() if status >> bit & 1)


# Writing and reading of the drivers' registers through a Klipper board, and their check.

CHECK = "switch off, let it cool down, then check the motor, its wires and its supply"
"""What to do after a fault of a driver."""
TRIES = 5
"""Attempts to read a register."""


class MotorDriver:
    """The driver of an axis.

    Args:
        connection: The connection to the board.
        oid: Object of its UART or SPI device.
        motor: Column of its axis, and the number of its motor.
        machine: The machine.

    Attributes:
        column: Column of its axis.
        driver: Its table in the machine file.
    """

    def __init__(
        self, connection: Connection, oid: int, motor: tuple[int, int], machine: Machine
    ) -> None:
        self._connection, self._oid = connection, oid
        self.column, self._number = motor
        self._letter = tuple(machine.axes)[self.column]
        self._drivers = _drivers(machine, self._letter)
        self.driver = self._drivers[self._number]

    def read(self, register: int) -> int:
        """Return the value of a register.

        Raises:
            BoardError: ``motor-driver``, if the driver does not answer.
        """
        if not self.driver.has_uart:
            self._transfer(bytes((register, 0, 0, 0, 0)))
            return int.from_bytes(self._transfer(bytes((register, 0, 0, 0, 0)))[1:], "big")
        for _ in range(TRIES):
            answer = self._ask(
                "tmcuart_send",
                "tmcuart_response",
                write=to_bits(uart_read(self.driver.address, register)),
                read=ANSWER_BYTES * 10 // 8,
            )
            data = from_bits(answer.data("read"))
            value = None if data is None else uart_answer(data, register)
            if value is not None:
                return value
        raise self._fault("does not answer", "check its pins, its address and the motor supply")

    def write(self, register: int, value: int) -> None:
        """Write a register.

        Raises:
            BoardError: ``motor-driver``, if the driver did not take it.
        """
        if not self.driver.has_uart:
            self._transfer(bytes((register | WRITE,)) + value.to_bytes(4, "big"))
            return
        before = self.read(IFCNT)
        for _ in range(TRIES):
            self._ask(
                "tmcuart_send",
                "tmcuart_response",
                write=to_bits(uart_write(self.driver.address, register, value)),
                read=0,
            )
            if self.read(IFCNT) != before:
                return
        raise self._fault("takes no settings", "check its pins and the motor supply")

    def configure(self, machine: Machine) -> None:
        """Write all settings, and compare what can be read back.

        Raises:
            BoardError: ``motor-driver``.
            MachineFileError: The driver cannot give the current.
        """
        try:
            wanted = list(settings(self.driver))
        except CurrentOutOfRange as error:
            key = ("board", "klipper", self._letter, "driver")
            hint = f"with its sense resistor of {self.driver.resistor:g} ohm it gives {error}"
            message = f"the driver cannot give {self.driver.run_current:g} A"
            raise error_in(machine, key, message, hint) from error
        for setting in wanted:
            self.write(setting.register, setting.value)
        for setting in wanted:
            if setting.readable and (present := self.read(setting.register)) != setting.value:
                message = (
                    f"has {present:#x} in its register {setting.register:#04x} instead of "
                    f"{setting.value:#x}"
                )
                raise self._fault(message, "check its kind, its pins and the motor supply")
        self.write(GSTAT, 7)
        self.read(GSTAT)  # A tmc2130 clears it when it is read.

    def check(self) -> None:
        """Read the state of the driver.

        Raises:
            BoardError: ``motor-driver``, if it reports a fault.
        """
        fault = fault_of(self.driver, self.read(DRV_STATUS)) or reset_of(self.read(GSTAT))
        if fault:
            raise self._fault(f"reports a fault: {fault}", CHECK)

    def watch_stalls(self, speed: float | None) -> None:
        """Let DIAG tell a stall of a move at a speed, steps/s; None ends this."""
        settings = (
            motion_settings(self.driver) if speed is None else stall_settings(self.driver, speed)
        )
        for setting in settings:
            self.write(setting.register, setting.value)

    def ask_for(self, register: int) -> None:
        """Ask for a register, without waiting for the answer."""
        if self.driver.has_uart:
            write = to_bits(uart_read(self.driver.address, register))
            read = ANSWER_BYTES * 10 // 8
            self._connection.send("tmcuart_send", oid=self._oid, write=write, read=read)
        else:
            data = bytes((register, 0, 0, 0, 0))
            self._connection.send("spi_transfer", oid=self._oid, data=data)

    def answer_of(self, message: Message, register: int) -> int | None:
        """Return the value of an answer, -1 if it is not readable, None for another message."""
        uart = self.driver.has_uart
        name = "tmcuart_response" if uart else "spi_transfer_response"
        if message.name != name or message["oid"] != self._oid:
            return None
        if not uart:
            data = message.data("response")
            value = int.from_bytes(data[1:], "big") if len(data) == SPI_BYTES else 0
            # A driver with power always tells a scale of its current there.
            return -1 if register == DRV_STATUS and not value else value
        bits = from_bits(message.data("read"))
        decoded = None if bits is None else uart_answer(bits, register)
        return -1 if decoded is None else decoded

    def text(self, message: str) -> str:
        """Return a message about the driver."""
        owner = self._letter.upper()
        if len(self._drivers) > 1:
            owner = f"motor {self._number + 1} of {owner}"
        return f"the {self.driver.kind} of {owner} {message}"

    def _transfer(self, data: bytes) -> bytes:
        answer = self._ask("spi_transfer", "spi_transfer_response", data=data).data("response")
        if len(answer) != SPI_BYTES:
            raise self._fault("does not answer", "check its pins and the motor supply")
        return answer

    def _ask(self, command: str, response: str, **values: bytes | int) -> Message:
        connection = self._connection
        return connection.ask(command, response, connection.pump, oid=self._oid, **values)

    def _fault(self, message: str, hint: str) -> BoardError:
        return board_error("motor-driver", self.text(message), hint=hint)


def motor_drivers(connection: Connection, layout: Layout, machine: Machine) -> list[MotorDriver]:
    """Return the drivers that the machine file names."""
    return [
        MotorDriver(connection, layout.drivers[letter, number], (column, number), machine)
        for column, letter in enumerate(machine.axes)
        for number in range(len(_drivers(machine, letter)))
    ]


def _drivers(machine: Machine, letter: str) -> tuple[TrinamicDriver, ...]:
    axis = section(machine).axis(letter)
    return () if axis is None else axis.driver or ()


# Watch on the motor drivers during motion: one question at a time, without waiting for it.
#
# A driver that is too hot or has a short circuit switches its motor off. One whose supply has
# failed has lost its settings. Both end the motion.

PERIOD_S = 0.05
"""Time between two questions: each of 4 drivers tells two registers in 0.4 s."""
ANSWER_S = 0.25
"""Time without an answer after which a question counts as lost."""
UNREADABLE, LOST = 3, 10
"""Answers in a row that the board could not read from the driver, or that did not come from the
board, after which a driver counts as lost. The board does not repeat answers.
"""
REGISTERS = DRV_STATUS, GSTAT


class DriverWatch:
    """Asks the drivers for their state in turn.

    Args:
        connection: The connection to the board.
        drivers: The drivers.
    """

    def __init__(self, connection: Connection, drivers: list[MotorDriver]) -> None:
        self._connection = connection
        self._drivers = drivers
        self._stalls: list[MotorDriver] = []
        self._turns = [(driver, register) for driver in drivers for register in REGISTERS]
        self._turn = 0
        self._asked_at: float | None = None
        self._next_at = 0.0
        self._stale = False
        self._unreadable = [0] * len(self._turns)
        self._lost = [0] * len(self._turns)

    def check(self, pump: Pump) -> None:
        """Read the state of all drivers at rest; ``pump`` exchanges bytes.

        Raises:
            BoardError: ``motor-driver``, the fault of one.
        """
        while self._asked_at is not None:
            pump(POLL_S)
            if self._asked_at is not None:
                self.ask()
        for driver in self._drivers:
            driver.check()

    def begin_stalls(self, column: int, speed: float) -> None:
        """Let the drivers of an axis tell stalls of a homing move at a speed, steps/s."""
        for driver in self._drivers:
            if driver.column == column and driver.driver.stallguard is not None:
                driver.watch_stalls(speed)
                self._stalls.append(driver)

    def end_stalls(self) -> None:
        """Let the drivers go back to the mode of the machine file."""
        while self._stalls:
            self._stalls.pop().watch_stalls(None)

    def ask(self) -> str:
        """Send the next question if it is due.

        Returns:
            The fault of a driver that does not answer any more, "" if there is none.
        """
        now = self._connection.clock.now()
        if self._asked_at is not None:
            if now - self._asked_at < ANSWER_S:
                return ""
            return self._missed(self._lost, LOST)
        if not self._turns or now < self._next_at:
            return ""
        driver, register = self._turns[self._turn]
        self._asked_at = now
        # The answer of SPI comes with the next datagram.
        self._stale = not driver.driver.has_uart
        driver.ask_for(register)
        if self._stale:
            driver.ask_for(register)
        return ""

    def take(self, message: Message) -> str:
        """Return the fault that an answer tells, "" if it tells none or is no answer."""
        if self._asked_at is None:
            return ""
        driver, register = self._turns[self._turn]
        value = driver.answer_of(message, register)
        if value is None:
            return ""
        if self._stale:
            self._stale = False
            return ""
        if value < 0:
            return self._missed(self._unreadable, UNREADABLE)
        self._unreadable[self._turn] = self._lost[self._turn] = 0
        self._advance()
        fault = reset_of(value) if register == GSTAT else fault_of(driver.driver, value)
        return driver.text(f"reports a fault: {fault}") if fault else ""

    def _missed(self, counts: list[int], most: int) -> str:
        """Count an answer without a value; return the fault if there are too many in a row."""
        driver = self._turns[self._turn][0]
        counts[self._turn] += 1
        silent = counts[self._turn] >= most
        self._advance()
        return driver.text("does not answer any more") if silent else ""

    def _advance(self) -> None:
        self._asked_at = None
        self._next_at = self._connection.clock.now() + PERIOD_S
        self._turn = (self._turn + 1) % len(self._turns)
