"""The report of a run tells what the board did, and which feeds its lines lower."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from cnc.api import Machine, Report, check, load_machine
from cnc.boards.grbl.driver import GrblBoard
from cnc.report.summary import print_summary
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.simulator_bench import material_below
from tests.support.session.runs import run_with

MACHINE = load_machine("grbl-uno")
FAST = {110: 6000.0, 111: 6000.0, 112: 3000.0, 120: 800.0, 121: 800.0, 122: 400.0}


def ran(
    tmp_path: Path,
    text: str,
    box: GrblSimulator,
    *,
    check_only: bool = False,
    feed_override: float = 100.0,
) -> tuple[Report, str]:
    program = tmp_path / "p.nc"
    program.write_text(text)
    port = GrblSimulatorPort(box)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    board.check_only = check_only
    report = run_with(program, MACHINE, board=board, feed_override=feed_override)
    board.close()
    assert report.ok, report.faults
    out = io.StringIO()
    print_summary(report, out)
    return report, out.getvalue()


def test_the_end_position_is_that_of_the_board_after_a_probe(tmp_path: Path) -> None:
    box = GrblSimulator(settings=FAST, environment=material_below(-4.0))
    report, _ = ran(tmp_path, "G21 G90\nG0 X3\nG38.2 Z-20 F100\nM2\n", box)
    assert report.end_position == pytest.approx(dict(zip("xyz", box.position, strict=True)))
    assert report.end_position["z"] == pytest.approx(-4.0, abs=0.1)


def test_the_time_of_a_run_is_measured(tmp_path: Path) -> None:
    box = GrblSimulator(settings=FAST)
    report, shown = ran(tmp_path, "G21 G90\nG1 X20 F600\nM2\n", box)
    assert report.played_s is not None
    assert report.as_json()["played_s"] == report.played_s
    moved = box.moves[-1].end_time - box.moves[0].begin_time
    # One report at rest, 50 ms after the one before; the rest behind the offsets does not count.
    assert moved < report.played_s < moved + 0.06
    assert "computed" in shown


@pytest.mark.parametrize("percent", [40.0, 100.0, 160.0])
def test_the_computed_time_has_the_override_of_the_beginning(
    tmp_path: Path, percent: float
) -> None:
    text = "G21 G90\nG0 X20\nG1 X40 F900\nY30\nG3 X20 Y30 I-10 J0\nG1 Z-3 F300\nG0 Z0\nM2\n"
    box = GrblSimulator(settings=FAST)
    report, _ = ran(tmp_path, text, box, feed_override=percent)
    moved = box.moves[-1].end_time - box.moves[0].begin_time
    assert report.duration_s == pytest.approx(moved, rel=0.03)
    # The feed moves have 20, 30, 31.4 and 3 mm.
    at_feed = (81.4 / 15.0 + 3.0 / 5.0) * 100.0 / percent
    assert at_feed < report.duration_s < at_feed + 1.2


def test_a_check_on_the_board_does_not_claim_a_run(tmp_path: Path) -> None:
    report, shown = ran(tmp_path, "G1 X20 F600\nM2\n", GrblSimulator(), check_only=True)
    assert "nothing moved" in shown
    assert "run on the board" not in shown
    assert report.played_s is None


def test_a_traverse_is_not_shown_as_a_part_of_the_feed_limit(tmp_path: Path) -> None:
    path = MACHINE.path.model_copy(update={"max_feed": 20.0})
    machine = MACHINE.model_copy(update={"path": path})
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\nG0 X30 Y30\nG1 X20 F600\nM2\n")
    report = check(program, machine)
    assert report.largest.feed is not None
    assert report.largest.feed > 20.0
    out = io.StringIO()
    print_summary(report, out)
    (row,) = [line for line in out.getvalue().splitlines() if line.startswith("feed ")]
    assert row.rstrip().endswith("traverse")


@pytest.mark.parametrize(
    ("moves", "cause", "share"),
    [
        # 0.05 mm at 3000 mm/min are 1000 lines a second; an AVR takes 385.
        ("M3 S1\n" + "".join(f"X{0.05 * k:.2f} S{k}\n" for k in range(2, 400)), "short lines", 90),
        # sqrt(a r) with a = 250 mm/s^2 and r = 0.5 mm is 671 mm/min.
        ("G3 X1 I0.5\nG3 X2 I0.5\nG3 X3 I0.5\n", "small arcs", 99),
    ],
)
def test_lowered_feeds_are_a_note(moves: str, cause: str, share: float, tmp_path: Path) -> None:
    program = tmp_path / "p.nc"
    program.write_text(f"G21 G90\nG0 Z1\nG1 F3000\n{moves}M2\n")
    report = check(program, grbl(MACHINE).model_copy(update={"kind": "laser"}))
    (note,) = [each for each in report.warnings if each.code == "feed-lowered"]
    assert note.severity == "note"
    assert cause in note.message
    assert 4 <= note.line <= 60
    told = float(note.message.split("in ")[-1].split(" %")[0])
    assert told == pytest.approx(share, abs=10)


def test_feeds_as_programmed_get_no_note(tmp_path: Path) -> None:
    program = tmp_path / "p.nc"
    program.write_text("G21 G90\nG0 Z1\nG1 X10 F600\nG2 X20 I5\nG1 Y5\nM2\n")
    assert not [
        each for each in check(program, grbl(MACHINE)).warnings if each.code == "feed-lowered"
    ]


def grbl(machine: Machine) -> Machine:
    return machine.model_copy(
        update={"board": machine.board.model_copy(update={"kind": "grbl", "port": None})}
    )


@pytest.mark.usefixtures("nothing_kept")
def test_a_check_uses_the_offsets_of_the_last_run(tmp_path: Path) -> None:
    board_of_file = MACHINE.board.model_copy(update={"kind": "grbl", "port": "COM77"})
    machine = MACHINE.model_copy(update={"board": board_of_file})
    program = tmp_path / "p.nc"
    program.write_text("G21 G90 G54\nG0 X1\nG10 L2 P2 X9\nM2\n")

    def shown(report: Report) -> str:
        out = io.StringIO()
        print_summary(report, out)
        return next(row for row in out.getvalue().splitlines() if row.startswith("offset"))

    before = check(program, machine)
    assert before.end_position["x"] == pytest.approx(1.0)
    assert "assumed" in shown(before)
    box = GrblSimulator(settings=FAST)
    box.core.eeprom.systems["G54"] = (30.0, 20.0, 0.0)
    port = GrblSimulatorPort(box)
    board = GrblBoard(port, machine, port.clock, "the simulator", identity="COM77")
    board.connect()
    assert run_with(program, machine, board=board, trust_position=True).ok
    board.close()
    after = check(program, machine)
    assert after.end_position["x"] == pytest.approx(31.0)
    assert "G54 X30 Y20 Z0" in shown(after)
    assert "last run" in shown(after)
    # G10 of the run counts, too.
    program.write_text("G21 G90 G55\nG0 X1\nM2\n")
    assert check(program, machine).end_position["x"] == pytest.approx(10.0)


def test_largest_values_are_those_of_the_motion_on_the_board(tmp_path: Path) -> None:
    box = GrblSimulator(settings=FAST)
    text = "G21 G90\nG0 X20\nG1 Y10 F900\nG2 X30 Y0 J-10 F1200\nG0 X0 Y-3\nM2\n"
    report, shown = ran(tmp_path, text, box)
    phases = [(move, phase) for move in box.moves for phase in move.phases]
    fastest = max(phase.v + max(phase.a, 0.0) * phase.duration for _, phase in phases)
    steepest = max(abs(phase.a) for _, phase in phases)
    assert report.largest.feed == pytest.approx(fastest, rel=0.01)
    assert report.largest.accel == pytest.approx(steepest, rel=0.01)
    along_x = max(
        (phase.v + max(phase.a, 0.0) * phase.duration) * abs(move.unit[0]) for move, phase in phases
    )
    assert report.largest.axes["x"]["velocity"] == pytest.approx(along_x, rel=0.01)
    assert report.limits.axes["x"]["velocity"] == FAST[110] / 60.0
    assert report.limits.axes["z"]["acceleration"] == FAST[122]
    assert "along the path, as computed" in shown


def test_a_check_outside_the_travel_names_the_offset_that_it_assumed(tmp_path: Path) -> None:
    program = tmp_path / "p.nc"
    program.write_text("G21 G90 G54\nG0 X-10\nM2\n")
    outside = check(program, MACHINE)
    assert [fault.diagnostic.code for fault in outside.faults] == ["soft-limit"]
    assumed = [warning.message for warning in outside.warnings if warning.code == "offset-assumed"]
    assert assumed == ["G54 is assumed to be X0 Y0 Z0: that of the board is not known"]
    program.write_text("G21 G90 G54\nG0 X10\nM2\n")
    assert not [each for each in check(program, MACHINE).warnings if each.code == "offset-assumed"]
