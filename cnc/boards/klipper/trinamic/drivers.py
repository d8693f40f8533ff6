"""Writing and reading of the drivers' registers through a Klipper board, and their check."""

from __future__ import annotations

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
    settings,
)
from cnc.boards.protocols import board_error
from cnc.machine.klipper import TrinamicDriver
from cnc.machine.load import error_in
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError

TRIES = 5
"""Attempts to read a register."""


class MotorDriver:
    """The driver of an axis.

    Args:
        connection: The connection to the board.
        oid: Object of its UART or SPI device.
        owner: Letter of its axis, and the number of its motor among several.
        driver: Its table in the machine file.
    """

    def __init__(
        self,
        connection: Connection,
        oid: int,
        owner: tuple[str, int | None],
        driver: TrinamicDriver,
    ) -> None:
        self._connection, self._oid = connection, oid
        self.letter, self.number = owner
        self.driver = driver

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
            key = ("board", "klipper", self.letter, "driver")
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

    def check(self) -> None:
        """Read the state of the driver.

        Raises:
            BoardError: ``motor-driver``, if it reports a fault.
        """
        found = fault_of(self.driver, self.read(DRV_STATUS))
        if found:
            raise self._fault(f"reports a fault: {found}", "switch off, then check the motor")

    def _transfer(self, data: bytes) -> bytes:
        answer = self._ask("spi_transfer", "spi_transfer_response", data=data).data("response")
        if len(answer) != SPI_BYTES:
            raise self._fault("does not answer", "check its pins and the motor supply")
        return answer

    def _ask(self, command: str, response: str, **values: bytes | int) -> Message:
        connection = self._connection
        return connection.ask(command, response, connection.pump, oid=self._oid, **values)

    def _fault(self, message: str, hint: str) -> BoardError:
        owner = self.letter.upper()
        if self.number is not None:
            owner = f"motor {self.number + 1} of {owner}"
        text = f"the {self.driver.kind} of {owner} {message}"
        return board_error("motor-driver", text, hint=hint)


def motor_drivers(connection: Connection, layout: Layout, machine: Machine) -> list[MotorDriver]:
    """Return the drivers that the machine file names."""
    found: list[MotorDriver] = []
    for letter in machine.axes:
        axis = section(machine).axis(letter)
        drivers = () if axis is None else axis.driver or ()
        for number, driver in enumerate(drivers):
            owner = letter, number if len(drivers) > 1 else None
            found.append(MotorDriver(connection, layout.drivers[letter, number], owner, driver))
    return found
