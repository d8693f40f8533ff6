"""Calls of programs that are not at hand: a warning of a check, an error of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cnc.api import check, run
from cnc.session.options import Outputs, RunOptions

CALLS = {
    "fanuc": ("G65 P9810 Z5. F100.", "program-unknown", 5),
    "haas": ("M98 P9004", "program-unknown", 5),
    "mach3": ("M98 P9004", "program-unknown", 5),
    "siemens": ("L6", "sub-unknown", 1),
}
"""A call in each dialect, the error of a run, and the column."""


def program(folder: Path, call: str, *, name: str = "part.nc") -> Path:
    path = folder / name
    path.write_text(f"G0 X1.\n{call}\n{call}\nG0 X4.\nM30\n")
    return path


@pytest.mark.parametrize("dialect", CALLS)
def test_a_check_reports_a_missing_program_once_and_continues(tmp_path: Path, dialect: Any) -> None:
    call, _, column = CALLS[dialect]
    report = check(program(tmp_path, call), options=RunOptions(dialect=dialect))
    assert report.ok
    (found,) = [each for each in report.warnings if each.code == "subprogram-missing"]
    assert (found.line, found.column, found.severity) == (2, column, "warning")
    assert report.bounding_box["x"] == (0.0, 4.0)


@pytest.mark.parametrize("dialect", CALLS)
def test_a_run_and_pulses_refuse_it(tmp_path: Path, dialect: Any) -> None:
    call, code, column = CALLS[dialect]
    path = program(tmp_path, call)
    pulses = RunOptions(dialect=dialect, outputs=Outputs(pulses=str(tmp_path / "out.npz")))
    for report in (run(path, options=RunOptions(dialect=dialect)), check(path, options=pulses)):
        (fault,) = report.faults
        found = fault.diagnostic
        assert (found.code, found.line, found.column) == (code, 2, column)
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize("head", ["O1", "O1 (part)", "%\nO1"])
def test_the_number_of_the_main_program_is_no_subprogram(tmp_path: Path, head: str) -> None:
    path = tmp_path / "part.nc"
    path.write_text(f"{head}\nM98 P3\nM30\n")
    assert check(path, options=RunOptions(dialect="fanuc")).ok


@pytest.mark.parametrize("call", ["G65 P9810 Z5.", "M98 P8000"])
def test_a_builders_program_may_be_missing_beside_others(tmp_path: Path, call: str) -> None:
    path = tmp_path / "part.nc"
    path.write_text(f"O1\n{call}\nM98 P2\nM30\nO2\nG0 X4.\nM99\n")
    report = check(path, options=RunOptions(dialect="fanuc"))
    assert report.ok
    assert "subprogram-missing" in [each.code for each in report.warnings]
    assert not run(path, options=RunOptions(dialect="fanuc")).ok


def test_a_missing_modal_macro_is_not_called(tmp_path: Path) -> None:
    path = tmp_path / "part.nc"
    path.write_text("G66 P9100 A1.\nG0 X1.\nX2.\nG67\nM30\n")
    report = check(path, options=RunOptions(dialect="fanuc"))
    assert [each.code for each in report.warnings] == ["subprogram-missing"]
    assert report.ok


@pytest.mark.parametrize(
    ("source", "dialect", "code"),
    [
        ("o<drill> sub\no<drill> endsub\no<dril> call", "linuxcnc", "sub-unknown"),
        ("o5 sub\no5 endsub\nM98 P5", "linuxcnc", "call-style-mixed"),
        ("o<drill> call [1] [2]", "linuxcnc", "sub-unknown"),
        ("o<drill> call [1] [2]", "auto", "sub-unknown"),
        ("O1\nM98 P3\nM30\nO2\nM99", "fanuc", "program-unknown"),
        ("O1\nM98 P3\nM30\nO2\nM99", "auto", "program-unknown"),
        ("M98 P3\nM30\nO2\nM99", "fanuc", "program-unknown"),
        ("%\nM98 P2\nM30\n%\nO2\nM99", "fanuc", "program-unknown"),
        ("NOSUCH", "siemens", "sub-unknown"),
    ],
    ids=[
        "near name",
        "other style",
        "no file",
        "auto",
        "other programs",
        "auto too",
        "no main number",
        "behind the percent sign",
        "name alone",
    ],
)
def test_what_may_be_a_mistake_stays_an_error(
    tmp_path: Path, source: str, dialect: Any, code: str
) -> None:
    path = tmp_path / "part.nc"
    path.write_text(f"{source}\nM2\n")
    report = check(path, options=RunOptions(dialect=dialect))
    assert [fault.diagnostic.code for fault in report.faults] == [code]
