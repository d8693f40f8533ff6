"""A computer that pauses now and then, on the simulator: no job is stopped for it.

The sender gets no processor for some time, at any moment: between reading the clock and writing,
between reading and judging. Reports and answers gather meanwhile, and are read together. Faults of
the board are found all the same.
"""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cnc.boards.grbl.driver import GrblBoard
from cnc.model.operator_control import Control
from cnc.simulators.grbl.grbl_simulator import Drop, Error, Fault, Freeze, GrblSimulator, Swallow
from tests.support.boards.grbl_rig import MACHINE, ROUTER, outcome
from tests.support.boards.grbl_wire import Wire
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE
from tests.support.soak import share

MACHINES = (None, ROUTER, {110: 5000.0, 111: 5000.0, 120: 4000.0, 121: 4000.0})


class PausedComputer:
    """Port and clock of a process that the system does not run all the time.

    Args:
        simulator: The board, which goes on.
        pauses: Calls of port or clock from one pause to the next, and its length, s.
    """

    def __init__(self, simulator: GrblSimulator, pauses: list[tuple[int, float]]) -> None:
        self._wire, self._simulator = Wire(simulator), simulator
        self._pauses, self._calls = iter(pauses), 0
        self._due, self._length = -1, 0.0
        self.close, self.raise_lines = self._wire.close, self._wire.raise_lines

    def begin(self) -> None:
        """Pause from now on."""
        self._next()

    def read(self, timeout: float) -> bytes:
        self._maybe()
        data = self._wire.read(timeout)
        self._maybe()
        return data

    def write(self, data: bytes) -> None:
        self._maybe()
        self._wire.write(data)
        self._maybe()

    def now(self) -> float:
        self._maybe()
        now = self._simulator.now
        self._maybe()
        return now

    def sleep(self, seconds: float) -> None:
        self._wire.clock.sleep(seconds)
        self._maybe()

    def _next(self) -> None:
        calls, self._length = next(self._pauses, (-1, 0.0))
        self._due = self._calls + calls

    def _maybe(self) -> None:
        self._calls += 1
        if self._calls == self._due:
            self._simulator.advance(self._simulator.now + self._length)
            self._next()


PAUSES = st.lists(
    st.tuples(
        st.one_of(st.integers(1, 12), st.integers(1, 300)),
        st.one_of(st.floats(0.001, 1.0), st.floats(1.0, 40.0)),
    ),
    min_size=1,
    max_size=60,
)


def lines_of(rng: random.Random, count: int) -> list[str]:
    """Return moves of every length, so that the board is idle, waiting, or full."""
    longest = rng.choice((0.05, 0.5, 9.0))
    lines = [PREAMBLE]
    x = y = 0.0
    for _ in range(count):
        x = min(max(x + rng.uniform(-longest, longest), 0.0), 9.0)
        y = min(max(y + rng.uniform(-longest, longest), 0.0), 9.0)
        lines.append(f"G1 X{x:.3f} Y{y:.3f} F{rng.choice((400, 1500, 4000))}")
        if rng.random() < 0.02:
            lines.append(f"G4 P{rng.uniform(0.0, 0.5):.2f}")
    return [*lines, f"G1 X{x:.3f} Y{y:.3f}"]


def begun(seed: int, pauses: list[tuple[int, float]]) -> tuple[GrblSimulator, GrblBoard]:
    """Return a board that has started on a computer that pauses from now on."""
    simulator = GrblSimulator(settings=MACHINES[seed % len(MACHINES)])
    computer = PausedComputer(simulator, pauses)
    board = GrblBoard(computer, MACHINE, computer, "the simulator")
    board.connect()
    board.connect_operator(Control(), lambda: None)
    board.start(ORIGIN)
    computer.begin()
    return simulator, board


@settings(max_examples=share(10_000, 12), deadline=None)
@given(st.integers(0, 1 << 32), PAUSES)
def test_a_pause_of_the_computer_stops_no_job(seed: int, pauses: list[tuple[int, float]]) -> None:
    rng = random.Random(seed)
    simulator, board = begun(seed, pauses)
    lines = lines_of(rng, rng.choice((20, 150)))
    assert outcome(board, lines) is None
    end = [float(word[1:]) for word in lines[-1].split()[1:3]]
    assert simulator.position[:2] == pytest.approx(end, abs=0.01)


FAULTS: list[Callable[[random.Random], Fault]] = [
    lambda rng: Drop(rng.randint(1, 30)),
    lambda rng: Swallow(),
    lambda rng: Freeze(),
    lambda rng: Error(rng.choice((1, 20, 33))),
]


@settings(max_examples=share(10_000, 12), deadline=None)
@given(st.integers(0, 1 << 32), PAUSES, st.sampled_from(FAULTS))
@example(472, [(1, 1.0), (1, 0.75), (1, 0.75)], FAULTS[1])
def test_faults_are_found_on_a_computer_that_pauses(
    seed: int, pauses: list[tuple[int, float]], make: Callable[[random.Random], Fault]
) -> None:
    """Whether a fault is told, or what was lost did no harm: the machine stands at the end."""
    rng = random.Random(seed)
    simulator, board = begun(seed, pauses)
    lines = lines_of(rng, 150)
    fault = make(rng)
    simulator.inject(fault, time=simulator.now + rng.uniform(0.0, 5.0))
    error = outcome(board, lines)
    if error is None:
        # A fault that still waits for the next reply or line has not happened.
        core = simulator.core
        waits = bool(simulator._pending or core.swallow or core.forced_error)
        assert isinstance(fault, Drop) or waits
        end = [float(word[1:]) for word in lines[-1].split()[1:3]]
        assert simulator.position[:2] == pytest.approx(end, abs=0.1)
    else:
        assert error.exit_code == 3
        stands = simulator.position
        simulator.advance(simulator.now + 10.0)
        assert simulator.position == stands
