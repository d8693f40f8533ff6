"""Squareness and error tables in a machine file: what is read, and what is refused at its line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.registry import open_board
from cnc.machine.compensation import angle, read_error_table
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import MachineFileError, UsageError

LIMITS = "steps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\nmax_jerk = 9000\n"


def load(tmp_path: Path, *, head: str = "", x: str = "", more: str = "") -> Machine:
    file = tmp_path / "m.toml"
    axes = f"[axes.x]\n{LIMITS}travel = [0, 300]\n{x}\n[axes.y]\n{LIMITS}travel = [0, 200]\n"
    file.write_text(f"[machine]\n{head}\n{axes}{more}\n")
    return load_machine(file)


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("0.02 deg", 0.02),
        ("-.5deg", -0.5),
        ("0.35 mm/m", math.degrees(math.atan(0.00035))),
        ("1e-1 DEG", 0.1),
    ],
)
def test_an_angle_has_its_unit(text: str, degrees: float) -> None:
    assert math.degrees(angle(text)) == pytest.approx(degrees, rel=1e-12)


WRONG_ANGLES = [
    ("squareness = { xy = 0.02 }", "machine.squareness.xy: must have a unit"),
    ('squareness = { xy = "0.02" }', "machine.squareness.xy: must be a number with its unit"),
    ('squareness = { xy = "0.02 rad" }', "machine.squareness.xy: must be a number with its unit"),
    ('squareness = { xy = "90 deg" }', "machine.squareness.xy: must be at most 5 degrees"),
    ('squareness = { yx = "1 deg" }', "machine.squareness.yx: there is no such key"),
    ('squareness = { xz = "1 deg" }', "machine.squareness.xz: the machine has no axis z"),
]


@pytest.mark.parametrize(("head", "message"), WRONG_ANGLES)
def test_wrong_angles_are_errors_at_their_line(tmp_path: Path, head: str, message: str) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, head=head)
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.line == 2


GOOD = "position,error\n0,0\n100,0.01\n300,0.02\n"
WRONG_TABLES = [
    ("x.csv", None, "is not readable: No such file"),
    ("x.csv", "", "the first line of x.csv must be position,error"),
    ("x.csv", "0,0\n300,0.1\n", "the first line of x.csv must be position,error"),
    ("x.csv", "position,error\n0,0\n", "an error table has at least two rows"),
    ("x.csv", "position,error\n0,0\n300\n", "line 3 of x.csv must have 2 numbers"),
    ("x.csv", "position,error\n0,0\n300,nan\n", "line 3 of x.csv must have 2 numbers"),
    ("x.csv", "position,error\n0,0\n100,0\n100,0.1\n300,0\n", "two rows are for 100"),
    ("x.csv", "position,error\n0,0\n200,0\n100,0.1\n300,0\n", "the row for 100 stands behind"),
    ("x.csv", "position,error\n0,0\n1,-0.9\n300,0\n", "between 0 and 1 the error changes by -0.9"),
    (
        "x.csv",
        "position,error\n0,0\n1,0.4\n2,0\n3,0.4\n4,0\n300,0\n",
        "the spline through the rows",
    ),
    ("x.csv", "position,error\n0,0\n250,0\n", "the table is for 0 to 250, the travel is 0 to 300"),
    ("x.csv", "position,forward_error,reverse_error\n0,0,-0.1\n300,0,0\n", "stands lower when"),
    ("x.comp", "0 0 0\n300 0.1 0.1\n", "between 0 and 300 the error changes by -299.9"),
    ("x.comp", "0 0\n300 300\n", "line 1 of x.comp must have 3 numbers"),
]


@pytest.mark.parametrize(("name", "text", "message"), WRONG_TABLES)
def test_wrong_tables_are_errors_at_the_line_of_the_machine_file(
    tmp_path: Path, name: str, text: str | None, message: str
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, x=f'error_table = "{name}"')
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.message.startswith("axes.x.error_table: ")
    assert caught.value.diagnostic.line == 9


BOTH = "position,forward_error,reverse_error\n0,-0.02,0.02\n300,0.01,0.03\n"


@pytest.mark.parametrize(
    ("table", "backlash", "message"),
    [
        (BOTH, "0.02", "have the backlash in them"),
        (
            "position,error\n0,0\n0.03,0\n300,0\n",
            "0.04",
            "the backlash, 0.04, is larger than a step",
        ),
        ("position,forward_error,reverse_error\n0,0,2\n1,0,2\n300,0,2\n", None, "is larger than"),
    ],
)
def test_a_table_that_contradicts_the_backlash_is_an_error(
    tmp_path: Path, table: str, backlash: str | None, message: str
) -> None:
    (tmp_path / "x.csv").write_text(table)
    more = "" if backlash is None else f"\nbacklash = {backlash}"
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, x=f'error_table = "x.csv"{more}')
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.line == 9


@pytest.mark.parametrize("value", ["0", "-0.04", '"0.04"', "inf"])
def test_a_backlash_is_a_length(tmp_path: Path, value: str) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, x=f"backlash = {value}")
    assert "axes.x.backlash" in caught.value.diagnostic.message
    assert caught.value.diagnostic.line == 9


def test_a_table_of_both_directions_is_a_mean_with_a_play(tmp_path: Path) -> None:
    """Pushed up, the axis stands at place + forward error; so the motor goes to the place."""
    (tmp_path / "x.csv").write_text(BOTH)
    motors = load(tmp_path, x='error_table = "x.csv"').compensation
    up, down = (motors.motors_at(np.array([[x, 0.0]])) for x in (300.01, 0.02))
    assert up[0, 0] == pytest.approx(300.0, abs=1e-4)
    pushed = motors.motors_at(np.array([[0.02, 0.0]]), {0: -1.0})
    assert pushed[0, 0] == pytest.approx(0.0, abs=1e-4)
    assert down[0, 0] == pytest.approx(0.04, abs=1e-4)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("[[0, 0], [300]]", "must have rows of two or three numbers"),
        ('[[0, 0], [300, "a"]]', "must have rows of two or three numbers"),
        ("7", "must be"),
    ],
)
def test_wrong_rows_are_errors(tmp_path: Path, rows: str, message: str) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, x=f"error_table = {rows}")
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.line == 9


def test_three_forms_of_a_table_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("position,error\n# a dial gauge\n0,0\n\n100,0.01\n300,0.02\n")
    (tmp_path / "x.comp").write_text("0 0 0\n100 100.01 100.01\n300 300.02 300.02\n")
    file = load(tmp_path, x='error_table = "x.csv"').axes["x"].error_table
    rows = (
        load(tmp_path, x="error_table = [[0, 0], [100, 0.01], [300, 0.02]]").axes["x"].error_table
    )
    assert file == rows
    flat = [value for row in read_error_table(tmp_path / "x.comp") for value in row]
    assert flat == pytest.approx([0, 0, 0, 100, 0.01, 0.01, 300, 0.02, 0.02], abs=1e-9)


def test_a_table_is_for_the_whole_travel_of_an_axis_with_a_motor(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(GOOD)
    load(tmp_path, x='error_table = "x.csv"')
    with pytest.raises(MachineFileError, match="needs a motor for each axis"):
        load(
            tmp_path,
            head='squareness = { xy = "1 mm/m" }',
            more=f"[axes.z]\n{LIMITS}\n[axes.a]\n{LIMITS}\n[axes.c]\n{LIMITS}\n"
            '[kinematics]\ntype = "xyzac"',
        )


@pytest.mark.parametrize(
    "changes",
    [
        {"head": 'squareness = { xy = "1 mm/m" }'},
        {"x": "error_table = [[0, 0], [300, 0.1]]"},
        {"x": "backlash = 0.04"},
    ],
)
def test_a_board_that_takes_lines_is_refused(tmp_path: Path, changes: dict[str, str]) -> None:
    """Its firmware counts, homes and limits in places of the motors."""
    with pytest.raises(UsageError) as caught:
        open_board(load(tmp_path, **changes), kind="grbl-sim")
    assert caught.value.diagnostic.code == "compensation-on-board"


def test_the_motors_stand_at_home_where_the_tip_is_at_home(tmp_path: Path) -> None:
    """X homes at 0, Y at 0; with homing at the high end the tip is at the end of the travel."""
    (tmp_path / "x.csv").write_text("position,error\n-1,0.05\n301,0.05\n")
    machine = load(
        tmp_path,
        head='squareness = { xy = "1 deg" }',
        x='error_table = "x.csv"',
        more='homing = { end = "high" }',
    )
    motors = machine.of_joints
    assert not motors.is_compensated
    # Y is 200 above: its place is 200 / cos 1 degree, and X has to make up for 200 tan 1 degree.
    assert motors.axes["y"].home("y") == pytest.approx(200.0 / math.cos(math.radians(1.0)))
    assert motors.axes["x"].home("x") == pytest.approx(200.0 * math.tan(math.radians(1.0)) - 0.05)
