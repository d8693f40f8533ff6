"""Segments: compressed grid moves, and their player in the integer arithmetic of an 8-bit board.

Grid moves are played in slots. Slot k lasts interval + k * add, so a segment follows a constant
or linearly changing speed. The axes of the ``always`` mask step at the end of each slot. An axis
that steps less often has a phase: the time to its next step, counted in slots. Its period may
change from step to step, as it does along a curve.

      slot            0          1          2          3          4
      always   |------x----|-----x----|----x----|----x---|---x---|   phase 1.8, period 2.6 slots
      phase    1.8        0.8        2.4       1.4       0.4         below 1: a step, + period
    even              .          xy         .         .       xy     the step joins that of its slot
    placed            .       y  x          .         .   y   x      or is at 0.8, 0.4 of the slot

Algorithms that step the fastest axis in every move give even segments. Algorithms that step each
axis where it crosses a grid line give placed segments. Other moves are ``packed`` (one mask per
slot) or ``timed`` (a mask and an interval for each move). The bits are in
``docs/explanation/segments.md``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

TICK_NS = 500
"""Tick of the board's timer, ns."""
SUB = 256
"""Units of intervals in a tick."""
SLOT = 65536
"""Units of phases in a slot."""
MAX_SLOTS = 255
MAX_ROWS = 3 * MAX_SLOTS
"""Grid moves of the longest segment: that of each slot and those of two phases inside it."""
MAX_INTERVAL = 0xFFFF * SUB
MAX_PERIOD = 0xFFFFFF
MIN_ADD, MAX_ADD = -32768, 32767
MAX_TIMED = 4095
"""Longest interval of a timed move, ticks."""
MAX_AXES = 4
MAX_PHASES = 2

TOGETHER = 1
"""Largest distance of steps in a placed segment that count as one grid move, ticks."""
NEVER = 2**62
"""A tick that no clock reaches."""

EVEN, PLACED, PACKED, TIMED = 0, 1, 2, 3
"""Forms of a segment."""
FORM = 3
"""Bits of byte 1 with the form."""
END = 4
"""Bit of byte 1: nothing need follow, so that an empty buffer is not a fault."""
COMMAND = 8
"""Bit of byte 1: a command instead of a segment. Byte 0 is the number of bytes after byte 1, and
bits 4-7 of byte 1 are the code of the command.
"""

HEAD, PHASE_BYTES, MASKS_AT, TIMED_AT = 8, 8, 7, 2
"""Bytes of the head and of a phase; first byte of the masks of packed and of the words of timed
segments.
"""
MAX_BYTES = TIMED_AT + 2 * MAX_SLOTS
"""Length of the longest segment, bytes."""


@njit
def whole_number(data: Bytes, at: int, size: int) -> int:
    """Return the number in ``size`` bytes from ``at`` on, the lowest first."""
    value = np.int64(0)
    for i in range(size):
        value |= np.int64(data[at + i]) << 8 * i
    return int(value)


@njit
def _signed16(data: Bytes, at: int) -> int:
    """Return the signed number in two bytes, the lowest first."""
    value = whole_number(data, at, 2)
    return value - 65536 if value > MAX_ADD else value


@njit
def segment_bytes(data: Bytes, at: int) -> int:
    """Return the length of the segment or command at byte ``at``, -1 without a complete one."""
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
            if count <= MAX_PHASES and always & phases == 0 and (always != 0 or count == 0):
                size = HEAD + PHASE_BYTES * count
        if at + size > len(data):
            size = -1
    return size


@njit
def play(data: Bytes, at: int, clock: int, tick: Ints, mask: Bytes) -> tuple[int, int]:
    """Play the segment at byte ``at`` as the board does.

    Only the clock continues from segment to segment, and the board needs only its low byte. All
    numbers have at most 24 bits, except the product of two 16-bit numbers.

    Args:
        data: Segments.
        at: First byte of the segment.
        clock: Clock at its start, 1/256 tick.
        tick: Gets the tick of each grid move (MAX_ROWS,).
        mask: Gets the axes that step in each move (MAX_ROWS,).

    Returns:
        Number of grid moves, and the clock after the segment.
    """
    slots = whole_number(data, at, 1)
    form = data[at + 1] & FORM
    rows = 0
    if data[at + 1] & COMMAND:
        slots = 0
    elif form == TIMED:
        for k in range(slots):
            first = at + TIMED_AT + 2 * k
            word = int(np.int64(data[first]) | np.int64(data[first + 1]) << 8)
            clock += (word & MAX_TIMED) * SUB
            tick[rows] = clock // SUB
            mask[rows] = word >> 12
            rows += 1
    else:
        interval = whole_number(data, at + 2, 3)
        add = _signed16(data, at + 5)
        roles = whole_number(data, at + 7, 1)
        first_axis, phase, period, change = 0, MAX_PERIOD, 0, 0
        second_axis, other_phase, other_period, other_change = 0, MAX_PERIOD, 0, 0
        if form != PACKED:
            where = at + HEAD
            for i in range(MAX_AXES):
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
                steps = int(np.int64(data[at + MASKS_AT + k // 2]) >> 4 * (k & 1) & 15)
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
                for _ in range(MAX_PHASES):
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


# Bytes of a segment, written by the encoder.


class Head(NamedTuple):
    """The fields of the eight bytes at the start of all forms with slots."""

    slots: int
    form: int
    backward: int
    roles: int
    interval: int
    add: int


@njit
def write_head(out: Bytes, at: int, head: Head) -> None:
    """Write the eight bytes at the start of all forms with slots."""
    out[at] = head.slots
    out[at + 1] = head.form | head.backward << 4
    write24(out, at + 2, head.interval)
    out[at + 5] = head.add & 0xFF
    out[at + 6] = head.add >> 8 & 0xFF
    out[at + 7] = head.roles


@njit
def write_masks(masks: Ints, out: Bytes) -> None:
    """Write the masks of a packed segment, two in a byte."""
    for k in range(len(masks)):
        if k & 1:
            out[MASKS_AT + k // 2] |= masks[k] << 4
        else:
            out[MASKS_AT + k // 2] = masks[k]


@njit
def write24(out: Bytes, at: int, value: int) -> None:
    """Write three bytes, the lowest first."""
    out[at] = value & 0xFF
    out[at + 1] = value >> 8 & 0xFF
    out[at + 2] = value >> 16 & 0xFF
