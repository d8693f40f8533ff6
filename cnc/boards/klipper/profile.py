"""Facts about a microcontroller that decide which programs it can play."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.boards.klipper.guards import REST_S
from cnc.boards.klipper.protocol.dictionary import Dictionary
from cnc.boards.klipper.simulator.firmware import FIRMWARES, Firmware
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError

USB_BYTES_PER_S = 400_000.0
"""Bytes per second that a full-speed USB device takes for certain."""
CAREFUL_STEP_S = 10e-6
"""Time of a step on a microcontroller that is not known."""


@dataclass(frozen=True, slots=True)
class Profile:
    """A microcontroller.

    Attributes:
        frequency: Ticks of its clock per second.
        slots: Entries of its move queue.
        bytes_per_s: Bytes per second on the wire.
        step_s: Time that a step takes, s.
        pulse_s: Time for which a step pin stays high, and low after that, s.
    """

    frequency: float
    slots: int
    bytes_per_s: float
    step_s: float
    pulse_s: float = 0.0


def firmware_of(machine: Machine) -> Firmware:
    """Return the microcontroller of the machine file.

    Raises:
        UsageError: ``klipper-mcu``, if it is not known.
    """
    name = machine.board.klipper.mcu if machine.board.klipper is not None else "rp2040"
    if name not in FIRMWARES:
        hint = f"board.klipper.mcu is one of {', '.join(FIRMWARES)}"
        message = f"there is no model of the microcontroller {name!r}"
        raise UsageError(Diagnostic("klipper-mcu", message, hint=hint))
    return FIRMWARES[name]


def profile_of(machine: Machine, dictionary: Dictionary | None = None, slots: int = 0) -> Profile:
    """Return the profile of a board, else of the microcontroller of the machine file."""
    if dictionary is None:
        known = firmware_of(machine)
        wire = known.baud / 10 if known.baud else USB_BYTES_PER_S
        step_s = _step_s(machine, known)
        return Profile(known.frequency, known.slots, wire, step_s, machine.board.step_pulse)
    frequency = dictionary.constant("CLOCK_FREQ")
    baud = dictionary.constant("SERIAL_BAUD", 0.0)
    step_s = next(
        (
            _step_s(machine, each)
            for each in FIRMWARES.values()
            if each.mcu == dictionary.constants.get("MCU")
        ),
        CAREFUL_STEP_S,
    )
    wire = baud / 10 if baud else USB_BYTES_PER_S
    return Profile(frequency, slots, wire, step_s, machine.board.step_pulse)


def _step_s(machine: Machine, firmware: Firmware) -> float:
    """Return the time that a step takes with the pulse of the machine, s.

    The samples of the switches and of the e-stop take a share of the processor's time.
    """
    known, inputs = machine.board.klipper, 0
    if known is not None:
        axes = [known.axis(letter) for letter in machine.axes]
        inputs = sum(len(axis.endstop or ()) for axis in axes if axis is not None)
        inputs += known.emergency_stop is not None
    pulse = round(machine.board.step_pulse * firmware.frequency)
    event = firmware.event_time(pulse, inputs / (REST_S * firmware.frequency))
    return firmware.events(pulse) * event / firmware.frequency
