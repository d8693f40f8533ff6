"""The board ``grbl-sim``: the GRBL driver on the GRBL simulator, in virtual time.

It stands alone because the simulator itself shares no code with the driver, whose errors it finds.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.line_stream import LineStream
from cnc.boards.protocols import BoardTraits
from cnc.machine.models import Machine
from cnc.simulators.grbl.firmware_profile import profile_of, settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import NAME, GrblSimulatorPort, ScaledTime

PAUSE = 0.02
"""Real seconds for the operator between two steps of virtual time while the run is held."""


class SimulatorStream(LineStream):
    """A stream of lines that leaves the operator real time while the run is held."""

    def serve(self, timeout: float, *, poll: float | None = None) -> None:
        """Receive, after a short real pause while the run is held; see LineStream."""
        if self.held:
            time.sleep(PAUSE)
        super().serve(timeout, poll=poll)


class GrblSimulatorBoard(GrblBoard):
    """A simulated board with the axes of a machine file, at machine zero."""

    traits = BoardTraits(has_port=False, simulated=True, has_settings=True)
    stream_type = SimulatorStream
    simulator: GrblSimulator

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> GrblSimulatorBoard:
        """Return a new connected board."""
        simulator = GrblSimulator(profile_of(machine), settings=settings_of(machine))
        return cls._connected(machine, GrblSimulatorPort(simulator))

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> GrblSimulatorBoard:
        """Return a new connected board, whose clock is that of the computer."""
        simulator = GrblSimulator(profile_of(machine), settings=settings_of(machine))
        port = GrblSimulatorPort(simulator, ScaledTime(simulator), boot_time=0.0)
        return cls._connected(machine, port)

    @classmethod
    def _connected(cls, machine: Machine, port: GrblSimulatorPort) -> GrblSimulatorBoard:
        board = cls(port, machine, port.clock, NAME)
        board.simulator = port.simulator
        board.connect()
        return board
