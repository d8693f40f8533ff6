"""Jogs, offsets, unlock, and the next program after a stop, on the GRBL simulator."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from cnc.boards.grbl.driver import JogLine
from cnc.model.diagnostics import BoardError, UsageError
from cnc.operate.jogging import REST_TIME
from cnc.operate.machines import LineMachine
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import MACHINE, ROUTER, connected

LOST_TIME = 0.5
SETTINGS = ROUTER | {112: 3000.0, 122: 250.0, 130: 300.0, 131: 300.0, 132: 60.0}


class Dead(Exception):
    """The computer stops."""


def rig(**settings):
    simulator = GrblSimulator(settings=SETTINGS | settings.get("settings", {}))
    return simulator, connected(simulator)


def fastest(board, direction):
    """Return the speed that a session gives a jog in this direction, mm/s."""
    from cnc.operate.jogging import jog_speed

    machine = LineMachine(board, board.operation, MACHINE)
    return jog_speed(machine.for_jogs(), direction, machine.rest)


def nothing():
    return None


@pytest.mark.parametrize("direction", [{"x": 1.0}, {"x": 0.6, "y": -0.8}, {"z": -1.0}])
def test_a_released_jog_rests_in_time(direction):
    simulator, board = rig()
    feed = fastest(board, direction)
    start = dict.fromkeys(direction, 0.0)
    end = {a: 200.0 * part for a, part in direction.items()}
    released, rest = [], []
    begin = simulator.now

    def is_released():
        if not released and simulator.now - begin > 0.8:
            released.append(simulator.now)
            assert simulator.speed == pytest.approx(feed, rel=0.01)
        if released and not rest and simulator.speed == 0.0:
            rest.append(simulator.now)
        return bool(released)

    board.operation.jog(start, end, feed, is_released, nothing)
    assert simulator.speed == 0.0
    assert rest[0] - released[0] <= REST_TIME


@pytest.mark.parametrize("after", [0.05, 0.3, 1.0])
def test_the_board_rests_by_itself_when_the_computer_dies(after):
    simulator, board = rig()
    feed = fastest(board, {"x": 1.0})
    begin = simulator.now

    def dies():
        if simulator.now - begin > after:
            raise Dead
        return False

    with pytest.raises(Dead):
        board.operation.jog({"x": 0.0}, {"x": 280.0}, feed, dies, nothing)
    dead = simulator.now
    simulator.advance(dead + LOST_TIME)
    assert simulator.speed == 0.0
    assert simulator.core.state == "Idle"
    place = simulator.position
    simulator.advance(dead + 10.0)
    assert simulator.position == place
    assert place[0] <= feed * (dead - begin + LOST_TIME)


def test_a_jog_in_pieces_is_as_fast_as_one_line():
    """GRBL joins the pieces: the time is that of one trapezoid, and of the reports of rest."""
    simulator, board = rig()
    feed, length = 30.0, 45.0
    begin = simulator.now
    board.operation.jog({"x": 0.0}, {"x": length}, feed, lambda: False, nothing)
    trapezoid = length / feed + feed / SETTINGS[120]
    assert simulator.position[0] == pytest.approx(length, abs=0.002)
    assert simulator.now - begin <= trapezoid + 0.3


def test_a_jog_that_the_board_refuses_is_an_error_at_rest():
    simulator, board = rig(settings={20: 1.0, 22: 1.0, 130: 50.0})
    board.operation.unlock()
    with pytest.raises(BoardError, match="board-error"):
        board.operation.jog({"x": 0.0}, {"x": -120.0}, 30.0, lambda: False, nothing)
    assert simulator.speed == 0.0
    assert simulator.position[0] >= -50.0


@pytest.mark.parametrize("system", ["G54", "G57", "G92"])
def test_an_offset_makes_the_place_the_wanted_position(system):
    simulator, board = rig()
    board.operation.jog({"x": 0.0, "y": 0.0}, {"x": 3.0, "y": 4.0}, 30.0, bool, nothing)
    board.operation.set_work_position(system, {"x": 1.0, "y": -2.5})
    place = board.info.places[system]
    assert place[:2] == pytest.approx((2.0, 6.5), abs=0.002)
    shown = board.operation.work_position("G54" if system == "G92" else system)
    assert shown[:2] == pytest.approx((1.0, -2.5), abs=0.002)
    assert math.isclose(simulator.position[0], 3.0, abs_tol=0.002)


def test_an_offset_that_the_board_does_not_keep_is_an_error(monkeypatch):
    _, board = rig()
    real = board.link.ask

    def loses(text):
        return real("G4P0" if "G10" in text else text)

    monkeypatch.setattr(board.link, "ask", loses)
    with pytest.raises(BoardError, match="offset-not-kept"):
        board.operation.set_work_position("G54", {"x": 5.0})


def test_a_system_that_grbl_lacks_is_refused():
    _, board = rig()
    with pytest.raises(UsageError, match="no-such-system"):
        board.operation.set_work_position("G59.1", {"x": 5.0})


def test_an_alarm_is_left_by_unlock():
    _, board = rig(settings={22: 1.0})
    assert board.status.state == "Alarm"
    board.operation.unlock()
    assert board.link.refresh().state == "Idle"


def test_a_program_runs_after_a_stop():
    import numpy as np

    from tests.support.boards.line_board_conformance import PREAMBLE, feed

    _, board = rig()
    board.start(np.zeros(3, np.int64))
    feed(board, PREAMBLE, "G1 X5 F1500")
    board.stop()
    with pytest.raises(BoardError, match="board-stopped"):
        board.start(np.zeros(3, np.int64))
    board.operation.revive()
    board.start(np.zeros(3, np.int64))
    feed(board, PREAMBLE, "G1 X1 F1500")
    board.finish()
    assert board.position[0] == pytest.approx(1.0, abs=0.003)


def test_a_part_of_a_jog_line_ends_on_the_line():
    move = JogLine({"x": 1.0, "y": 0.0}, {"x": 7.0, "y": 8.0}, 10.0)
    assert move.length == 10.0
    assert move.line(5.0) == "$J=G53G21X4.000Y4.000F600.0"
    assert move.line(99.0) == "$J=G53G21X7.000Y8.000F600.0"
    assert replace(move, feed=0.5).line(10.0).endswith("F30.0")
