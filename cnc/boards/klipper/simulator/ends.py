"""The ends of a simulated machine: limit switches, and hard stops where a driver finds the end."""

from __future__ import annotations

from cnc.boards.klipper.layout import InputObject, LayoutBuilder, MotorObject, section
from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator
from cnc.boards.klipper.simulator.stall import HardStop
from cnc.boards.klipper.simulator.trsync import EndLevel, Level
from cnc.boards.loopback_switches import switch_places
from cnc.machine.klipper import KlipperAxis, Pin
from cnc.machine.models import Machine


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
            model = simulator.spi[simulator.pin(Pin.of(str(driver.select)).name)]
        return HardStop(simulator, model, step, (sign * towards, sign * round(place))).diag
    end_of_motor = sign * towards, sign * place
    return EndLevel(simulator.positions, simulator.pin(step), end_of_motor, switch.active)
