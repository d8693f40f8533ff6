"""Candidates for the next segment: the longest segment of each form within a tolerance.

A segment grows slot by slot. The times of its slots, and the positions of the steps of the axes
with a phase, are lines through windows (:mod:`cnc.kernels.stepper.windows`). It ends where no line
with whole coefficients passes the next window. Windows are the permitted times:

      time   ---[----due----]------[----due----]----      due: the time asked for, or the least
                                                          spacing after the move before

In placed segments one half of the tolerance is for the slots, the other for the axes inside them.
Each candidate is played before it is accepted, and ends before the first wrong move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.stepper.segments import (
    HEAD,
    MASKS_AT,
    MAX_ADD,
    MAX_AXES,
    MAX_INTERVAL,
    MAX_PERIOD,
    MAX_PHASES,
    MIN_ADD,
    PACKED,
    PHASE_BYTES,
    PLACED,
    SLOT,
    SUB,
    TICK_NS,
    TOGETHER,
    Bytes,
    Ints,
    play,
)
from cnc.kernels.stepper.windows import Bounds, Floats, Polygon, Windows, longest


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


class Rules(NamedTuple):
    """Tolerance of the times in ns, and least spacing between two moves in ticks."""

    tolerance: int
    spacing: int


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


class Candidate(NamedTuple):
    """A segment in ``Scratch.trial``: its form, bytes and moves (0 if there is none)."""

    form: int
    bytes: int
    rows: int


class Head(NamedTuple):
    """The fields of the eight bytes at the start of all forms with slots."""

    slots: int
    form: int
    backward: int
    roles: int
    interval: int
    add: int


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
def candidate(
    form: int,
    moves: GridMoves,
    first: int,
    rows: int,
    rules: Rules,
    clock: int,
    reach: int,
    scratch: Scratch,
) -> Candidate:
    """Write the longest segment of a form to the row of the form in ``scratch.trial``.

    Args:
        form: EVEN, PACKED or PLACED.
        moves: The moves.
        first: First move of the segment.
        rows: Number of moves.
        rules: Tolerance and spacing.
        clock: Clock at the start, 1/256 tick.
        reach: Largest number of slots.
        scratch: Scratch.

    Returns:
        The candidate.
    """
    out = scratch.trial[form]
    always, phases = 0, 0
    if form != PACKED:
        always, phases = _roles(form, moves, first, min(first + reach, rows))
    start = Start(form, always, phases, first, clock)
    count = (phases & 1) + (phases >> 1 & 1) + (phases >> 2 & 1) + (phases >> 3)
    slots, backward = 0, 0
    if count <= MAX_PHASES and (form == PACKED or always != 0) and (form != PLACED or count > 0):
        slots, backward = _slots(start, moves, rows, rules.tolerance, reach, scratch)
    interval, add = 0, 0
    if slots > 0:
        bounds = Bounds(
            float(rules.spacing * SUB), float(MAX_INTERVAL), float(MIN_ADD), float(MAX_ADD)
        )
        slots, interval, add = longest(scratch.windows, slots, bounds, scratch.polygon)
    at = HEAD
    for i in range(MAX_AXES):
        if phases >> i & 1 and slots > 0:
            slots = _write_phase(start, 1 << i, moves, rules.tolerance, slots, out, at, scratch)
            at += PHASE_BYTES
    covered = 0
    if slots > 0:
        write_head(out, 0, Head(slots, form, backward, always | phases << 4, interval, add))
        if form == PACKED:
            _write_masks(moves.axes[first : first + slots], out)
        planned = scratch.ends[slots - 1] + 1 - first
        slots, covered = _played(start, moves, planned, rules, out, scratch)
        out[0] = slots
    size = MASKS_AT + (slots + 1) // 2 if form == PACKED else at
    return Candidate(form, size, covered)


@njit
def _write_phase(
    start: Start,
    axis: int,
    moves: GridMoves,
    tolerance: int,
    slots: int,
    out: Bytes,
    at: int,
    scratch: Scratch,
) -> int:
    """Write the phase of an axis to ``out`` at byte ``at``; return the slots that it covers.

    A constant period is tried first, then a period that changes from step to step.
    """
    windows, polygon = scratch.windows, scratch.polygon
    slots, steps = _steps(start, axis, moves, tolerance, slots, scratch)
    bounds = Bounds(0.0, float(MAX_PERIOD), float(SLOT), float(MAX_PERIOD))
    met, phase, period = longest(windows, slots, bounds, polygon)
    change = _subtract_bend(scratch, slots, steps) if met < slots else 0
    if change != 0:
        bent, bent_phase, bent_period = longest(windows, slots, bounds, polygon)
        if bent > met:
            met, phase, period = bent, bent_phase, bent_period
        else:
            change = 0
    _write24(out, at, phase)
    _write24(out, at + 3, period)
    out[at + 6] = change & 0xFF
    out[at + 7] = change >> 8 & 0xFF
    return met


@njit
def _slots(
    start: Start, moves: GridMoves, rows: int, tolerance: int, reach: int, scratch: Scratch
) -> tuple[int, int]:
    """Divide moves into slots; fill ``ends`` and the windows of the times of the slots.

    Args:
        start: Start of the candidate.
        moves: The moves.
        rows: Number of moves.
        tolerance: Tolerance of the times, ns.
        reach: Largest number of slots.
        scratch: Gets the ends and the windows.

    Returns:
        Number of slots, and mask of the axes that step down.
    """
    form, always, phases = start.form, start.always, start.phases
    axes, due, windows = moves.axes, moves.due, scratch.windows
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
            up |= axes[k] & ~moves.backward[k]
            down |= moves.backward[k]
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
            scratch.ends[slots] = last
            windows.w[slots] = 0.5 * slots
            windows.low[slots] = (earliest * SUB - start.clock) / (slots + 1)
            windows.high[slots] = (latest * SUB + SUB - 1 - start.clock) / (slots + 1)
            slots += 1
            row = last + 1
    return slots, minus


@njit
def _steps(
    start: Start, axis: int, moves: GridMoves, tolerance: int, slots: int, scratch: Scratch
) -> tuple[int, int]:
    """Fill the windows of the positions of an axis's steps among the slots, one window per slot.

    ``scratch.middles`` gets the middle of the window of each step.

    Returns:
        Number of slots up to the first one with two steps of the axis, and number of steps.
    """
    axes, due, windows = moves.axes, moves.due, scratch.windows
    begin = float(start.clock)
    off = SUB * max(0.5 * tolerance / TICK_NS - 0.5, 0.25)
    steps = 0
    row = start.first
    for slot in range(slots):
        last = scratch.ends[slot]
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
            scratch.middles[steps] = 0.5 * (least + most)
            steps += 1
        begin = end
        row = last + 1
    return slots, steps


@njit
def _subtract_bend(scratch: Scratch, slots: int, steps: int) -> int:
    """Subtract a quadratic term from the windows; return the change of the period per step.

    The change follows from the mean positions of the first, middle and last third of the steps.
    """
    windows, middles = scratch.windows, scratch.middles
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


@njit
def _roles(form: int, moves: GridMoves, first: int, until: int) -> tuple[int, int]:
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
def write_head(out: Bytes, at: int, head: Head) -> None:
    """Write the eight bytes at the start of all forms with slots."""
    out[at] = head.slots
    out[at + 1] = head.form | head.backward << 4
    _write24(out, at + 2, head.interval)
    out[at + 5] = head.add & 0xFF
    out[at + 6] = head.add >> 8 & 0xFF
    out[at + 7] = head.roles


@njit
def _write_masks(masks: Ints, out: Bytes) -> None:
    """Write the masks of a packed segment, two in a byte."""
    for k in range(len(masks)):
        if k & 1:
            out[MASKS_AT + k // 2] |= masks[k] << 4
        else:
            out[MASKS_AT + k // 2] = masks[k]


@njit
def _write24(out: Bytes, at: int, value: int) -> None:
    """Write three bytes, the lowest first."""
    out[at] = value & 0xFF
    out[at + 1] = value >> 8 & 0xFF
    out[at + 2] = value >> 16 & 0xFF


@njit
def _played(
    start: Start, moves: GridMoves, planned: int, rules: Rules, out: Bytes, scratch: Scratch
) -> tuple[int, int]:
    """Play a segment; return how many of its slots and of its moves are right from its start on.

    Args:
        start: Start of the candidate.
        moves: The moves.
        planned: Number of moves that the segment should make.
        rules: Tolerance and spacing.
        out: The segment.
        scratch: Gets the moves played.
    """
    tick, mask = scratch.tick, scratch.mask
    rows, _ = play(out, 0, start.clock, tick, mask)
    before = start.clock // SUB
    slots, kept = 0, 0
    for k in range(min(rows, planned)):
        row = start.first + k
        if (
            mask[k] != moves.axes[row]
            or tick[k] < before + rules.spacing
            or not abs(tick[k] * TICK_NS - moves.due[row]) <= rules.tolerance
        ):
            break
        before = tick[k]
        if start.form != PLACED or mask[k] & start.always:
            slots += 1
            kept = k + 1
    return slots, kept
