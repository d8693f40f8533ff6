"""Sharp corners of the tip under G64, where the joints are no linear function of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check
from cnc.machine.models import Machine
from tests.support.five_axis import five_axis_machine, tip_of
from tests.support.kinematics import MIDDLE, machine_of, misfit
from tests.support.soak import share

TOLERANCE = 0.04
LENGTH = np.array([0.0, 0.0, 80.0])
MOVES = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 9.0], [2.0, 5.0], [14.0, 3.0]])
"""Turns by 90, 112 and 168 degrees, mm."""
START = "G21 G90 F4000\nG10 L2 P1 X{} Y{} Z{}\nG0 X0 Y0 Z0\n"
TILTED = "G21 G90 F4000\nG43.1 Z80\nM428\nG0 X0 Y0 Z0 A-10 C20\n"


def traced(machine: Machine, start: str, mode: str, folder: Path, turn: str = "") -> dict:
    file, target = folder / "part.ngc", folder / "trace.npz"
    moves = [f"G1 X{x} Y{y}{turn.format(30 + 2 * (-1) ** k)}" for k, (x, y) in enumerate(MOVES)]
    file.write_text("\n".join([start + mode, *moves, "M2"]) + "\n")
    report = check(
        file, machine, RunOptions(dialect="linuxcnc", outputs=Outputs(trace=str(target)))
    )
    assert report.ok, report.faults
    assert not any(report.violations.values())
    with np.load(target) as found:
        rows = dict(found)
    first = 2 + len((start + mode).split("\n"))
    return {name: rows[name][rows["line"] >= first] for name in ("t", "position", "tool")}


def distance_from_moves(tip: np.ndarray) -> np.ndarray:
    """Return the distance of tips (m, 3) from the programmed moves in the plane, mm."""
    a, b = MOVES[:-1], MOVES[1:]
    out = tip[:, None, :2] - a
    share = (out * (b - a)).sum(axis=2) / ((b - a) ** 2).sum(axis=1)
    nearest = np.clip(share, 0.0, 1.0)[..., None] * (b - a)
    return np.hypot(np.linalg.norm(out - nearest, axis=2).min(axis=1), tip[:, 2])


def expect_passed(blended: dict, exact: dict, tip: np.ndarray) -> None:
    away = distance_from_moves(tip)
    assert away.max() <= TOLERANCE + 1e-5
    assert away.max() > 0.5 * TOLERANCE
    assert len(blended["t"]) < 0.97 * len(exact["t"])
    speed = np.linalg.norm(np.diff(tip, axis=0), axis=1) * 1000.0
    moving = np.flatnonzero(speed > 5.0)
    assert speed[moving[0] : moving[-1]].min() > 1.0, "the tip does not rest at a corner"


@pytest.mark.parametrize("name", ["polar", "scara", "delta", "rotary-delta"][:: share(1, 2)])
def test_sharp_corners_are_passed_within_the_tolerance(name: str, tmp_path: Path) -> None:
    machine, start = machine_of(name), START.format(*MIDDLE[name])
    blended = traced(machine, start, f"G64 P{TOLERANCE}", tmp_path)
    exact = traced(machine, start, "G61", tmp_path)
    assert misfit(name, blended["position"], blended["tool"]) < 2e-5
    expect_passed(blended, exact, blended["tool"] - np.array(MIDDLE[name]))


@pytest.mark.parametrize("turn", ["", " C{}"])
def test_sharp_corners_under_tool_tip_control(turn: str, tmp_path: Path) -> None:
    machine = five_axis_machine("xyzac")
    blended = traced(machine, TILTED, f"G64 P{TOLERANCE}", tmp_path, turn)
    exact = traced(machine, TILTED, "G61", tmp_path, turn)
    tip = tip_of("xyzac", blended["position"], LENGTH) - LENGTH
    expect_passed(blended, exact, tip)
