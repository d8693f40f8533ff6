"""Straight moves from words to points: the modal state of G0, G1 and F on arrays.

The arithmetic is that of a line executed on its own (:mod:`cnc.gcode.codes.motion`), operation by
operation, so that the numbers are the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

TRAVERSE, FEED, NO_MOTION = 0, 1, -1
"""Motion modes; NO_MOTION is any but the others."""
NO_AXIS = -1
LINEAR, ROTARY = 0, 1
"""Entries of ``feed``."""
SCALE, ZERO, TURNS = 0, 1, 2
"""Rows of ``axes``."""

_A, _F, _G, _N = 65, 70, 71, 78


@njit
def straight(
    line: int, first: Counts, letter: Bytes, number: Floats, begin: int, end: int, column: Ints, axes: Floats, absolute: int,
    feed_scale: float, min_feed: float, mode: int, position: Floats, feed: Floats, points: Floats, feeds: Floats, lines: Counts,
) -> tuple[int, int, int]:  # fmt: skip
    """Execute the lines ``begin`` to ``end`` of a scan, all of which hold only words of straight
    moves, each once.

    ``line`` is the number of line ``begin``. column (26,): the axis of each letter or NO_AXIS. axes
    (3, n): mm or degrees a program unit, the position of the program's zero, 1 where the axis
    turns. ``feed_scale`` mm a program unit, ``min_feed`` mm/s. The state: ``mode``, position (n,),
    feed (2,) mm/s and deg/s, NaN for none; the arrays are brought up to date.

    Stops before the first line that needs a closer look: an axis that the machine has not, a move
    without a motion mode or a feed, a feed too slow. Returns the number of lines executed, of moves
    written to points, feeds (NaN for a traverse) and lines, and the mode.
    """
    n = len(position)
    moves = 0
    for k in range(begin, end):
        code = mode
        linear = feed[LINEAR]
        rotary = feed[ROTARY]
        moving = False
        for w in range(first[k], first[k + 1]):
            char = int(letter[w])
            if char == _G:
                code = int(number[w])
            elif char == _F:
                linear = number[w] * feed_scale / 60.0
                rotary = number[w] / 60.0
                if rotary < min_feed:
                    return k - begin, moves, mode
            elif char != _N:
                moving = True
                if column[char - _A] == NO_AXIS:
                    return k - begin, moves, mode
        if moving and (code == NO_MOTION or (code == FEED and np.isnan(linear))):
            return k - begin, moves, mode
        mode = code
        feed[LINEAR] = linear
        feed[ROTARY] = rotary
        if not moving:
            continue
        turned = False
        shifted = False
        for i in range(n):
            points[moves, i] = position[i]
        for w in range(first[k], first[k + 1]):
            char = int(letter[w])
            if char in (_G, _F, _N):
                continue
            i = column[char - _A]
            value = number[w] * axes[SCALE, i]
            value = value + axes[ZERO, i] if absolute else position[i] + value
            if value != position[i]:
                if axes[TURNS, i] != 0.0:
                    turned = True
                else:
                    shifted = True
            points[moves, i] = value
        for i in range(n):
            position[i] = points[moves, i]
        feeds[moves] = np.nan if code == TRAVERSE else rotary if turned and not shifted else linear
        lines[moves] = line + k - begin
        moves += 1
    return end - begin, moves, mode
