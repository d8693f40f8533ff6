"""What the operator sees of a run."""

import pytest

from cnc.machine.load import load_machine
from cnc.model.operator_control import Control
from cnc.operate.machines import Readings
from cnc.operate.state_view import StateView
from cnc.session.run_pulses import Progress


@pytest.mark.parametrize(
    ("taken", "played", "shown"), [(20, 7, 7), (3, 0, 3)], ids=["ahead", "not known"]
)
def test_the_line_is_the_one_that_the_board_plays(taken, played, shown):
    """A board takes lines ahead of its motion: GRBL some 16."""
    view = StateView(load_machine(None))
    view.board = "grbl"
    view.begin("part.nc")
    view.progress(Progress(1.0, taken, taken, at=played), Readings())
    assert view.state("program", Control()).line == shown


@pytest.mark.parametrize("seconds", [0.0, 0.62])
def test_an_override_that_waits_is_told(seconds):
    view = StateView(load_machine(None))
    view.board = "stepper"
    view.begin("part.nc")
    view.progress(Progress(1.0, 3, 5, pending=seconds), Readings())
    assert view.state("program", Control(50.0)).pending == seconds
