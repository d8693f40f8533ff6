"""Requests of the operator to a GRBL board: hold, resume, overrides, program stops."""

from __future__ import annotations

import random

import pytest

from cnc.boards.grbl.line_stream import OperatorRequests
from cnc.boards.grbl.messages import Status
from cnc.model.diagnostics import BoardError, UsageError
from cnc.model.operator_control import Control
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import connected, started
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.soak import share


def test_a_stop_keeps_the_position_without_an_alarm() -> None:
    for seed in range(share(50, 3)):
        rng = random.Random(seed)
        simulator = GrblSimulator()
        control = Control()
        board = started(simulator, control)
        when = simulator.now + rng.uniform(0.2, 6.0)

        def stop_in_time(
            when: float = when, simulator: GrblSimulator = simulator, control: Control = control
        ) -> None:
            if simulator.now > when:
                control.stop()

        board.connect_operator(control, stop_in_time)
        feed(
            board,
            PREAMBLE,
            *(f"G1 X{rng.uniform(0, 9):.3f} Y{rng.uniform(0, 9):.3f} F1500" for _ in range(40)),
        )
        board.finish()
        assert control.stopped
        board.stop()
        assert simulator.core.state == "Idle"
        assert board.position == pytest.approx(simulator.position, abs=0.002)
        assert [event.value for event in simulator.events if event.kind == "alarm"] == []


def test_hold_and_resume_keep_all_motion() -> None:
    simulator = GrblSimulator()
    control = Control()
    seen: list[str] = []
    board = connected(simulator)
    held_at = simulator.now + 1.5

    def operate() -> None:
        state = board.status.state
        if not seen or seen[-1] != state:
            seen.append(state)
        if simulator.now > held_at and len(seen) < 3:
            control.hold()
        if state == "Hold" and simulator.now > held_at + 3.0:
            control.resume()

    board.connect_operator(control, operate)
    board.start(ORIGIN)
    feed(board, PREAMBLE, *(f"G1 X{k % 2 * 5} Y{k % 3 * 2} F1000" for k in range(12)))
    board.finish()
    assert seen[-4:] == ["Run", "Hold", "Run", "Idle"]
    assert board.position == pytest.approx((5.0, 4.0, 0.0), abs=0.002)


@pytest.mark.parametrize("percent", [10, 55, 87, 100, 123, 200])
def test_the_feed_override_is_reached_and_held(percent: int) -> None:
    simulator = GrblSimulator()
    control = Control(percent)
    board = started(simulator, control)
    assert simulator.core.planner.feed_override == percent
    control.override(100)
    feed(board, PREAMBLE, "G1 X9 F100")
    board.finish()
    assert simulator.core.planner.feed_override == 100


@pytest.mark.parametrize("percent", [25, 70, 130])
def test_the_overrides_end_with_the_run(percent: int) -> None:
    simulator = GrblSimulator()
    control = Control(percent)
    control.override_rapids(25)
    control.override_spindle(percent)
    board = started(simulator, control)
    feed(board, PREAMBLE, "G1 X2 F600")
    board.finish()
    planner = simulator.core.planner
    assert (planner.feed_override, planner.rapid_override) == (100, 100)
    assert simulator.core.spindle_override == 100
    assert control.feed_override == percent
    board.start(ORIGIN)
    assert (planner.feed_override, planner.rapid_override) == (percent, 25)


def test_an_unsupported_override_is_refused_before_motion() -> None:
    with pytest.raises(BoardError) as caught:
        started(GrblSimulator(), Control(5.0))
    assert caught.value.diagnostic.code == "override-refused"


def said(state: str, override: int = 100, phase: int = -1) -> Status:
    return Status(state, phase, (0.0, 0.0, 0.0), None, (override, 100, 100))


def test_lost_requests_are_repeated() -> None:
    control = Control()
    requests = OperatorRequests(control)
    assert requests.commands(said("Run"), 0.0, 0.1) == b""
    control.hold()
    assert requests.commands(said("Run"), 0.1, 1.0) == b"!"
    assert requests.commands(said("Run"), 1.2, 1.3) == b""
    assert requests.commands(said("Run"), 1.6, 1.7) == b"!"
    assert requests.commands(said("Hold", phase=1), 1.8, 1.9) == b""
    control.resume()
    assert requests.commands(said("Hold", phase=0), 2.0, 2.1) == b"~"
    # a report that is older than the command, or as old, says nothing
    assert requests.commands(said("Hold", phase=0), 2.0, 3.0) == b""
    assert not control.held


def test_a_hold_at_the_machine_becomes_a_hold_of_the_operator() -> None:
    control = Control()
    requests = OperatorRequests(control)
    assert requests.commands(said("Hold", phase=0), 1.0, 1.1) == b""
    assert control.held
    assert requests.commands(said("Run"), 2.0, 2.1) == b""
    assert not control.held
    assert requests.commands(said("Door", phase=0), 3.0, 3.1) == b""
    assert control.held
    control.resume()
    assert requests.commands(said("Door", phase=0), 3.2, 3.3) == b"~"


@pytest.mark.parametrize(
    ("wanted", "now", "byte"),
    [
        (150, 100, b"\x91"),
        (50, 100, b"\x92"),
        (105, 100, b"\x93"),
        (95, 100, b"\x94"),
        (100, 100, b""),
    ],
)
def test_the_override_changes_in_steps_of_ten_and_one(wanted: int, now: int, byte: bytes) -> None:
    requests = OperatorRequests(Control(wanted))
    assert requests.commands(said("Run", now), 1.0, 1.1) == byte
    assert requests.commands(said("Run", now), 1.2, 1.3) == b""


def test_a_program_stop_waits_for_the_operator() -> None:
    simulator = GrblSimulator()
    control = Control()
    board = connected(simulator)
    waited: list[float] = []

    def operate() -> None:
        if control.held:
            waited.append(simulator.now)
            if len(waited) > 40:
                control.resume()

    board.connect_operator(control, operate)
    board.start(ORIGIN)
    feed(board, PREAMBLE, "G1 X1 F600", "M0", "G1 X2")
    board.finish()
    assert waited[-1] - waited[0] > 5.0
    assert board.position[0] == pytest.approx(2.0, abs=0.002)


def test_overrides_of_traverses_and_spindle_are_followed() -> None:
    simulator, control = GrblSimulator(), Control()
    control.override_rapids(25)
    control.override_spindle(137.0)
    board = started(simulator, control)
    core = simulator.core
    assert (core.planner.rapid_override, core.spindle_override) == (25, 137)
    feed(board, PREAMBLE, "M3 S100", "G0 X4", "G1 X8 F300")
    control.override_rapids(50)
    control.override_spindle(60.0)
    began = simulator.now
    while core.spindle_override != 60 and simulator.now - began < 15.0:
        board.stream.serve(0.05)
    assert (core.planner.rapid_override, core.spindle_override) == (50, 60)
    assert core.rpm == 60.0
    board.finish()


@pytest.mark.parametrize("percent", [0, 30, 99, 101])
def test_impossible_overrides_of_traverses_are_refused(percent: int) -> None:
    with pytest.raises(UsageError):
        Control().override_rapids(percent)


@pytest.mark.parametrize("percent", [0.0, 9.0, 201.0, float("nan")])
def test_impossible_overrides_of_the_spindle_are_refused(percent: float) -> None:
    with pytest.raises(UsageError):
        Control().override_spindle(percent)
