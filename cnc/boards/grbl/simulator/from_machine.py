"""The simulator as a machine file describes it: a board that has been set up for that machine."""

from __future__ import annotations

from cnc.boards.grbl.simulator.firmware_profile import GRBL_SETTINGS
from cnc.machine.models import Machine
from cnc.model.blocks import AxisLetter

AXES: tuple[AxisLetter, ...] = ("x", "y", "z")
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130


def settings_of(machine: Machine) -> dict[int, float]:
    """``$`` settings for X, Y, Z: steps/mm, mm/min, mm/s^2, travel in mm; what the file leaves open
    stays as on a fresh board.
    """
    settings: dict[int, float] = {}
    for index, name in enumerate(AXES):
        axis = machine.axes.get(name)
        if axis is None:
            continue
        acceleration = (
            axis.max_acceleration
            or machine.path.max_tangential_acceleration
            or GRBL_SETTINGS[ACCELERATION + index]
        )
        settings[STEPS + index] = axis.steps_per_mm
        settings[RATE + index] = axis.max_velocity * 60.0
        settings[ACCELERATION + index] = acceleration
        if axis.travel is not None:
            settings[TRAVEL + index] = axis.travel[1] - axis.travel[0]
    return settings
