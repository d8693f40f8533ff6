"""A request of the operator takes effect on a GRBL board when the sender looks next.

The simulator has its own clock. A request comes at any moment between two reports, as that of a
person does, and not only where the sender looks. What counts is the board: the time at which it
holds, goes on, or has the override.
"""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.line_stream import PATIENCE, WAIT
from cnc.boards.grbl.link import POLL
from cnc.model.operator_control import Control
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.grbl_rig import MACHINE, ROUTER
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed
from tests.support.soak import share

WIRE = 0.02
"""s; for the command on the wire, and for the line that the board reads first."""

MOVES = [f"G{1 if k % 3 else 0} X{5 + k % 2 * 40} Y{k % 3 * 30} F1500" for k in range(8)]


class Requested:
    """The port of a board, and requests of an operator at given times.

    Args:
        simulator: The board.
        loses: Whether the first command of each request gets lost on the wire.

    Attributes:
        requests: Time of each request, s, the request, and whether it is in effect.
        late: Time from each request to its effect, s.
    """

    def __init__(self, simulator: GrblSimulator, *, loses: bool) -> None:
        self.simulator, self.port = simulator, GrblSimulatorPort(simulator)
        self.requests: list[tuple[float, Callable[[], None], Callable[[], bool]]] = []
        self.loses, self._lost = loses, False
        self.late: list[float] = []
        self.wanted: Callable[[], bool] | None = None
        self.begin = 0.0

    def __getattr__(self, name: str) -> object:
        return getattr(self.port, name)

    def read(self, timeout: float) -> bytes:
        """Read as the port does, but see the board every two milliseconds."""
        end = self.simulator.now + timeout
        while True:
            data = self.port.read(min(max(end - self.simulator.now, 0.0), 2e-3))
            now = self.simulator.now
            if self.wanted is not None and self.wanted():
                self.late.append(now - self.begin)
                self.wanted = None
            if self.wanted is None and self.requests and now >= self.requests[0][0]:
                self.begin, request, self.wanted = self.requests.pop(0)
                self._lost = self.loses
                request()
            if data or now >= end:
                return data

    def write(self, data: bytes) -> None:
        """Write as the port does, without the first real-time command of a request."""
        if self._lost and len(data) == 1 and data != b"?":
            self._lost = False
            return
        self.port.write(data)


def times_of(seed: int, *, loses: bool = False) -> list[float]:
    """Return the times from requests to their effect, s: hold, resume, rapid and spindle.

    ``loses``: whether the first command of each request gets lost; there is no hold then.
    """
    rng = random.Random(seed)
    simulator, control = GrblSimulator(settings=ROUTER), Control()
    core, at, requests = simulator.core, 1.5, []
    holds = [
        (control.hold, lambda: core.state == "Hold"),
        (control.resume, lambda: core.state == "Run"),
    ]
    for request, wanted in (
        *([] if loses else holds),
        (lambda: control.override_rapids(25), lambda: core.planner.rapid_override == 25),
        (lambda: control.override_spindle(90.0), lambda: core.spindle_override == 90),
        (lambda: control.override_rapids(50), lambda: core.planner.rapid_override == 50),
        (lambda: control.override_spindle(91.0), lambda: core.spindle_override == 91),
        (lambda: control.override(110.0), lambda: core.planner.feed_override == 110),
    ):
        at += rng.uniform(0.8, 1.2)
        requests.append((at, request, wanted))
    count = len(requests)
    port = Requested(simulator, loses=loses)
    board = GrblBoard(port, MACHINE, port.clock, "the simulator")
    board.connect()
    shift = simulator.now
    port.requests = [(shift + when, *rest) for when, *rest in requests]
    board.connect_operator(control, lambda: None)
    board.start(ORIGIN)
    feed(board, PREAMBLE, "M3 S100", *MOVES)
    board.finish()
    assert len(port.late) == count
    return port.late


@pytest.mark.parametrize("seed", range(share(100, 2)))
def test_a_request_takes_effect_when_the_sender_looks_next(seed: int) -> None:
    """One that has no effect would leave the time of its successor open, and end the test."""
    assert max(times_of(seed)) <= WAIT + WIRE


@pytest.mark.parametrize("seed", range(share(50, 1)))
def test_an_override_that_gets_lost_on_the_wire_is_repeated(seed: int) -> None:
    late = times_of(seed, loses=True)
    assert min(late) >= PATIENCE - POLL
    assert max(late) <= PATIENCE + POLL + WAIT + WIRE
