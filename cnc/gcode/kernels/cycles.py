"""Lines with canned cycles for holes (G73, G81 to G83, G85, G89) as rows.

The rules of the cycles are in :mod:`cnc.gcode.kernels.cycles`. The other cycles turn or stop the
spindle; they and wrong lines are left to the interpreter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.compiled.jit import njit
from cnc.gcode.kernels.rows import (
    DEPTH,
    LAST_MOTION,
    MOST_ROWS,
    PATH,
    PAUSE,
    PECK,
    RETRACT,
    STRAIGHT,
    UNCLEAR_LEVEL,
    WAIT,
    Bytes,
    Floats,
    LineWords,
    Record,
    Rows,
    Setup,
)
from cnc.gcode.kernels.rules import DWELL_OK, dwell_of

# Canned cycles for holes (G73, G74, G76, G81 to G89): their rules, from numbers to steps.
#
# Compiled code and the interpreter call these functions, in mm of the coordinate system in use. A
# point has the plane's two axes and the height along the axis across it.
#
#     height                  G98: clear is the level before the cycles (if above R)
#       clear  ──────┬─────┬──    G99: clear is R
#                    ┊     ┊      ┊ traverse
#       R      ──────┊─────┊──    │ feed
#                    │     ┊
#       bottom ──────┴─────┘
#
# Sources: LinuxCNC 2.9, "G-codes", G80-G89 canned cycles; FANUC Series 0i operator's manual,
# "canned cycle for drilling".

PECKING = (73, 83)
"""Cycles with pecks (Q)."""
TAPPING = (74, 84)
DWELLING = (74, 82, 84, 86, 88, 89)
"""Cycles with a dwell at the bottom (P) on every control."""
FINE_BORING = 76

SPINDLE_OFF, SPINDLE_BACK, SPINDLE_AGAIN = 16, 17, 18
"""Kinds of steps, beside STRAIGHT and PAUSE of rows: the spindle stops, turns the other way, or
turns as before the cycle.
"""
ORIENT, OPERATOR_STOP, OVERRIDES_OFF, OVERRIDES_ON = 19, 20, 21, 22

ROUNDING = 1e-9
"""Part of a peck or of a pass that is rounding, and does not add one."""
MOST_STEPS = 16
"""Most steps of a hole without those of its pecks, which have three each."""

NEW, BEGUN_AGAIN, GOES_ON = 0, 1, 2
"""Kinds of a series at a line: new, with the old level but new words, or with the old words."""

Point = tuple[float, float, float]


class Hole(NamedTuple):
    """A hole: its place in the plane and its heights, mm.

    The cycle ends at ``clear``, which is ``retract`` (R) or above.
    """

    first: float
    second: float
    bottom: float
    retract: float
    clear: float


class HoleSettings(NamedTuple):
    """Settings of the holes of a line.

    Attributes:
        feed: mm/s.
        dwell: s at the bottom.
        peck: mm of a peck (Q), or of the first one (I of Haas).
        less: mm by which each peck is smaller than the one before (J of Haas).
        least: mm of the smallest peck (K of Haas).
        clearance: mm of the retract of G73, and of the distance at which G83 ends its return.
        shift: mm away from the wall along the plane's first axis before G76 retracts.
        out_to_retract: Whether the feed move out in G74, G84 and G89 ends at R. A traverse does the
            rest. If not, it ends at the clear height.
        dwells_twice: Whether a tap dwells before each reversal of the spindle, and not once after
            the first.
    """

    feed: float
    dwell: float = 0.0
    peck: float = 0.0
    less: float = 0.0
    least: float = 0.0
    clearance: float = 0.0
    shift: float = 0.0
    out_to_retract: bool = False
    dwells_twice: bool = False


class Steps(NamedTuple):
    """Steps of cycles.

    Attributes:
        kinds: (m,) kinds.
        numbers: (m, 4 or more). Of a move: its end (mm), and mm/s or NaN for a traverse. Of a
            dwell: s.
    """

    kinds: Bytes
    numbers: Floats


@njit
def series_at(after_cycle: bool, same_plane: bool, same_cycle: bool, all_cycles: bool) -> int:
    """Return the kind of the series at a line with a cycle.

    Args:
        after_cycle: Whether a cycle was in effect before the line.
        same_plane: Whether the plane is that of the series.
        same_cycle: Whether the cycle is that of the series.
        all_cycles: Whether the words of a cycle stay in effect for another cycle.
    """
    if not after_cycle or not same_plane:
        return NEW
    return GOES_ON if same_cycle or all_cycles else BEGUN_AGAIN


@njit
def heights_of(
    retract: float, depth: float, level: float, retract_absolute: bool, depth_absolute: bool,
    to_level: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the heights of R, of the bottom, and of the end of the cycle, mm.

    Args:
        retract: The R word, mm.
        depth: The word of the axis across the plane, mm.
        level: Height at the start of the series, mm.
        retract_absolute: Whether R is a height; if not, it counts from the level.
        depth_absolute: Whether the depth is a height; if not, it counts from R.
        to_level: Whether the cycle ends at the level, if that is above R (G98).
    """
    top = retract + (0.0 if retract_absolute else level)
    bottom = depth + (0.0 if depth_absolute else top)
    return top, bottom, level if to_level and level >= top else top


@njit
def coordinate_of_hole(number: int, start: float, word: float, absolute: bool) -> float:
    """Return a coordinate of a hole, mm.

    Args:
        number: 1 for the first hole of the line.
        start: Coordinate at the start of the line, mm.
        word: The axis word, mm; NaN for none. Under G91 it is the step between holes.
        absolute: G90.
    """
    if word != word:
        return start
    return word if absolute else start + number * word


@njit
def machine_coordinate(value: float, start: float, position: float, zero: float) -> float:
    """Return the machine coordinate of a step, mm.

    An axis that does not leave its ``start`` keeps the exact ``position``.
    """
    return position if value == start else value + zero


@njit
def peck_count(top: float, bottom: float, peck: float) -> int:
    """Return the number of pecks of ``peck`` mm from ``top`` to ``bottom``."""
    return max(1, math.ceil((top - bottom) / peck - ROUNDING))


@njit
def most_steps(cycle: int, hole: Hole, how: HoleSettings) -> int:
    """Return a number of steps that a hole does not exceed."""
    if cycle not in PECKING:
        return MOST_STEPS
    smallest = how.least if how.less > 0.0 else how.peck
    return MOST_STEPS + 3 * (1 + math.ceil((hole.retract - hole.bottom) / smallest))


@njit
def _move(row: int, here: Point, to: Point, feed: float, steps: Steps) -> int:
    """Add a move, if it has a length; return the number of steps."""
    if to[0] == here[0] and to[1] == here[1] and to[2] == here[2]:
        return row
    numbers = steps.numbers
    numbers[row, 0], numbers[row, 1], numbers[row, 2], numbers[row, 3] = to[0], to[1], to[2], feed
    steps.kinds[row] = STRAIGHT
    return row + 1


@njit
def _event(row: int, kind: int, steps: Steps) -> int:
    """Add a step that is no move and no dwell."""
    steps.kinds[row] = kind
    return row + 1


@njit
def _pause(row: int, seconds: float, steps: Steps) -> int:
    """Add a dwell, if it takes time."""
    if not seconds > 0.0:
        return row
    steps.kinds[row], steps.numbers[row, 0] = PAUSE, seconds
    return row + 1


@njit
def _pecks(row: int, cycle: int, hole: Hole, how: HoleSettings, steps: Steps) -> int:
    """Add the pecks of G73 or G83. G83 retracts to R after each; both end at the bottom."""
    x, y, top, bottom = hole.first, hole.second, hole.retract, hole.bottom
    here, number, peck = (x, y, top), 1, how.peck
    shrinks = how.less > 0.0
    count = 0 if shrinks else peck_count(top, bottom, peck)
    depth = top
    while True:
        depth = depth - peck if shrinks else top - number * peck
        last = depth <= bottom + ROUNDING * how.least if shrinks else number == count
        if last:
            depth = bottom
        row = _move(row, here, (x, y, depth), how.feed, steps)
        here = (x, y, depth)
        if depth > bottom:
            if cycle == 83:
                row = _move(row, here, (x, y, top), math.nan, steps)
                here = (x, y, top)
            # A peck shorter than the clearance must not end above R.
            height = depth + how.clearance
            to = (x, y, top if top < height else height)
            row = _move(row, here, to, math.nan, steps)
            here = to
        if last:
            return row
        number += 1
        if shrinks:
            peck = max(how.least, peck - how.less)


@njit
def add_hole(row: int, cycle: int, here: Point, hole: Hole, how: HoleSettings, steps: Steps) -> int:
    """Add the steps of a hole.

    Below R the tool first rises to R. It then moves across at its height, down to R, and makes the
    hole.

    Args:
        row: Number of the steps before.
        cycle: Number of the cycle: 81 for G81.
        here: The point before.
        hole: The hole.
        how: Its settings.
        steps: Takes the steps.

    Returns:
        The number of steps. The tool is then above the hole at its clear height.
    """
    x, y = hole.first, hole.second
    bottom, top, clear = (x, y, hole.bottom), (x, y, hole.retract), (x, y, hole.clear)
    if here[2] < hole.retract:
        to = (here[0], here[1], hole.retract)
        row = _move(row, here, to, math.nan, steps)
        here = to
    to = (x, y, here[2])
    row = _move(row, here, to, math.nan, steps)
    row = _move(row, to, top, math.nan, steps)
    if cycle in PECKING:
        row = _pecks(row, cycle, hole, how, steps)
        row = _pause(row, how.dwell, steps)
        return _move(row, bottom, clear, math.nan, steps)
    taps = cycle in TAPPING
    if taps:
        row = _event(row, OVERRIDES_OFF, steps)
    row = _move(row, top, bottom, how.feed, steps)
    if cycle != 85 and (not taps or how.dwells_twice):
        row = _pause(row, how.dwell, steps)
    if cycle in (74, 76, 84, 86, 88):
        row = _event(row, SPINDLE_OFF, steps)
    here = bottom
    if taps:
        row = _event(row, SPINDLE_BACK, steps)
        if not how.dwells_twice:
            row = _pause(row, how.dwell, steps)
    elif cycle == 88:
        row = _event(row, OPERATOR_STOP, steps)
    elif cycle == FINE_BORING:
        row = _event(row, ORIENT, steps)
        aside, above = (x + how.shift, y, hole.bottom), (x + how.shift, y, hole.clear)
        row = _move(row, here, aside, math.nan, steps)
        row = _move(row, aside, above, math.nan, steps)
        here = above
    if cycle in (74, 84, 85, 89):
        out = top if cycle == 85 or how.out_to_retract else clear
        row = _move(row, here, out, how.feed, steps)
        here = out
    if taps:
        if how.dwells_twice:
            row = _pause(row, how.dwell, steps)
        row = _event(row, SPINDLE_OFF, steps)
        row = _event(row, SPINDLE_AGAIN, steps)
        row = _event(row, OVERRIDES_ON, steps)
    row = _move(row, here, clear, math.nan, steps)
    if cycle in (76, 86, 88):
        row = _event(row, SPINDLE_AGAIN, steps)
    return row


_A = 65


class _Series(NamedTuple):
    """Whether a line continues a series, and its words stay; depth, R, P, Q of the line."""

    goes_on: bool
    stay: bool
    given: tuple[float, float, float, float]


@njit
def _place(
    begin: int, end: int, columns: tuple[int, int, int], start: Point, line: int, setup: Setup,
    position: Floats, rows: Rows,
) -> None:  # fmt: skip
    """Give the rows of steps their lines, and those of moves their machine positions."""
    zero = setup["zero"]
    for row in range(begin, end):
        rows.lines[row] = line
        if rows.kinds[row] == STRAIGHT:
            point, data = rows.points[row], rows.data[row]
            for i in range(len(position)):
                point[i] = position[i]
            for axis in range(3):
                i = columns[axis]
                point[i] = machine_coordinate(data[axis], start[axis], position[i], zero[i])
            rows.feeds[row] = data[3]


@njit
def _keep_series(
    words: LineWords, series: _Series, line: int, now: Record, position: Floats
) -> None:
    """Bring the series up to date: its start and its words."""
    now["cycle"], now["cycle_plane"] = words.mode, words.plane
    now["cycle_distance"] = 1 + words.absolute
    if not series.goes_on:
        for i in range(len(position)):
            now["start"][i] = position[i]
    for place in range(len(series.given)):
        if series.given[place] == series.given[place]:
            now["words"][place], now["word_lines"][place] = series.given[place], line
        elif not series.stay:
            now["words"][place] = math.nan


@njit
def _series(
    words: LineWords, depth: float, columns: tuple[int, int, int], setup: Setup, now: Record,
    position: Floats,
) -> tuple[bool, Hole, HoleSettings, _Series]:  # fmt: skip
    """Return the hole of a line from its words and those of the series; False for none.

    The place of the hole is not known yet.

    Args:
        words: The words of the line.
        depth: Its word of the axis across the plane, NaN for none.
        columns: Columns of the axes of the plane and of the axis across it.
        setup: Settings.
        now: Modal state before the line.
        position: (n,) the position.
    """
    cycle, k = words.mode, columns[2]
    pecks, waits = cycle in PECKING, cycle in DWELLING
    before, absolute = int(now["cycle"]), words.absolute != 0
    kind = series_at(
        int(now["mode"]) > LAST_MOTION and before > 0, int(now["cycle_plane"]) == words.plane,
        before == cycle, bool(setup["words_stay"]),
    )  # fmt: skip
    goes_on, stay = kind != NEW, kind == GOES_ON
    given = (depth, words.radius, words.time, words.peck)
    old = now["words"]
    depth = given[0] if given[0] == given[0] or not stay else old[DEPTH]
    retract = given[1] if given[1] == given[1] or not stay else old[RETRACT]
    time = given[2] if given[2] == given[2] or not stay else old[WAIT]
    peck = (given[3] if given[3] == given[3] or not stay else old[PECK]) * setup["unit"]
    dwell, status = dwell_of(time, setup["cycle_dwell"]) if waits else (0.0, DWELL_OK)
    known = (words.peck != words.peck or pecks) and (words.time != words.time or waits)
    if waits and time != time and not setup["dwell_needed"]:
        dwell, status = 0.0, DWELL_OK
    known = known and status == DWELL_OK
    level = (now["start"][k] if goes_on else position[k]) - setup["zero"][k]
    top, bottom, clear = heights_of(
        retract * setup["scale"][k], depth * setup["scale"][k], level, absolute, absolute,
        words.initial != 0,
    )  # fmt: skip
    # A P in effect is a dwell of pecks in one dialect, and none in another.
    known = known and bottom <= top and (not pecks or (peck > 0.0 and time != time))
    known = known and (words.initial != UNCLEAR_LEVEL or clear == top)
    # Heights of a line before count as that line says, in a way that depends on the dialect.
    keeps = stay and (given[0] != given[0] or given[1] != given[1])
    known = known and (not keeps or int(now["cycle_distance"]) == 1 + words.absolute)
    hole = Hole(math.nan, math.nan, bottom, top, clear)
    clearance, to_retract = float(setup["clearance"]), bool(setup["out_to_retract"])
    how = HoleSettings(
        words.linear, dwell, peck if pecks else 0.0, 0.0, 0.0, clearance, 0.0, to_retract, False
    )
    return bool(known), hole, how, _Series(goes_on, stay, given)


@njit
def _repeats(words: LineWords, setup: Setup) -> int:
    """Return the number of repeats; 0 if the line is left to the interpreter."""
    i, j, k = words.center
    if i == i or j == j or (k == k and (not setup["repeats_k"] or words.repeats == words.repeats)):
        return 0
    number = k if k == k else words.repeats
    if number != number:
        return 1
    return int(number) if 1.0 <= number <= MOST_ROWS and number == math.floor(number) else 0


@njit
def add_cycle(
    words: LineWords, letters: Bytes, numbers: Floats, line: int, row: int, setup: Setup,
    now: Record, position: Floats, rows: Rows,
) -> int:  # fmt: skip
    """Execute a line with a cycle: add its rows, and bring position and series up to date.

    Args:
        words: The words of the line.
        letters: Codes of the letters of its words.
        numbers: Numbers of its words.
        line: Number of the line.
        row: Number of rows before.
        setup: Settings.
        now: Modal state before the line.
        position: (n,) the position.
        rows: Takes the rows.

    Returns:
        The number of rows; -1 if the line is left to the interpreter, and nothing was done.
    """
    zero, scale, planes = setup["zero"], setup["scale"], setup["planes"]
    plane, repeats = words.plane, _repeats(words, setup)
    i, j, k = int(planes[plane, 0]), int(planes[plane, 1]), int(planes[plane, 2])
    if i < 0 or j < 0 or k < 0 or repeats == 0 or words.linear != words.linear:
        return -1
    x = y = depth = math.nan
    for w in range(len(letters)):
        column = setup["column"][int(letters[w]) - _A]
        if column == i:
            x = numbers[w] * scale[i]
        elif column == j:
            y = numbers[w] * scale[j]
        elif column == k:
            depth = numbers[w]
        elif column >= 0:
            return -1
    known, hole, how, series = _series(words, depth, (i, j, k), setup, now, position)
    if not known or (how.peck > 0.0 and (hole.retract - hole.bottom) / how.peck > MOST_ROWS):
        return -1
    start = (position[i] - zero[i], position[j] - zero[j], position[k] - zero[k])
    absolute = words.absolute != 0
    # The last row restores G64.
    most = int(now["rows"]) + MOST_ROWS - 1 - most_steps(words.mode, hole, how)
    if setup["blends"]:
        rows.kinds[row], rows.lines[row], rows.data[row, 0] = PATH, line, 0.0
        row += 1
    here, begin, steps = start, row, Steps(rows.kinds, rows.data)
    for number in range(1, repeats + 1):
        if row > most:
            return -1
        first = coordinate_of_hole(number, start[0], x, absolute)
        second = coordinate_of_hole(number, start[1], y, absolute)
        hole = Hole(first, second, hole.bottom, hole.retract, hole.clear)
        row = add_hole(row, words.mode, here, hole, how, steps)
        here = (first, second, hole.clear)
    _place(begin, row, (i, j, k), start, line, setup, position, rows)
    if setup["blends"]:
        rows.kinds[row], rows.lines[row], rows.data[row, 0] = PATH, line, 1.0
        row += 1
    _keep_series(words, series, line, now, position)
    position[i] = machine_coordinate(here[0], start[0], position[i], zero[i])
    position[j] = machine_coordinate(here[1], start[1], position[j], zero[j])
    position[k] = machine_coordinate(here[2], start[2], position[k], zero[k])
    return row
