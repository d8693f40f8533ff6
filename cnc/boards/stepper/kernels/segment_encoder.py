"""Encoding of grid moves as segments: the longest ones whose times stay within a tolerance.

At each move three forms of segment are tried (:mod:`cnc.boards.stepper.kernels.candidates`), and
the form with the fewest bytes per move is taken. Moves that no form makes short become timed
moves. A segment begins at the true time of the clock after the one before, so errors do not add
up.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc.boards.stepper.kernels.candidates import Candidate, GridMoves, Rules, Scratch, candidate
from cnc.boards.stepper.kernels.segments import (
    EVEN,
    HEAD,
    MAX_SLOTS,
    MAX_TIMED,
    PACKED,
    PLACED,
    SUB,
    TICK_NS,
    TIMED,
    TIMED_AT,
    Bytes,
    Head,
    play,
    write_head,
)
from cnc.compiled.jit import njit

LOOK_AHEAD = 1024
"""Moves that must wait before the first is encoded: more than the longest segment has."""
FREE_BYTES = 1024
"""Free bytes that a move needs to be encoded: more than three of the longest segments."""
PAUSE = 0x8000
"""Length of a slot of a pause, ticks."""
MAX_DELAY = 0xFFFF
"""Longest time to the next move without a pause, ticks."""
FIRST_REACH = 16
"""Reach of the first candidates, in slots."""
MAX_TIMED_RUN = 16
"""Largest number of moves that are timed before other forms are tried again."""
FEW_BYTES = 0.6
"""Bytes per move at which a form is taken without trying the next one."""

STATE = np.dtype(
    [
        ("clock", np.int64),
        ("due_ns", np.int64),
        ("delay_ns", np.int64),
        ("reach", np.int64),
        ("last_at", np.int64),
        ("timed_run", np.int64),
        ("run_at", np.int64),
        ("run_up", np.int64),
        ("run_down", np.int64),
    ]
)
"""State of an encoder, one record:

- ``clock``: end of the segments so far, 1/256 tick;
- ``due_ns``: due time of the last move taken;
- ``delay_ns``: longest delay of a move by the spacing;
- ``reach``: slots that a candidate may have, twice as many as the last segment had;
- ``last_at``: first byte of the last segment;
- ``timed_run``: moves that are timed before other forms are tried again;
- ``run_at``: first byte of the current run of timed moves, -1 without one;
- ``run_up``, ``run_down``: axes that step up and down in that run.
"""
State = Any


@njit
def take(
    time_ns: NDArray[np.int64],
    step: NDArray[np.int8],
    spacing_ns: int,
    state: State,
    rows: int,
    moves: GridMoves,
) -> None:
    """Append grid moves to the buffers.

    A move that is closer than ``spacing_ns`` to the one before, or to the start, is delayed.

    Args:
        time_ns: Times of the moves (n,), ns.
        step: Steps of the moves (n, axes).
        spacing_ns: Least time between two moves, ns.
        state: State of the encoder.
        rows: Moves in the buffers.
        moves: The buffers.
    """
    latest = state["due_ns"]
    for row in range(len(time_ns)):
        moving, down = 0, 0
        for i in range(step.shape[1]):
            moving |= (step[row, i] != 0) << i
            down |= (step[row, i] < 0) << i
        latest = max(latest + spacing_ns, time_ns[row])
        state["delay_ns"] = max(state["delay_ns"], latest - time_ns[row])
        moves.axes[rows + row] = moving
        moves.backward[rows + row] = down
        moves.due[rows + row] = latest
    state["due_ns"] = latest


@njit
def encode(
    moves: GridMoves,
    rows: int,
    keep: int,
    rules: Rules,
    state: State,
    out: Bytes,
    scratch: Scratch,
) -> tuple[int, int]:
    """Write segments of the first grid moves in the buffers.

    Args:
        moves: The buffers.
        rows: Moves in the buffers.
        keep: Moves that are left for the next call.
        rules: Tolerance and spacing.
        state: State of the encoder.
        out: Gets the segments.
        scratch: Scratch.

    Returns:
        Number of moves encoded, and number of bytes written.
    """
    done, size = 0, 0
    state["run_at"] = -1
    state["run_up"] = state["run_down"] = 0
    while rows - done > keep and size + FREE_BYTES <= len(out):
        size = _write_pause(moves.due[done], state, out, size)
        if _ticks_to(moves.due[done], state["clock"]) > MAX_DELAY:
            break
        best = Candidate(EVEN, 0, 0)
        for form in (EVEN, PACKED, PLACED):
            if best.rows == 0 or best.bytes > FEW_BYTES * best.rows:
                found = candidate(
                    form, moves, done, rows, rules, state["clock"], state["reach"], scratch
                )
                if found.rows > 0 and (
                    best.rows == 0 or found.bytes * best.rows < best.bytes * found.rows
                ):
                    best = found
        timed, size = _write_timed(moves, done, rows - keep, rules, best, state, out, size)
        done += timed
        if timed > 0:
            state["timed_run"] = min(2 * max(state["timed_run"], 1), MAX_TIMED_RUN)
        else:
            state["timed_run"] = 0
            state["run_at"] = -1
            state["last_at"] = size
            for i in range(best.bytes):
                out[size + i] = scratch.trial[best.form, i]
            _, clock = play(out, size, state["clock"], scratch.tick, scratch.mask)
            state["clock"] = clock
            size += best.bytes
            done += best.rows
            state["reach"] = min(max(2 * best.rows, FIRST_REACH), MAX_SLOTS)
    return done, size


@njit
def _ticks_to(due: int, clock: int) -> int:
    """Return the ticks from the clock to the tick nearest to a time in ns."""
    return (due + TICK_NS // 2) // TICK_NS - clock // SUB


@njit
def _write_pause(due: int, state: State, out: Bytes, size: int) -> int:
    """Write segments without steps until a move is near; return the bytes in ``out``."""
    ticks = _ticks_to(due, state["clock"])
    while ticks > MAX_DELAY and size + FREE_BYTES <= len(out):
        slots = min((ticks - PAUSE) // PAUSE, MAX_SLOTS)
        write_head(out, size, Head(slots, EVEN, 0, 0, PAUSE * SUB, 0))
        state["last_at"] = size
        size += HEAD
        state["clock"] += slots * PAUSE * SUB
        ticks -= slots * PAUSE
        state["run_at"] = -1
    return size


@njit
def _write_timed(
    moves: GridMoves,
    first: int,
    until: int,
    rules: Rules,
    best: Candidate,
    state: State,
    out: Bytes,
    size: int,
) -> tuple[int, int]:
    """Write timed moves while they take fewer bytes than the best candidate.

    Args:
        moves: The buffers.
        first: First move.
        until: Move behind the last one that may be written.
        rules: Tolerance and spacing.
        best: The best candidate.
        state: State of the encoder.
        out: Gets the moves.
        size: Bytes in ``out``.

    Returns:
        Number of moves written, and bytes in ``out``.
    """
    clock, run_at = state["clock"], state["run_at"]
    run_up, run_down = state["run_up"], state["run_down"]
    timed = 0
    most = max(best.rows, state["timed_run"])
    while timed < most and first + timed < until:
        new_run = TIMED_AT if run_at < 0 else 0
        if best.bytes <= 2 * best.rows + new_run:
            break
        row = first + timed
        ticks = max(_ticks_to(moves.due[row], clock), rules.spacing)
        if ticks > MAX_TIMED:
            break
        up, down = moves.axes[row] & ~moves.backward[row], moves.backward[row]
        if run_at < 0 or out[run_at] == MAX_SLOTS or (run_up | up) & (run_down | down):
            run_at = size
            size += TIMED_AT
            out[run_at] = 0
            run_up, run_down = 0, 0
        run_up |= up
        run_down |= down
        out[run_at] += 1
        out[run_at + 1] = TIMED | run_down << 4
        out[size] = ticks & 0xFF
        out[size + 1] = ticks >> 8 | moves.axes[row] << 4
        size += 2
        clock += ticks * SUB
        timed += 1
    if timed > 0:
        state["clock"], state["run_at"], state["last_at"] = clock, run_at, run_at
        state["run_up"], state["run_down"] = run_up, run_down
    return timed, size
