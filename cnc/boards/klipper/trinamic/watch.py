"""Watch on the motor drivers during motion: one question at a time, without waiting for it.

A driver that is too hot or has a short circuit switches its motor off. One whose supply has failed
has lost its settings. Both end the motion.
"""

from __future__ import annotations

from cnc.boards.klipper.connection import POLL_S, Connection, Pump
from cnc.boards.klipper.protocol.dictionary import Message
from cnc.boards.klipper.trinamic.drivers import MotorDriver
from cnc.boards.klipper.trinamic.settings import DRV_STATUS, GSTAT, fault_of, reset_of

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
        found = reset_of(value) if register == GSTAT else fault_of(driver.driver, value)
        return driver.text(f"reports a fault: {found}") if found else ""

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
