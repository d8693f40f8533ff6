"""Directions of the tool as vectors (G43.5): great circles of the angles, and programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from cnc.api import Outputs, RunOptions, check
from cnc.kinematics.orientation import swing
from tests.kinematics.test_five_axis import placed, read
from tests.support.five_axis import five_axis_machine, table_of, tip_of
from tests.support.gcode.gcode_cases import error_of

ANGLE = st.floats(-120.0, 120.0)
PART = st.floats(-1.0, 1.0)


def direction(tilt: np.ndarray, p: np.ndarray) -> np.ndarray:
    tilt, p = np.radians(tilt), np.radians(p)
    return np.stack([np.cos(p) * np.sin(tilt), np.sin(p) * np.sin(tilt), np.cos(tilt)], axis=-1)


def between(a: np.ndarray, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return directions between a and b by the formula of slerp."""
    w = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    return (np.sin((1.0 - u) * w)[:, None] * a + np.sin(u * w)[:, None] * b) / np.sin(w)


@given(tilt=ANGLE, turn=st.floats(-800.0, 800.0), x=PART, y=PART, z=PART)
def test_the_tool_follows_the_great_circle(
    tilt: float, turn: float, x: float, y: float, z: float
) -> None:
    wanted = np.array([x, y, z])
    if abs(tilt) < 0.1 or np.linalg.norm(wanted) < 0.1 or np.hypot(x, y) < 0.01:
        return
    begin, end = direction(tilt, turn - 90.0), wanted / np.linalg.norm(wanted)
    if np.linalg.norm(np.cross(begin, end)) < 1e-3:
        return
    found = swing((tilt, turn), wanted, 90.0)
    assert found is not None
    if found.nearest <= 1e-4:
        return
    u = np.linspace(0.0, 1.0, 101)
    angles = BSpline(found.knots, found.angles, 7)(u)
    way = direction(angles[:, 0], angles[:, 1] - 90.0)
    assert np.abs(way - between(begin, end, u)).max() < 1e-8
    assert np.abs(angles[0] - (tilt, turn)).max() < 1e-9
    assert np.abs(angles[-1] - found.end).max() < 1e-9
    # the branch is kept
    assert (np.sign(np.sin(np.radians(angles[:, 0]))) == np.sign(np.sin(np.radians(tilt)))).all()
    assert np.abs(np.diff(angles, axis=0)).max() < 181.0


def test_a_circle_through_the_axis_of_c_has_no_end() -> None:
    found = swing((30.0, 40.0), direction(np.array(30.0), np.array(40.0 - 90.0 + 180.0)), 90.0)
    assert found is not None
    assert found.nearest < 1e-9
    assert not len(found.angles)


def test_meridians_keep_the_angle_of_c() -> None:
    up = swing((30.0, 400.0), np.array([0.0, 0.0, 2.0]), 90.0)
    assert up is not None
    assert up.end == pytest.approx((0.0, 400.0), abs=1e-9)
    down = swing((0.0, 400.0), direction(np.array(-20.0), np.array(400.0 - 90.0)), 90.0)
    assert down is not None
    assert down.end == pytest.approx((-20.0, 400.0), abs=1e-9)


@pytest.mark.parametrize("kind", ["xyzac", "xyzbc-head"])
def test_a_program_with_vectors_keeps_tip_and_direction(kind: str, tmp_path: Path) -> None:
    machine = placed(five_axis_machine(kind), tmp_path)
    file, trace = tmp_path / "part.nc", tmp_path / "trace.npz"
    tilt = table_of(kind).tilting.upper()
    file.write_text(
        f"G21 G90 G94\nG0 X10. Y0. Z5. {tilt}-20. C30.\nG43.5 H1\n"
        "G1 X20. Y5. Z0. I0.3 J0.2 K1. F1500.\nX10. I-0.4 J0.3 K0.8\nI0.5 J0.5 K0.5\n"
        "G0 Z30. I0. J0. K1.\nG49\nM30\n"
    )
    report = check(file, machine, RunOptions(dialect="fanuc", outputs=Outputs(trace=str(trace))))
    assert report.ok, report.faults
    assert not any(report.violations.values())
    rows = np.load(trace)
    tool, position, line = rows["tool"], rows["position"], rows["line"]
    tip = tip_of(kind, position, np.array([0.0, 0.0, 80.0]))
    assert np.abs(tip - tool[:, :3])[(line > 3) & (line < 8)].max() < 2e-5
    short = tip_of(kind, position, np.array([0.0, 0.0, 79.0])) + np.array([0.0, 0.0, 1.0])
    way = (short - tip)[:, :3]
    mean = np.array([-0.4, 0.3, 0.8]) / np.linalg.norm([-0.4, 0.3, 0.8])
    first = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    plane = np.cross(first, mean) / np.linalg.norm(np.cross(first, mean))
    assert np.abs(way[line == 5] @ plane).max() < 1e-6
    assert np.abs(way[line == 6][-1] - np.full(3, 3**-0.5)).max() < 1e-3
    still = tip[line == 6]
    assert np.abs(still - still[0]).max() < 2e-5


@pytest.mark.parametrize(
    ("line", "code", "column"),
    [
        ("G1 X1. I0. J0. K0. F60.", "tool-direction", 8),
        ("G1 X1. A5. K1. F60.", "tool-direction", 8),
        ("G1 X1. I0. J-0.5 K1. F60.", "singular-pose", 8),
    ],
)
def test_wrong_directions_are_refused_at_their_line(line: str, code: str, column: int) -> None:
    program, options = read(f"G0 A-30. C0.\nG43.5 H1\n{line}")
    found = error_of(program, **options)
    assert (found.code, found.line, found.column) == (code, 3, column)
