"""Pulses of machines whose joints are not the axes: joints and tool tip after each grid move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check, run
from cnc.machine.models import Machine
from tests.support.five_axis import five_axis_machine, tip_of
from tests.support.kinematics import MIDDLE, TABLES, machine_of, misfit
from tests.support.soak import share

LENGTH = np.array([0.0, 0.0, 80.0])
FIVE = """G21 G90 G94
G0 X4 Y3 {tilt}-10 C20
G43.1 Z80
M428
G1 X9 Y1 Z2 F3000
G64 P0.02
X11 Y5 Z1 {tilt}-30 C60
X14 Y4 {tilt}-25 C75
M429
G0 X20 Y0 {tilt}0 C0
M2
"""
UNDER_CONTROL = (4, 8)
"""First and last line of the moves under tool-tip control."""


def pulses_of(program: str, machine: Machine, folder: Path, *, board: bool) -> dict:
    file, target = folder / "part.ngc", folder / "pulses.npz"
    file.write_text(program)
    options = RunOptions(dialect="linuxcnc", outputs=Outputs(pulses=str(target)))
    report = run(file, machine, options) if board else check(file, machine, options)
    assert report.ok, report.faults
    with np.load(target) as found:
        return dict(found)


def expect_position_of_steps(found: dict) -> None:
    grid = found["origin_steps"] + np.cumsum(found["step"], axis=0, dtype=np.int64)
    assert len(grid) > 1000
    assert (found["position"] == grid / found["steps_per_mm"]).all()


@pytest.mark.parametrize("board", [False, True])
@pytest.mark.parametrize("kind", share(["xyzac", "xyzbc-head-table"], ["xyzac"]))
def test_the_tip_follows_tool_tip_control(kind: str, board: bool, tmp_path: Path) -> None:
    machine = five_axis_machine(kind)
    found = pulses_of(FIVE.format(tilt=kind[3].upper()), machine, tmp_path, board=board)
    expect_position_of_steps(found)
    assert found["tip_axes"].tolist() == list(machine.axis_names)
    first, last = UNDER_CONTROL
    controlled = (found["line"] > first) & (found["line"] <= last)
    assert 100 < controlled.sum() < len(controlled) - 100
    tip, position = found["tip"], found["position"]
    wanted = tip_of(kind, position[controlled], LENGTH)
    assert np.abs(tip[controlled, :3] - wanted).max() < 1e-9
    assert (tip[controlled, 3:] == position[controlled, 3:]).all()
    assert (tip[~controlled] == position[~controlled]).all()


@pytest.mark.parametrize("name", ["corexy", "polar", "delta"])
def test_the_tip_is_that_of_the_joints(name: str, tmp_path: Path) -> None:
    assert name in TABLES
    x, y, z = MIDDLE[name]
    program = f"G21 G90\nG0 X{x} Y{y} Z{z}\nG2 X{x + 20} Y{y} I10 J0 F2000\nM2\n"
    found = pulses_of(program, machine_of(name), tmp_path, board=False)
    expect_position_of_steps(found)
    assert found["tip_axes"].tolist() == ["x", "y", "z"]
    assert misfit(name, found["position"], found["tip"]) < 1e-9
    arc = found["tip"][found["line"] == 3]
    radius = np.hypot(arc[:, 0] - (x + 10.0), arc[:, 1] - y)
    # Half a BLU of each joint; 100 steps to a mm or degree, 90 mm from the centre at most.
    assert np.abs(radius - 10.0).max() < 0.05


def test_pulses_of_axes_have_steps_alone(tmp_path: Path) -> None:
    machine = machine_of("corexy").of_joints
    found = pulses_of("G21 G90\nG1 Z20 F600\nM2\n", machine, tmp_path, board=False)
    names = {"time_ns", "step", "line", "axes", "steps_per_mm", "origin_steps"}
    assert set(found) == names
