"""``--board grbl-sim``: the GRBL driver on the board in the simulator, in virtual time, as fast as it
computes.
"""

from __future__ import annotations

import time
from pathlib import Path

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.settings import ACCELERATIONS, RATES, STEPS, TRAVELS
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.boards.grbl.simulator.ports import GrblSimulatorPort
from cnc.boards.protocols import BoardTraits
from cnc.machine.models import Machine
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.units import per_minute

AXES = AXIS_LETTERS[:3]
NAP = 0.02
"""Seconds that pass for the operator while the simulator waits for him, and no time passes in it."""


class GrblSimulatorBoard(GrblBoard):
    """A board with the axes of a machine file, at machine zero. ``simulator``: what it is made of."""

    traits = BoardTraits(has_port=False, takes_lines=True)
    simulator: GrblSimulator

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> GrblSimulatorBoard:
        """A fresh one, connected."""
        settings: dict[int, float] = {}
        for column, letter in enumerate(AXES):
            axis = machine.axes.get(letter)
            if axis is None:
                continue
            settings[STEPS + column] = axis.steps_per_mm
            settings[RATES + column] = per_minute(axis.max_velocity)
            if axis.max_acceleration is not None:
                settings[ACCELERATIONS + column] = axis.max_acceleration
            if axis.travel is not None:
                settings[TRAVELS + column] = axis.travel[1] - axis.travel[0]
        simulator = GrblSimulator(settings=settings)
        port = GrblSimulatorPort(simulator)
        board = cls(port, machine, port.clock, "the board in the simulator")
        board.simulator = simulator
        board.connect()
        return board

    def _serve(self, timeout: float, *, fast: bool = False) -> None:
        if self._requests is not None and self._requests.control.held:
            time.sleep(NAP)
        super()._serve(timeout, fast=fast)
