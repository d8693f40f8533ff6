"""Homing of a GRBL board, and the position that it confirms."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import Control, HomingStopped, Report, home
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.boards.grbl.simulator.ports import GrblSimulatorPort
from cnc.model.diagnostics import BoardError, UsageError
from cnc.session.last_position import LastPosition
from tests.support.session.position_runs import (
    FAST,
    MACHINE,
    SQUARE,
    SWITCHES,
    ran,
    refused,
)
from tests.support.session.runs import run_with


@pytest.fixture(autouse=True)
def nothing_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "p.ngc").write_text(SQUARE)
    return tmp_path / "p.ngc"


def test_homing_restores_the_position(program: Path, tmp_path: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    homing = tmp_path / "home.nc"
    homing.write_text("$H\n")
    program.write_text("G21 G90\nG1 X-50 Y-50 Z-20 F2000\nM2\n")
    machine = MACHINE.model_copy(
        update={
            "axes": {
                letter: axis.model_copy(update={"travel": (-200.0, 0.0)})
                for letter, axis in MACHINE.axes.items()
            }
        }
    )

    def go(name: Path, **arguments: object) -> Report:
        port = GrblSimulatorPort(simulator, hang_up=False)
        board = GrblBoard(port, machine, port.clock, "the simulator", identity="the simulator")
        board.connect()
        try:
            return run_with(name, machine, board=board, dialect="grbl", **arguments)
        finally:
            board.close()

    for _ in range(2):
        assert not go(homing).faults
        assert not go(program).faults, "a board that has homed is not locked"
        assert simulator.position == pytest.approx((-50.0, -50.0, -20.0))
        simulator.power_up()
        said = refused(go(program))
        assert "home the machine with cncrun home" in said
    simulator.core.environment.broken.add("Z")
    assert [fault.diagnostic.code for fault in go(homing).faults] == ["board-alarm"]
    assert refused(go(program)), "a homing that fails finds nothing"


def home_alone(
    simulator: GrblSimulator, *axes: str, control: Control | None = None
) -> dict[str, float | None]:
    port = GrblSimulatorPort(simulator, hang_up=False)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator", identity="the simulator")
    board.connect()
    try:
        return home(MACHINE, axes, board=board, control=control)
    finally:
        board.close()


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


def test_a_board_that_refuses_to_home_keeps_its_position(program: Path) -> None:
    simulator = GrblSimulator(settings=FAST)
    assert ran(simulator, program).ok
    for _ in range(2):
        with pytest.raises(BoardError) as caught:
            home_alone(simulator)
        assert caught.value.diagnostic.code == "board-error"
    assert ran(simulator, program).ok
    simulator.power_up()
    program.write_text("$H\n" + SQUARE)
    assert [fault.diagnostic.code for fault in ran(simulator, program, dialect="grbl").faults] == [
        "board-error"
    ]
    program.write_text(SQUARE)
    refused(ran(simulator, program))
