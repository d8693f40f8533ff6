"""The ends of a simulated machine: limit switches, and hard stops where a driver finds the end.

                     machine zero, where the simulator begins
    switch                  |
    ──┤◄── pull_off ──┤ position ├──────────── travel ────────────►

Each motor has its own end. It lies ``pull_off`` beyond the homed position, and at least that far
from machine zero, so that nothing is pressed when the simulator begins.
"""

from __future__ import annotations

from collections.abc import Callable

from cnc.boards.klipper.layout import InputObject, LayoutBuilder, MotorObject, section
from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator
from cnc.boards.klipper.simulator.stall import HardStop
from cnc.machine.klipper import KlipperAxis, Pin
from cnc.machine.models import Axis, Homing, Machine, switch_end


def add_ends(simulator: KlipperSimulator, machine: Machine) -> None:
    """Let the switches at the ends of the travels follow the motors.

    Those of axes that no motor moves alone (a CoreXY) stay open.
    """
    layout = LayoutBuilder(machine, simulator.firmware.dictionary).build()
    moved = machine.kinematics.axes
    for column, (letter, axis) in enumerate(machine.axes.items()):
        pins = section(machine).axis(letter)
        if pins is None or pins.endstop is None or axis.travel is None or letter in moved:
            continue
        motors = [each for each in layout.motors if each.column == column]
        for switch in layout.limits(column):
            level = _level(simulator, pins, motors[switch.motor], switch, _end(letter, axis))
            simulator.set_pin(Pin.of(pins.endstop[switch.motor]).name, level)


def _end(letter: str, axis: Axis) -> tuple[int, int]:
    """Return the direction (1 or -1) and the place, in steps, of the end of an axis."""
    assert axis.travel is not None
    homing = axis.homing or Homing()
    towards, beyond = switch_end(letter, homing), homing.pull_off
    near = axis.travel[1] if towards > 0 else axis.travel[0]
    rest = near if homing.position is None else homing.position
    place = max(towards * rest + beyond, beyond)
    return towards, towards * round(place * axis.steps_per_mm)


def _level(
    simulator: KlipperSimulator,
    pins: KlipperAxis,
    motor: MotorObject,
    switch: InputObject,
    end: tuple[int, int],
) -> Callable[[], int]:
    """Return a function that gives the level of the switch of a motor."""
    towards, place = end
    sign = 1 if motor.forward else -1
    step = Pin.of(pins.step[motor.number]).name
    driver = pins.driver[motor.number] if pins.driver else None
    if driver is not None and driver.stallguard is not None:
        if driver.uart is not None:
            model = simulator.uarts[simulator.pin(Pin.of(driver.uart).name)].drivers[driver.address]
        else:
            model = simulator.spi[simulator.pin(Pin.of(str(driver.select)).name)]
        return HardStop(simulator, model, step, (sign * towards, sign * place)).diag
    number = simulator.pin(step)

    def level() -> int:
        pressed = (sign * simulator.positions.get(number, 0) - place) * towards >= 0
        return switch.active if pressed else 1 - switch.active

    return level
