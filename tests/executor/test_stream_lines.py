"""Programs on a board that plans for itself: the GRBL simulator follows the program, and faults
and requests end in reports.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, Machine, Outputs, Report, run
from cnc.boards.grbl.driver import GrblBoard
from cnc.machine.load import load_machine
from cnc.model.diagnostics import UsageError
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import Drop, GrblSimulator, Unplug
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.simulator_bench import material_below
from tests.support.session.runs import run_with
from tests.support.soak import share

MACHINE = load_machine("grbl-uno")
WITHOUT_TRAVEL = MACHINE.model_copy(
    update={
        "axes": {
            letter: axis.model_copy(update={"travel": None})
            for letter, axis in MACHINE.axes.items()
        }
    }
)
FAST = {110: 5000.0, 111: 5000.0, 112: 5000.0, 120: 500.0, 121: 500.0, 122: 500.0}


@pytest.fixture
def simulator() -> GrblSimulator:
    return GrblSimulator()


def ran(
    simulator: GrblSimulator,
    tmp_path: Path,
    text: str,
    machine: Machine = MACHINE,
    **arguments: object,
) -> Report:
    program = tmp_path / "p.nc"
    program.write_text(text)
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, machine, port.clock, "the simulator")
    board.connect()
    report = run_with(program, machine, board=board, **arguments)
    board.close()
    return report


def test_program_ends_at_its_end_point(simulator: GrblSimulator, tmp_path: Path) -> None:
    report = ran(
        simulator,
        tmp_path,
        "G21 G90\nG0 Z5\nM3 S1000\nG1 Z-1 F300\nG2 X10 Y0 I5 J0 F900\nG1 Y20\nG0 Z5\nM5\nM30\n",
    )
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((10.0, 20.0, 5.0), abs=0.002)
    assert simulator.lost == 0
    assert [event.value for event in simulator.events if event.kind == "spindle"] == [
        "M3 1000",
        "M5 0",
    ]


def test_program_uses_the_offsets_of_the_board(simulator: GrblSimulator, tmp_path: Path) -> None:
    simulator.core.eeprom.systems["G54"] = (30.0, 20.0, -10.0)
    simulator.core.eeprom.systems["G55"] = (50.0, 20.0, -10.0)
    report = ran(simulator, tmp_path, "G54 G0 X1 Y2 Z3\nG55 G1 X1 F900\nG53 G0 Z0\nM2\n")
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((51.0, 22.0, 0.0), abs=0.002)
    assert report.end_position == pytest.approx({"x": 51.0, "y": 22.0, "z": 0.0})


def test_board_keeps_the_offsets_of_the_program(simulator: GrblSimulator, tmp_path: Path) -> None:
    report = ran(simulator, tmp_path, "G0 X10 Y5\nG10 L20 P2 X0 Y0\nG10 L2 P3 Z-4.5\nM2\n")
    assert report.ok, report.faults
    assert simulator.core.eeprom.systems["G55"] == pytest.approx((10.0, 5.0, 0.0))
    assert simulator.core.eeprom.systems["G56"] == pytest.approx((0.0, 0.0, -4.5))
    assert simulator.core.eeprom.systems["G54"] == pytest.approx((0.0, 0.0, 0.0))


def test_program_gets_the_position_of_the_contact(tmp_path: Path) -> None:
    simulator = GrblSimulator(environment=material_below(-4.0))
    report = ran(simulator, tmp_path, "G38.2 Z-20 F100\nG10 L20 P1 Z0\nG0 Z5\nX1\nM2\n")
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((1.0, 0.0, 1.0), abs=0.01)
    assert simulator.core.eeprom.systems["G54"][2] == pytest.approx(-4.0, abs=0.01)


def test_lines_outside_the_travel_are_not_sent(tmp_path: Path) -> None:
    simulator = GrblSimulator(settings={20: 1, 130: 50, 131: 50, 132: 50})
    report = ran(simulator, tmp_path, "G0 X-4\nG1 X10 F100\nM2\n")
    (fault,) = report.faults
    assert (fault.diagnostic.code, fault.diagnostic.line, fault.exit_code) == ("soft-limit", 2, 1)
    assert not simulator.moves


def test_connection_fault_has_file_and_line(simulator: GrblSimulator, tmp_path: Path) -> None:
    simulator.inject(Unplug(), time=6.0)
    report = ran(simulator, tmp_path, "".join(f"G1 X{k % 2 * 20} F600\n" for k in range(40)))
    (fault,) = report.faults
    found = fault.diagnostic
    assert (found.code, fault.exit_code) == ("port-lost", 3)
    assert found.file.endswith("p.nc")
    assert 1 <= found.line < 40
    assert found.text.startswith("G1 X")


def test_different_end_position_is_a_fault(simulator: GrblSimulator, tmp_path: Path) -> None:
    text = "G1 X20.05 F600\n"
    assert ran(simulator, tmp_path, text).ok
    asked = simulator.core.receiver.received - 80
    codes = set()
    # One byte after the other of what is sent at the end is lost on the way.
    for byte in range(asked, asked + 80, share(1, 5)):
        other = GrblSimulator()
        other.inject(Drop(1), byte=byte)
        report = ran(other, tmp_path, text)
        codes.update(fault.diagnostic.code for fault in report.faults)
        if report.ok:
            assert other.position == pytest.approx((20.05, 0.0, 0.0), abs=0.005)
    assert {"position-differs", "board-error"} <= codes


def test_stop_is_reported_with_the_position(simulator: GrblSimulator, tmp_path: Path) -> None:
    control = Control()
    seen: list[Progress] = []

    def watch(progress: Progress) -> None:
        seen.append(progress)
        if progress.position is not None and progress.position[0] > 10.0:
            control.stop()

    report = ran(
        simulator,
        tmp_path,
        "G1 X20 F600\n" + "Y0.1\nY0\n" * 30,
        control=control,
        callbacks=Callbacks(on_sent=watch),
    )
    assert report.ok
    assert report.stopped_at_line is not None
    assert report.end_position["x"] == pytest.approx(simulator.position[0], abs=0.002)
    assert 10.0 < simulator.position[0] <= 20.0
    assert any(progress.buffered for progress in seen)


def test_pauses_wait_or_are_refused_or_skipped(tmp_path: Path) -> None:
    text = "G1 X1 F600\nT1 M6\nG1 X2\nM0\nG1 X3\nM2\n"
    control, holds = Control(), []

    def go_on(progress: Progress) -> None:
        if progress.held:
            holds.append(progress.line)
            control.resume()

    waited, refused, left_out = GrblSimulator(), GrblSimulator(), GrblSimulator()
    assert ran(
        waited,
        tmp_path,
        text,
        control=control,
        callbacks=Callbacks(on_sent=go_on),
        dialect="linuxcnc",
    ).ok
    assert len(holds) == 2
    report = ran(refused, tmp_path, text, pauses="refuse", dialect="linuxcnc")
    assert [fault.diagnostic.code for fault in report.faults] == ["needs-operator"]
    assert report.faults[0].diagnostic.line == 2
    assert not refused.moves
    assert ran(left_out, tmp_path, text, pauses="skip", dialect="linuxcnc").ok
    for simulator in (waited, left_out):
        assert simulator.position[0] == pytest.approx(3.0, abs=0.002)


def test_check_on_the_board_moves_nothing(simulator: GrblSimulator, tmp_path: Path) -> None:
    program = tmp_path / "p.nc"
    program.write_text("G1 X10 F600\nG2 X20 I5\nM2\n")
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    board.check_only = True
    assert run(program, MACHINE, board=board).ok
    assert not simulator.moves
    assert simulator.core.state == "Idle"


def test_home_and_unlock_are_sent_first(tmp_path: Path) -> None:
    simulator = GrblSimulator(settings={22: 1})
    report = ran(simulator, tmp_path, "$H\n", dialect="grbl")
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((-1.0, -1.0, -1.0), abs=0.002)
    locked = ran(GrblSimulator(settings={22: 1}), tmp_path, "G1 X1 F100\n")
    assert [fault.diagnostic.code for fault in locked.faults] == ["board-locked"]


@pytest.mark.parametrize("upwards", [True, False])
@pytest.mark.parametrize("restarted", [True, False])
def test_a_program_that_homes_goes_on_where_the_board_stands(
    tmp_path: Path, upwards: bool, restarted: bool
) -> None:
    simulator = GrblSimulator(settings={22: 1, 23: 0 if upwards else 3, 27: 2.0} | FAST)
    if not restarted:
        # The position before homing has nothing to do with the one after it.
        assert ran(simulator, tmp_path, "$H\nG0 X-30 Y-20\n", WITHOUT_TRAVEL, dialect="grbl").ok
    program = "$H\nG0 X0 Y0\nG91\nG1 X-1 F500\nG90\nG53 G0 Z-5\nG1 Y-7\nM2\n"
    report = ran(simulator, tmp_path, program, WITHOUT_TRAVEL, dialect="grbl")
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((-1.0, -7.0, -5.0), abs=0.002)
    assert report.end_position == pytest.approx({"x": -1.0, "y": -7.0, "z": -5.0}, abs=0.002)


def test_a_relative_move_after_homing_begins_at_the_homed_position(tmp_path: Path) -> None:
    simulator = GrblSimulator(settings={22: 1, 27: 3.0} | FAST)
    program = "$H\nG91 G1 X-4 F500\nM2\n"
    report = ran(simulator, tmp_path, program, WITHOUT_TRAVEL, dialect="grbl")
    assert report.ok, report.faults
    assert simulator.position == pytest.approx((-7.0, -3.0, -3.0), abs=0.002)


def test_line_board_has_no_pulses(simulator: GrblSimulator, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        ran(simulator, tmp_path, "G1 X1 F100\n", outputs=Outputs(pulses=str(tmp_path / "x.npz")))
    assert caught.value.diagnostic.code == "no-pulses"
    assert np.allclose(simulator.position, 0.0)
    assert replace(Progress(0.0, 0, 0), held=True).held
