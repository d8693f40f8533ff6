"""Limits of a GRBL board that decide how long its moves take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from cnc.grbl_lines.number_format import board_axes
from cnc.machine.models import Machine
from cnc.model.units import per_second

PLANNER_MOVES = 15
"""Moves that GRBL's planner holds."""
MOVES_AHEAD = PLANNER_MOVES - 1
"""Moves that it knows on average when it begins one: the last place is free while the next line is
read.
"""
JUNCTION_DEVIATION, ARC_TOLERANCE = 11, 12
STEPS, MAX_RATE, ACCELERATION = 100, 110, 120
"""Numbers of GRBL's settings; the last three are those of the X axis."""


@dataclass(frozen=True, slots=True)
class BoardLimits:
    """The limits of a board.

    Attributes:
        rates: Highest rate of each axis of the board, mm/s ($110..).
        accelerations: Acceleration of each axis, mm/s^2 ($120..).
        junction_deviation: $11, mm.
        arc_tolerance: $12, mm.
        blocks: Moves that the planner looks ahead.
        steps: Steps/mm of each axis ($100..), 0 where they are not known. A board plans with whole
            steps: these turn short moves a little, and it slows down at every turn.
        baud: Speed of the wire to the board, bit/s; 0 if lines take no time.
    """

    rates: tuple[float, ...]
    accelerations: tuple[float, ...]
    junction_deviation: float = 0.01
    arc_tolerance: float = 0.002
    blocks: int = MOVES_AHEAD
    steps: tuple[float, ...] = ()
    baud: int = 0

    @classmethod
    def of_machine(cls, machine: Machine) -> BoardLimits:
        """Return the limits in a machine file; GRBL's defaults for the others."""
        along = machine.path.max_tangential_acceleration or math.inf
        axes = [machine.axes.get(letter) for letter in board_axes(machine.axes)]
        rates = [math.inf if axis is None else axis.max_velocity for axis in axes]
        accelerations = [
            math.inf if axis is None else axis.max_acceleration or along for axis in axes
        ]
        steps = tuple(0.0 if axis is None else axis.steps_per_mm for axis in axes)
        return cls(tuple(rates), tuple(accelerations), steps=steps, baud=machine.board.baud)

    @classmethod
    def of_board(
        cls, machine: Machine, settings: Mapping[int, float], places: int = 0
    ) -> BoardLimits:
        """Return the limits that a board reports.

        Args:
            machine: The machine file; its limits replace those that the board does not report.
            settings: The answer to ``$$``: number and value of each setting.
            places: Moves that its planner holds; 0 where it is not known.
        """
        own = cls.of_machine(machine)
        return cls(
            tuple(
                per_second(settings[MAX_RATE + k]) if settings.get(MAX_RATE + k) else rate
                for k, rate in enumerate(own.rates)
            ),
            tuple(
                settings.get(ACCELERATION + k) or acceleration
                for k, acceleration in enumerate(own.accelerations)
            ),
            settings.get(JUNCTION_DEVIATION, own.junction_deviation),
            settings.get(ARC_TOLERANCE) or own.arc_tolerance,
            places - 1 if places > 1 else own.blocks,
            steps=tuple(settings.get(STEPS + k) or steps for k, steps in enumerate(own.steps)),
            baud=own.baud,
        )
