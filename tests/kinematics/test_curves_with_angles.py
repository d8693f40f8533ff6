"""NURBS with rotary axes, and directions of the tool in SINUMERIK's words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cnc.api import Outputs, RunOptions, check
from cnc.kinematics.orientation import angles_of
from cnc.model.blocks import NurbsFeed, Polyline
from tests.kinematics.test_five_axis import placed, read
from tests.kinematics.test_orientation import direction
from tests.support.five_axis import five_axis_machine, table_of, tip_of
from tests.support.gcode.gcode_cases import error_of, run
from tests.support.soak import share

KNOTS = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
POINTS = np.array(
    [
        [0.0, 0.0, 5.0, 0.0, 0.0],
        [10.0, 8.0, 5.0, 5.0, 10.0],
        [30.0, -4.0, 7.0, 12.0, -20.0],
        [50.0, 6.0, 5.0, 10.0, 30.0],
        [60.0, 0.0, 4.0, 4.0, 40.0],
    ]
)
"""The columns of X are the means of the knots, so X is 60 u along the curve."""


def fanuc(kind: str) -> str:
    tilt = table_of(kind).tilting.upper()
    words = [f"X{x} Y{y} Z{z} {tilt}{a} C{c}" for x, y, z, a, c in POINTS.tolist()]
    curve = [f"K{knot} {point}" for knot, point in zip(KNOTS.tolist(), words, strict=False)]
    lines = [
        f"G21 G90 G94\nG0 X0. Y0. {tilt}0. C0.\nG43.4 H1\nG0 Z5.",
        f"G6.2 P4 {curve[0]} F1200.",
        *curve[1:],
        *["K1."] * 4,
    ]
    return "\n".join([*lines, "G0 Z30.", "G49", "M30"]) + "\n"


def siemens(kind: str) -> str:
    tilt = table_of(kind).tilting
    words = [f"X{x} Y{y} Z{z} {tilt}={a} C={c}" for x, y, z, a, c in POINTS.tolist()]
    lines = [
        f"G90 G94\nT1 M6\nG0 X0 Y0 {tilt.upper()}0 C0\nTRAORI\nG0 Z5",
        "BSPLINE F1200",
        *words[1:],
    ]
    return "\n".join([*lines, "G0 Z30", "TRAFOOF", "M30"]) + "\n"


@pytest.mark.parametrize(
    ("kind", "dialect"),
    [("xyzac", "fanuc"), ("xyzbc-head", "fanuc"), ("xyzac-head-table", "siemens")],
)
def test_tip_and_angles_follow_one_curve(kind: str, dialect: str, tmp_path: Path) -> None:
    machine = placed(five_axis_machine(kind), tmp_path)
    file, trace = tmp_path / "part.nc", tmp_path / "trace.npz"
    file.write_text((fanuc if dialect == "fanuc" else siemens)(kind))
    report = check(file, machine, RunOptions(dialect=dialect, outputs=Outputs(trace=str(trace))))
    assert report.ok, report.faults
    assert not any(report.violations.values())
    rows = np.load(trace)
    first = 1 + next(k for k, row in enumerate(file.read_text().split("\n")) if "F1200" in row)
    here = rows["line"] == first
    tool, position = rows["tool"][here], rows["position"][here]
    assert len(tool) > 100
    length = np.array([0.0, 0.0, 80.0])
    wanted = BSpline(KNOTS, POINTS, 3)(tool[:, 0] / 60.0)
    wanted[:, :3] += length
    assert np.abs(tool - wanted).max() < 1e-5
    assert np.abs(tip_of(kind, position, length) - wanted[:, :3]).max() < 2e-5


STANDING = {
    "cusp": ([[0, 0], [10, 10], [0, 10], [10, 0]], [1, 1, 1, 1]),
    "cusp but for 1e-9": ([[0, 0], [10, 10], [1e-9, 10], [10, 0]], [1, 1, 1, 1]),
    "tip rests at an inner knot": (
        [[0, 0], [3, 9], [8, 2], [8, 2], [8, 2], [15, 3], [20, 0]],
        [1, 1, 1, 2, 2, 2, 2],
    ),
    "large cusp": ([[0, 0], [300, 300], [0, 300], [300, 0]], [1, 1, 1, 1]),
    "small cusp": ([[0, 0], [0.01, 0.01], [0, 0.01], [0.01, 0]], [1, 1, 1, 1]),
}
"""X and Y of the control points, and the inner and last knots: the tip stands and the axes turn."""


@pytest.mark.parametrize("name", share([*STANDING], [*STANDING][:-1]))
def test_the_tip_stands_on_a_curve_while_axes_turn(name: str, tmp_path: Path) -> None:
    """C grows evenly with the parameter, so it gives the place on the curve."""
    flat, last = STANDING[name]
    knots = np.array([0.0] * 4 + [float(k) for k in last])
    knots = np.concatenate((knots, [knots[-1]] * (len(flat) + 4 - len(knots))))
    even = np.array([knots[k + 1 : k + 4].mean() for k in range(len(flat))])
    points = np.column_stack((flat, np.zeros(len(flat)), -5.0 * even, 30.0 * even))
    rows = [
        f"K{knot} X{x:.9f} Y{y} Z{z} A{a:.12f} C{c:.12f}"
        for knot, (x, y, z, a, c) in zip(knots.tolist(), points.tolist(), strict=False)
    ]
    file, trace = tmp_path / "part.nc", tmp_path / "trace.npz"
    words = [f"G6.2 P4 {rows[0]} F1200.", *rows[1:], *(f"K{k}" for k in knots[-4:])]
    start = "G21 G90 G94\nG0 X0. Y0. A0. C0.\nG43.4 H1\nG0 Z0."
    file.write_text("\n".join([start, *words, "G49", "M30"]) + "\n")
    machine = placed(five_axis_machine("xyzac"), tmp_path)
    report = check(file, machine, RunOptions(dialect="fanuc", outputs=Outputs(trace=str(trace))))
    assert report.ok, [fault.diagnostic for fault in report.faults]
    assert not any(report.violations.values())
    found = np.load(trace)
    tool = found["tool"][(found["line"] >= 5) & (found["line"] < 5 + len(words))]
    wanted = BSpline(knots, points, 3)(np.minimum(tool[:, 4] / 30.0, knots[-1]))
    wanted[:, 2] += 80.0
    assert len(tool) > 100
    assert np.abs(tool - wanted).max() < 1e-5
    steps = np.linalg.norm(np.diff(tool[:, :3], axis=0), axis=1)
    assert steps.max() <= 1.001 * 20.0 * 1e-3
    length = found["s"][(found["line"] >= 5) & (found["line"] < 5 + len(words))]
    assert (steps <= np.diff(length) + 1e-9).all(), "the tip goes no farther than the length"


def siemens_blocks(program: str) -> list:
    text, options = read(program, dialect="siemens")
    return [block for block in run(text, **options) if isinstance(block, NurbsFeed | Polyline)]


VECTORS = np.array([[0.1, 0.1, 1.0], [0.3, 0.1, 2.0], [0.1, -0.2, 0.7], [-0.2, -0.3, 0.9]])


def test_directions_at_control_points_become_angles() -> None:
    points = "\n".join(
        f"X{10 * k + 10} A3={x} B3={y} C3={z}" for k, (x, y, z) in enumerate(VECTORS.tolist())
    )
    blocks = siemens_blocks(f"G0 A-20 C30\nTRAORI\nBSPLINE F600\n{points}\nM30")
    curve = next(block for block in blocks if isinstance(block, NurbsFeed))
    angles = curve.control_points[:, 3:]
    way = direction(angles[1:, 0], angles[1:, 1] - 90.0)
    assert np.abs(way - VECTORS / np.linalg.norm(VECTORS, axis=1)[:, None]).max() < 1e-12
    assert (angles[:, 0] < 0.0).all()
    assert np.abs(np.diff(angles[:, 1])).max() <= 180.0


def test_oriaxes_turns_the_axes_linearly_and_orivect_ends_it() -> None:
    move = "G1 X10 A3=0.5 B3=0.1 C3=1 F600"
    start = "G0 A-20 C30\nTRAORI\n"
    linear = siemens_blocks(f"{start}ORIAXES\n{move}\nM30")[-1]
    circle = siemens_blocks(f"{start}ORIAXES\nORIVECT\n{move}\nM30")[-1]
    default = siemens_blocks(f"{start}{move}\nM30")[-1]
    assert isinstance(linear, Polyline)
    assert isinstance(circle, NurbsFeed)
    assert isinstance(default, NurbsFeed)
    assert (circle.control_points == default.control_points).all()
    assert np.abs(linear.points[-1] - circle.control_points[-1]).max() < 1e-9


@pytest.mark.parametrize("start", [(0.0, 77.0), (-30.0, 400.0), (200.0, -50.0), (360.0, 10.0)])
def test_angles_of_a_direction_stay_near_those_before(start: tuple[float, float]) -> None:
    for tilt, p in ((25.0, 10.0), (60.0, 170.0), (0.0, 0.0), (120.0, -100.0)):
        wanted = direction(np.array(tilt), np.array(p))
        found = angles_of(start, 3.0 * wanted, 90.0)
        assert (
            np.abs(direction(np.array(found[0]), np.array(found[1] - 90.0)) - wanted).max() < 1e-9
        )
        assert abs(found[1] - start[1]) <= 180.0 + 1e-9
        assert abs(found[0] - start[0]) <= 180.0 + 1e-9


def test_a_curve_of_rotary_axes_alone_has_its_feed_in_degrees() -> None:
    curve = "K0 A0. C0. F600.\nK0 A5. C9.\nK0 A9. C20.\nK0 A10. C30.\nK1\nK1\nK1\nK1"
    for units in ("G20", "G21"):
        text, options = read(f"{units}\nG6.2 P4 {curve}\nM30")
        found = next(block for block in run(text, **options) if isinstance(block, NurbsFeed))
        assert found.feed == pytest.approx(10.0)


ERRORS = {
    "direction without tool-tip control": ("word-unused", "G1 X1 ¦A3=1 F60"),
    "direction on an arc": ("word-unused", "TRAORI\nG2 X2 I1 F60 ¦A3=1"),
    "direction and angle": ("tool-direction", "TRAORI\nG1 X1 ¦A5 A3=1 F60"),
    "direction and angle of a point": ("tool-direction", "TRAORI\nBSPLINE F60\nX1 ¦C5 A3=1"),
    "no direction": ("tool-direction", "TRAORI\nG1 X1 ¦A3=0 F60"),
    "increment of a direction": ("code-not-supported", "TRAORI\nG1 X1 A3=¦IC(1) F60"),
    "tip at rest": (
        "nurbs-tip-rests",
        "TRAORI\n¦BSPLINE F60\nA5\nX1 A6\nX2 A7\nX3 A8\nM30",
    ),
}


@pytest.mark.parametrize("name", ERRORS)
def test_wrong_directions_are_refused_at_their_place(name: str) -> None:
    code, marked = ERRORS[name]
    program, options = read(marked.replace("¦", ""), dialect="siemens")
    found = error_of(program, **options)
    line = next(k for k, row in enumerate(marked.split("\n"), 1) if "¦" in row)
    assert (found.code, found.line) == (code, line)
