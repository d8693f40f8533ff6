"""Compressed grid moves: the format of a segment and its player, in the integer arithmetic of an
8-bit board.

Grid moves are played in slots. Slot k lasts interval + k * add, so that a segment follows an even
or evenly changing speed; the axes of the ``always`` mask step at its end. An axis that steps less
often has a phase: the time to its next step, counted in slots. Its period may change from step to
step, too, as it does along a curve.

      slot            0          1          2          3          4              phase = 1.8 slots, period = 2.6 slots
      always   |------x----|-----x----|----x----|----x---|---x---|
      phase    1.8        0.8        2.4       1.4       0.4                    below one slot: a step, and the period is added
    even              .          xy         .         .       xy                 the step joins that of its slot, or it is
    placed            .       y  x          .         .   y   x                  placed inside the slot: 0.8 and 0.4 of its length

Even are the moves of algorithms that step the fastest axis in every move; placed those made where
axes cross grid lines, one at a time. What is neither is ``packed`` (one mask a slot) or ``timed``
(a mask and an interval of its own for each move). ``docs/explanation/segments.md`` has the bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

TICK_NS = 500
"""A tick of the board's timer."""
SUB = 256
"""Intervals are counted in this part of a tick."""
SLOT = 65536
"""Phases are counted in this part of a slot."""
MOST_SLOTS = 255
MOST_ROWS = 3 * MOST_SLOTS
"""Grid moves of the longest segment: a slot's own and those of two phases inside it."""
LONGEST_INTERVAL = 0xFFFF * SUB
LONGEST_PERIOD = 0xFFFFFF
LEAST_ADD, MOST_ADD = -32768, 32767
LONGEST_TIMED = 4095
"""Ticks: longest interval of a timed move."""
MOST_AXES = 4
MOST_PHASES = 2

TOGETHER = 1
"""Ticks: steps in a placed segment that are no farther apart are one grid move; no board could tell
them apart.
"""
NEVER = 2**62

EVEN, PLACED, PACKED, TIMED = 0, 1, 2, 3
"""Form of a segment."""
FORM = 3
END = 4
"""Bit of byte 1: nothing need follow, the board may run dry."""
COMMAND = 8
"""Bit of byte 1: no segment but a command, with as many bytes behind byte 1 as byte 0 says; bits
4-7 of byte 1 tell which.
"""

HEAD, PHASE_BYTES, MASKS_AT, TIMED_AT = 8, 8, 7, 2
"""Bytes of the fixed part and of a phase; where the masks of packed and the words of timed segments
begin.
"""
LONGEST = TIMED_AT + 2 * MOST_SLOTS
"""Bytes of the longest segment."""


@njit
def whole_number(data: Bytes, at: int, size: int) -> int:
    """The number in ``size`` bytes from ``at`` on, the lowest first."""
    value = np.int64(0)
    for i in range(size):
        value |= np.int64(data[at + i]) << 8 * i
    return int(value)


@njit
def _signed16(data: Bytes, at: int) -> int:
    """The number in two bytes, below zero if its highest bit is set."""
    value = whole_number(data, at, 2)
    return value - 65536 if value > MOST_ADD else value


@njit
def segment_bytes(data: Bytes, at: int) -> int:
    """Length of the segment or command that begins at byte ``at``; -1 if that is none, or not yet
    there as a whole.
    """
    size = -1
    if at + 2 <= len(data) and data[at + 1] & COMMAND:
        size = 2 + whole_number(data, at, 1)
        if at + size > len(data):
            size = -1
    elif at + 2 <= len(data) and data[at] > 0:
        slots = whole_number(data, at, 1)
        form = data[at + 1] & FORM
        if form == TIMED:
            size = TIMED_AT + 2 * slots
        elif form == PACKED:
            size = MASKS_AT + (slots + 1) // 2
        elif at + HEAD <= len(data):
            roles = whole_number(data, at + 7, 1)
            always, phases = roles & 15, roles >> 4
            count = (phases & 1) + (phases >> 1 & 1) + (phases >> 2 & 1) + (phases >> 3)
            if count <= MOST_PHASES and always & phases == 0 and (always != 0 or count == 0):
                size = HEAD + PHASE_BYTES * count
        if at + size > len(data):
            size = -1
    return size


@njit
def play(data: Bytes, at: int, clock: int, tick: Ints, mask: Bytes) -> tuple[int, int]:
    """Play the segment at byte ``at`` as the board does; returns the number of grid moves and the
    clock after it (1/256 tick).

    tick, mask (MOST_ROWS,): get when each move is made, and which axes step in it. The clock is the
    only thing that goes on from segment to segment; a board needs but its low byte. Nothing here is
    wider than 24 bits, but for the product of two 16-bit numbers.
    """
    slots = whole_number(data, at, 1)
    form = data[at + 1] & FORM
    rows = 0
    if data[at + 1] & COMMAND:
        slots = 0
    elif form == TIMED:
        for k in range(slots):
            word = whole_number(data, at + TIMED_AT + 2 * k, 2)
            clock += (word & LONGEST_TIMED) * SUB
            tick[rows] = clock // SUB
            mask[rows] = word >> 12
            rows += 1
    else:
        interval = whole_number(data, at + 2, 3)
        add = _signed16(data, at + 5)
        roles = whole_number(data, at + 7, 1)
        first_axis, phase, period, change = 0, LONGEST_PERIOD, 0, 0
        second_axis, other_phase, other_period, other_change = 0, LONGEST_PERIOD, 0, 0
        if form != PACKED:
            where = at + HEAD
            for i in range(MOST_AXES):
                if roles >> 4 + i & 1:
                    due = whole_number(data, where, 3)
                    every = whole_number(data, where + 3, 3)
                    more = _signed16(data, where + 6)
                    where += PHASE_BYTES
                    if first_axis == 0:
                        first_axis, phase, period, change = 1 << i, due, every, more
                    else:
                        second_axis, other_phase, other_period, other_change = (
                            1 << i,
                            due,
                            every,
                            more,
                        )
        for k in range(slots):
            begin = clock // SUB
            clock += interval
            interval = (interval + add) & 0xFFFFFF
            end = clock // SUB
            steps = roles & 15
            if form == PACKED:
                steps = whole_number(data, at + MASKS_AT + k // 2, 1) >> 4 * (k & 1) & 15
            one = first_axis != 0 and phase < SLOT
            two = second_axis != 0 and other_phase < SLOT
            if form == PLACED:
                here = begin + (phase * (end - begin) + SLOT // 2) // SLOT if one else NEVER
                there = begin + (other_phase * (end - begin) + SLOT // 2) // SLOT if two else NEVER
                if one and end - here <= TOGETHER:
                    here = end
                if two and end - there <= TOGETHER:
                    there = end
                if abs(there - here) <= TOGETHER:
                    here = there = min(here, there)
                for _ in range(MOST_PHASES):
                    soonest = min(here, there)
                    if soonest < end:
                        tick[rows] = soonest
                        mask[rows] = (first_axis if here == soonest else 0) | (
                            second_axis if there == soonest else 0
                        )
                        rows += 1
                        here = NEVER if here == soonest else here
                        there = NEVER if there == soonest else there
                steps |= (first_axis if here == end else 0) | (second_axis if there == end else 0)
            else:
                steps |= (first_axis if one else 0) | (second_axis if two else 0)
            phase = (phase + (period if one else 0) - SLOT) & 0xFFFFFF
            other_phase = (other_phase + (other_period if two else 0) - SLOT) & 0xFFFFFF
            period = (period + (change if one else 0)) & 0xFFFFFF
            other_period = (other_period + (other_change if two else 0)) & 0xFFFFFF
            if steps != 0:
                tick[rows] = end
                mask[rows] = steps
                rows += 1
    return rows, clock


@njit
def play_all(
    data: Bytes, at: int, clock: int, time_ns: Ints, step: NDArray[np.int8], tick: Ints, mask: Bytes
) -> tuple[int, int, int]:
    """Play segments from byte ``at`` on while there is room for the longest one; returns the bytes
    done, the clock and the rows.

    time_ns (rows,), step (rows, axes): get the grid moves. tick, mask: scratch for one segment.
    """
    rows = 0
    size = segment_bytes(data, at)
    while size > 0 and rows + MOST_ROWS <= len(time_ns):
        made, clock = play(data, at, clock, tick, mask)
        backward = data[at + 1] >> 4
        for k in range(made):
            time_ns[rows] = tick[k] * TICK_NS
            for i in range(step.shape[1]):
                step[rows, i] = (-1 if backward >> i & 1 else 1) if mask[k] >> i & 1 else 0
            rows += 1
        at += size
        size = segment_bytes(data, at)
    return at, clock, rows
