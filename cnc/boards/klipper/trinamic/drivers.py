"""Writing and reading of the drivers' registers through a Klipper board, and their check."""

from __future__ import annotations

from cnc.boards.errors import board_error
from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import Layout, section
from cnc.boards.klipper.protocol.dictionary import Message
from cnc.boards.klipper.trinamic.frames import (
    ANSWER_BYTES,
    SPI_BYTES,
    WRITE,
    from_bits,
    to_bits,
    uart_answer,
    uart_read,
    uart_write,
)
from cnc.boards.klipper.trinamic.settings import (
    DRV_STATUS,
    GSTAT,
    IFCNT,
    CurrentOutOfRange,
    fault_of,
    motion_settings,
    reset_of,
    settings,
    stall_settings,
)
from cnc.machine.klipper import TrinamicDriver
from cnc.machine.load import error_in
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError

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
        for each in wanted:
            self.write(each.register, each.value)
        for each in wanted:
            if each.readable and (found := self.read(each.register)) != each.value:
                message = (
                    f"has {found:#x} in its register {each.register:#04x} instead of "
                    f"{each.value:#x}"
                )
                raise self._fault(message, "check its kind, its pins and the motor supply")
        self.write(GSTAT, 7)
        self.read(GSTAT)  # A tmc2130 clears it when it is read.

    def check(self) -> None:
        """Read the state of the driver.

        Raises:
            BoardError: ``motor-driver``, if it reports a fault.
        """
        found = fault_of(self.driver, self.read(DRV_STATUS)) or reset_of(self.read(GSTAT))
        if found:
            raise self._fault(f"reports a fault: {found}", CHECK)

    def watch_stalls(self, speed: float | None) -> None:
        """Let DIAG tell a stall of a move at a speed, steps/s; None ends this."""
        known = (
            motion_settings(self.driver) if speed is None else stall_settings(self.driver, speed)
        )
        for each in known:
            self.write(each.register, each.value)

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
        found = None if bits is None else uart_answer(bits, register)
        return -1 if found is None else found

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
