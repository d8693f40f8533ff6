"""Jogs of a stepper board that does not know its position, in virtual time."""

from __future__ import annotations

import pytest

from cnc.boards.stepper.driver import Stepper
from cnc.machine.load import load_machine
from cnc.machine.models import HomingOrder
from cnc.operate import operator_session
from cnc.operate.operator_session import OperatorSession
from tests.support.boards.stepper_rig import INPUT_PINS
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort

PATIENCE = 60


@pytest.fixture(params=[False, True], ids=["no switches", "switches"])
def session(request, monkeypatch, tmp_path):
    """A session with a board that was just switched on; whether its machine can home."""
    machine = load_machine("stepper-uno")
    program = machine.program.model_copy(update={"parameters": tmp_path / "machine.var"})
    homing = HomingOrder() if request.param else None
    machine = machine.model_copy(update={"program": program, "homing": homing})
    assert machine.can_home == request.param
    simulator = Simulator()
    for pin in INPUT_PINS:
        simulator.set_pin(pin, 1)
    port = SimulatorPort(simulator)
    board = Stepper(port, machine, "the simulator", clock=port)
    monkeypatch.setattr(operator_session, "open_live", lambda *_: board)
    with OperatorSession(machine, clock=port) as opened:
        opened.connect("stepper").result(PATIENCE)
        yield opened


def test_the_position_follows_the_jogs(session):
    for wanted in (0.5, 1.0):
        session.jog_step({"x": 0.5}, unhomed=True).result(PATIENCE)
        assert session.state.machine == pytest.approx({"x": wanted, "y": 0.0, "z": 0.0})
    # Only homing finds the position of a machine with switches.
    assert session.state.homed == (
        {"x": False, "y": False, "z": False} if session.machine.can_home else {}
    )


def test_an_entered_line_begins_where_the_jog_ended(session):
    session.jog_step({"x": 1.0}, unhomed=True).result(PATIENCE)
    ended = session.mdi("G91 G0 X-0.25").result(PATIENCE)
    assert (ended.exit_code == 0) != session.machine.can_home
    assert session.state.machine["x"] == pytest.approx(1.0 if session.machine.can_home else 0.75)
