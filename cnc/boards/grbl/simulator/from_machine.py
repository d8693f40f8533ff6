"""Settings of the GRBL simulator for the machine of a machine file."""

from __future__ import annotations

from cnc.boards.grbl.simulator.firmware_profile import (
    ACCELERATIONS,
    GRBL,
    GRBL_SETTINGS,
    GRBLHAL,
    RATES,
    STEPS,
    TRAVELS,
    FirmwareProfile,
)
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.units import per_minute


def axes_of(machine: Machine) -> str:
    """Return the letters of a board for the axes of a machine: X, Y, Z at least, C at most."""
    columns = [AXIS_LETTERS.index(letter) for letter in machine.axes]
    return "XYZABC"[: max(3, *(column + 1 for column in columns))]


def profile_of(machine: Machine) -> FirmwareProfile:
    """Return GRBL, or grblHAL for a machine with rotary axes, which GRBL does not have."""
    letters = axes_of(machine)
    return GRBL if len(letters) == 3 else GRBLHAL.with_axes(letters)


def settings_of(machine: Machine) -> dict[int, float]:
    """Return the ``$`` settings of the axes: steps/mm, mm/min, mm/s^2, travel in mm.

    A value that the machine file leaves open is that of a new board.
    """
    settings: dict[int, float] = {32: 1.0} if machine.kind == "laser" else {}
    for column, letter in enumerate(AXIS_LETTERS[: len(axes_of(machine))]):
        axis = machine.axes.get(letter)
        if axis is None:
            continue
        settings[STEPS + column] = axis.steps_per_mm
        settings[RATES + column] = per_minute(axis.max_velocity)
        settings[ACCELERATIONS + column] = (
            axis.max_acceleration
            or machine.path.max_tangential_acceleration
            or GRBL_SETTINGS[ACCELERATIONS]
        )
        if axis.travel is not None:
            settings[TRAVELS + column] = axis.travel[1] - axis.travel[0]
    return settings
