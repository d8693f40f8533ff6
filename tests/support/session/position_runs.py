"""Runs of a square on the GRBL simulator, for the position check."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cnc.api import Callbacks, Control, Report
from cnc.boards.grbl.driver import GrblBoard
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.session.runs import run_with

MACHINE = load_machine("grbl-uno")
BELOW_ZERO = MACHINE.model_copy(
    update={
        "axes": {
            letter: axis.model_copy(update={"travel": (-200.0, 0.0)})
            for letter, axis in MACHINE.axes.items()
        }
    }
)
"""The machine whose zero is at its switches, where the cycle of GRBL puts it."""
FAST = {110: 5000.0, 111: 5000.0, 112: 5000.0, 120: 500.0, 121: 500.0, 122: 500.0}
SWITCHES = FAST | {22: 1.0, 24: 500.0, 25: 4000.0, 27: 1.0}
SQUARE = "G21 G90\nG0 Z2\nG1 X6 F2000\nG1 Z-1 F600\nG1 X12 F100\nG1 Y8 F1500\nG1 X4\nG1 Y3\nM2\n"
END = (4.0, 3.0, -1.0)


def tool(simulator: GrblSimulator) -> tuple[float, ...]:
    """Return the position of the tool from its first position; the board counts from its start."""
    began = simulator.core.environment.of_travels(*simulator.core.per_axis(130)).offset
    return tuple(
        round(p + o - b, 3)
        for p, o, b in zip(
            simulator.position, simulator.core.environment.offset, began, strict=True
        )
    )


def ran(simulator: GrblSimulator, program: Path, **arguments: object) -> Report:
    """Run a program on a port that keeps DTR high, as the serial port does."""
    return run_on(simulator, program, MACHINE, **arguments)


def run_on(
    simulator: GrblSimulator, program: Path, machine: Machine, **arguments: object
) -> Report:
    """Do the same with another machine."""
    with connected(simulator, machine) as board:
        board.check_only = bool(arguments.get("check_on_board"))
        return run_with(program, machine, board=board, **arguments)


@contextmanager
def connected(simulator: GrblSimulator, machine: Machine = MACHINE) -> Iterator[GrblBoard]:
    """Connect to the simulator, and close the port afterwards."""
    port = GrblSimulatorPort(simulator, hang_up=False)
    board = GrblBoard(port, machine, port.clock, "the simulator", identity="the simulator")
    board.connect()
    try:
        yield board
    finally:
        board.close()


def refused(report: Report) -> str:
    """Return message and hint of the only fault, ``position-lost``."""
    (fault,) = report.faults
    assert fault.diagnostic.code == "position-lost", fault.diagnostic
    assert fault.exit_code == 3
    return f"{fault.diagnostic.message}\n{fault.diagnostic.hint}"


def stopping(control: Control, at_x: float) -> Callbacks:
    def on_sent(sent: Progress) -> None:
        if sent.position is not None and sent.position[0] > at_x:
            control.stop()

    return Callbacks(on_sent=on_sent)
