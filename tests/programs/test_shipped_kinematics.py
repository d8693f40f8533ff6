"""Each kinematics has a shipped machine file that runs a program, from the start of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import load_machine
from cnc.boards.loopback import Loopback
from cnc.machine.kinematics import KINEMATICS, Custom
from cnc.machine.load import shipped_machines
from cnc.planner.joints import Joints
from cnc.session.program_reader import start_position
from tests.support.session.runs import run_with

SIDE = 12.0


def test_each_kinematics_has_a_shipped_machine() -> None:
    shipped = {type(load_machine(name).kinematics) for name in shipped_machines()}
    assert set(KINEMATICS) - {Custom} <= shipped


@pytest.mark.parametrize(
    "name",
    [name for name in shipped_machines() if load_machine(name).kinematics.type != "cartesian"],
)
def test_shipped_machine_runs_a_program(name: str, tmp_path: Path) -> None:
    """A square with an arc beside the start: the joints end where the formulas have its corner."""
    machine = load_machine(name)
    x, y, z = start_position(machine)[:3]
    corner = x - SIDE if x > 0 else x + SIDE
    (tmp_path / "p.ngc").write_text(
        f"G21 G90 G61\nG0 Z{z + 2:.4f}\nG1 X{corner:.4f} F1200\nY{y + SIDE:.4f}\n"
        f"G3 X{corner + SIDE:.4f} Y{y:.4f} R{SIDE + 3}\nG0 X{corner:.4f} Y{y:.4f}\nM2\n"
    )
    joints = Joints(machine)
    board = Loopback(len(joints.machine.axes))
    report = run_with(tmp_path / "p.ngc", machine, board=board)
    assert report.ok, report.faults
    end = np.array([corner, y, z + 2, *start_position(machine)[3:]])
    wanted = joints.at(end.round(4)) * joints.machine.steps_per_mm
    assert np.abs(board.position_steps - wanted).max() <= 1.0
