"""Parameters and tools between programs, subroutine files, and answers of a board."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import check, run
from cnc.boards.loopback import Loopback
from cnc.gcode.core.tool_table import ToolTable
from cnc.gcode.reader.parameters import read_parameters
from cnc.model.diagnostics import MachineFileError, UsageError
from tests.support.session.runs import check_with

AXIS = "steps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\nmax_jerk = 9000\n"
MACHINE = "".join(f"[axes.{axis}]\n{AXIS}" for axis in "xyz")
FILES = '[program]\nparameters = "cnc.var"\ntool_table = "tool.tbl"\nsubroutines = ["subs"]\n'


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    (tmp_path / "subs").mkdir()
    (tmp_path / "tool.tbl").write_text("T1 P3 Z40.25 D6 ; end mill\nT2 P2 Z20\n")
    file = tmp_path / "machine.toml"
    file.write_text(MACHINE + FILES)
    return file


def program(machine: Path, *lines: str) -> Path:
    file = machine.parent / "p.ngc"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_parameters_are_saved_after_a_run(machine: Path) -> None:
    kept = machine.parent / "cnc.var"
    assert (
        run(program(machine, "#100 = [#100 + 0.1]", "G10 L2 P1 X3", "G0 X1"), machine).end_position[
            "x"
        ]
        == 4.0
    )
    assert read_parameters(kept)[100] == 0.1
    report = run(program(machine, "#100 = [#100 + 0.1]", "G0 X1"), machine)
    assert report.end_position["x"] == 4.0, "the origin was kept"
    assert read_parameters(kept)[100] == 0.2


def test_a_check_saves_nothing(machine: Path) -> None:
    report = check(program(machine, "#100 = 5", "T1 M6", "G10 L1 P1 Z99", "G0 X#100"), machine)
    assert report.ok
    assert report.end_position["x"] == 5.0
    assert not (machine.parent / "cnc.var").exists()
    assert "40.25" in (machine.parent / "tool.tbl").read_text()


@pytest.mark.parametrize("fault", ["G0 X[1/0]", "G1 X1"])
def test_a_faulty_program_saves_nothing(machine: Path, fault: str) -> None:
    assert not run(program(machine, "#100 = 5", fault), machine).ok
    assert not (machine.parent / "cnc.var").exists()


def test_a_failed_run_saves_nothing(machine: Path) -> None:
    assert not run(
        program(machine, "#100 = 5", "G0 X10"), machine, board=Loopback(3, fail_after=7)
    ).ok
    assert not (machine.parent / "cnc.var").exists()


def test_tools_are_saved_after_a_run(machine: Path) -> None:
    report = run(program(machine, "T1 M6 G43", "G10 L1 P2 Z33.5", "G0 Z1"), machine)
    assert report.end_position["z"] == 41.25
    table = ToolTable.load(machine.parent / "tool.tbl")
    first, second = table.tool(1), table.tool(2)
    assert first is not None
    assert second is not None
    assert (first.pocket, first.offsets, first.diameter, first.comment) == (
        3,
        {"Z": 40.25},
        6.0,
        "end mill",
    )
    assert second.offsets == {"Z": 33.5}


def test_an_unchanged_tool_table_is_not_written(machine: Path) -> None:
    table = machine.parent / "tool.tbl"
    before = table.read_bytes()
    run(program(machine, "T1 M6 G43", "G0 Z1"), machine)
    assert table.read_bytes() == before


def test_subroutines_beside_the_program_come_before_those_of_the_machine(machine: Path) -> None:
    body = "o<place> sub\nG0 X{}\no<place> endsub\n"
    (machine.parent / "subs" / "place.ngc").write_text(body.format(7))
    file = program(machine, "o<place> call")
    assert check(file, machine).end_position["x"] == 7.0
    (machine.parent / "place.ngc").write_text(body.format(8))
    assert check(file, machine).end_position["x"] == 8.0


def test_a_fault_in_a_subroutine_names_its_file_and_shows_its_line(machine: Path) -> None:
    (machine.parent / "subs" / "place.ngc").write_text("o<place> sub\nG0 X999\no<place> endsub\n")
    machine.write_text(MACHINE.replace("[axes.y]", "travel = [0, 100]\n[axes.y]") + FILES)
    (fault,) = check(program(machine, "G0 X1", "o<place> call"), machine).faults
    found = fault.diagnostic
    assert (Path(found.file).name, found.line, found.column, found.text) == (
        "place.ngc",
        2,
        4,
        "G0 X999",
    )


def test_limits_of_the_machine_file(machine: Path) -> None:
    machine.write_text(MACHINE + FILES + "max_repeated_lines = 50\nmax_call_depth = 3\n")
    (fault,) = check(program(machine, "o1 while [1]", "o1 endwhile"), machine).faults
    assert (fault.diagnostic.code, fault.diagnostic.line) == ("loop-endless", 1)
    (fault,) = check(program(machine, "o1 sub", "o1 call", "o1 endsub", "o1 call"), machine).faults
    assert fault.diagnostic.code == "call-too-deep"


@pytest.mark.parametrize(("name", "text"), [("tool.tbl", "T1 Z\n"), ("cnc.var", "100 x\n")])
def test_an_unreadable_state_file_is_named(machine: Path, name: str, text: str) -> None:
    (machine.parent / name).write_text(text)
    with pytest.raises((MachineFileError, UsageError)) as caught:
        check(program(machine, "G0 X1"), machine)
    found = caught.value.diagnostic
    assert (Path(found.file).name, found.line) == (name, 1)


def test_the_answer_of_the_board_decides_how_the_program_continues(machine: Path) -> None:
    lines = "M66 P1 L0", "G0 X[#5399 + 1]"
    assert check(program(machine, *lines), machine).end_position["x"] == 1.0
    board = Sensing(3)
    assert run(program(machine, *lines), machine, board=board).ok
    assert board.position_steps.tolist() == [800, 0, 0]


class Sensing(Loopback):
    """A board whose inputs are all 7."""

    def execute(self, block, time_ns):  # type: ignore[no-untyped-def]
        expected = super().execute(block, time_ns)
        return expected and ((7.0,) if len(expected) == 1 else expected)

    def send(self, chunk):  # type: ignore[no-untyped-def]
        super().send(chunk)
        self.times = [*getattr(self, "times", []), *chunk.time_ns.tolist()]


@pytest.mark.parametrize(
    ("wrong", "code"),
    [("G1 X[100 + #5399]", "soft-limit"), ("G1 X[9 + 1 / [#5399 - 7]]", "division-by-zero")],
)
def test_a_fault_after_an_answer_brings_the_motion_to_rest_on_the_path(
    machine: Path, wrong: str, code: str
) -> None:
    """The check pass has no answer, so it finds no fault. The motion has begun when it occurs."""
    machine.write_text(MACHINE.replace("[axes.y]", "travel = [0, 100]\n[axes.y]") + FILES)
    lines = [
        "F3000",
        "M66 P1 L0",
        "G1 X30",
        *(f"X{30 + 0.001 * k:.3f}" for k in range(1, 40_000)),
        wrong,
    ]
    board = Sensing(3)
    (fault,) = run(program(machine, *lines), machine, board=board).faults
    assert fault.diagnostic.code.startswith(code)
    assert fault.diagnostic.line == len(lines)
    x, y, z = board.position_steps.tolist()
    assert (y, z) == (0, 0)
    assert 3000 < x < 8000
    assert board.state == "stopped"
    intervals = np.diff(board.times)
    assert intervals.min() < 250_000, "it was moving fast"
    assert intervals[-1] > 4 * intervals[-200:].min(), "and comes to rest"


@pytest.mark.parametrize("line", ["M66 P1 L3 Q2", "G38.2 X5 F100", "S100 M3 G33 Z1 K1"])
def test_a_board_without_inputs_refuses_probes_and_inputs(machine: Path, line: str) -> None:
    target = machine.parent / "p.npz"
    (fault,) = run(program(machine, "G0 X1", line), machine, board="file", port=str(target)).faults
    assert (fault.diagnostic.code, fault.diagnostic.line) == ("board-senseless", 2)
    assert not target.exists()


def test_lines_for_a_grbl_board(machine: Path) -> None:
    file = program(machine, "G21", "$H", "G0 X1")
    (fault,) = check_with(file, machine, dialect="grbl").faults
    assert (fault.diagnostic.code, fault.diagnostic.line, fault.diagnostic.text) == (
        "board-command",
        2,
        "$H",
    )
    machine.write_text(MACHINE + '[board]\nkind = "grbl"\n' + FILES)
    assert check_with(file, machine, dialect="grbl").ok
