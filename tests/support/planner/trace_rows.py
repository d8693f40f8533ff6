"""Rows of a trace: the pieces that they may lie on, and the feed in force."""

from __future__ import annotations

import numpy as np

from cnc.machine.models import Machine

ALLOWED = 1e-3
"""Relative; a value may exceed its limit by this."""
SLICES_S, SLICES_LENGTH = 0.2, 0.02
"""s, mm; an operator's request may take effect this late. The length counts for slow motion."""
WINDOW = 4
"""A row may belong to so many more programmed pieces before and after its source line."""
Override = tuple[np.ndarray, np.ndarray]
"""Machine times from which on feeds are scaled, the first of them 0, and the factors."""
NEVER: Override = np.zeros(1), np.ones(1)


def feed_in_force(
    override: Override, t: np.ndarray, s: np.ndarray, used: np.ndarray, letting_go: float
) -> np.ndarray:
    """Return the factor of its feed that each step may use.

    A request takes effect at the end of the motion that the board has or is about to get: two
    slices. Then the acceleration may end within ``letting_go`` seconds. After that no step is
    faster than the fastest so far, until the feeds are as requested.
    """
    since, factors = override
    now = factors[np.searchsorted(since, t[1:], side="right") - 1]
    allowed = now.copy()
    for changed in np.flatnonzero(np.diff(now)) + 1:
        handed_out = max(
            t[changed + 1] + SLICES_S,
            t[min(int(np.searchsorted(s, s[changed + 1] + SLICES_LENGTH)), len(now))],
        )
        gone = min(int(np.searchsorted(t[1:], handed_out + letting_go)) + 1, len(now))
        before, peak = allowed[changed - 1], used[changed:gone].max()
        slowed = gone + int(
            np.append(np.flatnonzero(used[gone:] <= now[gone:] * (1.0 + ALLOWED)), len(now) - gone)[
                0
            ]
        )
        allowed[changed:gone] = np.maximum(now[changed:gone], before)
        allowed[gone:slowed] = np.maximum(now[gone:slowed], min(before, peak))
    return allowed


def time_to_let_go(machine: Machine) -> float:
    """Return twice the longest time in which an acceleration ends at full jerk, s."""
    limits = [(machine.path.max_tangential_acceleration, machine.path.max_jerk)]
    limits += [(axis.max_acceleration, axis.max_jerk) for axis in machine.axes.values()]
    return 2.0 * max(a / j for a, j in limits if a is not None and j is not None)


def pieces_of_rows(line: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last piece that each row may lie on.

    Pieces are in the order of the source lines of the rows. Where moves become one curve, the line
    of a row is that of any of them. So a row may lie between the pieces of the line before its own
    and those of the second line behind it, since a blend reaches into the next move, and WINDOW
    pieces more.
    """
    runs = np.append(0, np.flatnonzero(np.diff(line)) + 1)
    begins, ends = np.empty(len(runs), np.int64), np.empty(len(runs), np.int64)
    at = 0
    for k, run in enumerate(runs):
        ahead = np.flatnonzero(lines[at:] == line[run])
        at += int(ahead[0]) if len(ahead) else 0
        begins[k] = at
        while at + 1 < len(lines) and lines[at + 1] == line[run]:
            at += 1
        ends[k] = at
    first = np.maximum(np.append(0, begins[:-1]) - WINDOW, 0)
    last = np.minimum(np.concatenate((begins, [len(lines) - 1] * 2))[2:] + WINDOW, len(lines) - 1)
    which = np.repeat(np.arange(len(runs)), np.diff(np.append(runs, len(line))))
    return first[which], np.maximum(last, ends)[which]


def range_max(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the largest of values[low..high] for each pair."""
    best = values[low]
    for offset in range(1, int((high - low).max()) + 1):
        best = np.maximum(best, values[np.minimum(low + offset, high)])
    return best
