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
    ({"type": 'type = "cartesian"'}, "axes.x.steps_per_mm: is missing"),
    ({"b": "b = {steps_per_mm=100, max_velocity=50}"}, "joints.b.max_acceleration: nothing limits"),
    ({"more": "[axes.a]\n" + AXIS[1:-1].replace(", ", "\n")}, "axes.a: the kinematics has a joint"),
]


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
