"""Limits of a GRBL board that decide how long its moves take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from cnc.machine.models import Machine
from cnc.model.units import per_second

BLOCKS_AHEAD = 15
JUNCTION_DEVIATION, ARC_TOLERANCE = 11, 12
MAX_RATE, ACCELERATION = 110, 120
"""Numbers of GRBL's settings; the last two are those of the X axis."""


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """The limits of a board.

    Attributes:
        rates: Highest rate of x, y, z, mm/s ($110 to $112).
        accelerations: Acceleration of x, y, z, mm/s^2 ($120 to $122).
        junction_deviation: $11, mm.
        arc_tolerance: $12, mm.
        blocks: Moves that the planner holds.
    """

    rates: tuple[float, float, float]
    accelerations: tuple[float, float, float]
    junction_deviation: float = 0.01
    arc_tolerance: float = 0.002
    blocks: int = BLOCKS_AHEAD

    @classmethod
    def of_machine(cls, machine: Machine) -> BoardLimits:
        """Return the limits in a machine file; GRBL's defaults for the others."""
        along = machine.path.max_tangential_acceleration or math.inf
        axes = [machine.axes.get(letter) for letter in ("x", "y", "z")]
        rates = [math.inf if axis is None else axis.max_velocity for axis in axes]
        accelerations = [
            math.inf if axis is None else axis.max_acceleration or along for axis in axes
        ]
        return cls(
            (rates[0], rates[1], rates[2]),
            (accelerations[0], accelerations[1], accelerations[2]),
        )

    @classmethod
    def of_board(cls, machine: Machine, settings: Mapping[int, float]) -> BoardLimits:
        """Return the limits that a board reports.

        Args:
            machine: The machine file; its limits replace those that the board does not report.
            settings: The answer to ``$$``: number and value of each setting.
        """
        own = cls.of_machine(machine)
        x, y, z = (
            per_second(settings[MAX_RATE + k]) if settings.get(MAX_RATE + k) else own.rates[k]
            for k in range(3)
        )
        a, b, c = (settings.get(ACCELERATION + k) or own.accelerations[k] for k in range(3))
        return cls(
            (x, y, z),
            (a, b, c),
            settings.get(JUNCTION_DEVIATION, own.junction_deviation),
            settings.get(ARC_TOLERANCE) or own.arc_tolerance,
        )
