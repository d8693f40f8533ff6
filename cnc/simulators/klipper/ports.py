"""Ports of the simulator: in this process, the board ``klipper-sim``, and at a pseudo-terminal.

In virtual time a read advances the time to the next answer, or by the timeout; nothing sleeps. In
real time the simulator is advanced whenever the host reads, writes or asks for the time.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.feasibility import firmware_of
from cnc.boards.klipper.layout import LayoutBuilder, section
from cnc.boards.port import port_lost
from cnc.boards.protocols import BoardTraits
from cnc.machine.klipper import KlipperAxis, KlipperBoard, KlipperSpindle, Pin
from cnc.machine.models import Machine
from cnc.simulators.klipper.accelerometer import add_accelerometer
from cnc.simulators.klipper.devices import DriverModel, UartModel
from cnc.simulators.klipper.ends import add_ends
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.terminal import READ_SIZE, Terminal

NAME = "the Klipper simulator"
UNPLUGGED, VANISHED = "the cable was pulled", "the device was reset"
LONGEST_SLEEP = 0.002
"""Time between two checks for an answer, s."""


class KlipperSimulatorPort:
    """Port and clock of a simulator (:mod:`cnc.boards.port`), in virtual time.

    Raises:
        PortLost: The board restarts, and its USB device is not there yet.
    """

    def __init__(self, simulator: KlipperSimulator) -> None:
        self.simulator = simulator
        self.closed = False
        self._resets = simulator.resets
        if simulator.has_usb and simulator.now < simulator.boots_until:
            raise port_lost(NAME, VANISHED)

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s of virtual time."""
        self._check()
        simulator = self.simulator
        data = simulator.read()
        if not data and timeout > 0.0:
            simulator.advance(simulator.now + timeout, answer=True)
            self._check()
            data = simulator.read()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._check()
        self.simulator.write(data)

    def raise_lines(self) -> bool:
        """Return that the lines were high already."""
        return False

    def close(self) -> None:
        """Close the port."""
        self.closed = True

    def now(self) -> float:
        """Return the virtual time, s."""
        return self.simulator.now

    def sleep(self, seconds: float) -> None:
        """Advance the virtual time."""
        self.simulator.advance(self.simulator.now + seconds)

    def _check(self) -> None:
        if self.closed or not self.simulator.cable.plugged:
            raise port_lost(NAME, UNPLUGGED)
        if self.simulator.has_usb and self._resets != self.simulator.resets:
            raise port_lost(NAME, VANISHED)


class RealTimePort(KlipperSimulatorPort):
    """The same by the clock of this computer."""

    def __init__(self, simulator: KlipperSimulator) -> None:
        super().__init__(simulator)
        self._zero = time.monotonic() - simulator.now

    def read(self, timeout: float) -> bytes:
        """Return the received bytes after at most ``timeout`` s."""
        end = self.now() + timeout
        while True:
            self._catch_up()
            data = super().read(0.0)
            left = end - self.now()
            if data or left <= 0.0:
                return data
            time.sleep(min(left, LONGEST_SLEEP))

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._catch_up()
        super().write(data)

    def now(self) -> float:
        """Return the time of the simulator, s."""
        return time.monotonic() - self._zero

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(max(seconds, 0.0))
        self._catch_up()

    def _catch_up(self) -> None:
        self.simulator.advance(max(self.now(), self.simulator.now))


# The board ``klipper-sim``: the Klipper driver on the Klipper simulator.


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
        add_accelerometer(simulator, machine)
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


# The Klipper simulator at a pseudo-terminal, in real time.

STEP_S = 0.0005
"""Longest time between two advances of the simulator."""


class PtyServer(Terminal):
    """The terminal of a simulated board.

    Args:
        simulator: The board. Other threads may use it under ``lock``.
    """

    def __init__(self, simulator: KlipperSimulator) -> None:
        self.simulator = simulator
        self.lock = threading.Lock()
        super().__init__()
        self._thread.start()

    def _serve(self) -> None:
        simulator = self.simulator
        began = time.monotonic() - simulator.now
        while not self._ended.is_set():
            ready = select.select((self._ours,), (), (), STEP_S)[0]
            with self.lock:
                simulator.advance(max(simulator.now, time.monotonic() - began))
                if ready:
                    with contextlib.suppress(OSError):
                        simulator.write(os.read(self._ours, READ_SIZE))
                data = simulator.read()
            if data:
                # What a host does not read is lost, as at a serial port.
                with contextlib.suppress(OSError):
                    os.write(self._ours, data)
