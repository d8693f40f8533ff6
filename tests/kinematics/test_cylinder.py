"""A drawing wrapped on a cylinder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check, load_machine

JOINT = "steps_per_mm = 100\nmax_velocity = 100\nmax_acceleration = 1000\nmax_jerk = 20000\n"
RADIUS = 12.5


@pytest.mark.parametrize("wrapped", ["x", "y"])
def test_the_angle_is_the_length_of_the_circumference(wrapped: str, tmp_path: Path) -> None:
    """A circle of the drawing, and three turns of the part."""
    other = "y" if wrapped == "x" else "x"
    machine_file, program = tmp_path / "machine.toml", tmp_path / "part.ngc"
    machine_file.write_text(
        f'[kinematics]\ntype = "cylinder"\nwrapped = "{wrapped}"\nradius = {RADIUS}\n'
        f"[axes.{other}]\n{JOINT}[axes.{wrapped}]\n[axes.z]\n{JOINT}[joints.a]\n{JOINT}"
    )
    program.write_text(
        f"G21 G90 G64 P0.01 F1200\nG1 X5 Y5\nG2 X5 Y5 I4 J3\nG0 {wrapped}{6 * np.pi * RADIUS}\nM2\n"
    )
    trace = tmp_path / "trace.npz"
    report = check(
        program, load_machine(machine_file), RunOptions(outputs=Outputs(trace=str(trace)))
    )
    assert report.ok, report.faults
    assert not any(report.violations.values())
    rows = np.load(trace)
    axes, tool_axes = rows["axes"].tolist(), rows["tool_axes"].tolist()
    angle = np.radians(rows["position"][:, axes.index("a")])
    assert np.abs(angle * RADIUS - rows["tool"][:, tool_axes.index(wrapped)]).max() < 1e-9
    assert angle[-1] == pytest.approx(6.0 * np.pi, abs=1e-9)
    circle = rows["tool"][rows["line"] == 3][:, [tool_axes.index("x"), tool_axes.index("y")]]
    assert np.abs(np.hypot(*(circle - np.array([9.0, 8.0])).T) - 5.0).max() < 0.0101
    assert report.largest.axes["a"]["velocity"] <= 100.0 * (1 + 1e-9)
