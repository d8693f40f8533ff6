"""Candidates for the next segment: the longest segment of each form within a tolerance.

A segment grows slot by slot (:mod:`cnc.kernels.stepper.slots`). It ends where no line with whole
coefficients passes the next window. Each candidate is played before it is accepted, and ends before
the first wrong move.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.kernels.jit import njit
from cnc.kernels.stepper.segment_bytes import Head, write24, write_head, write_masks
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
    Bytes,
    Ints,
    play,
)
from cnc.kernels.stepper.slots import (
    GridMoves,
    Scratch,
    Start,
    axis_roles,
    divide_into_slots,
    step_windows,
    subtract_bend,
)
from cnc.kernels.stepper.windows import Bounds, longest


class Rules(NamedTuple):
    """Tolerance of the times in ns, and least spacing between two moves in ticks."""

    tolerance: int
    spacing: int


class Candidate(NamedTuple):
    """A segment in ``Scratch.trial``: its form, bytes and moves (0 if there is none)."""

    form: int
    bytes: int
    rows: int


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
        always, phases = axis_roles(form, moves, first, min(first + reach, rows))
    start = Start(form, always, phases, first, clock)
    count = (phases & 1) + (phases >> 1 & 1) + (phases >> 2 & 1) + (phases >> 3)
    slots, backward = 0, 0
    if count <= MAX_PHASES and (form == PACKED or always != 0) and (form != PLACED or count > 0):
        slots, backward = divide_into_slots(
            start, moves, rows, rules.tolerance, reach, scratch.ends, scratch.windows
        )
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
            write_masks(moves.axes[first : first + slots], out)
        planned = scratch.ends[slots - 1] + 1 - first
        slots, covered = _played(start, moves, planned, rules, out, scratch.tick, scratch.mask)
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
    slots, steps = step_windows(
        start, axis, moves, tolerance, slots, scratch.ends, windows, scratch.middles
    )
    bounds = Bounds(0.0, float(MAX_PERIOD), float(SLOT), float(MAX_PERIOD))
    met, phase, period = longest(windows, slots, bounds, polygon)
    change = subtract_bend(windows, scratch.middles, slots, steps) if met < slots else 0
    if change != 0:
        bent, bent_phase, bent_period = longest(windows, slots, bounds, polygon)
        if bent > met:
            met, phase, period = bent, bent_phase, bent_period
        else:
            change = 0
    write24(out, at, phase)
    write24(out, at + 3, period)
    out[at + 6] = change & 0xFF
    out[at + 7] = change >> 8 & 0xFF
    return met


@njit
def _played(
    start: Start,
    moves: GridMoves,
    planned: int,
    rules: Rules,
    out: Bytes,
    tick: Ints,
    mask: Bytes,
) -> tuple[int, int]:
    """Play a segment; return how many of its slots and of its moves are right from its start on.

    Args:
        start: Start of the candidate.
        moves: The moves.
        planned: Number of moves that the segment should make.
        rules: Tolerance and spacing.
        out: The segment.
        tick: Gets the tick of each move played.
        mask: Gets the axes that step in each of these.
    """
    axes, due = moves.axes, moves.due
    rows, _ = play(out, 0, start.clock, tick, mask)
    before = start.clock // SUB
    slots, kept = 0, 0
    for k in range(min(rows, planned)):
        row = start.first + k
        if (
            mask[k] != axes[row]
            or tick[k] < before + rules.spacing
            or not abs(tick[k] * TICK_NS - due[row]) <= rules.tolerance
        ):
            break
        before = tick[k]
        if start.form != PLACED or mask[k] & start.always:
            slots += 1
            kept = k + 1
    return slots, kept
