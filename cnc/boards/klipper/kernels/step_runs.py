"""Runs of steps for the queues of a Klipper board.

Step k of a run comes ``(k + 1) * interval + add * k * (k + 1) / 2`` ticks after the run began
(Klipper documentation, MCU commands, ``queue_step``).

Each step has a window of times. A run of n steps fits if integers ``interval`` and ``add`` exist
that place every step into its window. For a given ``add``, each step bounds the interval:

      (low[k] - add * k * (k + 1) / 2) / (k + 1) <= interval <= (high[k] - ...) / (k + 1)

The bounds of step k fall by ``k / 2`` for each unit of ``add``. So the space between the highest
lower bound and the lowest upper bound is a concave function of ``add``. Where it is negative, the
two steps that bound it cut off all ``add`` on one side (Kelley's cutting planes in one dimension).

The longest run is found by doubling and bisection, because a part of a run that fits also fits. The
result is checked in integers, so rounding cannot move a step out of its window.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

Ints = NDArray[np.int64]

MAX_COUNT = 65535
MIN_ADD, MAX_ADD = -32768, 32767
MAX_INTERVAL = 2**32 - 1
REACH, LEAST_REACH = 3, 32
"""Steps that are considered for a run: this many times the last run, and at least so many."""
TRIALS = 10
"""Most values of ``add`` that are tried for a length."""
FINE = 16
"""The bisection of a length ends at this fraction of it."""
SHARE = 4
"""A step is moved by at most this fraction of the time to its neighbours, so steps stay apart."""
OK, TOO_FAR, NOT_RISING = 0, 1, 2
"""Status: all encoded; an interval is too long; two steps have the same time."""


class Runs(NamedTuple):
    """Runs of steps of one motor.

    Attributes:
        interval: Ticks to the first step (n,).
        length: Number of steps (n,).
        add: Ticks by which the interval grows from step to step (n,).
        sign: Direction of the steps, 1 or -1 (n,).
        begin: Time of the first step (n,), ticks.
        end: Time of the last step (n,), ticks.
    """

    interval: Ints
    length: Ints
    add: Ints
    sign: Ints
    begin: Ints
    end: Ints


class Fit(NamedTuple):
    """Scratch space: window of each step and the reciprocal of its number; result (interval, add).

    Attributes:
        low: Earliest time of each step after the begin of the run (n,), ticks.
        high: Latest time (n,), ticks.
        inverse: ``1 / (k + 1)`` (n,).
        found: Interval and add of the last run that fits (2,).
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    inverse: NDArray[np.float64]
    found: Ints


@njit
def encode_steps(
    due: Ints,
    sign: NDArray[np.int8],
    tolerance: int,
    least: int,
    last: int,
    runs: Runs,
    fit: Fit,
) -> tuple[int, int, int]:
    """Encode steps as runs.

    Args:
        due: Time of each step (n,), ticks, increasing.
        sign: Direction of each step (n,).
        tolerance: Largest deviation of a step from its time, ticks.
        least: Least time from the last of these steps to a later one, ticks.
        last: Time of the last step before, ticks.
        runs: Space for n runs.
        fit: Scratch space for n steps.

    Returns:
        Status, number of runs, and time of the last step, ticks.
    """
    made, at, guess = 0, 0, 8
    begin = last
    while at < len(due):
        until = min(len(due), at + min(max(REACH * guess, LEAST_REACH), MAX_COUNT))
        before = last if at == 0 else due[at - 1]
        limit = _windows(due, sign, at, until, tolerance, least, begin, before, fit)
        if limit <= 0:
            return (NOT_RISING if limit == 0 else TOO_FAR), made, begin
        count = _longest(limit, guess, fit)
        while not _is_exact(count, fit):
            count = max(count // 2, 1)
            if count == 1 or not _fits(count, fit):
                count = 1
                fit.found[0] = due[at] - begin
                fit.found[1] = 0
                break
        interval, add = fit.found[0], fit.found[1]
        runs.interval[made] = interval
        runs.length[made] = count
        runs.add[made] = add
        runs.sign[made] = sign[at]
        runs.begin[made] = begin + interval
        begin += count * interval + add * (count * (count - 1) // 2)
        runs.end[made] = begin
        made += 1
        at += count
        guess = count
    return OK, made, begin


@njit
def _windows(
    due: Ints,
    sign: NDArray[np.int8],
    at: int,
    until: int,
    tolerance: int,
    least: int,
    begin: int,
    before: int,
    fit: Fit,
) -> int:
    """Set the windows of the steps of the next run, from ``at`` to at most ``until``.

    Returns:
        Number of steps in one direction; 0 if times do not rise, -1 if a step is too far away.
    """
    most = until - at
    for k in range(most):
        row = at + k
        if sign[row] != sign[at]:
            return k
        moved = tolerance
        gap = due[row] - before
        if gap <= 0 or due[row] <= begin:
            return 0 if k == 0 else k
        moved = min(moved, gap // SHARE)
        ahead = max(due[row + 1] - due[row], 0) if row + 1 < len(due) else least
        moved = min(moved, ahead // SHARE)
        ahead = due[row] - begin
        if ahead > MAX_INTERVAL:
            return -1 if k == 0 else k
        fit.low[k] = max(ahead - moved, 1)
        fit.high[k] = ahead + moved
        before = due[row]
    return most


@njit
def _longest(limit: int, guess: int, fit: Fit) -> int:
    """Return the length of a long run, whose interval and add are then in ``fit.found``."""
    fit.found[0] = np.int64(0.5 * (fit.low[0] + fit.high[0]))
    fit.found[1] = 0
    fits, fails = 1, limit + 1
    trial = min(max(guess, 2), limit)
    while fails - fits > max(1, fits // FINE):
        if _fits(trial, fit):
            fits = trial
        else:
            fails = trial
        trial = min(2 * fits, limit) if fails > limit else (fits + fails) // 2
        if trial <= fits:
            break
    return fits


@njit
def _fits(count: int, fit: Fit) -> bool:
    """Return whether a run of ``count`` steps fits; if so, set ``fit.found``."""
    lowest, highest = MIN_ADD, MAX_ADD
    add = min(max(fit.found[1], lowest), highest)
    for _ in range(TRIALS):
        floor, ceiling = -1e300, 1e300
        floor_at, ceiling_at = 0, 0
        half = 0.5 * add
        for k in range(count):
            slope = half * k
            low = fit.low[k] * fit.inverse[k] - slope
            high = fit.high[k] * fit.inverse[k] - slope
            if low > floor:
                floor, floor_at = low, k
            if high < ceiling:
                ceiling, ceiling_at = high, k
        least = np.ceil(floor - 1e-9)
        if least <= np.floor(ceiling + 1e-9) and ceiling >= 0.0:
            middle = np.rint(0.5 * (floor + ceiling))
            fit.found[0] = np.int64(min(max(middle, least), np.floor(ceiling + 1e-9)))
            fit.found[1] = add
            return True
        gain = 0.5 * (floor_at - ceiling_at)
        if gain == 0.0:
            return False
        # Without an integer between the bounds, the next add towards more space is tried.
        needed = max((floor - ceiling) / abs(gain), 1.0) if floor > ceiling else 1.0
        if gain > 0.0:
            lowest = add + np.int64(np.ceil(min(needed, 70000.0) - 1e-6))
            add = lowest
        else:
            highest = add - np.int64(np.ceil(min(needed, 70000.0) - 1e-6))
            add = highest
        if lowest > highest:
            return False
    return False


@njit
def _is_exact(count: int, fit: Fit) -> bool:
    """Return whether the run in ``fit.found`` places each step into its window, in integers."""
    interval, add = fit.found[0], fit.found[1]
    if interval < 0 or interval > MAX_INTERVAL:
        return False
    place, step = np.int64(0), interval
    for k in range(count):
        place += step
        step += add
        if place < np.int64(fit.low[k]) or place > np.int64(fit.high[k]):
            return False
    return True
