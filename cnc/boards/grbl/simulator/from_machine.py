"""Settings of the GRBL simulator for the machine of a machine file."""

from __future__ import annotations

from cnc.boards.grbl.simulator.firmware_profile import (
    ACCELERATIONS,
    GRBL_SETTINGS,
    RATES,
    STEPS,
    TRAVELS,
)
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.units import per_minute


def settings_of(machine: Machine) -> dict[int, float]:
    """Return the ``$`` settings of X, Y and Z: steps/mm, mm/min, mm/s^2, travel in mm.

    A value that the machine file leaves open is that of a new board.
    """
    settings: dict[int, float] = {32: 1.0} if machine.kind == "laser" else {}
    for column, letter in enumerate(AXIS_LETTERS[:3]):
        axis = machine.axes.get(letter)
        if axis is None:
            continue
        settings[STEPS + column] = axis.steps_per_mm
        settings[RATES + column] = per_minute(axis.max_velocity)
        settings[ACCELERATIONS + column] = (
            axis.max_acceleration
            or machine.path.max_tangential_acceleration
            or GRBL_SETTINGS[ACCELERATIONS + column]
        )
        if axis.travel is not None:
            settings[TRAVELS + column] = axis.travel[1] - axis.travel[0]
    return settings
