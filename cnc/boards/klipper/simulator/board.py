"""The board ``klipper-sim``: the Klipper driver on the Klipper simulator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.layout import LayoutBuilder, section
from cnc.boards.klipper.profile import firmware_of
from cnc.boards.klipper.simulator.devices import DriverModel, UartModel
from cnc.boards.klipper.simulator.ends import add_ends
from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator
from cnc.boards.klipper.simulator.ports import NAME, KlipperSimulatorPort, RealTimePort
from cnc.boards.protocols import BoardTraits
from cnc.machine.klipper import KlipperAxis, KlipperBoard, KlipperSpindle, Pin
from cnc.machine.models import Machine


class KlipperSimulatorBoard(Klipper):
    """A simulated board with the microcontroller and pins of a machine file, at machine zero."""

    traits = BoardTraits(has_port=False, simulated=True)
    simulator: KlipperSimulator

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> KlipperSimulatorBoard:
        """Return a new connected board in virtual time; a machine file without pins gets some."""
        return cls._connected(machine, KlipperSimulatorPort)

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> KlipperSimulatorBoard:
        """Return a new connected board, whose clock is that of the computer."""
        return cls._connected(machine, RealTimePort, background=True)

    @classmethod
    def _connected(
        cls, machine: Machine, port_type: type[KlipperSimulatorPort], *, background: bool = False
    ) -> KlipperSimulatorBoard:
        machine = with_pins(machine)
        simulator = simulator_for(machine)
        add_ends(simulator, machine)
        port = port_type(simulator)
        board = cls(port, machine, NAME, clock=port, background=background)
        board.simulator = simulator
        board._position.known = np.ones(len(machine.axes), np.bool_)
        return board


def simulator_for(machine: Machine) -> KlipperSimulator:
    """Return a simulated board whose switches are open."""
    simulator = KlipperSimulator(firmware_of(machine))
    layout = LayoutBuilder(machine, simulator.firmware.dictionary).build()
    for command in layout.config:
        for message in simulator.firmware.dictionary.decode_commands(command):
            if message.name == "config_endstop":
                pressed = next(e.active for e in layout.inputs if e.oid == message["oid"])
                simulator.levels[message["pin"]] = 1 - pressed
    _add_drivers(simulator, machine)
    return simulator


def _add_drivers(simulator: KlipperSimulator, machine: Machine) -> None:
    """Connect the motor drivers that the machine file names."""
    for letter in machine.axes:
        axis = section(machine).axis(letter)
        for driver in () if axis is None else axis.driver or ():
            if driver.uart is not None:
                pin = simulator.pin(Pin.of(driver.uart).name)
                wire = simulator.uarts.setdefault(pin, UartModel())
                wire.drivers[driver.address] = DriverModel(driver.kind)
            elif driver.select is not None:
                pin = simulator.pin(Pin.of(driver.select).name)
                simulator.spi[pin] = DriverModel(driver.kind)


def with_pins(machine: Machine) -> Machine:
    """Return a machine with pins: its own, else some of an RP2040."""
    if machine.board.klipper is not None:
        return machine
    pins = (f"gpio{number}" for number in range(30))
    axes = {
        str(letter): KlipperAxis(
            step=tuple(next(pins) for _ in axis.motors),
            direction=tuple(next(pins) for _ in axis.motors),
        )
        for letter, axis in machine.axes.items()
    }
    known = KlipperBoard(
        spindle=KlipperSpindle(pin=next(pins), pwm=True, backward=next(pins)),
        flood=next(pins),
        mist=next(pins),
    ).model_copy(update=axes)
    board = machine.board.model_copy(update={"klipper": known})
    return machine.model_copy(update={"board": board})
