"""Shared parts of the stepper board's tests: machines, rows of grid moves, a bad cable, checks of
the pins.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.driver import Stepper
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.streams import PulseChunk
from tests.support.boards.stepper_simulator import (
    DIRECTION_PINS,
    FREQUENCY,
    STEP_PINS,
    Simulator,
    SimulatorPort,
)

CLOSE_US = 5.0
"""Edges come within this of their time."""
STACK = 256
"""Bytes of the stack that nothing has touched, at least."""
LIMIT_X, PROBE_PIN, ENABLE_PIN, SPINDLE_PIN, FLOOD_PIN = 9, 19, 8, 11, 17
EMERGENCY_STOP_PIN, HOLD_PIN, RESUME_PIN = 14, 15, 16
INPUT_PINS = (9, 10, 12, 14, 15, 16, 19)
"""Pins that are high while nothing is pressed: switches, buttons, probe."""
FASTEST, LEAST_PART_S = 20_000, 0.0002
"""Steps of an axis in a second, and the shortest part of a run with a part to touch."""


def machine(**changes: object) -> Machine:
    known: Machine = load_machine("stepper-uno")
    return known.model_copy(update=changes)


class Part:
    """A part that the probe touches. Its input is low where the axis is at ``at`` steps or beyond.

    Args:
        simulator: The board.
        at: Place of the part, steps.
        axis: Column of the axis.
        towards: Direction in which the part lies, 1 or -1; None for the sign of ``at``.
    """

    def __init__(
        self, simulator: Simulator, at: int, axis: int = 0, towards: int | None = None
    ) -> None:
        self.at, self._towards = at, towards or (1 if at >= 0 else -1)
        self._place = self._seen = self._backward = 0
        self._pins = STEP_PINS[axis], DIRECTION_PINS[axis]
        self._simulator, self._run = simulator, simulator.run
        simulator.run = self._felt  # type: ignore[method-assign]

    def _felt(self, seconds: float, *, or_byte: bool = False) -> None:
        """Run in parts so short that the part is not passed between two of them."""
        simulator, end = self._simulator, self._simulator.now + seconds
        while (left := end - simulator.now) > 0.5 / FREQUENCY:
            part = min(left, max(abs(self._place - self.at) / FASTEST, LEAST_PART_S))
            before = simulator.now
            self._run(part, or_byte=or_byte)
            self._feel()
            if or_byte and simulator.now < before + part - 1.0 / FREQUENCY:
                return

    def _feel(self) -> None:
        edges = self._simulator.edges()
        step, direction = self._pins
        for edge in edges[self._seen :]:
            if edge["pin"] == direction:
                self._backward = int(edge["level"])
            if edge["pin"] == step and edge["level"]:
                self._place += 1 - 2 * self._backward
        self._seen = len(edges)
        touched = (self._place - self.at) * self._towards >= 0
        self._simulator.set_pin(PROBE_PIN, 0 if touched else 1)


def with_axes(axes: int, **board_changes: object) -> Machine:
    """Return the shipped machine with a number of axes and changes of its board."""
    known = machine()
    letters = dict(zip("xyza", [*known.axes.values(), known.axes["x"]][:axes], strict=False))
    return known.model_copy(
        update={"axes": letters, "board": known.board.model_copy(update=board_changes)}
    )


@contextmanager
def board(
    simulator: Simulator, port: SimulatorPort | None = None, known: Machine | None = None
) -> Iterator[Stepper]:
    """Provide a driver on a simulated board."""
    port = port or SimulatorPort(simulator)
    driver = Stepper(port, known or machine(), "the simulator", clock=port)
    try:
        yield driver
    finally:
        driver.close()


def chunks(
    time_ns: NDArray[np.int64], step: NDArray[np.int8], rows: int = 500
) -> Iterator[PulseChunk]:
    for at in range(0, len(time_ns), rows):
        part = slice(at, at + rows)
        yield PulseChunk(
            time_ns[part],
            step[part],
            np.arange(at + 1, at + 1 + len(time_ns[part]), dtype=np.int32),
        )


def send_all(
    driver: Stepper,
    time_ns: NDArray[np.int64],
    step: NDArray[np.int8],
    after: Callable[[int], None],
) -> None:
    """Send rows to their end; ``after`` gets the number of rows sent so far."""
    for part in chunks(time_ns, step, 100):
        driver.send(part)
        after(int(part.line[-1]))
    driver.finish()


def line(
    rows: int, gap_ns: int, shares: tuple[float, ...] = (1.0, -0.63, 0.277)
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Return a straight move at a steady speed; the first axis steps in every row."""
    k = np.arange(rows + 1)[:, None]
    step = np.diff(np.floor(k * np.abs(shares) + 0.5), axis=0) * np.sign(shares)
    return (np.arange(rows, dtype=np.int64) + 1) * gap_ns, step.astype(np.int8)


def eased(
    rows: int, fastest_gap_ns: int, shares: tuple[float, ...] = (1.0, -0.63, 0.277)
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Return a straight move from rest to rest."""
    _, step = line(rows, fastest_gap_ns, shares)
    t = np.linspace(0.0, 1.0, 20_001)
    place = (np.arange(rows) + 0.5) / rows
    seconds = np.interp(place, t**3 * (10 - 15 * t + 6 * t * t), t) * rows * fastest_gap_ns * 1.875
    return np.round(seconds).astype(np.int64), step


def wander(seed: int, rows: int, least_ns: int) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Return random rows: any axes and directions, any time from ``least_ns`` to long pauses."""
    chance = np.random.default_rng(seed)
    step = np.zeros((rows, 3), np.int8)
    while (empty := ~step.any(axis=1)).any():
        step[empty] = chance.integers(-1, 2, (int(empty.sum()), 3))
    kinds = chance.choice(4, rows, p=(0.6, 0.3, 0.0985, 0.0015))
    gaps = np.select(
        [kinds == 0, kinds == 1, kinds == 2],
        [
            chance.integers(least_ns, 4 * least_ns, rows),
            chance.integers(least_ns, 1_000_000, rows),
            chance.integers(1_000_000, 9_000_000, rows),
        ],
        chance.integers(50_000_000, 400_000_000, rows),
    )
    return np.cumsum(gaps), step


FAULTS = ("damaged", "dropped", "doubled", "all")


class BadCable(SimulatorPort):
    """A cable that damages, drops or doubles bytes with the same chance, in both directions."""

    def __init__(self, simulator: Simulator, chance: float, seed: int, faults: str = "all") -> None:
        super().__init__(simulator)
        self.chance = chance
        self.kinds = FAULTS[:3] if faults == "all" else (faults,)
        self.random = random.Random(seed)

    def _spoilt(self, data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            share, fate = divmod(self.random.random(), self.chance)
            if share >= len(self.kinds):
                out.append(byte)
            elif self.kinds[int(share)] == "damaged":
                out.append(byte ^ 1 + int(fate / self.chance * 255))
            elif self.kinds[int(share)] == "doubled":
                out += bytes((byte, byte))
        return bytes(out)

    def read(self, timeout: float) -> bytes:
        return self._spoilt(super().read(timeout))

    def write(self, data: bytes) -> None:
        super().write(self._spoilt(data))


def off_plan_us(cycles: NDArray[np.int64], time_ns: NDArray[np.int64]) -> float:
    """Return the largest distance of an edge from its time, us.

    The start is shifted so that it is least.
    """
    late = cycles * (1e6 / FREQUENCY) - time_ns * 1e-3
    return float(late.max() - late.min()) / 2 if len(late) else 0.0


def assert_played(cycles: NDArray[np.int64], time_ns: NDArray[np.int64]) -> None:
    """Check that moves are on time, or on time up to a ramp, in which each is later than the one
    before.
    """
    late_us = cycles * (1e6 / FREQUENCY) - time_ns[: len(cycles)] * 1e-3
    late_us -= np.median(late_us[:50])
    off = np.flatnonzero(np.abs(late_us) > CLOSE_US)
    if len(off):
        assert (np.diff(late_us[off[0] :]) > -2 * CLOSE_US).all()
        assert late_us[off[0]] > 0.0


def stands_at(moves: NDArray[np.int8]) -> list[int]:
    return moves.sum(axis=0, dtype=np.int64).tolist()
