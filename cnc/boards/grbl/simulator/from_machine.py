"""Settings of the GRBL simulator for the machine of a machine file."""

from __future__ import annotations

from cnc.boards.grbl.simulator.firmware_profile import (
    ACCELERATIONS,
    GRBL,
    GRBL_SETTINGS,
    GRBLHAL,
    RATES,
    ROTARY,
    STEPS,
    TRAVELS,
    FirmwareProfile,
)
from cnc.machine.models import Homing, Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.units import per_minute

SOFT_LIMITS, HARD_LIMITS, HOMING, HOMING_DIRECTION = 20, 21, 22, 23
HOMING_FEED, HOMING_SEEK, PULL_OFF = 24, 25, 27


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

    A value that the machine file leaves open is that of a new board. Homing and limits are on
    where the machine file describes limit switches.
    """
    settings: dict[int, float] = {32: 1.0} if machine.kind == "laser" else {}
    if machine.can_home:
        settings |= _homing(machine)
    letters = axes_of(machine)
    if len(letters) > 3:
        settings[ROTARY] = float((1 << (len(letters) - 3)) - 1)
    for column, letter in enumerate(AXIS_LETTERS[: len(letters)]):
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


def _homing(machine: Machine) -> dict[int, float]:
    """Return the settings of homing and limits: the lowest speeds and pull-off of the axes."""
    downwards, each = 0, []
    for column, letter in enumerate(AXIS_LETTERS[: len(axes_of(machine))]):
        axis = machine.axes.get(letter)
        if axis is not None:
            homing = axis.homing or Homing()
            each.append(homing)
            low = (homing.end or ("high" if letter == "z" else "low")) == "low"
            downwards |= low << column
    return {
        SOFT_LIMITS: 1.0,
        HARD_LIMITS: 1.0,
        HOMING: 1.0,
        HOMING_DIRECTION: float(downwards),
        HOMING_FEED: per_minute(min(homing.latch for homing in each)),
        HOMING_SEEK: per_minute(min(homing.seek for homing in each)),
        PULL_OFF: min(homing.pull_off for homing in each),
    }
