"""Grid moves to segments: the longest ones whose times stay within a tolerance.

At each move three forms of segment are tried, the one with the fewest bytes a move is taken, and
what none of them makes short becomes timed moves. A segment grows slot by slot: the times of the
slots, and the places of the steps of the axes with a phase, are lines through windows
(:mod:`cnc.kernels.stepper.windows`), and it ends where one of them finds no line with whole
coefficients. Windows are where a time may be:

      time   ---[----due----]------[----due----]----      due: as asked for, or the board's smallest spacing after the one before.

In placed segments one half of the tolerance is for the slots, the other for the axes inside them. A
segment begins where the clock really is after the one before, so that errors don't add up; and each
one is played before it's accepted, and ends before the first move that comes out wrong.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.stepper.segments import (
    EVEN,
    HEAD,
    LEAST_ADD,
    LONGEST_INTERVAL,
    LONGEST_PERIOD,
    LONGEST_TIMED,
    MASKS_AT,
    MOST_ADD,
    MOST_AXES,
    MOST_PHASES,
    MOST_SLOTS,
    PACKED,
    PHASE_BYTES,
    PLACED,
    SLOT,
    SUB,
    TICK_NS,
    TIMED,
    TIMED_AT,
    TOGETHER,
    Bytes,
    Ints,
    play,
)
from cnc.kernels.stepper.windows import Floats, longest

AHEAD = 1024
"""Grid moves, more than the longest segment has: so many are looked at before the first one is
encoded.
"""
ROOM = 1024
"""Bytes, more than three of the longest segments: so many must be free for a move to be encoded."""
PAUSE = 0x8000
"""Ticks of a slot of a pause."""
FIRST_GLANCE = 16
"""Slots looked ahead at the start; later twice as many as the last segment had."""

CLOCK, DUE_NS, LATEST_NS, GLANCE, LAST_AT, HASTE = range(6)
"""State: clock in 1/256 tick, when the last move taken is due, longest delay for spacing, slots
looked ahead, byte of the last segment, and how many moves are timed before the next try to do
better.
"""
STATE = 6
MOST_HASTE = 16
ENOUGH = 0.6
"""Bytes a move: a form that needs no more is taken without a look at the next."""


@njit
def take(
    time_ns: Ints, step: NDArray[np.int8], spacing_ns: int, state: Ints, rows: int, axes: Ints, backward: Ints, due: Ints,
) -> None:  # fmt: skip
    """Append grid moves to the buffers, of which ``rows`` rows are taken.

    axes, backward: masks of the axes that step, and that step down. due: ns; a move that comes
    sooner than spacing_ns after the one before, or after the start, is put off.
    """
    latest = state[DUE_NS]
    for row in range(len(time_ns)):
        moving, down = 0, 0
        for i in range(step.shape[1]):
            moving |= (step[row, i] != 0) << i
            down |= (step[row, i] < 0) << i
        latest = max(latest + spacing_ns, time_ns[row])
        state[LATEST_NS] = max(state[LATEST_NS], latest - time_ns[row])
        axes[rows + row] = moving
        backward[rows + row] = down
        due[rows + row] = latest
    state[DUE_NS] = latest


@njit
def _first_tick(due: int, tolerance: int) -> int:
    """The first tick within the tolerance, both in ns, of when a move is due."""
    return -((tolerance - due) // TICK_NS)


@njit
def _last_tick(due: int, tolerance: int) -> int:
    """The last one."""
    return (due + tolerance) // TICK_NS


@njit
def _nearest_tick(due: int) -> int:
    """The one nearest to when a move is due."""
    return (due + TICK_NS // 2) // TICK_NS


@njit
def encode(
    axes: Ints, backward: Ints, due: Ints, rows: int, keep: int, tolerance: int, spacing: int, state: Ints, out: Bytes,
    trial: Bytes, tick: Ints, mask: Bytes, ends: Ints, windows: Floats, px: Floats, py: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Write the segments of the first grid moves in the buffers; returns how many moves are done,
    and the bytes.

    rows: moves in the buffers; ``keep`` of them are left for the next call. tolerance: ns. spacing:
    least ticks between two moves. trial (3, LONGEST), tick, mask (MOST_ROWS,), ends (MOST_SLOTS,),
    windows (4, MOST_SLOTS), px, py (2, CORNERS): scratch.
    """
    done, size = 0, 0
    run_at = -1
    plus, minus = 0, 0
    while rows - done > keep and size + ROOM <= len(out):
        away = _nearest_tick(due[done]) - state[CLOCK] // SUB
        while away > 0xFFFF and size + ROOM <= len(out):
            slots = min((away - PAUSE) // PAUSE, MOST_SLOTS)
            _head(out, size, slots, EVEN, 0, 0, PAUSE * SUB, 0)
            state[LAST_AT] = size
            size += HEAD
            state[CLOCK] += slots * PAUSE * SUB
            away -= slots * PAUSE
            run_at = -1
        if away > 0xFFFF:
            break
        best, best_bytes, best_rows = EVEN, 0, 0
        for form in (EVEN, PACKED, PLACED):
            if best_rows == 0 or best_bytes > ENOUGH * best_rows:
                made, covered = _candidate(
                    form, axes, backward, due, done, rows, tolerance, spacing, state, trial[form], tick, mask, ends, windows, px, py
                )  # fmt: skip
                if covered > 0 and (best_rows == 0 or made * best_rows < best_bytes * covered):
                    best, best_bytes, best_rows = form, made, covered
        timed = 0
        while (
            timed < max(best_rows, state[HASTE])
            and done + timed < rows - keep
            and best_bytes > 2 * best_rows + (0 if run_at >= 0 else TIMED_AT)
        ):
            row = done + timed
            here = state[CLOCK] // SUB
            away = max(_nearest_tick(due[row]) - here, spacing)
            if away > LONGEST_TIMED:
                break
            up, down = axes[row] & ~backward[row], backward[row]
            if run_at < 0 or out[run_at] == MOST_SLOTS or (plus | up) & (minus | down):
                run_at = size
                size += TIMED_AT
                out[run_at] = 0
                plus, minus = 0, 0
            plus |= up
            minus |= down
            out[run_at] += 1
            out[run_at + 1] = TIMED | minus << 4
            out[size] = away & 0xFF
            out[size + 1] = away >> 8 | axes[row] << 4
            size += 2
            state[CLOCK] += away * SUB
            state[LAST_AT] = run_at
            timed += 1
        done += timed
        if timed > 0:
            state[HASTE] = min(2 * max(state[HASTE], 1), MOST_HASTE)
        else:
            state[HASTE] = 0
            run_at = -1
            state[LAST_AT] = size
            for i in range(best_bytes):
                out[size + i] = trial[best, i]
            _, state[CLOCK] = play(out, size, state[CLOCK], tick, mask)
            size += best_bytes
            done += best_rows
            state[GLANCE] = min(max(2 * best_rows, FIRST_GLANCE), MOST_SLOTS)
    return done, size


@njit
def _candidate(
    form: int, axes: Ints, backward: Ints, due: Ints, first: int, rows: int, tolerance: int, spacing: int, state: Ints, out: Bytes,
    tick: Ints, mask: Bytes, ends: Ints, windows: Floats, px: Floats, py: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Write to ``out`` the longest segment of a form from move ``first`` on; returns its bytes and
    its moves, 0 if there is none.
    """
    clock = state[CLOCK]
    always, phases = 0, 0
    if form != PACKED:
        always, phases = _roles(form, axes, backward, first, min(first + state[GLANCE], rows))
    count = (phases & 1) + (phases >> 1 & 1) + (phases >> 2 & 1) + (phases >> 3)
    slots, minus = 0, 0
    if count <= MOST_PHASES and (form == PACKED or always != 0) and (form != PLACED or count > 0):
        slots, minus = _slots(
            form,
            always,
            phases,
            axes,
            backward,
            due,
            first,
            rows,
            clock,
            tolerance,
            state[GLANCE],
            ends,
            windows,
        )
    interval, add = 0, 0
    if slots > 0:
        slots, interval, add = longest(
            windows[0], windows[1], windows[2], slots, spacing * SUB, LONGEST_INTERVAL, LEAST_ADD, MOST_ADD, px, py
        )  # fmt: skip
    at = HEAD
    for i in range(MOST_AXES):
        if phases >> i & 1 and slots > 0:
            slots, steps = _steps(
                form, 1 << i, axes, due, first, clock, tolerance, slots, ends, windows
            )
            met, phase, period = longest(
                windows[0], windows[1], windows[2], slots, 0.0, LONGEST_PERIOD, SLOT, LONGEST_PERIOD, px, py
            )  # fmt: skip
            change = _bend(windows, slots, steps) if met < slots else 0
            if change != 0:
                bent, bent_phase, bent_period = longest(
                    windows[0], windows[1], windows[2], slots, 0.0, LONGEST_PERIOD, SLOT, LONGEST_PERIOD, px, py
                )  # fmt: skip
                if bent > met:
                    met, phase, period = bent, bent_phase, bent_period
                else:
                    change = 0
            slots = met
            _whole24(out, at, phase)
            _whole24(out, at + 3, period)
            out[at + 6] = change & 0xFF
            out[at + 7] = change >> 8 & 0xFF
            at += PHASE_BYTES
    covered = 0
    if slots > 0:
        _head(out, 0, slots, form, minus, always | phases << 4, interval, add)
        if form == PACKED:
            for k in range(slots):
                if k & 1:
                    out[MASKS_AT + k // 2] |= axes[first + k] << 4
                else:
                    out[MASKS_AT + k // 2] = axes[first + k]
        slots, covered = _played(
            form,
            always,
            axes,
            due,
            first,
            ends[slots - 1] + 1 - first,
            tolerance,
            spacing,
            clock,
            out,
            tick,
            mask,
        )
        out[0] = slots
    return MASKS_AT + (slots + 1) // 2 if form == PACKED else at, covered


@njit
def _slots(
    form: int, always: int, phases: int, axes: Ints, backward: Ints, due: Ints, first: int, rows: int, clock: int, tolerance: int,
    most: int, ends: Ints, windows: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Divide the moves from ``first`` on into at most ``most`` slots; returns their number, and the
    axes that go down.

    ends: gets the last move of each slot. windows: w, low and high of the line of their times, a
    row each.
    """
    plus, minus = 0, 0
    slots, row = 0, first
    share = max(tolerance // 2, TICK_NS) if form == PLACED else tolerance
    legal = True
    while legal and slots < most and row < rows:
        last = row
        if form == PLACED:
            while last < rows - 1 and axes[last] & always == 0 and last < row + MOST_PHASES:
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
            ends[slots] = last
            windows[0, slots] = 0.5 * slots
            windows[1, slots] = (_first_tick(due[last], share) * SUB - clock) / (slots + 1)
            windows[2, slots] = (_last_tick(due[last], share) * SUB + SUB - 1 - clock) / (slots + 1)
            slots += 1
            row = last + 1
    return slots, minus


@njit
def _steps(
    form: int,
    axis: int,
    axes: Ints,
    due: Ints,
    first: int,
    clock: int,
    tolerance: int,
    slots: int,
    ends: Ints,
    windows: Floats,
) -> tuple[int, int]:
    """Windows of the line of an axis's steps among the slots, one a slot; returns how many slots
    have but one step of it, and the steps.

    windows[3] gets where each step should be.
    """
    begin = float(clock)
    off = SUB * max(0.5 * tolerance / TICK_NS - 0.5, 0.25)
    steps = 0
    row = first
    for slot in range(slots):
        last = ends[slot]
        end = due[last] * (SUB / TICK_NS)
        found = -1
        for k in range(row, last + 1):
            if axes[k] & axis:
                if found >= 0:
                    return slot, steps
                found = k
        place = float(slot * SLOT)
        windows[0, slot] = steps
        if found < 0:
            windows[1, slot] = place + SLOT
            windows[2, slot] = np.inf
        else:
            least, most = place, place + SLOT - 1
            if form == PLACED and end > begin:
                sub = SLOT / (end - begin)
                edge = place + SLOT - sub * SUB * (TOGETHER + 0.5)
                if found == last:
                    least = max(least, edge)
                else:
                    at = place + sub * (due[found] * (SUB / TICK_NS) - begin)
                    # two axes that step together inside a slot must come out within a tick
                    around = sub * (off if axes[found] == axis else 0.25 * SUB)
                    least, most = max(least, at - around), min(most, edge, at + around)
            windows[1, slot] = least
            windows[2, slot] = most
            windows[3, steps] = 0.5 * (least + most)
            steps += 1
        begin = end
        row = last + 1
    return slots, steps


@njit
def _bend(windows: Floats, slots: int, steps: int) -> int:
    """How much an axis's period changes from step to step, by the mean places of its first, middle
    and last steps; windows without it.
    """
    third = steps // 3
    first, middle, last = 0.0, 0.0, 0.0
    for j in range(third):
        first += windows[3, j]
        middle += windows[3, third + j]
        last += windows[3, 2 * third + j]
    change = 0
    if third > 0:
        change = int(
            np.floor(
                min(max((first - 2.0 * middle + last) / float(third) ** 3, LEAST_ADD), MOST_ADD)
                + 0.5
            )
        )
    for slot in range(slots):
        j = windows[0, slot]
        windows[1, slot] -= 0.5 * j * (j - 1.0) * change
        windows[2, slot] -= 0.5 * j * (j - 1.0) * change
    return change


@njit
def _roles(form: int, axes: Ints, backward: Ints, first: int, until: int) -> tuple[int, int]:
    """Masks of the axes that step in every slot, and of the others that step, judged by moves
    ``first`` to ``until``.
    """
    plus, minus, every = 0, 0, 15
    row = first
    count = np.zeros(MOST_AXES, np.int64)
    while row < until:
        plus |= axes[row] & ~backward[row]
        minus |= backward[row]
        if plus & minus:
            break
        every &= axes[row]
        for i in range(MOST_AXES):
            count[i] += axes[row] >> i & 1
        row += 1
    if form == PLACED:
        # the axis that steps most, and those that never step without it nor it without them
        lead = 0
        for i in range(1, MOST_AXES):
            if count[i] > count[lead]:
                lead = i
        every = 15
        for k in range(first, row):
            if axes[k] >> lead & 1:
                every &= axes[k]
        for i in range(MOST_AXES):
            if count[i] != count[lead]:
                every &= ~(1 << i)
    return every, (plus | minus) & ~every


@njit
def _head(
    out: Bytes, at: int, slots: int, form: int, backward: int, roles: int, interval: int, add: int
) -> None:
    """Write the eight bytes that all forms with slots begin with."""
    out[at] = slots
    out[at + 1] = form | backward << 4
    _whole24(out, at + 2, interval)
    out[at + 5] = add & 0xFF
    out[at + 6] = add >> 8 & 0xFF
    out[at + 7] = roles


@njit
def _whole24(out: Bytes, at: int, value: int) -> None:
    """Write three bytes, the lowest first."""
    out[at] = value & 0xFF
    out[at + 1] = value >> 8 & 0xFF
    out[at + 2] = value >> 16 & 0xFF


@njit
def _played(
    form: int, always: int, axes: Ints, due: Ints, first: int, covered: int, tolerance: int, spacing: int, clock: int, out: Bytes,
    tick: Ints, mask: Bytes,
) -> tuple[int, int]:  # fmt: skip
    """Play a segment; returns how many of its slots, and of its moves, come out right from its
    beginning on.
    """
    rows, _ = play(out, 0, clock, tick, mask)
    before = clock // SUB
    slots, kept = 0, 0
    for k in range(min(rows, covered)):
        row = first + k
        if (
            mask[k] != axes[row]
            or tick[k] < before + spacing
            or not abs(tick[k] * TICK_NS - due[row]) <= tolerance
        ):
            break
        before = tick[k]
        if form != PLACED or mask[k] & always:
            slots += 1
            kept = k + 1
    return slots, kept
