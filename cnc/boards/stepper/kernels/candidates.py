"""Candidates for the next segment: the longest segment of each form within a tolerance.

A segment grows slot by slot (:mod:`cnc.boards.stepper.kernels.candidates`). It ends where no line
with whole coefficients passes the next window. Each candidate is played before it is accepted, and
ends before the first wrong move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.kernels.segments import (
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
    Head,
    Ints,
    play,
    write24,
    write_head,
    write_masks,
)
from cnc.compiled.jit import njit

# A line with whole-number coefficients through as many consecutive windows as possible.
#
# value                    The points (x, y) for which x + w y lies in given windows form a convex
#   |           _|_        polygon. A line from its middle is tried. The first window that the line
#   |      _|_   |         misses cuts the polygon, and the next line is taken from the rest, until
#   | _|_   |  ,'          nothing remains: then no line passes all windows up to there. A window
#   |  | ,-'|'             that no line misses costs only one comparison.
#   | ,|'
#   +------------- w
#
# The lines are the times of the slots of a segment (after k slots: k (x + (k - 1) / 2 y)), and the
# positions of the steps of an axis among the slots (step j: x + j y).

Floats = NDArray[np.float64]

MAX_CORNERS = 64
"""Capacity of a polygon; a polygon with more corners counts as empty."""


class Windows(NamedTuple):
    """Windows low <= x + w y <= high, each array (n,)."""

    w: Floats
    low: Floats
    high: Floats


class Bounds(NamedTuple):
    """Bounds of x and y."""

    min_x: float
    max_x: float
    min_y: float
    max_y: float


class Polygon(NamedTuple):
    """Corners of a polygon in order, each array (2, MAX_CORNERS); the second row is scratch."""

    x: Floats
    y: Floats


@njit
def longest(windows: Windows, count: int, bounds: Bounds, polygon: Polygon) -> tuple[int, int, int]:
    """Find the line that passes most windows from the first one on.

    Args:
        windows: The windows.
        count: Number of windows.
        bounds: Bounds of x and y.
        polygon: Scratch.

    Returns:
        Number of windows that the line passes, and its x and y.
    """
    w, low, high = windows.w, windows.low, windows.high
    px, py = polygon.x, polygon.y
    x0, x1, y0, y1 = bounds.min_x, bounds.max_x, bounds.min_y, bounds.max_y
    px[0, 0], px[0, 1], px[0, 2], px[0, 3] = x0, x1, x1, x0
    py[0, 0], py[0, 1], py[0, 2], py[0, 3] = y0, y0, y1, y1
    corners = 4
    met, met_x, met_y = 0, 0, 0
    x, y = x0, min(max(0.0, y0), y1)
    while True:
        missed = 0
        while missed < count and low[missed] <= x + w[missed] * y <= high[missed]:
            missed += 1
        if missed > met:
            met, met_x, met_y = missed, int(x), int(y)
        if missed == count:
            break
        corners = _cut(corners, 1.0, w[missed], low[missed], polygon)
        corners = _cut(corners, -1.0, -w[missed], -high[missed], polygon)
        found, new_x, new_y = _whole_point(corners, polygon)
        if not found or (new_x == x and new_y == y):
            break
        x, y = float(new_x), float(new_y)
    return met, met_x, met_y


@njit
def _cut(corners: int, v: float, w: float, low: float, polygon: Polygon) -> int:
    """Keep the part of the polygon where v x + w y >= low; return its number of corners."""
    if corners == 0 or corners == MAX_CORNERS:
        return 0
    px, py = polygon.x, polygon.y
    kept = 0
    last = corners - 1
    before = v * px[0, last] + w * py[0, last] - low
    for i in range(corners):
        here = v * px[0, i] + w * py[0, i] - low
        if (before < 0.0) != (here < 0.0):
            part = before / (before - here)
            px[1, kept] = px[0, last] + part * (px[0, i] - px[0, last])
            py[1, kept] = py[0, last] + part * (py[0, i] - py[0, last])
            kept += 1
        if here >= 0.0:
            px[1, kept] = px[0, i]
            py[1, kept] = py[0, i]
            kept += 1
        before = here
        last = i
    for i in range(kept):
        px[0, i] = px[1, i]
        py[0, i] = py[1, i]
    return kept


@njit
def _whole_point(corners: int, polygon: Polygon) -> tuple[bool, int, int]:
    """Return whether there are whole x, y in the polygon near its middle, and the two."""
    px, py = polygon.x, polygon.y
    low, high, mean = math.inf, -math.inf, 0.0
    for i in range(corners):
        low = min(low, py[0, i])
        high = max(high, py[0, i])
        mean += py[0, i] / corners
    y = math.floor(mean + 0.5) if corners > 0 else 0.0
    if not low <= y <= high and high > -math.inf:
        y = math.floor(high)
    left, right = math.inf, -math.inf
    last = corners - 1
    for i in range(corners):
        if (py[0, last] <= y <= py[0, i]) or (py[0, i] <= y <= py[0, last]):
            part = (y - py[0, last]) / (py[0, i] - py[0, last]) if py[0, i] != py[0, last] else 0.0
            crossing = px[0, last] + part * (px[0, i] - px[0, last])
            left = min(left, crossing)
            right = max(right, crossing)
        last = i
    x = 0.0
    found = left <= right
    if found:
        x = math.floor(0.5 * (left + right) + 0.5)
        if not left <= x <= right:
            x = math.floor(right)
        found = left <= x
    return found, int(x), int(y)


# Slots of a candidate, and the windows of their times and of the steps among them.
#
# The times of the slots, and the positions of the steps of the axes with a phase, are lines through
# windows (:mod:`cnc.boards.stepper.kernels.candidates`). Windows are the permitted times:
#
#       time   ---[----due----]------[----due----]----      due: the time asked for, or the least
#                                                           spacing after the move before
#
# In placed segments one half of the tolerance is for the slots, the other for the axes inside them.


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
