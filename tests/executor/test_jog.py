"""Jogs of pulse boards: the end by a hold, the limits of the plan, and the time to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cnc.boards.loopback import Loopback
from cnc.boards.stepper.driver import STOP_LATENCY
from cnc.machine.load import load_machine
from cnc.model.operator_control import Control
from cnc.operate.jogging import REST_TIME, jog, jog_speed
from tests.support.boards.homing_bench import Bench, small
from tests.support.boards.stepper_simulator import FREQUENCY

MACHINE = load_machine(None)
NOWHERE = (-1e9, -1e9)


class Recorder(Loopback):
    """A loopback board with short slices, which keeps its pulses."""

    def __init__(self, axes):
        super().__init__(axes)
        self.chunks = []

    @property
    def capabilities(self):
        return replace(super().capabilities, slice_s=0.01)

    def send(self, chunk):
        super().send(chunk)
        self.chunks.append(chunk)


def test_a_jog_ends_at_its_end_point():
    board = Recorder(3)
    end = np.array([12.0, -3.0, 1.5])
    outcome = jog(board, MACHINE, np.zeros(3), end, 40.0, control=Control())
    assert outcome.finished
    assert outcome.position_steps.tolist() == (end * MACHINE.steps_per_mm).tolist()


@pytest.mark.parametrize("stops", [False, True])
def test_a_hold_or_a_stop_ends_a_jog_within_the_limits(stops):
    board, control = Recorder(3), Control()

    def release(progress):
        if progress.time > 0.3:
            (control.stop if stops else control.hold)()

    end = np.array([300.0, 0.0, 0.0])
    outcome = jog(board, MACHINE, np.zeros(3), end, 60.0, control=control, on_progress=release)
    x = outcome.position_steps[0] / 200.0
    assert 1.0 < x < 60.0
    time = np.concatenate([chunk.time_ns for chunk in board.chunks]) * 1e-9
    step = np.concatenate([chunk.step[:, 0] for chunk in board.chunks])
    assert step.sum() == outcome.position_steps[0]
    # The last steps are slow: the jog came to rest, and was not cut off.
    assert time[-1] - time[-2] > 0.002
    speed = np.gradient(np.cumsum(step)[::20] / 200.0, time[::20])
    assert speed.max() <= 60.0 * 1.01
    if not stops:
        board.start(outcome.position_steps)


def test_a_jog_of_the_stepper_board_rests_in_time():
    """The release comes while it moves at its highest speed; the pins show the last step."""
    bench, machine = Bench(x=NOWHERE, y=NOWHERE, z=NOWHERE), small()
    axes = {
        name: axis.model_copy(update={"travel": (-100.0, 100.0)})
        for name, axis in machine.axes.items()
    }
    machine = machine.model_copy(update={"axes": axes})
    board, control, released = bench.driver(machine), Control(), []
    feed = jog_speed(machine, {"x": 1.0}, REST_TIME - STOP_LATENCY)

    def release(progress):
        if not released and progress.time > 0.6:
            released.append(bench.simulator.now)
            control.hold()

    try:
        jog(
            board, machine, np.zeros(3), np.array([90.0, 0.0, 0.0]), feed,
            control=control, on_progress=release,
        )  # fmt: skip
    finally:
        board.close()
    cycles = bench.simulator.moves()[0]
    assert released
    assert cycles[-1] / FREQUENCY - released[0] <= REST_TIME
    assert board.position_steps[0] == len(cycles)
