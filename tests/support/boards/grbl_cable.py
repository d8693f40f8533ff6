"""A GRBL simulator at a cable that commands of this process open by name, in virtual time.

A pseudo-terminal shows the same to a command, but then each connection waits for seconds of the
real clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from cnc.boards.port import port_lost
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort, VirtualTime


class _End(GrblSimulatorPort):
    """The host's end of the cable, which tells whether it is closed."""

    closed = False

    def close(self) -> None:
        super().close()
        self.closed = True


class GrblCable:
    """The cable of a simulated board. It keeps DTR high when it is closed, as a serial port does.

    Attributes:
        name: The name under which commands open it.
        simulator: The board.
        opened: How often it was opened.
    """

    name = "the-cable"

    def __init__(self, simulator: GrblSimulator) -> None:
        self.simulator = simulator
        self.opened = 0
        self._port: _End | None = None

    def open(self, name: str, _baud: int = 0) -> GrblSimulatorPort:
        """Open the cable, in place of ``open_port``.

        Raises:
            PortLost: Another name, or the cable is open already.
        """
        if name != self.name:
            raise port_lost(name, "no such cable")
        if self.is_open:
            raise port_lost(name, "the cable is in use")
        self.opened += 1
        self._port = _End(self.simulator, hang_up=False)
        return self._port

    @property
    def is_open(self) -> bool:
        """Whether a command has the cable open."""
        return self._port is not None and not self._port.closed


@contextmanager
def grbl_cable(simulator: GrblSimulator) -> Iterator[GrblCable]:
    """Provide the cable to the commands of this process."""
    cable = GrblCable(simulator)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("cnc.boards.grbl.driver", "cnc.boards.discovery"):
            patch.setattr(f"{module}.open_port", cable.open)
            patch.setattr(f"{module}.SystemClock", lambda: VirtualTime(simulator))
        yield cable
