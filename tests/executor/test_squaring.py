"""Squaring of a gantry, on a board with a switch for each motor."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.api import home
from cnc.machine.models import Homing, Machine
from cnc.model.diagnostics import BoardError
from cnc.session.homing import Squared
from tests.support.boards.gantry_board import PLACES, QUICK, RecordedLoopback, gantry
from tests.support.soak import share

LIMIT = QUICK.squaring_limit


def homed(
    board: RecordedLoopback, machine: Machine, *axes: str
) -> tuple[dict[str, float | None], list[Squared]]:
    found: list[Squared] = []
    return home(machine, axes, board=board, on_squared=found.append), found


def y_motors(board: RecordedLoopback) -> list[int]:
    return board.motor_steps[1]


@settings(max_examples=share(200, 7), deadline=None)
@given(
    skew=st.floats(-LIMIT + 0.05, LIMIT - 0.05),
    offset=st.floats(-0.45, 0.45),
    end=st.sampled_from(("low", "high")),
)
def test_each_motor_ends_at_its_own_switch_and_offset(skew: float, offset: float, end: str) -> None:
    """After homing the motors differ from each other by what the switches and offsets say."""
    homing = QUICK.model_copy(update={"end": end})
    machine = gantry(offset if end == "high" else -offset, homing=homing)
    given_offset = machine.axes["y"].motors[1].offset
    towards = 1 if end == "high" else -1
    # Motor 2 stands skew further along +Y than motor 1; both count from 0 now.
    at = towards * 400.0
    places = {**PLACES, (1, 0): (towards, at), (1, 1): (towards, at + 100 * (given_offset - skew))}
    board = RecordedLoopback(machine, places)
    position, found = homed(board, machine, "y")
    rest = machine.axes["y"].travel[1 if end == "high" else 0]  # type: ignore[index]
    assert position["y"] == rest
    first, second = y_motors(board)
    assert abs(first - (at - towards * 50)) <= 1
    assert abs((second - first) - (-100 * skew)) <= 2, "the second motor has made good the skew"
    assert [each.letter for each in found] == ["y"]
    assert abs(found[0].skew[1] - towards * skew) <= 0.03
    assert found[0].limit == LIMIT


def test_both_motors_move_together_but_for_the_square() -> None:
    machine = gantry(0.0)
    board = RecordedLoopback(machine, {**PLACES, (1, 1): (-1, -450)})
    homed(board, machine, "y")
    alone = [(which, rows) for which, rows in board.rows_sent if which is not None]
    assert {which for which, _ in alone} == {(1, 1)}
    moved = sum(np.abs(rows).sum(axis=0) for _, rows in alone)
    assert moved[0] == moved[2] == 0
    assert moved[1] == pytest.approx(40, abs=6), "as far as the switches are apart"
    before = list(y_motors(board))
    board.rows_sent.clear()
    homed(board, machine, "y")
    assert y_motors(board) == pytest.approx(before, abs=1)


@pytest.mark.parametrize("broken", [0, 1])
def test_switch_that_never_closes_is_an_error_with_both_numbers(broken: int) -> None:
    machine = gantry(0.0)
    board = RecordedLoopback(machine, {**PLACES, (1, broken): (-1, -1e9)})
    with pytest.raises(BoardError) as caught:
        homed(board, machine, "y")
    found = caught.value.diagnostic
    assert found.code == "homing-square"
    closed, open_ = 2 - broken, 1 + broken
    assert f"motor {closed} closed its switch after 4.1" in found.message
    assert f"motor {open_} had not closed its after 6.6" in found.message
    assert "squaring_limit is 2.5 mm" in found.message
    first, second = y_motors(board)
    assert abs(first - second) <= 1, "the motor has returned: the gantry is as it was"
    assert board.known_steps[1] is None


def test_switch_that_closes_at_once_is_an_error() -> None:
    """Its wire breaks while the gantry moves to the switches."""
    machine = gantry(0.0)
    board = RecordedLoopback(machine, {**PLACES, (1, 1): (-1, -100)})
    with pytest.raises(BoardError) as caught:
        homed(board, machine, "y")
    assert caught.value.diagnostic.code == "homing-square"
    assert "motor 2 closed its switch after 1.0" in caught.value.diagnostic.message


@pytest.mark.parametrize("motor", [0, 1])
def test_switch_that_is_closed_always(motor: int) -> None:
    machine = gantry(0.0)
    board = RecordedLoopback(machine, {**PLACES, (1, motor): (-1, 1e9)})
    with pytest.raises(BoardError) as caught:
        homed(board, machine, "y")
    assert caught.value.diagnostic.code == "homing-switch"
    assert f"motor {motor + 1} of Y is still closed" in caught.value.diagnostic.message


@pytest.mark.parametrize("closed", [(0,), (1,), (0, 1)])
def test_switches_that_are_closed_at_the_start(closed: tuple[int, ...]) -> None:
    machine = gantry(0.0)
    places = dict(PLACES)
    for motor in (0, 1):
        places[1, motor] = (-1, 120 if motor in closed else 20)
    board = RecordedLoopback(machine, places)
    position, _ = homed(board, machine, "y")
    assert position["y"] == -2.0
    for motor, place in enumerate(y_motors(board)):
        assert abs(place - (places[1, motor][1] + 50)) <= 2


@pytest.mark.parametrize("lost", [-130, 60, 249])
def test_lost_steps_on_one_side_are_found_and_made_good(lost: int) -> None:
    """Between two homings one motor has lost steps: its count no longer tells its place."""
    machine = gantry(0.0)
    board = RecordedLoopback(machine)
    _, first = homed(board, machine, "y")
    assert abs(first[0].skew[1]) <= 0.02
    before = y_motors(board)[1] - y_motors(board)[0]
    board.places[1, 1] = (-1, PLACES[1, 1][1] + lost)
    _, second = homed(board, machine, "y")
    assert second[0].skew[1] == pytest.approx(lost / 100, abs=0.03)
    assert y_motors(board)[1] - y_motors(board)[0] - before == pytest.approx(lost, abs=2)
    word = "ahead of" if lost > 0 else "behind"
    assert f"motor 2 was {abs(second[0].skew[1]):.3f} mm {word}" in second[0].description


def test_lost_steps_beyond_the_limit_are_an_error() -> None:
    machine = gantry(0.0)
    board = RecordedLoopback(machine)
    homed(board, machine, "y")
    board.places[1, 1] = (-1, PLACES[1, 1][1] - 300)
    with pytest.raises(BoardError) as caught:
        homed(board, machine, "y")
    assert caught.value.diagnostic.code == "homing-square"


@pytest.mark.parametrize("limit", [0.3, 5.0])
def test_no_motor_moves_further_alone_than_the_limit(limit: float) -> None:
    homing = Homing(seek=20.0, latch=2.0, pull_off=0.5, squaring_limit=limit)
    machine = gantry(0.0, homing=homing)
    board = RecordedLoopback(machine, {**PLACES, (1, 1): (-1, -1e9)})
    with pytest.raises(BoardError):
        homed(board, machine, "y")
    furthest = place = 0
    for which, rows in board.rows_sent:
        if which == (1, 1):
            path = place + np.cumsum(rows[:, 1])
            furthest = max(furthest, int(np.abs(path).max(initial=0)))
            place = int(path[-1]) if len(path) else place
    assert furthest == pytest.approx(100 * limit, abs=1)


def test_three_motors_of_z() -> None:
    machine = gantry(0.1, -0.1, letter="z")
    places = {
        (0, 0): (-1, -300.0),
        (1, 0): (-1, -410.0),
        (2, 0): (1, 150.0),
        (2, 1): (1, 190.0),
        (2, 2): (1, 120.0),
    }
    board = RecordedLoopback(machine, places)
    position, _ = homed(board, machine)
    assert position == {"x": 0.0, "y": -2.0, "z": 1.0}
    wanted = [150 - 50, 190 - 50 - 10, 120 - 50 + 10]
    assert board.motor_steps[2] == pytest.approx(wanted, abs=2)
