"""What is too fast for the board: pulses that are taken back at once, and rows nearer to each other
than it takes them.

A graze, an axis that turns back so soon behind a half-grid line that its two pulses would come
faster than the board takes them, is passed over: both pulses are taken out again. Grazes that rest
exactly on the line are common in real programs, and the slack of the generators deals with them;
those that reach a hair beyond it are rare in one move but sure to come in a million.

Rows of different axes may fall due at almost the same time. Where the board needs more time they
become one:

      x   |      |      |      |         at the time of the later: there the curve is within half a BLU of the grid point that both lead to.
      y     |       |      |    |        Two rows of the same axis only come so near where another axis takes the lead: its steps were
      row ^ ^    ^  ^      ^   ^         those of the other's rows, now they are its own. Then the second row waits.
                        one  one
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Ints

Steps = NDArray[np.int8]
Lines = NDArray[np.int32]


@njit
def without_grazes(
    first: int,
    rows: int,
    time_ns: Ints,
    step: Steps,
    line: Lines,
    recent: Ints,
    min_pulse_ns: float,
) -> int:
    """Take out, from row ``first`` on, pulses that an axis takes back too soon and those that take
    them back; returns the rows left.
    """
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
    return _close_ranks(rows, time_ns, step, line, recent) if grazed else rows


@njit
def _close_ranks(rows: int, time_ns: Ints, step: Steps, line: Lines, recent: Ints) -> int:
    """Take rows without a step out of the buffers; returns how many remain."""
    n = len(recent)
    kept = 0
    for row in range(rows):
        moves = False
        for i in range(n):
            moves = moves or step[row, i] != 0
        if moves:
            time_ns[kept] = time_ns[row]
            line[kept] = line[row]
            for i in range(n):
                step[kept, i] = step[row, i]
                if recent[i] == row:
                    recent[i] = kept
            kept += 1
    return kept


@njit
def spaced(
    rows: int,
    released_ns: int,
    time_ns: Ints,
    step: Steps,
    line: Lines,
    recent: Ints,
    min_ns: float,
) -> int:
    """Keep rows min_ns apart, the first one from ``released_ns``; returns how many remain. Those
    that waited stay as they are.
    """
    n = len(recent)
    kept = 0
    for row in range(rows):
        earliest = (time_ns[kept - 1] if kept > 0 else released_ns) + int(min_ns)
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
