"""Times of the moves of a GRBL board that plans each move when its line has arrived.

A line takes its time on the wire, and the board takes some for each byte and each move. The wire
waits while the buffer of the board is full, and the board while its planner is.

    wire      |--line 1--|--line 2--|--line 3--|        a line is sent when the buffer has space
    planner              |read|plan 1|    |read|plan 2| a move is planned when the planner has space
    motion                           |--move 1--~~|--move 2--    ~~: rest, for lack of a move

A move brakes in time to stop behind the last planned move. It is approximated: the moves that count
are those that are planned in the first quarter of its time. A later one comes too late to keep the
speed at its end.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RING = 256
"""Places of the rings; the board has fewer lines in its buffer, and moves in its planner."""

STATE = np.dtype(
    [
        ("wire", np.float64),
        ("board", np.float64),
        ("end", np.float64),
        ("speed", np.float64),
        ("begun", np.int64),
        ("sent", np.int64),
        ("read", np.int64),
        ("filled", np.int64),
        ("moves", np.int64),
        ("known", np.int64),
        ("read_at", np.float64, (RING,)),
        ("sizes", np.int64, (RING,)),
        ("planned_at", np.float64, (RING,)),
        ("ended_at", np.float64, (RING,)),
    ]
)
"""State between two calls. When the wire is free, the board has read and planned, and the motion
has ended, s; speed at that end, mm/s; whether a move has begun; numbers of lines sent and read;
bytes in the buffer; numbers of moves that have ended, and that are planned. Rings by number of line
(time when it was read, bytes) and by number of move (times of plan and end).
"""


class Link(NamedTuple):
    """Times of the wire and of the board.

    Attributes:
        byte_time: Of a byte on the wire, s.
        check_bytes: Bytes of questions to the board, for each line.
        read_time: That the board takes for a byte, s.
        plan_time: That it takes to plan a move, s.
        answer_time: From the end of a line on the board to the next line that the sender adds, s.
        buffer: Bytes that may be on their way or in the buffer.
        planner: Moves that the planner holds.
    """

    byte_time: float
    check_bytes: float
    read_time: float
    plan_time: float
    answer_time: float
    buffer: int
    planner: int


class Moves(NamedTuple):
    """Moves as the board plans them with all moves that it looks ahead; c cases.

    Attributes:
        length: (n,) mm.
        acceleration: (n,) mm/s^2.
        feed: (n, c) mm/s.
        begin: (n, c) highest speed at the begin, mm/s.
        end: (n, c) highest speed at the end, mm/s.
        line: (n,) number of the line, from 0, in the lines of this call; negative for a line
            that is read already.
    """

    length: Floats
    acceleration: Floats
    feed: Floats
    begin: Floats
    end: Floats
    line: Ints


@njit
def move_time(
    length: float, acceleration: float, feed: float, begin: float, end: float
) -> tuple[float, float]:
    """Return the time of a move from one speed to another, s, and the speed at its end."""
    end = min(end, math.sqrt(begin * begin + 2.0 * acceleration * length))
    peak = math.sqrt(0.5 * (begin * begin + end * end) + acceleration * length)
    peak = max(min(feed, peak), begin, end)
    ramps = (2.0 * peak * peak - begin * begin - end * end) / (2.0 * acceleration)
    seconds = (2.0 * peak - begin - end) / acceleration + max(length - ramps, 0.0) / peak
    return seconds, end


@njit
def _read_line(now: Any, size: int, link: Link) -> None:
    """Send and read the next line."""
    free = now["wire"]
    while now["filled"] + size > link.buffer and now["read"] < now["sent"]:
        k = now["read"] % RING
        free = max(free, now["read_at"][k] + link.answer_time)
        now["filled"] -= now["sizes"][k]
        now["read"] += 1
    now["filled"] += size
    now["wire"] = free + (size + link.check_bytes) * link.byte_time
    now["board"] = max(now["board"], now["wire"]) + size * link.read_time
    k = now["sent"] % RING
    now["sizes"][k] = size
    now["read_at"][k] = now["board"]
    now["sent"] += 1


@njit
def _plan(now: Any, link: Link) -> None:
    """Plan the next move, when the planner has space."""
    number = int(now["known"])
    at = now["board"] + link.plan_time
    if number >= link.planner:
        at = max(at, now["ended_at"][(number - link.planner) % RING])
    now["board"] = at
    now["planned_at"][number % RING] = at
    now["read_at"][(now["sent"] - 1) % RING] = at
    now["known"] += 1


@njit
def _carry_out(now: Any, moves: Moves, k: int, case: int, link: Link) -> None:
    """Carry out move ``k``: bring the end of the motion and the speed there up to date."""
    number = int(now["moves"])
    planned = now["planned_at"][number % RING]
    if not now["begun"]:
        # The time begins with the first move: the lines before it have taken none.
        late = planned - now["end"]
        now["wire"] -= late
        now["board"] -= late
        for i in range(RING):
            now["read_at"][i] -= late
            now["planned_at"][i] -= late
        planned, now["begun"] = now["end"], 1
    begin, speed = now["end"], now["speed"]
    if planned > begin:
        begin, speed = planned, 0.0
    speed = min(speed, moves.begin[k, case])
    length, acceleration = moves.length[k], moves.acceleration[k]
    feed, end = moves.feed[k, case], moves.end[k, case]
    seconds, end = move_time(length, acceleration, feed, speed, end)
    last = begin + 0.25 * seconds
    square, ahead = 0.0, 1
    while square < end * end and ahead < link.planner and k + ahead < len(moves.length):
        if number + ahead >= now["known"] or now["planned_at"][(number + ahead) % RING] > last:
            seconds, end = move_time(length, acceleration, feed, speed, math.sqrt(square))
            break
        square += 2.0 * moves.acceleration[k + ahead] * moves.length[k + ahead]
        ahead += 1
    now["end"], now["speed"] = begin + seconds, end
    now["ended_at"][number % RING] = now["end"]
    now["moves"] += 1


@njit
def times_of(
    states: NDArray[np.void], moves: Moves, sizes: Ints, done: int, link: Link, times: Floats
) -> None:
    """Carry out moves: fill the time from the end of the move before to that of each.

    Args:
        states: (c,) state of each case, brought up to date.
        moves: The moves. Those behind the first ``done`` are known, but not carried out. The
            first ones may be known already from the call before.
        sizes: (lines,) bytes of the lines after those of the call before.
        done: Number of moves to carry out.
        link: Times of wire and board.
        times: (done, c) filled, s.
    """
    for case in range(len(states)):
        now = states[case]
        first = int(now["moves"])
        line = 0
        for k in range(len(moves.length)):
            # The moves that must have ended before this one has space in the planner.
            while now["moves"] < first + done and now["moves"] + link.planner <= first + k:
                before = now["end"]
                j = int(now["moves"]) - first
                _carry_out(now, moves, j, case, link)
                times[j, case] = now["end"] - before
            if now["known"] <= first + k:
                while line <= moves.line[k]:
                    _read_line(now, sizes[line], link)
                    line += 1
                _plan(now, link)
        while now["moves"] < first + done:
            before = now["end"]
            j = int(now["moves"]) - first
            _carry_out(now, moves, j, case, link)
            times[j, case] = now["end"] - before
        while line < len(sizes):
            _read_line(now, sizes[line], link)
            line += 1
