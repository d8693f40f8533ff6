"""Rules of words and flow: moves, centres of arcs, feeds, spindle, coolant, rounds of loops.

Compiled code and the interpreter call these functions with plain numbers. NaN stands for a missing
word and for a feed that is not known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_NUMBER = 1e9
"""Largest magnitude of a word's number: a thousand kilometres. A larger one is a mistake."""
NEAR_WHOLE = 1e-4
"""Tolerance of a computed number that must be whole. Source: LinuxCNC."""
LOCAL = 30
"""#1 to #30 belong to the call; FANUC's to #33."""
MIN_FEED = 1e-6
"""mm/s. A slower feed is a typing error: 1 mm would take more than eleven days."""
FEED_OK, FEED_NOT_POSITIVE, FEED_TOO_SLOW = range(3)
"""What is to say about an F word."""
LONG_DWELL = 100.0
"""s. A dwell from here on without a decimal point may be meant in milliseconds."""
MAX_DWELL = 1e6
"""s. A longer dwell is a typing error: this is more than eleven days."""
DWELL_OK, DWELL_LONG, DWELL_TOO_LONG, DWELL_NEGATIVE, DWELL_WITHOUT_UNIT = range(5)
"""What is to say about a dwell. The time of a negative one, and of none (NaN), is not known."""

SPINDLE_OFF, SPINDLE_CW, SPINDLE_CCW = 0, 1, 2

LEFT_OUT, JUMP, IF, WHILE, END_WHILE, DO, DO_WHILE, REPEAT, END_REPEAT = 0, 1, 2, 3, 4, 5, 6, 7, 8
RETURN = 9
"""Actions of control lines; LEFT_OUT leaves the line to the interpreter."""


@njit
def end_of_word(value: float, here: float, zero: float, absolute: bool) -> float:
    """Return the machine coordinate of an axis word.

    Args:
        value: The word, mm or degrees.
        here: Machine coordinate before.
        zero: Machine coordinate of the program's zero.
        absolute: G90.
    """
    return value + zero if absolute else here + value


@njit
def center_of_word(word: float, unit: float, here: float, zero: float, absolute: bool) -> float:
    """Return the machine coordinate of a centre of an arc.

    Args:
        word: I, J or K. A missing one is 0.
        unit: mm of a program unit.
        here: Machine coordinate of the start.
        zero: Machine coordinate of the program's zero.
        absolute: G90.1.
    """
    offset = (word if word == word else 0.0) * unit
    return offset + (zero if absolute else here)


@njit
def feeds_of_word(number: float, unit: float, per_turn: bool) -> tuple[float, float]:
    """Return the feeds of linear and of rotary axes that an F word gives.

    Args:
        number: The word.
        unit: mm of a unit of feeds.
        per_turn: G95: mm and degrees a turn, and not mm/s and degrees/s.
    """
    if per_turn:
        return number * unit, number
    return number * unit / 60.0, number / 60.0


@njit
def feed_status(number: float, rotary: float) -> int:
    """Return what is to say about an F word: its number, and the feed of rotary axes it gives."""
    if not number > 0.0:
        return FEED_NOT_POSITIVE
    return FEED_OK if rotary >= MIN_FEED else FEED_TOO_SLOW


@njit
def feed_of_move(linear: float, rotary: float, shifts: bool, turns: bool) -> float:
    """Return the feed of a move: that of rotary axes if only they move.

    Args:
        linear: Feed of linear axes.
        rotary: Feed of rotary axes.
        shifts: Whether a linear axis moves.
        turns: Whether a rotary axis moves.
    """
    return rotary if turns and not shifts else linear


@njit
def length_of_move(
    start: Floats | list[float], end: Floats | list[float], groups: Ints | list[int]
) -> float:
    """Return the length of a straight move for its feed, mm or degrees.

    It counts x y z if one of them moves, else u v w, else a b c.

    Args:
        start: (n,) the position.
        end: (n,) the end.
        groups: (n,) the group of each axis, 0 to 2 in this order.
    """
    for group in range(3):
        square = 0.0
        for i in range(len(start)):
            if groups[i] == group:
                square += (end[i] - start[i]) * (end[i] - start[i])
        if square > 0.0:
            return math.sqrt(square)
    return 0.0


@njit
def feed_of_time(number: float, length: float) -> float:
    """Return the feed, mm/s or degrees/s, of a move under G93.

    Args:
        number: The F word, one over the minutes of the move.
        length: Length of the move. For 0 it is that of a move of 1: such a move takes no time.
    """
    return number * (length if length > 0.0 else 1.0) / 60.0


@njit
def dwell_of(number: float, unit: float) -> tuple[float, int]:
    """Return the seconds of a dwell, and what is to say about it.

    Args:
        number: The word.
        unit: s of a unit; 0 for a word that has none.
    """
    seconds = number * unit
    if unit == 0.0:
        return seconds, DWELL_WITHOUT_UNIT
    if not number >= 0.0:
        return seconds, DWELL_NEGATIVE
    if seconds > MAX_DWELL:
        return seconds, DWELL_TOO_LONG
    return seconds, DWELL_LONG if seconds >= LONG_DWELL else DWELL_OK


@njit
def spindle_after(direction: int, m: int) -> int:
    """Return the direction of the spindle after M3, M4 or M5; ``m`` is -1 for none of them."""
    if m < 0:
        return direction
    return SPINDLE_CW if m == 3 else SPINDLE_CCW if m == 4 else SPINDLE_OFF


@njit
def rpm_of(direction: int, speed: float) -> float:
    """Return the speed of the spindle, whose S word is NaN if there was none."""
    return speed if direction != SPINDLE_OFF and speed == speed and speed != 0.0 else 0.0


@njit
def keeps_motion(before: int, after: int, m: int) -> bool:
    """Return whether a laser changes its power in motion: by S alone, or in its mode before."""
    return m < 0 or (after != SPINDLE_OFF and after == before)


@njit
def speed_waits(speed: float, direction: int, m: int) -> bool:
    """Return whether an S word has no effect before the next start of the spindle."""
    return speed == speed and speed != 0.0 and (m >= 0 or direction == SPINDLE_OFF)


@njit
def coolants_after(mist: bool, flood: bool, m: int) -> tuple[bool, bool]:
    """Return mist and flood after M7, M8 or M9."""
    return m == 7 or (mist and m == 8), m == 8 or (flood and m == 7)


@njit
def motion_after_cancel(resting: int, restored: int) -> int:
    """Return the motion after G80 (0 to 3), -1 for none.

    Args:
        resting: The last of G0 to G3 in effect, -1 for none.
        restored: The highest of G0 to G3 to which G80 returns, -1 for none.
    """
    return resting if 0 <= resting <= restored else -1


@njit
def asks_value(action: int) -> bool:
    """Return whether a control line evaluates a condition or a count."""
    return action != JUMP and action != DO and action != END_REPEAT


@njit
def line_after(
    action: int, value: float, rounds: float, line: int, target: int
) -> tuple[int, float]:
    """Return the line to continue at after a control line, and the rounds left of its loop.

    Args:
        action: What the line does.
        value: Its condition or count. A condition that is 0 or NaN does not hold.
        rounds: The rounds left of a loop that counts.
        line: The line.
        target: The line to which it leads: of JUMP, at the else of an IF, after a WHILE or REPEAT
            that is left, at the beginning of a loop that is repeated.
    """
    if action == JUMP:
        return target, rounds
    if action == DO:
        return line + 1, rounds
    if action == REPEAT:
        # The nearest whole number, halves to the even one.
        rounds = max(np.rint(value), 0.0)
    elif action == END_REPEAT:
        rounds -= 1
    counts = action == REPEAT or action == END_REPEAT
    holds = rounds >= 1 if counts else value == value and value != 0.0
    leads_back = action == END_WHILE or action == DO_WHILE or action == END_REPEAT
    return (target if holds == leads_back else line + 1), rounds


# Arcs in a plane: centre, radii and signed turns.
#
# Coordinates are the first and second axis of the plane in mm; counter-clockwise turns the first
# towards the second. Lengths are square roots of sums of squares, so that compiled and interpreted
# code give the same bits.

SAME_POINT = 1e-7
"""mm. An arc that ends this near to its start is a full circle: the distance is rounding."""
OK, NO_RADIUS, MISMATCH, NO_CHORD, TOO_SMALL = 0, 1, 2, 3, 4
"""Status of an arc: OK, or the reason why there is none."""


class Tolerance(NamedTuple):
    """Tolerances of arcs, mm: see :class:`cnc.gcode.dialects.ArcTolerance`."""

    slack: float
    relative: float
    limit: float
    reach: float


class Wanted(NamedTuple):
    """An arc as a program describes it, mm.

    Attributes:
        x0: First coordinate of the start; ``y0`` is the second.
        x1: First coordinate of the end; ``y1`` is the second.
        x: First coordinate of the centre; ``y`` is the second. NaN if the radius is given.
        radius: Radius if the centre is not given; a negative one means more than half a turn.
        clockwise: Direction.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    x: float
    y: float
    radius: float
    clockwise: bool


class Arc(NamedTuple):
    """Status, centre, radius at the start and at the end (mm), and signed turns."""

    status: int
    x: float
    y: float
    radius: float
    end_radius: float
    turns: float


@njit
def arc_of(wanted: Wanted, tolerance: Tolerance) -> Arc:
    """Return the arc of up to one turn. Its radii are those of the message if there is none."""
    # One function without calls: the line-by-line interpreter runs it uncompiled.
    x0, y0, x1, y1, x, y, radius, clockwise = wanted
    dx, dy = x1 - x0, y1 - y0
    chord = math.sqrt(dx * dx + dy * dy)
    given = x != x
    if given:
        half = chord / 2.0
        if radius == 0.0:
            return Arc(NO_RADIUS, x, y, radius, half, 0.0)
        if chord <= SAME_POINT:
            return Arc(NO_CHORD, x, y, radius, half, 0.0)
        if half > abs(radius) + tolerance.reach:
            return Arc(TOO_SMALL, x, y, abs(radius), chord, 0.0)
        # The centre is to the left of the chord for a counter-clockwise arc of less than half a
        # turn.
        offset = math.sqrt(max((abs(radius) - half) * (abs(radius) + half), 0.0))
        left = offset if clockwise == (radius < 0.0) else -offset
        x = (x0 + x1) / 2.0 - left * dy / chord
        y = (y0 + y1) / 2.0 + left * dx / chord
    ax, ay, bx, by = x0 - x, y0 - y, x1 - x, y1 - y
    start, end = math.sqrt(ax * ax + ay * ay), math.sqrt(bx * bx + by * by)
    if not given:
        if start == 0.0 or end == 0.0:
            return Arc(NO_RADIUS, x, y, start, end, 0.0)
        error = abs(start - end)
        if error > tolerance.limit or (
            error > tolerance.slack and error > tolerance.relative * max(start, end)
        ):
            return Arc(MISMATCH, x, y, start, end, 0.0)
    if chord <= SAME_POINT:
        return Arc(OK, x, y, start, end, -1.0 if clockwise else 1.0)
    # For short arcs the angle from cross and dot product is more accurate than a difference of two
    # angles.
    turns = math.atan2(ax * by - ay * bx, ax * bx + ay * by) / math.tau
    if clockwise and turns >= 0.0:
        turns -= 1.0
    elif not clockwise and turns <= 0.0:
        turns += 1.0
    return Arc(OK, x, y, start, end, turns)
