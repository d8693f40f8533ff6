"""Pulses of the firmware: length, direction setup, noise on the switches' wires."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.model.diagnostics import BoardError
from tests.support.boards.stepper_rig import (
    CLOSE_US,
    board,
    chunks,
    line,
    off_plan_us,
    send_all,
    wander,
    with_axes,
)
from tests.support.boards.stepper_simulator import (
    DIRECTION_PINS,
    FREQUENCY,
    STEP_PINS,
    Simulator,
    SimulatorPort,
)
from tests.support.soak import share


@pytest.mark.parametrize(("axes", "pulse_us", "setup_us"), [(3, 5, 5), (3, 20, 12), (4, 3, 25)])
def test_pulse_length_and_direction_setup(axes: int, pulse_us: int, setup_us: int) -> None:
    """Many moves turn, and some are due sooner than the board can make them."""
    simulator = Simulator(axes)
    known = with_axes(axes, step_pulse=pulse_us * 1e-6, direction_setup=setup_us * 1e-6)
    least_ns = max(18_000, (pulse_us + max(pulse_us, setup_us) + 4) * 1000)
    time_ns, step = wander(11, 600, least_ns)
    if axes == 4:
        step = np.hstack((step, -np.roll(step[:, :1], 1)))
    time_ns[100:400:7] = time_ns[99:399:7] + 6_000
    time_ns, alone = np.maximum.accumulate(time_ns), np.arange(100, 400, 7)
    step[alone], step[alone - 1] = np.eye(axes, dtype=np.int8)[0], -np.eye(axes, dtype=np.int8)[1]
    keep = ~np.isin(np.arange(600), np.concatenate((alone + 1, alone - 2)))
    with board(simulator, SimulatorPort(simulator), known) as driver:
        driver.start(np.zeros(axes, np.int64))
        for part in chunks(time_ns[keep], step[keep]):
            driver.send(part)
        driver.finish()
    np.testing.assert_array_equal(simulator.moves()[1], step[keep])
    edges = simulator.edges()
    for axis in range(axes):
        own = edges[edges["pin"] == STEP_PINS[axis]]
        rises, falls = (own["cycle"][own["level"] == level].astype(np.int64) for level in (1, 0))
        falls = falls[falls > rises[0]]
        assert len(falls) == len(rises)
        assert (falls - rises).min() >= pulse_us * 16
        assert (falls - rises).max() <= pulse_us * 16 + 8 + 100, (
            "a tick, and the longest that another interrupt takes"
        )
        assert (rises[1:] - falls[:-1]).min() >= pulse_us * 16 - 8
        turns = edges["cycle"][edges["pin"] == DIRECTION_PINS[axis]].astype(np.int64)
        after = np.searchsorted(rises, turns)
        assert (
            rises[after[after < len(rises)]] - turns[after < len(rises)]
        ).min() >= setup_us * 16 - 8
    simulator.close()


@pytest.mark.parametrize(("pulse_us", "setup_us"), [(20, 20), (60, 60), (10, 30)])
def test_closest_steps_of_long_pulses_are_on_time(
    simulator: Simulator, pulse_us: int, setup_us: int
) -> None:
    known = with_axes(3, step_pulse=pulse_us * 1e-6, direction_setup=setup_us * 1e-6)
    slow = {
        letter: axis.model_copy(update={"max_velocity": 5.0}) for letter, axis in known.axes.items()
    }
    time_ns, step = line(1_000, (pulse_us + max(pulse_us, setup_us) + 4) * 1_000)
    with board(simulator, known=known.model_copy(update={"axes": slow})) as driver:
        driver.start(np.zeros(3, np.int64))
        send_all(driver, time_ns, step, lambda sent: None)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US


class Noise(SimulatorPort):
    """Adds spikes to the wires of the switches at random times.

    They are shorter than the debounce time.
    """

    def __init__(self, simulator: Simulator, seed: int, pause: float) -> None:
        super().__init__(simulator)
        self.chance = np.random.default_rng(seed)
        self.pause = pause
        self.quiet_run = simulator.run
        self.on = False
        self.next = 0.0
        simulator.run = self.noisy_run  # type: ignore[method-assign]

    def noisy_run(self, seconds: float, *, or_byte: bool = False) -> None:
        until = self.board.now + seconds
        while self.on and self.board.now < until:
            if self.board.now >= self.next:
                pin = int(self.chance.choice((9, 10, 12, 14)))
                self.board.set_pin(pin, 0)
                self.quiet_run(float(self.chance.uniform(0.1e-6, 1.5e-6)))
                self.board.set_pin(pin, 1)
                self.next = self.board.now + float(self.chance.uniform(5e-6, self.pause))
            stop = min(self.next, until)
            self.quiet_run(max(stop - self.board.now, 2 / FREQUENCY), or_byte=or_byte)
            if self.board.now < stop:
                return  # for a byte
        if not self.on:
            self.quiet_run(seconds, or_byte=or_byte)


@pytest.mark.parametrize("pause", [1e-3, 60e-6])
def test_noise_on_switches_loses_no_step(simulator: Simulator, pause: float) -> None:
    """The interrupt of the inputs must not delay the ends of pulses beyond the next pulse.

    With 30 000 spikes a second the processor time is too short: then the board may come to rest.
    """
    fault = ""
    time_ns, step = line(share(20_000, 820), 18_000)
    port = Noise(simulator, 1, pause)
    with board(simulator, port) as driver:
        driver.start(np.zeros(3, np.int64))
        port.on = True
        try:
            send_all(driver, time_ns, step, lambda sent: None)
        except BoardError as error:
            fault = error.diagnostic.code
        port.on = False
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step[: len(made)])
    assert fault == "" or (fault == "board-underrun" and pause < 1e-3)
    if not fault:
        assert len(made) == len(step)
        assert off_plan_us(cycles, time_ns) <= CLOSE_US


RECEIVE_CYCLES = 28
"""Length of the interrupt that receives a byte (play.S)."""


def edges_while_bytes_come(gaps_us: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cycles of 400 edges inside a straight move, from their first.

    Args:
        gaps_us: Times between bytes without meaning, which come while the board plays.
    """
    simulator = Simulator()
    port = SimulatorPort(simulator)
    time_ns, step = line(1500, 60_000)
    with board(simulator, port) as driver:
        driver.start(np.zeros(3, np.int64))
        for part in chunks(time_ns + 60_000_000, step):
            driver.send(part)
        driver._flush()
        simulator.run(0.024)
        assert 0 < len(simulator.moves()[0]) < 100
        for gap in gaps_us.tolist():
            simulator.run(gap * 1e-6)
            simulator.send(b"\0")
        simulator.run(0.03 - gaps_us.sum() * 1e-6)
        cycles, _ = simulator.moves()
    simulator.close()
    return cycles[100:500] - cycles[100]


def test_only_bytes_on_the_line_move_edges() -> None:
    """Two runs are identical to the cycle while nothing is received."""
    silent, bytes_us = np.zeros(0), np.random.default_rng(20_631).uniform(100, 300, 80)
    alone = edges_while_bytes_come(silent)
    np.testing.assert_array_equal(edges_while_bytes_come(silent), alone)
    moved = edges_while_bytes_come(bytes_us) - alone
    assert moved.any()
    assert np.abs(moved - np.median(moved)).max() <= RECEIVE_CYCLES + 8, "and a tick of the timer"
