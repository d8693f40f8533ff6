"""The tables [kinematics] and [joints] of a machine file."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.boards.registry import open_board
from cnc.machine.load import load_machine
from cnc.model.diagnostics import MachineFileError, UsageError

AXIS = "{steps_per_mm=100, max_velocity=50, max_acceleration=500, max_jerk=9000}"


def load(tmp_path: Path, text: str):
    file = tmp_path / "m.toml"
    file.write_text(text)
    return load_machine(file)


def text_of(**changes: str) -> str:
    """Return a machine file with lines replaced."""
    lines = {
        "type": 'type = "corexy"',
        "x": "[axes.x]\ntravel = [0, 300]",
        "y": "[axes.y]\ntravel = [0, 300]",
        "a": f"[joints]\na = {AXIS}",
        "b": f"b = {AXIS}",
        "more": "",
    } | changes
    kinematics = "[kinematics]\n" + lines.pop("type")
    return "\n".join((lines["x"], lines["y"], lines["a"], lines["b"], kinematics, lines["more"]))


def test_joints_stand_where_the_first_axis_stood_that_they_move(tmp_path: Path) -> None:
    machine = load(tmp_path, text_of(more="[axes.z]\n" + AXIS[1:-1].replace(", ", "\n")))
    assert machine.axis_names == ("x", "y", "z")
    assert tuple(machine.joint_tables) == ("a", "b", "z")
    assert machine.of_joints.axis_names == ("a", "b", "z")


WRONG = [
    ({"type": 'type = "coreyx"'}, "kinematics.type: must be one of"),
    ({"x": "[axes.x]\nmax_velocity = 5"}, "axes.x.max_velocity: belongs to the joints"),
    ({"b": ""}, "kinematics.type: [joints.b] is missing"),
    ({"b": f"b = {AXIS}\nc = {AXIS}"}, "joints.c: there is no such joint"),
    ({"y": ""}, "corexy moves the axis y, which the machine does not have"),
    ({"type": 'type = "corexy"\narms = [1, 2]'}, "kinematics.arms: there is no such key"),
    ({"type": 'type = "scara"'}, "kinematics.arms: is missing"),
    ({"type": 'type = "scara"\narms = [1, -2]'}, "kinematics.arms: must be greater than 0"),
    ({"type": 'type = "scara"\narms = [1]'}, "kinematics.arms: has too few numbers"),
    ({"type": 'type = "scara"\narms = [1, 2e6]'}, "kinematics.arms: must be at most 1e+06"),
    ({"more": "[machine]\nstart = {q = 1}"}, "machine.start.q: there is no such axis or joint"),
    (
        {"more": "[machine]\nstart = {x = -5}"},
        "machine.start.x: -5 is outside the travel, 0 to 300",
    ),
    ({"more": "[machine]\nstart = {x = 1, a = 2}"}, "machine.start: the joints a move x"),
    ({"more": "[machine]\nstart = {x = inf}"}, "machine.start.x: must be a finite number"),
    ({"type": 'type = "cartesian"'}, "axes.x.steps_per_mm: is missing"),
    ({"b": "b = {steps_per_mm=100, max_velocity=50}"}, "joints.b.max_acceleration: nothing limits"),
    ({"more": "[axes.a]\n" + AXIS[1:-1].replace(", ", "\n")}, "axes.a: the kinematics has a joint"),
]


GEOMETRIES = [
    ("delta", "radius = 100\nrod = 100", "kinematics.rod: must be longer than radius"),
    ("delta", "radius = 1\nrod = 9\nangles = [90, 90, 210]", "kinematics.angles: must be three"),
    ("delta", "radius = 1\nrod = 9\nangles = [0, 120, 359.5]", "kinematics.angles: must be three"),
    (
        "rotary-delta",
        "base = 520\nplatform = 40\narm = 110\nrod = 370",
        "kinematics.rod: must be longer than 370",
    ),
    ("cylinder", "radius = 0.001", "kinematics.radius: must be greater than 0.01"),
    ("xyzac", "tilt_point = [0, 0]", "kinematics.tilt_point: has too few numbers"),
    ("xyzac", "turn_point = [0, 0, -2e6]", "kinematics.turn_point: must be at least -1e+06"),
    ("xyzac", "turn_point = [0, 0, inf]", "kinematics.turn_point: must be a finite number"),
]


@pytest.mark.parametrize(("kind", "keys", "message"), GEOMETRIES)
def test_geometry_that_reaches_no_position_is_an_error(
    tmp_path: Path, kind: str, keys: str, message: str
) -> None:
    names = {"delta": "", "rotary-delta": "", "cylinder": "xz"}.get(kind, "xyzac")
    travels = "".join(f"[axes.{each}]\ntravel = [-5, 5]\n" for each in "xyz" if each not in names)
    own = "".join(f"[axes.{each}]\n" + AXIS[1:-1].replace(", ", "\n") + "\n" for each in names)
    joints = {"cylinder": "a", "xyzac": ""}.get(kind, "abc")
    movers = "".join(
        f"[joints.{each}]\n" + AXIS[1:-1].replace(", ", "\n") + "\n" for each in joints
    )
    text = f'[kinematics]\ntype = "{kind}"\n{keys}\n{travels}{own}{movers}'
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, text)
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.line > 0


@pytest.mark.parametrize(("changes", "message"), WRONG)
def test_wrong_tables_are_errors_that_name_the_key(
    tmp_path: Path, changes: dict[str, str], message: str
) -> None:
    load(tmp_path, text_of())
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, text_of(**changes))
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.line > 0


def test_a_board_that_takes_lines_gets_no_joints(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        open_board(load(tmp_path, text_of()), kind="grbl-sim")
    assert caught.value.diagnostic.code == "kinematics-on-board"
    board = open_board(load(tmp_path, text_of()), kind="loopback")
    board.close()
