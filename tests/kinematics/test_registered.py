"""Kinematics of users, registered by an entry point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check, load_machine
from cnc.model.diagnostics import MachineFileError

MODULE = '''
from cnc.kinematics.base import Kinematics


class Wedge(Kinematics):
    """Z by a wedge on a slope: a joint w with z = slope w, and x = u - w."""

    turning = (False, False)

    def __init__(self, slope):
        if slope == 0.0:
            raise ValueError("the slope must not be 0")
        self.slope = slope

    def inverse(self, tip):
        x, z = tip
        w = z * (1.0 / self.slope)
        return [x + w, w]

    def forward(self, joints):
        u, w = joints
        return [u - w, self.slope * w]
'''
JOINT = "steps_per_mm = 100\nmax_velocity = 100\nmax_acceleration = 1000\nmax_jerk = 20000\n"


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install a package with the kinematics; return a function that writes a machine file."""
    (tmp_path / "wedge_kinematics.py").write_text(MODULE)
    info = tmp_path / "wedge-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: wedge\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[cnc.kinematics]\nwedge = wedge_kinematics:Wedge\n")
    monkeypatch.syspath_prepend(tmp_path)

    def written(name: str = "wedge", slope: float = 0.25, joints: str = '["u", "w"]') -> Path:
        file = tmp_path / "machine.toml"
        tables = "".join(f"[joints.{joint}]\n{JOINT}" for joint in eval(joints))
        file.write_text(
            f'[kinematics]\ntype = "custom"\nname = "{name}"\nof_axes = ["x", "z"]\n'
            f"of_joints = {joints}\nparameters = {{ slope = {slope} }}\n"
            f"[axes.x]\n[axes.y]\n{JOINT}[axes.z]\n{tables}"
        )
        return file

    return written


def test_a_registered_kinematics_moves_the_tip(write, tmp_path: Path) -> None:
    program, trace = tmp_path / "part.ngc", tmp_path / "trace.npz"
    program.write_text("G21 G90 G18\nG1 X10 Z2 F1200\nG2 X20 Z2 I5 K0\nM2\n")
    machine = load_machine(write())
    report = check(program, machine, RunOptions(outputs=Outputs(trace=str(trace))))
    assert report.ok, report.faults
    assert not any(report.violations.values())
    rows = np.load(trace)
    assert rows["axes"].tolist() == ["u", "w", "y"]
    u, w, _ = rows["position"].T
    x, _, z = rows["tool"].T
    assert np.abs(x - (u - w)).max() < 1e-5
    assert np.abs(z - 0.25 * w).max() < 1e-5


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"name": "unknown"}, "kinematics-unknown"),
        ({"slope": 0.0}, "kinematics-parameters"),
        ({"joints": '["u", "w", "v"]'}, "kinematics-parameters"),
    ],
)
def test_wrong_tables_are_refused(write, change: dict, code: str, tmp_path: Path) -> None:
    program = tmp_path / "part.ngc"
    program.write_text("G21 G90\nG1 X10 F600\nM2\n")
    machine = load_machine(write(**change))
    try:
        found = [fault.diagnostic.code for fault in check(program, machine).faults]
    except MachineFileError as error:
        found = [error.diagnostic.code]
    assert found == [code]
