"""Homing rehearsed on the loopback board: rotary axes, gantries, and --home."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import RunOptions, home, run
from cnc.boards.loopback import SwitchedLoopback
from cnc.boards.registry import open_board
from cnc.cli import exit_code
from cnc.kinematics.delta import Delta
from cnc.kinematics.planar import CoreXY, CoreXZ
from cnc.machine.models import Machine, Motor
from cnc.model.diagnostics import BoardError, UsageError
from cnc.session.homing import Squared
from tests.support.boards.gantry_board import QUICK, axis
from tests.support.kinematics import machine_of


def machine(offset: float = 0.3, **rotary) -> Machine:
    motors = (Motor(offset=0.0), Motor(offset=offset))
    axes = {
        "x": axis((0.0, 8.0)),
        "y": axis((-2.0, 6.0), motors=motors),
        "z": axis((-5.0, 1.0)),
        "a": axis((-20.0, 10.0), QUICK.model_copy(update={"end": "high", "position": 5.0})),
        "c": axis((-30.0, 30.0)),
    }
    return Machine(axes=axes | rotary)


def test_gantries_and_rotary_axes_home_at_the_places_of_the_machine_file() -> None:
    known, squared = machine(), list[Squared]()
    board = open_board(known, kind="loopback", homes=True)
    assert isinstance(board, SwitchedLoopback)
    found = home(known, board=board, on_squared=squared.append)
    assert found == {"x": 0.0, "y": -2.0, "z": 1.0, "a": 5.0, "c": -30.0}
    # Both motors end as far from their switches, which are 0.3 mm apart.
    assert board.motor_steps[1] == pytest.approx([-200, -200], abs=1)
    assert [each.letter for each in squared] == ["y"]
    # The machine stood at zero: each axis went where it stands now.
    moved = [steps[0] for column, steps in enumerate(board.motor_steps) if column != 1]
    assert moved == pytest.approx([0, 100, 500, -3000], abs=1)


def test_a_difference_beyond_the_limit_is_an_error() -> None:
    known = machine(offset=QUICK.squaring_limit + 0.5)
    board = open_board(known, kind="loopback", homes=True)
    assert isinstance(board, SwitchedLoopback)
    # The switch of the second motor is not where the file says.
    towards, at = board.places[1, 1]
    board.places[1, 1] = towards, at - 600
    with pytest.raises(BoardError) as caught:
        home(known, ["y"], board=board)
    assert caught.value.diagnostic.code == "homing-square"


def test_a_program_runs_from_the_homed_position(tmp_path: Path) -> None:
    file = tmp_path / "part.ngc"
    file.write_text("G21 G90\nG1 X5 Y3 A-4 C20 F600\nM2\n")
    report = run(file, machine(), RunOptions(home=True), board="loopback")
    assert report.ok, report.faults
    assert report.steps == {"x": 500, "y": 500, "z": 0, "a": 900, "c": 5000}


def test_each_joint_of_a_delta_homes(tmp_path: Path) -> None:
    known = machine_of("delta")
    assert isinstance(known.kinematics, Delta)
    joint = known.joints["a"].model_copy(update={"travel": (0.0, 300.0), "homing": QUICK})
    known = known.model_copy(update={"joints": dict.fromkeys(("a", "b", "c"), joint)})
    found = home(known, board="loopback")
    height = (known.kinematics.rod**2 - known.kinematics.radius**2) ** 0.5
    assert found["x"] == pytest.approx(0.0, abs=1e-9)
    assert found["z"] == pytest.approx(-height)


def test_axes_without_a_travel_have_no_switch() -> None:
    bare = axis((0.0, 8.0)).model_copy(update={"travel": None})
    with pytest.raises(UsageError) as caught:
        home(machine(x=bare), board="loopback")
    assert caught.value.diagnostic.code == "no-switches"
    known = machine(c=bare)
    assert home(known, board="loopback")["c"] == 0.0, "its position is assumed"
    with pytest.raises(UsageError) as caught:
        home(known, ["c"], board="loopback")
    assert caught.value.diagnostic.code == "no-switch"


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        (CoreXY(type="corexy"), {"x": 0.0, "y": -2.0, "z": 1.0}),
        (CoreXZ(type="corexz"), {"x": 0.0, "y": -2.0, "z": 1.0}),
    ],
)
def test_belts_move_one_axis_at_a_time_to_its_switch(kind, found) -> None:
    axes = {"x": axis((0.0, 8.0)), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))}
    joints = {"a": axis((-99.0, 99.0)), "b": axis((-99.0, 99.0))}
    known = Machine(kinematics=kind, axes=axes, joints=joints)
    board = open_board(known, kind="loopback", homes=True)
    assert isinstance(board, SwitchedLoopback)
    moves: list[np.ndarray] = []
    real = board.send

    def send(chunk) -> None:
        before = board.position_steps
        real(chunk)
        moves.append(board.position_steps - before)

    board.send = send  # type: ignore[method-assign]
    assert home(known, board=board) == found
    letters = list(known.of_joints.axes)
    a, b = np.sum(moves, axis=0)[[letters.index("a"), letters.index("b")]] / 100.0
    first, second = kind.axes
    # The machine stood at zero.
    assert (a + b) / 2 == pytest.approx(found[first], abs=0.02)
    assert (a - b) / 2 == pytest.approx(found[second], abs=0.02)
    for move in moves:
        a, b = move[letters.index("a")], move[letters.index("b")]
        assert abs(a) == pytest.approx(abs(b), abs=2), "one axis moves"


def test_belts_need_the_switch_of_their_axis(tmp_path: Path) -> None:
    axes = {"x": axis((0.0, 8.0)), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))}
    joints = {"a": axis((-99.0, 99.0)), "b": axis((-99.0, 99.0))}
    known = Machine(kinematics=CoreXY(type="corexy"), axes=axes, joints=joints)
    board = open_board(known, kind="loopback", homes=True)
    assert isinstance(board, SwitchedLoopback)
    board.places[1, 0] = board.places[1, 0][0], -1e6
    with pytest.raises(BoardError) as caught:
        home(known, ["y"], board=board)
    assert caught.value.diagnostic.code == "homing-switch"


@pytest.mark.parametrize("axes", [["x"], ["y"], ["x", "y"]])
def test_the_axes_of_two_belts_are_known_together(
    axes: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motor = "steps_per_mm = 100\nmax_velocity = 40\nmax_acceleration = 400\nmax_jerk = 15000\n"
    homing = "homing = { seek = 40, latch = 5, pull_off = 0.5 }\n"
    file = tmp_path / "belts.toml"
    file.write_text(
        '[kinematics]\ntype = "corexy"\n'
        + f"[axes.x]\n{homing}travel = [0, 8]\n[axes.y]\n{homing}travel = [-2, 6]\n"
        + f"[joints.a]\n{motor}[joints.b]\n{motor}"
    )
    assert exit_code(["home", "--machine", str(file), "--board", "loopback", *axes]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sorted(line[0] for line in lines[:2]) == ["X", "Y"]
    assert lines[2:] == ["the machine stands at X0 Y-2"]
