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


class Buffers(NamedTuple):
    """Buffers of grid moves with their times.

    Attributes:
        moves: the moves.
        time_ns: (rows,) int64: time of each, ns.
        line: (rows,) int32: source line of each.
        recent: (n,) int64: row of the last pulse of each axis; -1 where it has left the buffers.
    """

    moves: Moves
    time_ns: Ints
    line: Lines
    recent: Ints


@njit
def without_grazes(first: int, rows: int, buffers: Buffers, min_pulse_ns: float) -> int:
    """Remove pulses that an axis takes back within ``min_pulse_ns``, from row ``first`` on.

    Returns:
        The number of rows left.
    """
    moves, time_ns, _, recent = buffers
    step = moves.step
    n = len(recent)
    grazed = False
    for row in range(first, rows):
        for i in range(n):
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
                    grazed = True
                else:
                    recent[i] = row
    return _without_empty_rows(rows, buffers) if grazed else rows


@njit
def _without_empty_rows(rows: int, buffers: Buffers) -> int:
    """Remove rows without a step; return the number of rows left."""
    moves, time_ns, line, recent = buffers
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
    moves, time_ns, line, recent = buffers
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
