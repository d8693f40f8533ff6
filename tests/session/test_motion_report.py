"""Machine time and largest values of a planned program in its report."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import Outputs, RunOptions, check
from cnc.machine.load import load_machine

MILL = load_machine("default")


def written(folder: Path, text: str) -> Path:
    program = folder / "part.nc"
    program.write_text(text, encoding="ascii")
    return program


def test_a_program_beyond_31_years_is_refused_at_its_line(tmp_path):
    # 990 000 s a dwell: the 1011th passes 1e9 s, the range of plausible times.
    text = "G21 G90 G94\n" + "G4 P990000.\n" * 1100 + "G1 X5 F500\nM2\n"
    report = check(written(tmp_path, text), MILL)
    (found,) = (fault.diagnostic for fault in report.faults)
    assert (found.code, found.line) == ("run-too-long", 1 + 1011)


@pytest.mark.parametrize("traced", [False, True])
def test_the_step_deviation_keeps_its_limit_where_a_corner_is_passed(tmp_path, traced):
    # Without a limit of the tangential jerk the motion passes the stop at a hairpin. The chord of a
    # sample across it is far shorter than the way.
    limits = {
        "max_tangential_acceleration": None,
        "max_normal_acceleration": None,
        "max_jerk": None,
        "step_deviation": 0.002,
    }
    slow = {"max_acceleration": 700.0, "max_jerk": 2000.0}
    axes = {letter: axis.model_copy(update=slow) for letter, axis in MILL.axes.items()}
    path = MILL.path.model_copy(update=limits)
    machine = MILL.model_copy(update={"axes": axes, "path": path})
    program = written(tmp_path, "G21 G90 G64 P0.004\nG0 Y0.6643\nG1 X-0.0037 Y0.509 F110\nM2\n")
    trace = str(tmp_path / "part.npz") if traced else None
    report = check(program, machine, RunOptions(outputs=Outputs(trace=trace)))
    assert report.ok
    assert report.violations["step_deviation"] == 0
    assert report.largest.step_deviation <= 0.002
