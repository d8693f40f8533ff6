"""A resume that the operator requests before the machine has come to rest.

GRBL ignores ``~`` while it brakes ("protocol_exec_rt_system": a cycle starts in state Hold only
when the hold is complete), and in the moment of the hold itself.
"""

from __future__ import annotations

import random

import pytest

from cnc.boards.grbl.line_stream import OperatorRequests
from cnc.boards.grbl.messages import Status
from cnc.model.operator_control import Control
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.grbl_rig import connected
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.boards.simulator_bench import Bench
from tests.support.soak import share

SLOW = {120: 20.0, 121: 20.0, 122: 20.0}
"""mm/s^2: a machine that brakes for more than a second."""


def said(state: str, phase: int = -1) -> Status:
    return Status(state, phase, (0.0, 0.0, 0.0), None, (100, 100, 100))


def test_the_simulator_ignores_a_resume_while_it_brakes() -> None:
    bench = Bench(settings=SLOW)
    bench.send("G1 X100 F2000\n", 3.0)
    assert "<Hold:1" in bench.send("!?", 0.2)[-1]
    bench.send("~", 3.0)
    assert "<Hold:0" in bench.send("?", 0.1)[-1]
    bench.send("~", 0.1)
    assert "<Run" in bench.send("?", 0.1)[-1]


def test_the_simulator_ignores_a_resume_that_it_serves_together_with_the_hold() -> None:
    bench = Bench()
    # Both bytes came while the main program planned a line.
    flags = bench.simulator.core.flags
    flags.hold = flags.start = True
    assert "<Hold:0" in bench.send("?", 0.1)[-1]


def test_a_resume_waits_for_rest() -> None:
    control = Control()
    requests = OperatorRequests(control)
    assert requests.commands(said("Run"), 0.0, 0.1) == b""
    control.hold()
    assert requests.commands(said("Run"), 0.2, 0.3) == b"!"
    control.resume()
    # a report from before the hold, then one that was on its way
    assert requests.commands(said("Run"), 0.2, 0.4) == b""
    assert requests.commands(said("Run"), 0.41, 0.42) == b""
    assert requests.commands(said("Hold", 1), 0.5, 0.55) == b""
    assert requests.commands(said("Hold", 1), 1.5, 1.55) == b""
    assert requests.commands(said("Hold", 0), 1.6, 1.65) == b"~"
    assert requests.commands(said("Hold", 0), 1.61, 1.7) == b""
    assert requests.commands(said("Run"), 1.8, 1.85) == b""
    assert not control.held


def test_a_hold_after_the_resume_keeps_the_machine_held() -> None:
    control = Control()
    requests = OperatorRequests(control)
    control.hold()
    assert requests.commands(said("Run"), 0.2, 0.3) == b"!"
    control.resume()
    assert requests.commands(said("Hold", 1), 0.5, 0.55) == b""
    control.hold()
    assert requests.commands(said("Hold", 1), 0.6, 0.65) == b""
    assert requests.commands(said("Hold", 0), 0.8, 0.85) == b""
    assert control.held


def test_a_lost_hold_needs_no_resume() -> None:
    control = Control()
    requests = OperatorRequests(control)
    control.hold()
    assert requests.commands(said("Run"), 0.2, 0.3) == b"!"
    control.resume()
    assert requests.commands(said("Run"), 0.7, 0.75) == b""
    assert requests.commands(said("Run"), 0.9, 0.95) in (b"", b"~")
    # from now on a hold is one at the machine
    assert requests.commands(said("Hold", 0), 2.0, 2.1) == b""
    assert control.held


@pytest.mark.parametrize("seed", share(range(30), range(3)))
def test_pause_and_resume_in_quick_succession_end_the_program(seed: int) -> None:
    rng = random.Random(seed)
    simulator, control = GrblSimulator(settings=SLOW), Control()
    board = connected(simulator)
    times, at = [], simulator.now
    for _ in range(4):
        at += rng.uniform(0.5, 4.0)
        times += [at, at := at + rng.uniform(0.0, 1.5)]

    def operate() -> None:
        if times and simulator.now >= times[0]:
            times.pop(0)
            (control.resume if control.held else control.hold)()
        # The machine would wait for ever for a second resume.
        assert times or not control.held

    board.connect_operator(control, operate)
    board.start(ORIGIN)
    feed(board, PREAMBLE, *(f"G1 X{5 + k % 2 * 50} Y{k % 3 * 20} F2000" for k in range(8)))
    board.finish()
    assert board.position == pytest.approx((55.0, 20.0, 0.0), abs=0.01)
    assert sum(event.kind == "resume" for event in simulator.events) in range(1, 5)
