"""Straight moves from words to points: the modal state of G0, G1 and F on arrays.

The arithmetic is that of a line executed on its own (:mod:`cnc.gcode.codes.motion`), operation by
operation, so that the numbers are the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.scanner import Words
from cnc.kernels.jit import njit

Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

TRAVERSE, FEED, NO_MOTION = 0, 1, -1
"""Motion modes; NO_MOTION is any but the others."""
NO_AXIS = -1

_A, _F, _G, _N = 65, 70, 71, 78


class Setup(NamedTuple):
    """The settings that hold for a run of lines; n is the number of axes.

    Attributes:
        column: (26,) the axis of each letter, or NO_AXIS.
        scale: (n,) mm or degrees a program unit.
        zero: (n,) machine position of the program's zero, mm or degrees.
        turns: (n,) 1 for a rotary axis, 0 for a linear one.
        absolute: 1 under G90, 0 under G91.
        feed_scale: mm a program unit.
        min_feed: Slowest feed, mm/s.
    """

    column: Ints
    scale: Floats
    zero: Floats
    turns: Floats
    absolute: int
    feed_scale: float
    min_feed: float


class State(NamedTuple):
    """The modal state before or after a run of lines.

    Attributes:
        mode: Motion mode.
        linear: Feed of linear axes, mm/s; NaN for none.
        rotary: Feed of rotary axes, degrees/s; NaN for none.
    """

    mode: int
    linear: float
    rotary: float


class Moves(NamedTuple):
    """Straight moves, n axes each.

    Attributes:
        points: (m, n) end positions, mm or degrees.
        feeds: (m,) mm/s or degrees/s, NaN for a traverse.
        lines: (m,) line numbers.
    """

    points: Floats
    feeds: Floats
    lines: Counts


@njit
def straight(
    first: Counts,
    words: Words,
    begin: int,
    end: int,
    number: int,
    setup: Setup,
    state: State,
    position: Floats,
    moves: Moves,
) -> tuple[int, int, State]:
    """Execute lines that hold only words of straight moves, each word once.

    Stops before the first line that needs the interpreter: an unknown axis, a move without a motion
    mode or a feed, a feed too slow.

    Args:
        first: Index of the first word of each line of a scan, and one entry more.
        words: The words of the scan.
        begin: Index of the first line.
        end: Index after the last line.
        number: Number of the first line in the program.
        setup: Settings that hold for all lines.
        state: Modal state before the first line.
        position: (n,) the position, brought up to date.
        moves: Filled with the moves.

    Returns:
        Number of lines executed, number of moves, and the state after them.
    """
    letter, value, column = words.letter, words.number, setup.column
    scale, zero, turns = setup.scale, setup.zero, setup.turns
    points, feeds, numbers = moves
    mode, linear, rotary = state
    count = 0
    # One function: calls for each line take a fifth of the time.
    for k in range(begin, end):
        code, line_linear, line_rotary = mode, linear, rotary
        moving = False
        for w in range(first[k], first[k + 1]):
            char = int(letter[w])
            if char == _G:
                code = int(value[w])
            elif char == _F:
                line_linear = value[w] * setup.feed_scale / 60.0
                line_rotary = value[w] / 60.0
                if line_rotary < setup.min_feed:
                    return k - begin, count, State(mode, linear, rotary)
            elif char != _N:
                moving = True
                if column[char - _A] == NO_AXIS:
                    return k - begin, count, State(mode, linear, rotary)
        if moving and (code == NO_MOTION or (code == FEED and np.isnan(line_linear))):
            return k - begin, count, State(mode, linear, rotary)
        mode, linear, rotary = code, line_linear, line_rotary
        if not moving:
            continue
        turned = False
        shifted = False
        for w in range(first[k], first[k + 1]):
            char = int(letter[w])
            if char in (_G, _F, _N):
                continue
            i = column[char - _A]
            target = value[w] * scale[i]
            target = target + zero[i] if setup.absolute else position[i] + target
            if target != position[i]:
                if turns[i] != 0.0:
                    turned = True
                else:
                    shifted = True
            position[i] = target
        for i in range(len(position)):
            points[count, i] = position[i]
        feeds[count] = np.nan if mode == TRAVERSE else rotary if turned and not shifted else linear
        numbers[count] = number + k - begin
        count += 1
    return end - begin, count, State(mode, linear, rotary)
