"""A motor at a hard stop, as its driver measures it.

Sources: TMC2209 data sheet, chapter 11 (StallGuard4); TMC5160 data sheet, chapter 13 (StallGuard2).
The value of the measurement falls with the load and with the speed: a slow motor has little back
EMF. DIAG is high while the value is at most the threshold, the motor runs faster than the limit in
TCOOLTHRS, and the chopper is in the mode in which the driver can measure.
"""

from __future__ import annotations

from cnc.boards.klipper.simulator.devices import DriverModel
from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator
from cnc.boards.klipper.trinamic.settings import (
    CHOPCONF,
    CLOCK,
    COOLCONF,
    GCONF,
    SGTHRS,
    TCOOLTHRS,
)

FREE = 300.0
"""Value of a motor that runs freely at FULL_SPEED or faster."""
PRESSED = 60.0
"""Value of a motor at its stop."""
FULL_SPEED = 50.0
"""Full steps per second from which the value does not grow any more."""


class HardStop:
    """A hard stop of a motor.

    Args:
        simulator: The board.
        driver: The motor's driver.
        step_pin: The motor's step pin.
        stop: Direction (1 or -1) and place of the stop, steps of the motor's count.

    Attributes:
        lost: Steps that the motor has lost at the stop.
    """

    def __init__(
        self,
        simulator: KlipperSimulator,
        driver: DriverModel,
        step_pin: str,
        stop: tuple[int, int],
    ) -> None:
        self._simulator, self._driver = simulator, driver
        self._pin = simulator.pin(step_pin)
        self._towards, self._stop = stop
        self.lost = 0

    @property
    def place(self) -> int:
        """Place of the motor, steps: its count without the steps that it has lost."""
        count = self._simulator.positions.get(self._pin, 0)
        beyond = (count - self.lost - self._stop) * self._towards
        if beyond > 0:
            self.lost += beyond * self._towards
        return count - self.lost

    def diag(self) -> int:
        """Return the level of DIAG."""
        registers = self._driver.registers
        pressed = (self.place - self._stop) * self._towards >= 0
        microsteps = 256 >> (registers.get(CHOPCONF, 0) >> 24 & 15)
        speed = self._speed() / microsteps
        if not speed or CLOCK / (speed * 256) > registers.get(TCOOLTHRS, 0):
            return 0
        bit = bool(registers.get(GCONF, 0) >> 2 & 1)
        free = min(speed / FULL_SPEED, 1.0)
        if self._driver.kind == "tmc2209":
            # StallGuard4: bit 2 is spreadCycle, in which it does not measure.
            value = PRESSED if pressed else FREE * free
            return int(not bit and value <= 2 * registers.get(SGTHRS, 0))
        # StallGuard2: bit 2 is stealthChop, in which it does not measure. The threshold is added.
        raw = registers.get(COOLCONF, 0) >> 16 & 0x7F
        threshold = raw - 128 if raw & 64 else raw
        value = (-PRESSED if pressed else FREE * free / 2) + 4 * threshold
        return int(not bit and value <= 0)

    def _speed(self) -> float:
        """Return the speed of the motor, steps per second; 0 at rest."""
        motor = next((m for m in self._simulator.motors if m.step_pin == self._pin), None)
        interval = None if motor is None else motor.interval
        return 0.0 if not interval else self._simulator.firmware.frequency / interval
