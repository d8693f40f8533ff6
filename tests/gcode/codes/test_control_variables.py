"""Variables that only a control knows, and words without a value."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cnc.api import check, run
from cnc.session.options import Outputs, RunOptions
from tests.support.gcode.gcode_cases import error_of

PARTS = "%\nO1000\nG21 G90\n{line}\nG0 X[10.+#100]\nM30\n%\n"


def program(folder: Path, line: str) -> Path:
    path = folder / "part.nc"
    path.write_text(PARTS.format(line=line))
    return path


@pytest.mark.parametrize(
    ("dialect", "line"),
    [
        ("fanuc", "#100=#3901"),
        ("fanuc", "#100=#3011"),
        ("fanuc", "#100=#1000"),
        ("fanuc", "#100=#5400+#5428"),
        ("haas", "#100=#3020-#3021"),
        ("haas", "#100=#1601"),
        ("haas", "#100=#5401"),
    ],
)
def test_a_check_takes_a_variable_of_the_control_as_0(
    tmp_path: Path, dialect: Any, line: str
) -> None:
    report = check(program(tmp_path, line), options=RunOptions(dialect=dialect))
    assert report.ok
    found = [each for each in report.warnings if each.code == "control-variable"]
    assert [each.line for each in found] == [4] * (line.count("#") - 1)
    assert line.split("=")[1][:5] in found[0].message
    assert report.bounding_box["x"] == (0.0, 10.0)


def test_the_program_sets_a_variable_of_the_control(tmp_path: Path) -> None:
    lines = "#3901=5\n#100=#3901+#3901"
    report = check(program(tmp_path, lines), options=RunOptions(dialect="fanuc"))
    assert report.ok
    assert [each.code for each in report.warnings].count("control-variable") == 1
    assert report.bounding_box["x"] == (0.0, 20.0)


def test_a_run_refuses_a_variable_of_the_control(tmp_path: Path) -> None:
    path = program(tmp_path, "#100=#3020")
    outputs = Outputs(pulses=str(tmp_path / "out.npz"))
    report = run(path, options=RunOptions(dialect="haas", outputs=outputs))
    assert not report.ok
    assert report.faults[0].diagnostic.code == "parameter-number"
    assert "#3020" in report.faults[0].diagnostic.message


def test_fanuc_has_no_timers_of_haas() -> None:
    assert error_of("O1\n#100=#3020\nM30", dialect="fanuc").code == "parameter-number"


def test_an_empty_variable_in_f_is_named() -> None:
    found = error_of("O1\nG21 G1 X1. F#650\nM30", dialect="fanuc")
    assert (found.code, found.line, found.column) == ("feed-missing", 2, 12)
    assert "F#650 gives no feed" in found.message


@pytest.mark.parametrize(
    ("line", "code"),
    [("G43 H#518 Z1.", "tool-offset-missing"), ("G41 D#518", "compensation-offset-missing")],
)
def test_an_empty_variable_in_h_or_d_is_named(line: str, code: str) -> None:
    found = error_of(f"O1\nG21\n{line}\nM30", dialect="fanuc")
    assert (found.code, found.line, found.column) == (code, 3, 5)
    assert "#518 gives no offset: the variable is empty" in found.message


def test_an_empty_angle_is_named() -> None:
    found = error_of("O1\nG68 X1. Y1. R[#600]\nM30", dialect="fanuc")
    assert (found.code, found.line, found.column) == ("rotation-angle", 2, 13)
    assert "R[#600] gives no angle: the variable is empty" in found.message
