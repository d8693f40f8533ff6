"""Sessions on the paced loopback board, the GRBL simulator, and two boards in virtual time."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from cnc.boards import loopback
from cnc.boards.stepper.driver import Stepper
from cnc.machine.load import load_machine
from cnc.operate import operator_session
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import shipped_cycles
from cnc.simulators.grbl import board as grbl_board
from cnc.simulators.grbl.ports import ScaledTime
from cnc.simulators.grbl.workpiece import HalfSpace, Workpiece
from cnc.simulators.klipper.ports import KlipperSimulatorBoard, KlipperSimulatorPort
from tests.support.boards import klipper_rig
from tests.support.boards.stepper_rig import FLOOD_PIN, INPUT_PINS, Part
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort


@dataclass
class Shop:
    """A session with a board that has a probe, a tool table and a part.

    Attributes:
        session: The session.
        put: Puts a surface at a machine place of Z, mm.
        spins: Whether the spindle turns.
    """

    session: OperatorSession
    put: Callable[[float], None]
    spins: Callable[[], bool]


class QuickClock:
    """The clock of this computer, ten times as fast."""

    @staticmethod
    def now():
        return 10.0 * time.monotonic()

    @staticmethod
    def sleep(seconds):
        time.sleep(seconds / 10.0)


@pytest.fixture
def quick_board(monkeypatch):
    """Let the simulated boards run faster than real ones: GRBL by 32, the loopback board by 10."""
    monkeypatch.setattr(grbl_board, "ScaledTime", functools.partial(ScaledTime, factor=32.0))
    monkeypatch.setattr(loopback, "SystemClock", QuickClock)


def with_files(machine, folder):
    """Return a machine with a parameter file, and a tool table that has the tools 1 and 2."""
    table = folder / "tools.tbl"
    table.write_text("T1 P1 Z0 D6\nT2 P2 Z0 D6\n")
    files = {"parameters": folder / "machine.var", "tool_table": table}
    return machine.model_copy(update={"program": machine.program.model_copy(update=files)})


@pytest.fixture
def pulse_machine(tmp_path):
    """The default machine with a parameter file."""
    machine = load_machine(None)
    program = machine.program.model_copy(update={"parameters": tmp_path / "machine.var"})
    return machine.model_copy(update={"program": program})


@pytest.fixture
def operator(pulse_machine):
    """Return a session with the paced loopback board."""
    with OperatorSession(pulse_machine) as session:
        session.connect("loopback").result(60)
        yield session


@pytest.fixture
def grbl_operator():
    """Return a session with the GRBL simulator in real time."""
    with OperatorSession(load_machine("grbl-uno")) as session:
        session.connect("grbl-sim").result(60)
        yield session


@pytest.fixture
def grbl_shop(tmp_path):
    """A shop with the GRBL simulator in real time."""
    machine = with_files(load_machine("grbl-uno"), tmp_path)
    with OperatorSession(machine, subroutines=[shipped_cycles()]) as session:
        session.connect("grbl-sim").result(60)
        core = session._worker.operated.board.simulator.core

        def put(z):
            core.environment.workpiece = Workpiece((HalfSpace((0.0, 0.0, 1.0), z),))

        yield Shop(session, put, lambda: core.rpm > 0.0)


@pytest.fixture
def klipper_shop(monkeypatch, tmp_path):
    """A shop with the Klipper simulator, in virtual time."""
    machine = with_files(klipper_rig.machine(), tmp_path)
    board = KlipperSimulatorBoard.from_machine(machine)
    simulator, pins = board.simulator, klipper_rig.pins(machine)

    def put(z):
        end = (-1, z * machine.axes["z"].steps_per_mm)
        level = klipper_rig.end_level(machine, simulator, "z", end)
        simulator.set_pin(str(pins.probe).strip("^!"), level)

    monkeypatch.setattr(operator_session, "open_live", lambda *_: board)
    with OperatorSession(
        machine, subroutines=[shipped_cycles()], clock=KlipperSimulatorPort(simulator)
    ) as session:
        session.connect("klipper-sim").result(60)
        yield Shop(session, put, lambda: simulator.value(pins.spindle.pin) > 0)


@pytest.fixture
def stepper_shop(monkeypatch, tmp_path):
    """A shop with the firmware of the stepper board, in virtual time."""
    machine = with_files(load_machine("stepper-uno"), tmp_path)
    simulator = Simulator()
    for pin in INPUT_PINS:
        simulator.set_pin(pin, 1)
    port = SimulatorPort(simulator)
    board = Stepper(port, machine, "the simulator", clock=port)

    def put(z):
        Part(simulator, round(z * machine.axes["z"].steps_per_mm), axis=2, towards=-1)

    monkeypatch.setattr(operator_session, "open_live", lambda *_: board)
    with OperatorSession(machine, subroutines=[shipped_cycles()], clock=port) as session:
        session.connect("stepper").result(60)
        # The simulator shows no level of the spindle's pulses: the coolant goes with it.
        yield Shop(session, put, lambda: simulator.level(FLOOD_PIN) > 0)


@pytest.fixture(params=["operator", "grbl_operator"])
def any_operator(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(params=["grbl_shop", "klipper_shop", "stepper_shop"])
def shop(request):
    return request.getfixturevalue(request.param)
