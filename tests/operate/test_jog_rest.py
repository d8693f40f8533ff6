"""Time from the release of a jog, or from the last sign of life of its client, to the last step.

The boards run in virtual time, and all times are those of their clocks: the load of this computer
changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cnc.boards.loopback import PacedLoopback
from cnc.boards.stepper.driver import Stepper
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.operate import operator_session
from cnc.operate.jogging import REST_TIME
from cnc.operate.operator_session import OperatorSession
from cnc.operate.program_session import KEEP_ALIVE, Jog
from cnc.simulators.grbl.board import GrblSimulatorBoard
from cnc.simulators.klipper.ports import KlipperSimulatorBoard
from tests.support.boards.stepper_rig import INPUT_PINS
from tests.support.boards.stepper_simulator import FREQUENCY, Simulator, SimulatorPort
from tests.support.soak import share

LOST = 0.5
"""Time from the last sign of life to rest, s."""
SIGN = 0.06
"""Time between two signs of life of the page, s."""
PATIENCE = 120

Rig = tuple[Machine, Any, Any, Callable[[], float]]
"""Machine, board, its clock, and the time of its last step, s."""


class VirtualClock:
    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


class ClockOf:
    """The clock of a simulator that has its own port."""

    def __init__(self, simulator: Any) -> None:
        self._simulator = simulator

    def now(self) -> float:
        return float(self._simulator.now)


def loopback() -> Rig:
    machine, clock = load_machine(None), VirtualClock()
    ends: list[float] = []

    class Recorder(PacedLoopback):
        def send(self, chunk: Any) -> None:
            super().send(chunk)
            if len(chunk.time_ns):
                ends.append(self._zero + float(chunk.time_ns[-1]) * 1e-9)

    return machine, Recorder(machine, [0.0] * 3, clock), clock, lambda: ends[-1]


def stepper() -> Rig:
    machine, simulator = load_machine("stepper-uno"), Simulator()
    for pin in INPUT_PINS:
        simulator.set_pin(pin, 1)
    port = SimulatorPort(simulator)
    board = Stepper(port, machine, "the simulator", clock=port)
    return machine, board, port, lambda: float(simulator.moves()[0][-1]) / FREQUENCY


def klipper() -> Rig:
    machine = load_machine("klipper-uno")
    board = KlipperSimulatorBoard.from_machine(machine)
    simulator = board.simulator

    def last() -> float:
        each = (int(np.abs(parts[-1]).max()) for parts in simulator.edges_of.values())
        return max(map(simulator.time_of, each))

    return machine, board, ClockOf(simulator), last


def grbl() -> Rig:
    machine = load_machine("grbl-uno")
    board = GrblSimulatorBoard.from_machine(machine)
    simulator = board.simulator

    def last() -> float:
        return max(each.time + each.duration for move in simulator.moves for each in move.phases)

    return machine, board, ClockOf(simulator), last


class ScriptedJog(Jog):
    """A jog whose client gives signs of life by the clock of the board, until it is lost."""

    release_after = lost_after = math.inf

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.began = self.sign = -math.inf

    @property
    def held(self) -> bool:
        now = self._clock.now()
        if self.began < 0.0:
            self.began = self.sign = now
            self.keep_alive()
        elif now - self.began >= self.release_after:
            self.release()
        elif now - self.sign >= SIGN and now - self.began < self.lost_after:
            self.sign = now
            self.keep_alive()
        return super().held


@pytest.fixture(params=[loopback, stepper, klipper, grbl], ids=lambda make: make.__name__)
def rig(request, monkeypatch, tmp_path):
    machine, board, clock, last = request.param()
    program = machine.program.model_copy(update={"parameters": tmp_path / "machine.var"})
    monkeypatch.setattr(operator_session, "open_live", lambda *_: board)
    monkeypatch.setattr(operator_session, "Jog", ScriptedJog)
    return machine.model_copy(update={"program": program}), clock, last


def jogged(rig) -> tuple[ScriptedJog, float]:
    """Jog until the end; return the jog, and the time of the last step."""
    machine, clock, last = rig
    with OperatorSession(machine, clock=clock) as session:
        session.connect("loopback").result(PATIENCE)
        jog = session.jog({"x": 1.0}, unhomed=True)
        jog.ended.result(PATIENCE)
        assert isinstance(jog, ScriptedJog)
        return jog, last()


@pytest.mark.parametrize("after", share([0.03, 0.173, 0.611], [0.03, 0.611]))
def test_a_released_jog_rests_in_time(rig, monkeypatch, after):
    monkeypatch.setattr(ScriptedJog, "release_after", after)
    jog, rest = jogged(rig)
    assert rest - (jog.began + after) <= REST_TIME


@pytest.mark.parametrize("after", [0.0, 0.4][:: share(1, 2)])
def test_the_jog_of_a_lost_client_rests_in_time(rig, monkeypatch, after):
    monkeypatch.setattr(ScriptedJog, "lost_after", after)
    jog, rest = jogged(rig)
    assert KEEP_ALIVE < rest - jog.sign <= LOST
