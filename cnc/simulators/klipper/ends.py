"""The ends of a simulated machine: limit switches, and hard stops where a driver finds the end."""

from __future__ import annotations

from cnc.boards.klipper.layout import InputObject, LayoutBuilder, MotorObject, section
from cnc.boards.klipper.trinamic import CHOPCONF, CLOCK, COOLCONF, GCONF, SGTHRS, TCOOLTHRS
from cnc.boards.loopback import switch_places
from cnc.machine.klipper import KlipperAxis, Pin
from cnc.machine.models import Machine
from cnc.simulators.klipper.devices import DriverModel
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.objects import EndLevel, Level

# A motor at a hard stop, as its driver measures it.
#
# Sources: TMC2209 data sheet, chapter 11 (StallGuard4); TMC5160 data sheet, chapter 13
# (StallGuard2). The value of the measurement falls with the load and with the speed: a slow motor
# has little back EMF. DIAG is high while the value is at most the threshold, the motor runs faster
# than the limit in TCOOLTHRS, and the chopper is in the mode in which the driver can measure.

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


def add_ends(simulator: KlipperSimulator, machine: Machine) -> None:
    """Let the switches at the ends of the travels follow the motors.

    Those of axes that no motor moves alone (a CoreXY) stay open.
    """
    layout = LayoutBuilder(machine, simulator.firmware.dictionary).build()
    places, moved = switch_places(machine), machine.kinematics.axes
    for column, letter in enumerate(machine.axes):
        pins = section(machine).axis(letter)
        if pins is None or pins.endstop is None or letter in moved:
            continue
        motors = [each for each in layout.motors if each.column == column]
        for switch in layout.limits(column):
            if (column, switch.motor) in places:
                end = places[column, switch.motor]
                level = _level(simulator, pins, motors[switch.motor], switch, end)
                simulator.set_pin(Pin.of(pins.endstop[switch.motor]).name, level)


def _level(
    simulator: KlipperSimulator,
    pins: KlipperAxis,
    motor: MotorObject,
    switch: InputObject,
    end: tuple[int, float],
) -> Level:
    """Return a function that gives the level of the switch of a motor.

    Args:
        simulator: The board.
        pins: Pins of the axis.
        motor: The motor.
        switch: Its switch.
        end: Direction and place of the end, steps of the axis.
    """
    towards, place = end
    sign = 1 if motor.forward else -1
    step = Pin.of(pins.step[motor.number]).name
    driver = pins.driver[motor.number] if pins.driver else None
    if driver is not None and driver.stallguard is not None:
        if driver.uart is not None:
            model = simulator.uarts[simulator.pin(Pin.of(driver.uart).name)].drivers[driver.address]
        else:
            device = simulator.spi[simulator.pin(Pin.of(str(driver.select)).name)]
            assert isinstance(device, DriverModel)
            model = device
        return HardStop(simulator, model, step, (sign * towards, sign * round(place))).diag
    end_of_motor = sign * towards, sign * place
    return EndLevel(simulator.positions, simulator.pin(step), end_of_motor, switch.active)
