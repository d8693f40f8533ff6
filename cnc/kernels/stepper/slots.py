"""Slots of a candidate, and the windows of their times and of the steps among them.

The times of the slots, and the positions of the steps of the axes with a phase, are lines through
windows (:mod:`cnc.kernels.stepper.windows`). Windows are the permitted times:

      time   ---[----due----]------[----due----]----      due: the time asked for, or the least
                                                          spacing after the move before

In placed segments one half of the tolerance is for the slots, the other for the axes inside them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.stepper.segments import (
    MAX_ADD,
    MAX_AXES,
    MAX_PHASES,
    MIN_ADD,
    PACKED,
    PLACED,
    SLOT,
    SUB,
    TICK_NS,
    TOGETHER,
    Bytes,
    Ints,
)
from cnc.kernels.stepper.windows import Floats, Polygon, Windows


class GridMoves(NamedTuple):
    """Buffers of grid moves.

    Attributes:
        axes: (n,): mask of the axes that step.
        backward: (n,): mask of the axes that step down.
        due: (n,): due time, ns.
    """

    axes: Ints
    backward: Ints
    due: Ints


class Scratch(NamedTuple):
    """Scratch of the encoder.

    Attributes:
        trial: Bytes of the candidate of each form (3, MAX_BYTES).
        tick: Ticks of a played segment (MAX_ROWS,).
        mask: Axes that step in each of these (MAX_ROWS,).
        ends: Last move of each slot (MAX_SLOTS,).
        windows: Windows, one per slot (MAX_SLOTS,).
        middles: Middle of the window of each step (MAX_SLOTS,).
        polygon: Scratch of the search for a line.
    """

    trial: Bytes
    tick: Ints
    mask: Bytes
    ends: Ints
    windows: Windows
    middles: Floats
    polygon: Polygon


class Start(NamedTuple):
    """The start of a candidate.

    Attributes:
        form: Its form.
        always: Axes that step at the end of every slot.
        phases: Axes with a phase.
        first: First move.
        clock: Clock at the start, 1/256 tick.
    """

    form: int
    always: int
    phases: int
    first: int
    clock: int


@njit
def axis_roles(form: int, moves: GridMoves, first: int, until: int) -> tuple[int, int]:
    """Return masks of the axes that step in every slot, and of the other axes that step.

    Only the moves from ``first`` to ``until`` count, up to the first that reverses an axis.
    """
    axes, backward = moves.axes, moves.backward
    plus, minus, every = 0, 0, 15
    row = first
    count = np.zeros(MAX_AXES, np.int64)
    while row < until:
        plus |= axes[row] & ~backward[row]
        minus |= backward[row]
        if plus & minus:
            break
        every &= axes[row]
        for i in range(MAX_AXES):
            count[i] += axes[row] >> i & 1
        row += 1
    if form == PLACED:
        # The axis with the most steps, and all axes that step only and always together with it.
        lead = 0
        for i in range(1, MAX_AXES):
            if count[i] > count[lead]:
                lead = i
        every = 15
        for k in range(first, row):
            if axes[k] >> lead & 1:
                every &= axes[k]
        for i in range(MAX_AXES):
            if count[i] != count[lead]:
                every &= ~(1 << i)
    return every, (plus | minus) & ~every


@njit
def divide_into_slots(
    start: Start,
    moves: GridMoves,
    rows: int,
    tolerance: int,
    reach: int,
    ends: Ints,
    windows: Windows,
) -> tuple[int, int]:
    """Divide moves into slots; fill ``ends`` and the windows of the times of the slots.

    Args:
        start: Start of the candidate.
        moves: The moves.
        rows: Number of moves.
        tolerance: Tolerance of the times, ns.
        reach: Largest number of slots.
        ends: Gets the last move of each slot.
        windows: Gets the windows.

    Returns:
        Number of slots, and mask of the axes that step down.
    """
    form, always, phases = start.form, start.always, start.phases
    axes, backward, due = moves.axes, moves.backward, moves.due
    plus, minus = 0, 0
    slots, row = 0, start.first
    share = max(tolerance // 2, TICK_NS) if form == PLACED else tolerance
    legal = True
    while legal and slots < reach and row < rows:
        last = row
        if form == PLACED:
            while last < rows - 1 and axes[last] & always == 0 and last < row + MAX_PHASES:
                last += 1
        legal = axes[last] & always == always
        up, down = plus, minus
        for k in range(row, last + 1):
            up |= axes[k] & ~backward[k]
            down |= backward[k]
            legal = legal and (
                form == PACKED
                or (axes[k] & ~(always | phases) == 0 and (k == last or axes[k] & always == 0))
            )
        legal = legal and up & down == 0
        if legal:
            plus, minus = up, down
            # The first and the last tick within the tolerance.
            earliest = -((share - due[last]) // TICK_NS)
            latest = (due[last] + share) // TICK_NS
            ends[slots] = last
            windows.w[slots] = 0.5 * slots
            windows.low[slots] = (earliest * SUB - start.clock) / (slots + 1)
            windows.high[slots] = (latest * SUB + SUB - 1 - start.clock) / (slots + 1)
            slots += 1
            row = last + 1
    return slots, minus


@njit
def step_windows(
    start: Start,
    axis: int,
    moves: GridMoves,
    tolerance: int,
    slots: int,
    ends: Ints,
    windows: Windows,
    middles: Floats,
) -> tuple[int, int]:
    """Fill the windows of the positions of an axis's steps among the slots, one window per slot.

    Args:
        start: Start of the candidate.
        axis: Mask of the axis.
        moves: The moves.
        tolerance: Tolerance of the times, ns.
        slots: Number of slots.
        ends: Last move of each slot.
        windows: Gets the windows.
        middles: Gets the middle of the window of each step.

    Returns:
        Number of slots up to the first one with two steps of the axis, and number of steps.
    """
    axes, due = moves.axes, moves.due
    begin = float(start.clock)
    off = SUB * max(0.5 * tolerance / TICK_NS - 0.5, 0.25)
    steps = 0
    row = start.first
    for slot in range(slots):
        last = ends[slot]
        end = due[last] * (SUB / TICK_NS)
        found = -1
        for k in range(row, last + 1):
            if axes[k] & axis:
                if found >= 0:
                    return slot, steps
                found = k
        position = float(slot * SLOT)
        windows.w[slot] = steps
        if found < 0:
            windows.low[slot] = position + SLOT
            windows.high[slot] = np.inf
        else:
            least, most = position, position + SLOT - 1
            if start.form == PLACED and end > begin:
                sub = SLOT / (end - begin)
                edge = position + SLOT - sub * SUB * (TOGETHER + 0.5)
                if found == last:
                    least = max(least, edge)
                else:
                    at = position + sub * (due[found] * (SUB / TICK_NS) - begin)
                    # Two axes that step together inside a slot must be played within one tick.
                    around = sub * (off if axes[found] == axis else 0.25 * SUB)
                    least, most = max(least, at - around), min(most, edge, at + around)
            windows.low[slot] = least
            windows.high[slot] = most
            middles[steps] = 0.5 * (least + most)
            steps += 1
        begin = end
        row = last + 1
    return slots, steps


@njit
def subtract_bend(windows: Windows, middles: Floats, slots: int, steps: int) -> int:
    """Subtract a quadratic term from the windows; return the change of the period per step.

    The change follows from the mean positions of the first, middle and last third of the steps.
    """
    third = steps // 3
    first, middle, last = 0.0, 0.0, 0.0
    for j in range(third):
        first += middles[j]
        middle += middles[third + j]
        last += middles[2 * third + j]
    change = 0
    if third > 0:
        bend = (first - 2.0 * middle + last) / float(third) ** 3
        change = int(np.floor(min(max(bend, MIN_ADD), MAX_ADD) + 0.5))
    for slot in range(slots):
        j = windows.w[slot]
        windows.low[slot] -= 0.5 * j * (j - 1.0) * change
        windows.high[slot] -= 0.5 * j * (j - 1.0) * change
    return change
