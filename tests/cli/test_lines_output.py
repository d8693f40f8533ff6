"""The output ``--lines``: lines for GRBL with the motion of the program."""

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, parse, start_position
from cnc.cli import exit_code
from cnc.machine.load import load_machine
from cnc.machine.models import Machine, Program
from cnc.model.blocks import PathMode
from cnc.model.diagnostics import UsageError
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from tests.support.deviation import deviation, path_points
from tests.support.paths import PROGRAMS
from tests.support.session.runs import check_with
from tests.support.soak import share

MILL = load_machine(None)


def points(program: Path, machine: Machine, dialect: str = "auto") -> np.ndarray:
    """Return points of the programmed motion, in machine coordinates."""
    blocks = (
        block
        for block in parse(program, machine, dialect=dialect)
        if not isinstance(block, PathMode)
    )
    path = build(blocks, axes=machine.axis_names, start=start_position(machine))
    return np.concatenate([path_points(chunk) for chunk in path if isinstance(chunk, PathChunk)])


def translated(program: Path, machine: Machine, folder: Path) -> Path:
    lines = folder / "lines.nc"
    report = check_with(program, machine, outputs=Outputs(lines=str(lines)))
    assert report.ok, report.faults
    return lines


SHIPPED = [file.name for file in sorted(PROGRAMS.glob("*.nc")) if file.stem != "turned-thread"]


# tests/programs compares the lines of all of them in every run.
@pytest.mark.parametrize("file", share(SHIPPED, ["drilling.nc", "trident.nc"]))
def test_lines_of_shipped_programs_have_the_same_motion(file, tmp_path):
    lines = translated(PROGRAMS / file, MILL, tmp_path)
    assert check_with(lines, MILL, dialect="grbl").ok
    assert (
        deviation(points(PROGRAMS / file, MILL), points(lines, MILL, "grbl")) <= MILL.path.tolerance
    )


def test_lines_are_relative_to_the_part(tmp_path):
    parameters = tmp_path / "offsets.var"
    parameters.write_text("5220 1\n5221 30.5\n5222 12.25\n5223 -7\n")
    machine = MILL.model_copy(update={"program": Program(parameters=parameters)})
    program = tmp_path / "part.nc"
    program.write_text(
        "G21 G90 G17\nG0 Z5\nG0 X1 Y1\nG1 Z-1 F100\nG2 X5 Y5 I4 J0\nG55 G1 X40 Y20\nM2\n"
    )
    lines = translated(program, machine, tmp_path)
    assert lines.read_text().splitlines()[1:4] == ["G0 Z5", "X1 Y1", "G1 Z-1 F100"]
    assert deviation(points(program, machine), points(lines, machine, "grbl")) <= 1e-4


@pytest.mark.parametrize(
    ("program", "expected"),
    [
        # X moves, and stands where it should by chance; Y never moves
        ("G0 Z5\nG0 X0 Y0\nG1 Z-1 F100\nG1 X10", ["G0 Z5", "X0", "G1 Z-1 F100", "X10"]),
        # the cut itself says where it goes, from wherever
        ("G0 X5 Y5\nG1 Z-1 F100\nG1 X10", ["G0 X5 Y5", "G1 Z-1 F100", "X10"]),
        # never down in a rapid move
        ("G0 X5\nG1 X10 F100\nG1 Z-1", ["G0 X5", "G1 Z0 F100", "X10", "Z-1"]),
        # an arc needs to know where it begins
        ("G2 X10 I5 F100", ["G0 X0 Y0", "G2 X10 I5 F100"]),
    ],
)
def test_the_first_line_positions_every_axis(program, expected, tmp_path):
    file = tmp_path / "zero.nc"
    file.write_text(f"G21 G90 G17\n{program}\nM2\n")
    assert translated(file, MILL, tmp_path).read_text().splitlines()[1:-1] == expected


def test_a_block_that_grbl_does_not_support_is_an_error_at_its_line(tmp_path, capsys):
    target = tmp_path / "thread.nc"
    assert exit_code(["check", str(PROGRAMS / "turned-thread.nc"), "--lines", str(target)]) == 1
    shown = capsys.readouterr().err
    assert "not-on-board" in shown and "turned-thread.nc:" in shown
    assert not target.exists()


def test_a_check_for_a_grbl_machine_reports_unsupported_blocks(tmp_path):
    program = tmp_path / "output.nc"
    program.write_text("G21 G90\nG1 X1 F100\nM62 P1\nG1 X2\nM2\n")
    report = check_with(program, load_machine("grbl-uno"), dialect="linuxcnc")
    assert [(fault.diagnostic.code, fault.diagnostic.line) for fault in report.faults] == [
        ("not-on-board", 3)
    ]


def test_standard_output_contains_only_the_program(tmp_path, capsys):
    program = tmp_path / "line.nc"
    program.write_text("G21 G90\nG1 X1 F100\nM2\n")
    assert exit_code([str(program), "--lines", "-"]) == 0
    assert capsys.readouterr().out == "G21 G90 G94 G17 G54\nG1 X1 F100\nM2\n"


@pytest.mark.parametrize("name", ["lines.txt", "lines"])
def test_other_suffixes_are_refused(name, tmp_path):
    with pytest.raises(UsageError, match="output-format"):
        check_with(PROGRAMS / "trident.nc", MILL, outputs=Outputs(lines=str(tmp_path / name)))


def test_the_program_itself_is_not_overwritten(tmp_path, capsys):
    program = tmp_path / "line.nc"
    program.write_text("G21 G90\nG1 X1 F100\nM2\n")
    assert exit_code(["check", str(program), "--lines", str(program)]) == 2
    assert program.read_text().startswith("G21 G90\n")
