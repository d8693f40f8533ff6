"""Pulses that an axis takes back at once, against a plain list of each axis's pulses."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.pulses.kernels.grid_moves import Moves
from cnc.pulses.kernels.reference_pulse import BLOCK, Buffers, without_grazes

AXES = 3


def random_rows(seed: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return steps (rows, axes) of axes that turn now and then, and their times."""
    random = np.random.default_rng(seed)
    turns = random.random((rows, AXES)) < random.choice([0.0, 0.002, 0.3], AXES)
    heading = np.where(np.cumsum(turns, axis=0) % 2, -1, 1) * random.choice([-1, 1], AXES)
    steps = heading * (random.random((rows, AXES)) < random.choice([0.0, 0.1, 0.9], AXES))
    steps[np.arange(rows), random.integers(0, AXES, rows)] = 1
    return steps.astype(np.int8), np.cumsum(random.integers(0, 4, rows))


def without_pairs(step: np.ndarray, time: np.ndarray, least: float) -> np.ndarray:
    """Return the steps of an axis without those that it takes back sooner than ``least``."""
    left, kept = step.copy(), []
    for row in np.flatnonzero(step):
        if kept and step[kept[-1]] != step[row] and time[row] - time[kept[-1]] < least:
            left[[kept[-1], row]] = 0
            kept = []
        else:
            kept = [row]
    return left


@pytest.mark.parametrize("seed", range(12))
def test_an_axis_makes_no_pulse_that_it_takes_back_at_once(seed: int) -> None:
    rows, least = 4 * BLOCK + 17 * seed, 2.5
    steps, times = random_rows(seed, rows)
    expected = np.stack([without_pairs(column, times, least) for column in steps.T], axis=1)
    moving = expected.any(axis=1)
    buffers = Buffers(
        Moves(steps.copy(), np.zeros(rows)),
        times.copy(),
        np.arange(rows, dtype=np.int32),
        np.full(AXES, -1, dtype=np.int64),
        np.zeros(AXES, dtype=np.int64),
    )
    # The rows come in two parts, the first of which ends inside a block.
    middle = BLOCK + 5 + seed
    first = without_grazes(0, middle, buffers, least)
    for array in (buffers.moves.step, buffers.time_ns, buffers.line):
        array[first : first + rows - middle] = array[middle:rows].copy()
    left = without_grazes(first, first + rows - middle, buffers, least)
    assert left == moving.sum()
    assert np.array_equal(buffers.moves.step[:left], expected[moving])
    assert np.array_equal(buffers.time_ns[:left], times[moving])
    assert np.array_equal(buffers.line[:left], np.flatnonzero(moving))
    assert np.array_equal(buffers.made, np.abs(expected.astype(np.int64)).sum(axis=0))
