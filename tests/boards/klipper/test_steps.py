"""Steps as runs of ``queue_step``: every step, in its direction, within the tolerance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cnc.boards.klipper.kernels.step_runs import MAX_ADD, MAX_COUNT, MAX_INTERVAL, MIN_ADD, Runs
from cnc.boards.klipper.sender import StepEncoder
from tests.support.soak import check_without_compiler, share


def check(
    runs: Runs, due: NDArray[np.int64], sign: NDArray[np.int8], tolerance: int, last: int = 0
) -> None:
    """Check runs by the rule of the documentation, step by step in Python's integers."""
    clock, k = last, 0
    columns = (runs.interval, runs.length, runs.add, runs.sign)
    for run in zip(*(column.tolist() for column in columns), strict=True):
        interval, length, add, direction = run
        assert 0 < length <= MAX_COUNT
        assert 0 <= interval <= MAX_INTERVAL
        assert MIN_ADD <= add <= MAX_ADD
        for _ in range(length):
            clock += interval
            interval += add
            assert abs(clock - int(due[k])) <= tolerance
            assert direction == sign[k]
            k += 1
    assert k == len(due)


def step_times(runs: Runs, last: int) -> NDArray[np.int64]:
    """Return the time of each step (n,) of runs that follow ``last``, ticks."""
    times: list[NDArray[np.int64]] = []
    for interval, count, add in zip(
        runs.interval.tolist(), runs.length.tolist(), runs.add.tolist(), strict=True
    ):
        k = np.arange(count, dtype=np.int64)
        times.append(last + (k + 1) * interval + add * (k * (k + 1) // 2))
        last = int(times[-1][-1])
    return np.concatenate(times) if times else np.empty(0, np.int64)


@given(st.lists(st.integers(1, 2**20), max_size=200), st.integers(0, 2000), st.data())
@settings(max_examples=share(2000, 17), deadline=None)
def test_any_steps(gaps: list[int], tolerance: int, data: st.DataObject) -> None:
    due = np.cumsum(np.array(gaps, np.int64)) + 7
    sign = np.array(
        data.draw(st.lists(st.sampled_from((-1, 1)), min_size=len(gaps), max_size=len(gaps))),
        np.int8,
    )
    encoder = StepEncoder(tolerance, 7)
    runs = encoder.encode(due, sign)
    check(runs, due, sign, tolerance, 7)
    times = step_times(runs, 7)
    assert (np.diff(times, prepend=7) > 0).all()
    assert encoder.last == (times[-1] if len(times) else 7)


def smooth(steps: int, rate: float, frequency: float, seed: int = 0) -> NDArray[np.int64]:
    """Return the times of the steps of a smooth move from rest to rest, ticks."""
    draw = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, 100_001)
    place = t**3 * (10 - 15 * t + 6 * t * t) + 0.002 * draw.random() * np.sin(np.pi * t) ** 2
    seconds = np.interp((np.arange(steps) + 0.5) / steps, place, t) * steps / rate * 1.875
    due = np.round(seconds * frequency).astype(np.int64) + 100_000
    return due[np.diff(due, prepend=0) > 0]


@pytest.mark.parametrize("frequency", [12e6, 16e6, 72e6, 180e6, 520e6])
@pytest.mark.parametrize("tolerance_us", [1, 5, 25])
def test_smooth_moves(frequency: float, tolerance_us: int) -> None:
    due = smooth(5000, 20_000, frequency)
    sign = np.where(np.arange(len(due)) % 2500 < 2000, 1, -1).astype(np.int8)
    tolerance = int(tolerance_us * 1e-6 * frequency)
    runs = StepEncoder(tolerance).encode(due, sign)
    check(runs, due, sign, tolerance)
    assert len(due) / len(runs.length) > (10 if tolerance_us == 1 else 30)


def test_steady_motion_is_one_run() -> None:
    """At a steady whole interval, a run has all steps that one command can have."""
    due = np.arange(1, 14_001, dtype=np.int64) * 800
    runs = StepEncoder(0).encode(due, np.ones(len(due), np.int8))
    assert runs.add.tolist() == [0] * len(runs.add)
    assert len(runs.length) < 12


def test_parts_follow_each_other() -> None:
    """The error does not grow from part to part."""
    due = smooth(4000, 30_000, 16e6)
    sign = np.ones(len(due), np.int8)
    encoder = StepEncoder(80)
    times = []
    for at in range(0, len(due), 333):
        last = encoder.last
        runs = encoder.encode(due[at : at + 333], sign[at : at + 333])
        times.append(step_times(runs, last))
    assert np.abs(np.concatenate(times) - due).max() <= 80


def test_steps_stay_apart() -> None:
    """The tolerance is never more than a quarter of the time to the next step."""
    due = np.cumsum(np.random.default_rng(3).integers(40, 60, 3000)).astype(np.int64)
    times = step_times(StepEncoder(900).encode(due, np.ones(3000, np.int8)), 0)
    assert np.diff(times).min() >= 20


def test_impossible_times_are_refused() -> None:
    ones = np.ones(2, np.int8)
    with pytest.raises(ValueError, match="do not increase"):
        StepEncoder(5).encode(np.array([10, 10], np.int64), ones)
    with pytest.raises(ValueError, match="too far apart"):
        StepEncoder(5).encode(np.array([2**33, 2**33 + 9], np.int64), ones)


@pytest.mark.own_code
def test_kernels_run_without_the_compiler() -> None:
    check_without_compiler(Path(__file__), some="smooth_moves and 16000000 and 5 or apart")
