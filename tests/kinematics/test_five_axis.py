"""Formulas of five-axis machines: both directions, derivatives, bounds, and programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cnc.api import Outputs, RunOptions, check, load_machine
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.kinematics.five_axis import FiveAxis
from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series
from cnc.machine.models import Axis, Board, Machine, PathLimits, Program
from cnc.planner.joint_map import JointMap
from cnc.planner.joints import ToolTipOf
from tests.support.five_axis import TYPES, five_axis_machine, table_of, tip_of
from tests.support.gcode.gcode_cases import error_of, run
from tests.support.paths import ROOT
from tests.support.soak import share

OFFSET = (0.5, -1.0, 80.0)


def joints_of(kind: str, reverse: tuple[str, ...] = ()) -> JointMap:
    found = JointMap.of(five_axis_machine(kind, reverse=reverse))
    assert found is not None
    return found.with_tool(OFFSET)


def poses(count: int) -> np.ndarray:
    rng = np.random.default_rng()
    return rng.uniform(-1.0, 1.0, (count, 5)) * np.array([100.0, 100.0, 100.0, 110.0, 400.0])


@pytest.mark.parametrize("reverse", [(), ("c",), ("a", "b", "c")])
@pytest.mark.parametrize("kind", TYPES)
def test_both_directions_fit_the_geometry(kind: str, reverse: tuple[str, ...]) -> None:
    letters = tuple(letter for letter in reverse if letter in (table_of(kind).tilting, "c"))
    joints, pose = joints_of(kind, letters), poses(200)
    tip = joints.forward(pose)
    assert np.abs(tip[:, :3] - tip_of(kind, pose, np.array(OFFSET), letters)).max() < 1e-9
    assert (tip[:, 3:] == pose[:, 3:]).all()
    assert np.abs(joints.inverse(tip) - pose).max() < 1e-9


@pytest.mark.parametrize("kind", TYPES)
def test_at_zero_angles_the_tip_has_the_coordinates_of_the_joints(kind: str) -> None:
    pose = poses(5) * np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    assert np.abs(joints_of(kind).forward(pose) - pose).max() < 1e-12


@pytest.mark.parametrize("kind", ["xyzac", "xyzbc", "xyzac-head", "xyzbc-head"])
def test_the_tool_points_as_iso_841_says(kind: str) -> None:
    """The direction on the part is that in which a longer tool moves the gauge point."""
    pose = poses(50)
    bare = JointMap.of(five_axis_machine(kind))
    assert bare is not None
    long, short = (bare.with_tool((0.0, 0.0, length)).forward(pose)[:, :3] for length in (1.0, 0.0))
    direction = short - (long - np.array([0.0, 0.0, 1.0]))
    tilt, c = np.radians(pose[:, 3]), np.radians(pose[:, 4])
    along = np.array([np.sin(c), -np.cos(c)] if "ac" in kind else [np.cos(c), np.sin(c)])
    expected = np.stack([*(along * np.sin(tilt)), np.cos(tilt)], axis=-1)
    assert np.abs(direction - expected).max() < 1e-12


def terms_of_a_path() -> np.ndarray:
    rng = np.random.default_rng()
    terms = rng.uniform(-1.0, 1.0, (4, 5)) * np.array([[60.0], [3.0], [0.5], [0.1]])
    terms[1:, 3:] *= 5.0
    return terms


@pytest.mark.parametrize("kind", TYPES)
def test_the_series_of_the_joints_moves_the_tip_along_its_path(kind: str) -> None:
    """Nine terms of the joints, through the forward kinematics of the test."""
    terms, order, joints = terms_of_a_path(), 8, joints_of(kind)
    zeros = [0.0] * (order - 3)
    tip = [Series([np.array([v]) for v in (*terms[:, c], *zeros)]) for c in range(5)]
    found = np.array([[float(np.asarray(t)[0]) for t in s.terms] for s in joints.series(tip)])
    u = np.linspace(-0.25, 0.25, 41)
    pose = u[:, None] ** np.arange(order + 1) @ found.T
    wanted = u[:, None] ** np.arange(4) @ terms
    assert np.abs(tip_of(kind, pose, np.array(OFFSET)) - wanted[:, :3]).max() < 1e-9
    assert np.abs(pose[:, 3:] - wanted[:, 3:]).max() < 1e-12


@pytest.mark.parametrize("kind", TYPES)
def test_bounds_hold_every_term(kind: str) -> None:
    rng, joints, order = np.random.default_rng(), joints_of(kind), 8
    start, rate = rng.uniform(-50.0, 50.0, 5), rng.uniform(-10.0, 10.0, 5)
    u = np.linspace(0.0, 2.0, 33)
    zeros = [np.zeros(33)] * (order - 1)
    places = [Series([a + r * u, np.full(33, r), *zeros]) for a, r in zip(start, rate, strict=True)]
    whole = [
        Series(
            [
                Interval(np.array([min(a, a + 2 * r)]), np.array([max(a, a + 2 * r)])),
                np.array([r]),
                *[np.zeros(1)] * (order - 1),
            ]
        )
        for a, r in zip(start, rate, strict=True)
    ]
    for series, bound in zip(joints.series(places), joints.series(whole), strict=True):
        for term, limits in zip(series.terms, bound.terms, strict=True):
            slack = 1e-9 * (1.0 + np.abs(term).max())
            low = limits.lo if isinstance(limits, Interval) else limits
            high = limits.hi if isinstance(limits, Interval) else limits
            assert (np.asarray(term) >= low - slack).all()
            assert (np.asarray(term) <= high + slack).all()


PROGRAM = """{units} G90 G94 G17
T1 M6
G0 X10. Y5. Z10. {tilt}-10. C30.
{on}
G1 X20. Y0. Z0. F1500.
{tilt}-40. C90.
G2 X20. Y0. I-20. J0. {tilt}-20. C-90.
{off}
G0 Z50.
M30
"""
SWITCHES = {
    "fanuc": ("G43.4 H1", "G49"),
    "haas": ("G234 H1", "G49"),
    "linuxcnc": ("M428\nG43 H1", "M429\nG49"),
    "siemens": ("TRAORI", "TRAFOOF"),
}


def placed(machine: Machine, folder: Path) -> Machine:
    """Return the machine with a tool table of one tool, 80 mm long."""
    table = folder / "tools.tbl"
    table.write_text("T1 P1 Z80.0 D6\n")
    return machine.model_copy(update={"program": Program(tool_table=table)})


@pytest.mark.parametrize(
    ("kind", "dialect"),
    [*((kind, "fanuc") for kind in TYPES), *(("xyzac", name) for name in SWITCHES)][:: share(1, 3)],
)
def test_the_tip_keeps_to_the_path(kind: str, dialect: str, tmp_path: Path) -> None:
    machine, trace = placed(five_axis_machine(kind), tmp_path), tmp_path / "trace.npz"
    file = tmp_path / "part.nc"
    on, off = SWITCHES[dialect]
    units, tilt = "G71" if dialect == "siemens" else "G21", table_of(kind).tilting.upper()
    file.write_text(PROGRAM.format(units=units, tilt=tilt, on=on, off=off))
    report = check(file, machine, RunOptions(dialect=dialect, outputs=Outputs(trace=str(trace))))
    assert report.ok, report.faults
    assert not any(report.violations.values())
    data = np.load(trace)
    lines, length = file.read_text().split("\n"), np.array([0.0, 0.0, 80.0])
    first = 1 + next(k for k, line in enumerate(lines) if line.startswith("G1 X20"))
    tip = tip_of(kind, data["position"], length) - length
    assert (
        np.abs(tip + length - data["tool"][:, :3])[
            (data["line"] >= first) & (data["line"] < first + 3)
        ].max()
        < 1e-5
    )
    still = tip[data["line"] == first + 1]
    assert np.abs(still - np.array([20.0, 0.0, 0.0])).max() < 1e-5
    arc = tip[data["line"] == first + 2]
    assert np.abs(np.hypot(arc[:, 0], arc[:, 1]) - 20.0).max() < 1e-5
    assert np.abs(arc[:, 2]).max() < 1e-5
    # The joints do not jump where the control begins and ends.
    step = np.abs(np.diff(data["position"], axis=0)).max(axis=0) / machine.path.period
    most = np.array([axis.max_velocity for axis in machine.axes.values()])
    assert (step <= 1.001 * most).all()


def read(program: str, dialect: str = "fanuc", kind: str = "xyzac", **options):
    machine = five_axis_machine(kind)
    tools = ToolTable()
    tools.put(ToolEntry(1, {"Z": 80.0}))
    options |= {"axes": machine.axis_names, "dialect": dialect, "tools": tools}
    return program, options | {"tool_tip": ToolTipOf.machine(machine)}


@pytest.mark.parametrize(
    "line", ["G28 Z0.", "G53 G0 Z0.", "G81 Z-1. R1. F60.", "G41 D1", "G30 P2 Z0."]
)
def test_codes_with_stored_places_are_refused_under_tip_control(line: str) -> None:
    program, options = read(f"G43.4 H1\n{line}")
    found = error_of(program, **options)
    assert (found.code, found.line) == ("tip-control-active", 2)


@pytest.mark.parametrize("code", ["M68", "M67"])
def test_the_output_that_selects_kinematics_is_refused(code: str) -> None:
    """LinuxCNC's configurations wire analog output 3 to the kinematics."""
    program, options = read(f"G0 X1\n{code} E3 Q0\nG1 X2 A5 F60\nM2", dialect="linuxcnc")
    found = error_of(program, **options)
    assert (found.code, found.line, found.column) == ("code-not-supported", 2, 1)
    run(program.replace("E3", "E2"), **options)
    del options["tool_tip"]
    run(program, **options)


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ({}, "tilt_point and turn_point"),
        ({"tilt_point": (0.0, 0.0, 0.0)}, "turn_point"),
        ({"turn_point": (0.0, 0.0, 0.0)}, "tilt_point"),
        ({"tilt_point": (0.0, 0.0, 0.0), "turn_point": (0.0, 0.0, 0.0)}, None),
    ],
)
def test_places_of_rotary_axes_that_the_machine_file_lacks_are_assumed_once(
    given: dict[str, tuple[float, float, float]], missing: str | None, tmp_path: Path
) -> None:
    table = FiveAxis(type="xyzac", **given)
    machine = placed(five_axis_machine("xyzac").model_copy(update={"kinematics": table}), tmp_path)
    file = tmp_path / "part.nc"
    file.write_text("G21 G90\nG0 X1.\nG43.4 H1\nG1 X2. F60.\nG49\nG43.4 H1\nX3.\nG49\nM30\n")
    report = check(file, machine, RunOptions(dialect="fanuc"))
    assert report.ok
    found = [each for each in report.warnings if each.code == "rotary-axis-place"]
    wanted = [] if missing is None else [(3, f"[kinematics] has no {missing}: taken as X0 Y0 Z0")]
    assert [(each.line, each.message) for each in found] == wanted


def test_tip_control_is_refused_under_compensation() -> None:
    program, options = read("G41 D1 G1 X5. F60.\nG43.4 H1")
    assert error_of(program, **options).code == "compensation-active"


def test_the_position_returns_when_the_control_ends() -> None:
    program, options = read("G0 X10. Y20. Z30. A-30. C70.\nG43.4 H1\nG49\nG91 G0 X1.")
    end = run(program, **options)[-1].points[-1]
    assert np.abs(end - np.array([11.0, 20.0, 30.0, -30.0, 70.0])).max() < 1e-12


def test_another_length_under_control_leaves_the_joints() -> None:
    program, options = read("G0 A-30. C70.\nG43.4 H1\nG43.4 H2\nG49\nG91 G0 X1.")
    options["tools"].put(ToolEntry(2, {"Z": 20.0}))
    end = run(program, **options)[-1].points[-1]
    assert np.abs(end - np.array([1.0, 0.0, 0.0, -30.0, 70.0])).max() < 1e-12


def test_a_run_does_not_begin_under_tip_control(tmp_path: Path) -> None:
    machine = placed(five_axis_machine("xyzac"), tmp_path)
    file = tmp_path / "part.nc"
    file.write_text(PROGRAM.format(units="G21", tilt="A", on="G43.4 H1", off="G49"))
    report = check(file, machine, RunOptions(dialect="fanuc", from_line=6))
    assert [each.diagnostic.code for each in report.faults] == ["from-line-unknown"]
    assert check(file, machine, RunOptions(dialect="fanuc", from_line=9)).ok


def test_travel_is_that_of_the_joints_on_a_bulge(tmp_path: Path) -> None:
    """The tip stands still; the joint leaves its travel in the middle of the move only."""
    machine = placed(five_axis_machine("xyzac"), tmp_path)
    file = tmp_path / "part.nc"
    file.write_text("G21 G90\nG0 X0. Y11. Z40.\nG43.4 H1\nG1 X0. Y60. Z0. F2000.\nC180.\nM30\n")
    assert check(file, machine, RunOptions(dialect="fanuc")).ok
    x = machine.axes["x"].model_copy(update={"travel": (-40.0, 40.0)})
    tight = machine.model_copy(update={"axes": machine.axes | {"x": x}})
    report = check(file, tight, RunOptions(dialect="fanuc"))
    assert [(each.diagnostic.code, each.diagnostic.line) for each in report.faults] == [
        ("soft-limit", 5)
    ]


def test_the_farthest_place_of_a_move_is_named(tmp_path: Path) -> None:
    machine = placed(five_axis_machine("xyzac"), tmp_path)
    a = machine.axes["a"].model_copy(update={"travel": (-110.0, 30.0)})
    machine = machine.model_copy(update={"axes": machine.axes | {"a": a}})
    file = tmp_path / "part.nc"
    file.write_text("G21 G90\nG43.4 H1\nG1 X0. Y5. A-150. F1000.\nM30\n")
    report = check(file, machine, RunOptions(dialect="fanuc"))
    found = [each.diagnostic for each in report.faults if "A" in each.diagnostic.message]
    assert [each.line for each in found] == [3]
    assert found[0].message.startswith("A would reach -150 degrees")


def test_the_shipped_program_cuts_a_cone(tmp_path: Path) -> None:
    trace = tmp_path / "trace.npz"
    program = ROOT / "programs" / "five-axis" / "cone.nc"
    report = check(program, load_machine("trunnion"), RunOptions(outputs=Outputs(trace=str(trace))))
    assert report.ok
    assert not any(report.violations.values())
    data = np.load(trace)
    line = 1 + next(
        k for k, text in enumerate(program.read_text().split("\n")) if text.startswith("G3")
    )
    pose = data["position"][data["line"] == line]

    # the same motion by rotations of scipy: the axis of the tool lies on the cone at each place
    def place(length: float) -> np.ndarray:
        tool = pose[:, :3] - np.array([0.0, 0.0, length])
        tilt = Rotation.from_euler("x", pose[:, 3:4], degrees=True)
        turn = Rotation.from_euler("z", pose[:, 4:5], degrees=True)
        centre = np.array([0.0, 0.0, -60.0])
        return turn.apply(tilt.apply(tool - centre) + centre)

    tip, above = place(80.0), place(60.0)
    assert np.abs(np.hypot(tip[:, 0], tip[:, 1]) - 33.0).max() < 1e-5
    narrower = 33.0 - 20.0 * np.sin(np.radians(15.0))
    assert np.abs(np.hypot(above[:, 0], above[:, 1]) - narrower).max() < 1e-5
    assert np.abs(tip[:, 2] + 10.0).max() < 1e-5


def test_a_large_turn_on_a_short_path_is_planned(tmp_path: Path) -> None:
    """35 degrees on 0.014 mm, 80 mm from the start: rounding of the length is one of degrees."""
    axis = Axis(
        steps_per_mm=200.0, max_velocity=25.0, max_acceleration=383.897, max_jerk=7677.946844
    )
    machine = Machine(
        axes=dict.fromkeys(("x", "y", "z", "b", "c"), axis),
        path=PathLimits(max_feed=300.0, period=1e-4),
        board=Board(max_step_rate=1e9),
    )
    file = tmp_path / "part.nc"
    file.write_text(
        "G21 G90\nG1 X-0.5267 Y0.5283 Z-80 F125.7462\nG1 X-0.5155 Y0.5373 B35.3727 C-22.1659\nM2\n"
    )
    report = check(file, machine, RunOptions(dialect="linuxcnc"))
    assert report.ok, report.faults
