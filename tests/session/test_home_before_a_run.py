"""``--home`` on a GRBL board: the board homes after the check and before the program."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import Callbacks, Control, HomingStopped, Report
from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL, FirmwareProfile
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.session.position_runs import BELOW_ZERO, SWITCHES, refused, run_on

PROGRAM = "G21 G90\nG0 X-20 Y-30\nG1 Z-5 F600\nG1 X-40 F1500\nG1 Y-50\nM2\n"
END = (-40.0, -50.0, -5.0)
HOMED = (-1.0, -1.0, -1.0)


pytestmark = pytest.mark.usefixtures("nothing_kept")


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "p.nc").write_text(PROGRAM)
    return tmp_path / "p.nc"


def ran(simulator: GrblSimulator, program: Path, **arguments: object) -> Report:
    return run_on(simulator, program, BELOW_ZERO, **arguments)


def homed_run(simulator: GrblSimulator, program: Path, **arguments: object) -> Report:
    return ran(simulator, program, home=True, **arguments)


def homings(simulator: GrblSimulator) -> int:
    return sum(event.kind == "line" and event.value == "$H" for event in simulator.events)


@pytest.mark.parametrize(("profile", "homing"), [(GRBL, 1.0), (GRBLHAL, 7.0)])
def test_a_locked_board_is_homed_then_runs(
    profile: FirmwareProfile, homing: float, program: Path
) -> None:
    simulator = GrblSimulator(profile, settings=SWITCHES | {22: homing})
    (locked,) = ran(simulator, program).faults
    assert locked.diagnostic.code == "board-locked"
    report = homed_run(simulator, program)
    assert report.ok, report.faults
    assert simulator.position == pytest.approx(END, abs=0.01)
    assert report.end_position == pytest.approx(dict(zip("xyz", END, strict=True)), abs=0.01)
    first = next(move for move in simulator.moves if move.kind == "rapid")
    assert first.start == pytest.approx(HOMED, abs=0.01)
    assert homings(simulator) == 1


def test_a_program_with_an_error_does_not_home(program: Path) -> None:
    program.write_text(PROGRAM.replace("X-40", "X-4000"))
    simulator = GrblSimulator(settings=SWITCHES | {20: 1.0})
    assert not homed_run(simulator, program).ok
    assert not simulator.moves


def test_homing_clears_a_lost_position(program: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    assert homed_run(simulator, program).ok
    simulator.drop_dtr()
    assert "--home" in refused(ran(simulator, program))
    assert homed_run(simulator, program).ok
    assert simulator.position == pytest.approx(END, abs=0.01)
    assert ran(simulator, program).ok


def test_from_a_line_after_homing(program: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    report = homed_run(simulator, program, from_line=5)
    assert report.ok, report.faults
    assert simulator.position == pytest.approx(END, abs=0.01)
    assert max(move.end[2] for move in simulator.moves if move.kind == "rapid") <= HOMED[2] + 0.01


def test_a_board_without_homing_refuses_and_does_not_move(program: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES | {22: 0.0})
    (fault,) = homed_run(simulator, program).faults
    assert (fault.diagnostic.code, fault.diagnostic.line) == ("board-error", 0)
    assert "homing is switched off" in fault.diagnostic.message
    assert not simulator.moves


def test_a_check_on_the_board_does_not_home(program: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES | {22: 0.0})
    report = homed_run(simulator, program, check_on_board=True)
    assert report.ok, report.faults
    assert not homings(simulator)


def test_the_operator_stops_the_homing(program: Path) -> None:
    simulator = GrblSimulator(settings=SWITCHES)
    control = Control()

    def stop(steps: object) -> bool:
        control.stop()
        return True

    seen = Callbacks(on_beginning=stop)
    with pytest.raises(HomingStopped):
        homed_run(simulator, program, from_line=5, control=control, callbacks=seen)
    assert simulator.position != pytest.approx(END, abs=1.0)
