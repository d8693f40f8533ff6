"""Choices of the user in a session: tool lengths, the dialect in reports, builders' codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cnc.api import check, load_machine, run
from cnc.boards.protocols import BoardTraits
from cnc.model.choices import DialectName
from cnc.session.options import Outputs, RunOptions
from cnc.session.required_capabilities import reading_policy

PROGRAM = "%\nO1000\nT1 M6\nG0 X1.\nG43 H1 Z5.\nM30\n%\n"


class RealBoard:
    """A board that moves a machine; the session must not get to it."""

    traits = BoardTraits()
    capabilities: Any = None


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "part.nc"
    path.write_text(PROGRAM)
    return path


def test_a_check_takes_lengths_as_zero_and_names_the_dialect(program: Path) -> None:
    report = check(program)
    assert report.ok
    assert [each.code for each in report.warnings] == ["tool-length-zero", "decimal-point-missing"][
        :1
    ]
    assert report.as_json()["dialect"] == "fanuc"
    assert "O1000 in line 2" in report.recognition


@pytest.mark.parametrize(
    ("chosen", "board", "lengths"),
    [(None, None, "zero"), (None, RealBoard(), "table"), ("zero", RealBoard(), "zero")],
)
def test_lengths_of_zero_are_refused_where_a_machine_moves(
    chosen: Any, board: Any, lengths: str
) -> None:
    options = RunOptions(tool_lengths=chosen)
    assert reading_policy(options, load_machine(), board).tool_lengths == lengths


def test_lines_for_a_board_need_a_tool_table(program: Path, tmp_path: Path) -> None:
    options = RunOptions(outputs=Outputs(lines=str(tmp_path / "out.nc")))
    (fault,) = check(program, "grbl-uno", options).faults
    assert fault.diagnostic.code == "tool-table-missing"


def test_a_chosen_dialect_is_not_recognised(program: Path) -> None:
    report = check(program, options=RunOptions(dialect="haas"))
    assert (report.dialect, report.recognition) == ("haas", "")


def test_a_foreign_file_has_one_error(tmp_path: Path) -> None:
    path = tmp_path / "part.i"
    path.write_text("%PART G71 *\nN10 G00 G40 G90 Z+100 *\nN20 G01 X+10 Y+10 F100 *\n")
    report = check(path)
    assert [fault.diagnostic.code for fault in report.faults] == ["not-gcode"]


def test_codes_of_the_machine_file(tmp_path: Path) -> None:
    default = Path(__file__).parents[2] / "config" / "default.toml"
    (tmp_path / "m131.ngc").write_text("G4 P2\n")
    machine = tmp_path / "machine.toml"
    machine.write_text(
        default.read_text() + '\n[program.codes]\nM131 = { file = "m131.ngc" }\nM31 = "ignore"\n'
    )
    path = tmp_path / "part.nc"
    path.write_text("M31\nM131\nG0 X1\n")
    report = check(path, machine)
    assert report.ok
    assert report.duration_s > 2.0
    assert [fault.diagnostic.code for fault in check(path).faults] == ["code-unknown"]


def test_commands_of_grbl_are_warnings_in_a_check(tmp_path: Path) -> None:
    path = tmp_path / "part.nc"
    path.write_text("$32=1\nG21 G90\nG0 X1\n")
    report = check(path)
    assert report.ok
    assert "board-command-skipped" in [each.code for each in report.warnings]


@pytest.mark.parametrize("board", ["loopback", "grbl-sim"])
def test_builders_codes_on_a_simulated_board(tmp_path: Path, board: str) -> None:
    """The file of M131 moves the tool. M10 switches an output, which a GRBL board does not have."""
    shipped = Path(__file__).parents[2] / "config" / "grbl-uno.toml"
    (tmp_path / "m131.ngc").write_text("G91\nG0 Z-2\nG0 Z2\nG90\n")
    machine = tmp_path / "machine.toml"
    codes = '\n[program.codes]\nM131 = { file = "m131.ngc" }\nM10 = { output = 3, on = true }\n'
    machine.write_text(shipped.read_text() + codes)
    path = tmp_path / "part.nc"
    path.write_text("G21 G90\nG0 X2 Z-1\nM131\nG0 X1\nM2\n")
    options = RunOptions(outputs=Outputs(blocks=tmp_path / "blocks.jsonl"))
    report = run(path, machine, options, board=board)
    assert report.ok
    assert report.end_position == {"x": 1.0, "y": 0.0, "z": -1.0}
    rows = [json.loads(row) for row in (tmp_path / "blocks.jsonl").read_text().splitlines()]
    assert [row["end"]["z"] for row in rows if row["kind"] == "traverse"] == [-1, -3, -1, -1]
    path.write_text("G21 G90\nG0 X2\nM10\nG0 X1\nM2\n")
    report = run(path, machine, options, board=board)
    assert [fault.diagnostic.code for fault in report.faults] == (
        [] if board == "loopback" else ["not-on-board"]
    )
    if board == "loopback":
        rows = [json.loads(row) for row in (tmp_path / "blocks.jsonl").read_text().splitlines()]
        assert [(row["number"], row["on"]) for row in rows if row["kind"] == "digital-output"] == [
            (3, True)
        ]


def test_a_report_names_everything_that_was_assumed(tmp_path: Path) -> None:
    path = tmp_path / "part.nc"
    path.write_text("G43 H1 Z5\nG4 P200\nX1\nG91 G53 G0 X2\nM30\n")
    assumed = check(path, options=RunOptions(default_feed=300.0)).as_json()["assumed"]
    for words in (
        "millimetres, as no G20 or G21",
        "a feed of 300 mm/min",
        "line 1: Z5 without a motion code",
        "line 1: H1: there is no tool table",
        "line 2: P200 is 200 s here",
        "line 4: G53 under G91",
    ):
        assert words in assumed
    path.write_text("G21 G90 G0 X1\nM30\n")
    assert "assumed" not in check(path).as_json()
    path.write_text("O1000\nG21 G90 G0 X1\nX2\nM30\n")
    assert check(path).as_json()["assumed"].count("decimal point") == 1


@pytest.mark.parametrize("dialect", ["auto", "fanuc", "haas", "siemens", "mach3", "grbl"])
def test_units_that_no_line_gives_are_assumed_in_every_dialect(
    tmp_path: Path, dialect: DialectName
) -> None:
    path = tmp_path / "part.nc"
    path.write_text("G90 G0 X1.\nM30\n")
    options = RunOptions(dialect=dialect)
    codes = "G70, G71, G700 or G710" if dialect == "siemens" else "G20 or G21"
    assert f"millimetres, as no {codes}" in check(path, options=options).as_json()["assumed"]
    path.write_text("(G20)\nG90 G21 G0 X1.\nM30\n")
    assert "assumed" not in check(path, options=options).as_json()


def test_functions_that_controllers_compute_differently_are_named(tmp_path: Path) -> None:
    path = tmp_path / "part.nc"
    path.write_text("G21 G90\n#1=[#2 MOD 3]\n#3=FIX[#1] (FUP)\nG0 X#3\nM30\n")
    assert "FIX, MOD of negative numbers" in check(path).as_json()["assumed"]
    options = RunOptions(dialect="mach3")
    assert "assumed" not in check(path, options=options).as_json()
