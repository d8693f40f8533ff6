"""Sessions on the paced loopback board and on the GRBL simulator in real time."""

from __future__ import annotations

import functools

import pytest

from cnc.machine.load import load_machine
from cnc.operate.operator_session import OperatorSession
from cnc.simulators.grbl import ports
from cnc.simulators.grbl.ports import ScaledTime


@pytest.fixture
def quick_board(monkeypatch):
    """Let the GRBL simulator run eight times as fast as a board."""
    monkeypatch.setattr(ports, "ScaledTime", functools.partial(ScaledTime, factor=8.0))


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


@pytest.fixture(params=["operator", "grbl_operator"])
def any_operator(request):
    return request.getfixturevalue(request.param)
