"""Homing of the GRBL simulator, and jogs before and after it."""

from __future__ import annotations

import pytest

from cnc.machine.load import load_machine
from cnc.machine.models import Homing
from cnc.model.diagnostics import UsageError
from cnc.operate.operator_session import OperatorSession

pytestmark = pytest.mark.usefixtures("quick_board")
PATIENCE = 60
QUICK = Homing(seek=30.0, latch=10.0, pull_off=1.0, end="high")


@pytest.fixture
def homing_machine():
    machine = load_machine("grbl-uno")
    axes = {
        letter: axis.model_copy(update={"travel": (-12.0, 0.0), "homing": QUICK})
        for letter, axis in machine.axes.items()
    }
    return machine.model_copy(update={"axes": axes})


def test_a_machine_with_homing_is_homed_before_it_jogs(homing_machine):
    with OperatorSession(homing_machine) as session:
        session.connect("grbl-sim").result(PATIENCE)
        assert session.state.state == "alarm"
        assert session.state.homed == {"x": False, "y": False, "z": False}
        with pytest.raises(UsageError, match="jog-unhomed"):
            session.jog_step({"x": -1.0})
        session.home().result(PATIENCE)
        assert session.state.state == "idle"
        assert session.state.homed == {"x": True, "y": True, "z": True}
        assert session.state.machine == pytest.approx({"x": -1.0, "y": -1.0, "z": -1.0}, abs=0.01)
        session.jog_step({"x": -2.0}).result(PATIENCE)
        assert session.state.machine["x"] == pytest.approx(-3.0, abs=0.01)
        with pytest.raises(UsageError, match="soft-limit"):
            session.jog_step({"x": -20.0})


def test_an_unlocked_machine_jogs_only_where_the_operator_says_so(homing_machine):
    with OperatorSession(homing_machine) as session:
        session.connect("grbl-sim").result(PATIENCE)
        session.unlock().result(PATIENCE)
        assert session.state.state == "idle"
        with pytest.raises(UsageError, match="jog-unhomed"):
            session.jog_step({"z": -1.0})
