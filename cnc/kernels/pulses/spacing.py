"""Limits of the board's step rate: pulses that are taken back at once, and rows too close together.

A graze is an axis that turns back so soon behind a half-grid line that its two pulses would come
faster than the board allows. Both pulses are removed. Grazes that rest exactly on the line are
common in real programs, and the slack of the generators deals with them. Those that reach slightly
beyond it are rare in one move, but sure to occur among a million.

Rows of different axes may fall due at almost the same time. Where the board needs more time they
are joined:

      x   |      |      |      |
      y     |       |      |    |
      row ^ ^    ^  ^      ^   ^
                        one  one

at the time of the later row: there the curve is within half a BLU of the grid point to which both
lead. Two rows of the same axis come so near only where another axis takes the lead: its steps were
those of the other's rows and are its own from then on. Then the second row waits.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Ints
from cnc.kernels.pulses.grid_moves import Lines, Moves

BLOCK = 256
"""Rows of which it is asked at once whether an axis turns in them."""


class Buffers(NamedTuple):
    """Buffers of grid moves with their times.

    Attributes:
        moves: the moves.
        time_ns: (rows,) int64: time of each, ns.
        line: (rows,) int32: source line of each.
        recent: (n,) int64: row of the last pulse of each axis; -1 where it has left the buffers.
        made: (n,) int64: number of pulses of each axis so far.
    """

    moves: Moves
    time_ns: Ints
    line: Lines
    recent: Ints
    made: Ints


@njit
def without_grazes(first: int, rows: int, buffers: Buffers, min_pulse_ns: float) -> int:
    """Remove pulses that an axis takes back within ``min_pulse_ns``, from row ``first`` on.

    Other pulses are counted in ``buffers.made``. An axis seldom turns, so in most blocks of rows no
    times have to be compared.

    Returns:
        The number of rows left.
    """
    step, recent, made = buffers.moves.step, buffers.recent, buffers.made
    grazes = 0
    for i in range(len(recent)):
        for begin in range(first, rows, BLOCK):
            end = min(begin + BLOCK, rows)
            ups, downs = 0, 0
            for row in range(begin, end):
                ups += step[row, i] > 0
                downs += step[row, i] < 0
            made[i] += ups + downs
            before = step[recent[i], i] if recent[i] >= 0 else 0
            if (ups > 0 or before > 0) and (downs > 0 or before < 0):
                found = _remove_grazes(i, begin, end, buffers, min_pulse_ns)
                made[i] -= 2 * found
                grazes += found
            elif ups + downs > 0:
                back = end - 1
                while step[back, i] == 0:
                    back -= 1
                recent[i] = back
    return _without_empty_rows(rows, buffers) if grazes > 0 else rows


@njit
def _remove_grazes(i: int, first: int, end: int, buffers: Buffers, min_pulse_ns: float) -> int:
    """Remove such pulses of axis i from the rows ``first`` to before ``end``.

    Returns:
        The number of pairs of pulses that were removed.
    """
    step, time_ns, recent = buffers.moves.step, buffers.time_ns, buffers.recent
    found = 0
    for row in range(first, end):
        if step[row, i] != 0:
            back = recent[i]
            if (
                back >= 0
                and step[back, i] != step[row, i]
                and time_ns[row] - time_ns[back] < min_pulse_ns
            ):
                step[back, i] = 0
                step[row, i] = 0
                recent[i] = -1
                found += 1
            else:
                recent[i] = row
    return found


@njit
def _without_empty_rows(rows: int, buffers: Buffers) -> int:
    """Remove rows without a step; return the number of rows left."""
    moves, time_ns, line, recent, _ = buffers
    step = moves.step
    n = len(recent)
    kept = 0
    for row in range(rows):
        steps = False
        for i in range(n):
            steps = steps or step[row, i] != 0
        if steps:
            time_ns[kept] = time_ns[row]
            line[kept] = line[row]
            for i in range(n):
                step[kept, i] = step[row, i]
                if recent[i] == row:
                    recent[i] = kept
            kept += 1
    return kept


@njit
def spaced(rows: int, released_ns: int, buffers: Buffers, min_ns: float) -> int:
    """Keep rows ``min_ns`` apart, and the first as far from ``released_ns``.

    Rows that were spaced before stay as they are.

    Returns:
        The number of rows left.
    """
    moves, time_ns, line, recent, _ = buffers
    step = moves.step
    n = len(recent)
    least = int(min_ns)
    kept = 0
    earliest = released_ns + least
    # Up to the first row that is too close to the one before it, nothing moves.
    while kept < rows and time_ns[kept] >= earliest:
        earliest = time_ns[kept] + least
        kept += 1
    for row in range(kept, rows):
        earliest = (time_ns[kept - 1] if kept > 0 else released_ns) + least
        joins = kept > 0 and time_ns[row] < earliest
        if joins:
            for i in range(n):
                joins = joins and (step[row, i] == 0 or step[kept - 1, i] == 0)
        if joins:
            kept -= 1
            for i in range(n):
                step[kept, i] += step[row, i]
                step[row, i] = step[kept, i]
        time = max(time_ns[row], time_ns[kept] if joins else earliest)
        if kept < row or time != time_ns[row]:
            time_ns[kept] = time
            line[kept] = line[row]
            for i in range(n):
                step[kept, i] = step[row, i]
                if recent[i] == row:
                    recent[i] = kept
        kept += 1
    return kept
