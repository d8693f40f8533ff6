"""Homing of a GRBL board, and the position that it confirms."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import Control, HomingStopped, Report, home
from cnc.model.diagnostics import BoardError, UsageError
from cnc.session.position_check import LastPosition
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.session.position_runs import (
    BELOW_ZERO,
    FAST,
    MACHINE,
    SQUARE,
    SWITCHES,
    connected,
    ran,
    refused,
    run_on,
)

pytestmark = pytest.mark.usefixtures("nothing_kept")


def test_homing_restores_the_position(square: Path, tmp_path: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    homing = tmp_path / "home.nc"
    homing.write_text("$H\n")
    square.write_text("G21 G90\nG1 X-50 Y-50 Z-20 F2000\nM2\n")

    def go(name: Path) -> Report:
        return run_on(simulator, name, BELOW_ZERO, dialect="grbl")

    for _ in range(2):
        assert not go(homing).faults
        assert not go(square).faults, "a board that has homed is not locked"
        assert simulator.position == pytest.approx((-50.0, -50.0, -20.0))
        simulator.power_up()
        said = refused(go(square))
        assert "home the machine with cncrun home" in said
    simulator.core.environment.broken.add("Z")
    assert [fault.diagnostic.code for fault in go(homing).faults] == ["board-alarm"]
    assert refused(go(square)), "a homing that fails finds nothing"


def home_alone(
    simulator: GrblSimulator, *axes: str, control: Control | None = None
) -> dict[str, float | None]:
    with connected(simulator) as board:
        return home(MACHINE, axes, board=board, control=control)


def test_cncrun_home_homes_a_grbl_board() -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    for _ in range(2):
        assert home_alone(simulator) == {"x": -1.0, "y": -1.0, "z": -1.0}
        kept = LastPosition.read("the simulator")
        assert kept is not None and (kept.position, kept.lost) == (
            {"x": -1.0, "y": -1.0, "z": -1.0},
            False,
        )
        assert simulator.core.state == "Idle"
        simulator.power_up()
    with pytest.raises(UsageError) as caught:
        home_alone(simulator, "x")
    assert caught.value.diagnostic.code == "board-homes-all"


def test_a_homing_that_fails_or_is_stopped_leaves_the_position_lost() -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    home_alone(simulator)
    simulator.core.environment.broken.add("Z")
    with pytest.raises(BoardError) as caught:
        home_alone(simulator)
    assert caught.value.diagnostic.code == "board-alarm"
    kept = LastPosition.read("the simulator")
    assert kept is not None and kept.lost
    stopped = GrblSimulator(settings=SWITCHES)
    control = Control()
    control.stop()
    with pytest.raises(HomingStopped):
        home_alone(stopped, control=control)
    assert not stopped.moves


def test_a_board_that_refuses_to_home_keeps_its_position(square: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, square).ok
    for _ in range(2):
        with pytest.raises(BoardError) as caught:
            home_alone(simulator)
        assert caught.value.diagnostic.code == "board-error"
    assert ran(simulator, square).ok
    simulator.power_up()
    square.write_text("$H\n" + SQUARE)
    assert [fault.diagnostic.code for fault in ran(simulator, square, dialect="grbl").faults] == [
        "board-error"
    ]
    square.write_text(SQUARE)
    refused(ran(simulator, square))
