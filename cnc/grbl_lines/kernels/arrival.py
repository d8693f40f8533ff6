r"""Times of the moves of a GRBL board that plans each move when its line has arrived.

A line takes its time on the wire, and the board takes some for each byte and each move. The wire
waits while the buffer of the board is full, and the board while its planner is.

    wire      |--line 1--|--line 2--|--line 3--|        a line is sent when the buffer has space
    planner              |read|plan 1|    |read|plan 2| a move is planned when the planner has space
    motion                           |--move 1--~~|--move 2--    ~~: rest, for lack of a move

A move brakes in time to stop behind the last planned move. Each further move that is planned
meanwhile raises the speed at its end:

    v |     ,---.       ,--  the end of move k + 2 was in sight from the begin on;
      |  ,-'     \   ,-'     at x, move k + 3 is planned, and the board speeds up again
      +-----------x---------> t

A board at rest begins the next move when it has read all that has arrived, or when its planner is
full (gnea/grbl, protocol.c and motion_control.c: the automatic cycle start).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

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
        ("started", np.int64),
        ("read_at", np.float64, (RING,)),
        ("sizes", np.int64, (RING,)),
        ("planned_at", np.float64, (RING,)),
        ("started_at", np.float64, (RING,)),
        ("ended_at", np.float64, (RING,)),
    ]
)
"""State between two calls. When the wire is free, the board has read and planned, and the motion
has ended, s; speed at that end, mm/s; whether a move has begun; numbers of lines sent and read;
bytes in the buffer; numbers of moves that have ended, that are planned, and that a board at rest
would have begun. Rings by number of line (time when it was read, bytes) and by number of move
(times of plan, of a start from rest, and of the end).
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
def _part_of_move(
    length: float, acceleration: float, feed: float, begin: float, end: float, time: float
) -> tuple[float, float]:
    """Return the length (mm) and the speed (mm/s) after the first part of a move.

    Args:
        length: Of the move, mm.
        acceleration: mm/s^2.
        feed: Highest speed, mm/s.
        begin: Speed at its begin, mm/s.
        end: Speed at its end, mm/s.
        time: Of the part, less than that of the move, s.
    """
    seconds, end = move_time(length, acceleration, feed, begin, end)
    peak = math.sqrt(0.5 * (begin * begin + end * end) + acceleration * length)
    peak = max(min(feed, peak), begin, end)
    up, down = (peak - begin) / acceleration, (peak - end) / acceleration
    if time < up:
        return (begin + 0.5 * acceleration * time) * time, begin + acceleration * time
    left = seconds - time
    if left < down:
        return length - (end + 0.5 * acceleration * left) * left, end + acceleration * left
    return 0.5 * (begin + peak) * up + peak * (time - up), peak


@njit
def _start(now: Any, at: float) -> None:
    """Let a board at rest begin the moves that are planned."""
    for number in range(now["started"], now["known"]):
        now["started_at"][number % RING] = at
    now["started"] = now["known"]


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
    if now["wire"] > now["board"]:
        _start(now, now["board"])
    now["board"] = max(now["board"], now["wire"]) + size * link.read_time
    k = now["sent"] % RING
    now["sizes"][k] = size
    now["read_at"][k] = now["board"]
    now["sent"] += 1


@njit
def _plan(now: Any, link: Link) -> None:
    """Plan the next move, when the planner has space."""
    number = int(now["known"])
    if number >= link.planner:
        free = now["ended_at"][(number - link.planner) % RING]
        if free > now["board"]:
            _start(now, now["board"])
            now["board"] = free
    at = now["board"]
    now["planned_at"][number % RING] = at
    now["read_at"][(now["sent"] - 1) % RING] = at
    now["known"] += 1


@njit
def _carry_out(now: Any, moves: Moves, first: int, case: int, link: Link, times: Floats) -> None:
    """Carry out the next move: bring the end of the motion and the speed there up to date.

    Args:
        now: The state.
        moves: The moves.
        first: Number of the first of them.
        case: Column of ``moves`` and ``times``.
        link: Times of wire and board.
        times: The time from the end of the move before is filled in, s.
    """
    number = int(now["moves"])
    k, before = number - first, now["end"]
    if number >= now["started"] and now["planned_at"][number % RING] > before:
        # The planner is full, or the line that is read waits for rest.
        _start(now, now["board"])
    start = now["started_at"][number % RING]
    if not now["begun"]:
        _begin_time(now, start - now["end"])
        start, now["begun"] = now["end"], 1
    time, speed = now["end"], now["speed"]
    if now["planned_at"][number % RING] > time:
        time, speed = max(start, time), 0.0
    speed = min(speed, moves.begin[k, case])
    left, acceleration = moves.length[k], moves.acceleration[k]
    feed, end = moves.feed[k, case], moves.end[k, case]
    square, ahead = 0.0, 1
    while True:
        planned = -math.inf
        while square < end * end and ahead < link.planner and k + ahead < len(moves.length):
            known = number + ahead < now["known"]
            planned = now["planned_at"][(number + ahead) % RING] if known else math.inf
            if planned > time:
                break
            square += 2.0 * moves.acceleration[k + ahead] * moves.length[k + ahead]
            ahead += 1
        leave = math.sqrt(square) if planned > time else end
        seconds, reached = move_time(left, acceleration, feed, speed, leave)
        if planned <= time or planned >= time + seconds:
            break
        # A move is planned meanwhile.
        gone, speed = _part_of_move(left, acceleration, feed, speed, leave, planned - time)
        left, time = max(left - gone, 0.0), planned
    now["end"], now["speed"] = time + seconds, reached
    now["ended_at"][number % RING] = now["end"]
    now["moves"] += 1
    times[k, case] = now["end"] - before


@njit
def _begin_time(now: Any, late: float) -> None:
    """Let the time begin with the first move: the lines before it have taken none."""
    now["wire"] -= late
    now["board"] -= late
    for i in range(RING):
        now["read_at"][i] -= late
        now["planned_at"][i] -= late
        now["started_at"][i] -= late


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
            if now["known"] > first + k:
                continue
            while line <= moves.line[k]:
                _read_line(now, sizes[line], link)
                line += 1
            now["board"] += link.plan_time
            # The moves that must have ended before this one has space in the planner.
            while now["moves"] < first + done and now["moves"] + link.planner <= first + k:
                _carry_out(now, moves, first, case, link, times)
            _plan(now, link)
        while line < len(sizes):
            _read_line(now, sizes[line], link)
            line += 1
        while now["moves"] < first + done:
            _carry_out(now, moves, first, case, link, times)
