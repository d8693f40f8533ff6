"""Canned cycles for holes (G73, G81 to G83, G85, G89) as rows.

The rows are those of :mod:`cnc.gcode.cycles.drilling`, which explains the cycles. The other cycles
turn or stop the spindle; they and wrong lines are left to the interpreter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.kernels.gcode.line_words import LAST_MOTION, LineWords
from cnc.kernels.gcode.rows import (
    DEPTH,
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
    Record,
    Rows,
    Setup,
)
from cnc.kernels.jit import njit

_A = 65
_ROUNDING = 1e-9
"""As :data:`cnc.gcode.cycles.steps.ROUNDING`."""
_HOLE_ROWS = 8
"""Most rows of a hole besides its pecks, and of a peck."""

Spot = tuple[float, float, float]


class _Place(NamedTuple):
    """The plane of a line: columns of its axes and of the axis across it, and the start."""

    first: int
    second: int
    across: int
    start: Spot
    line: int


class _Hole(NamedTuple):
    """Heights of a hole, its peck (mm; inf for none), dwell (s) and feed (mm/s)."""

    bottom: float
    top: float
    clear: float
    peck: float
    dwell: float
    feed: float


class _Series(NamedTuple):
    """Whether a line continues a series, and its words stay; depth, R, P, Q of the line."""

    goes_on: bool
    stay: bool
    given: tuple[float, float, float, float]


@njit
def _move_to(
    row: int, here: Spot, to: Spot, feed: float, at: _Place, setup: Setup, position: Floats,
    rows: Rows,
) -> int:  # fmt: skip
    """Add a straight move in the plane, if it has a length; return the number of rows."""
    if to[0] == here[0] and to[1] == here[1] and to[2] == here[2]:
        return row
    point = rows.points[row]
    for i in range(len(position)):
        point[i] = position[i]
    # An axis that does not leave the start of the line keeps its exact value.
    if to[0] != at.start[0]:
        point[at.first] = to[0] + setup["zero"][at.first]
    if to[1] != at.start[1]:
        point[at.second] = to[1] + setup["zero"][at.second]
    if to[2] != at.start[2]:
        point[at.across] = to[2] + setup["zero"][at.across]
    rows.kinds[row], rows.lines[row], rows.feeds[row] = STRAIGHT, at.line, feed
    return row + 1


@njit
def _add_hole(
    row: int, cycle: int, x: float, y: float, hole: _Hole, at: _Place, setup: Setup,
    position: Floats, rows: Rows,
) -> int:  # fmt: skip
    """Add the moves of a hole from R on; return the number of rows."""
    bottom, top = (x, y, hole.bottom), (x, y, hole.top)
    here = top
    if cycle == 73 or cycle == 83:
        clearance = setup["clearance"]
        count = max(1, math.ceil((hole.top - hole.bottom) / hole.peck - _ROUNDING))
        for number in range(1, count + 1):
            depth = hole.top - number * hole.peck if number < count else hole.bottom
            to = (x, y, depth)
            row = _move_to(row, here, to, hole.feed, at, setup, position, rows)
            here = to
            if depth > hole.bottom:
                if cycle == 83:
                    row = _move_to(row, here, top, math.nan, at, setup, position, rows)
                    here = top
                height = depth + clearance
                to = (x, y, hole.top if hole.top < height else height)
                row = _move_to(row, here, to, math.nan, at, setup, position, rows)
                here = to
    else:
        row = _move_to(row, here, bottom, hole.feed, at, setup, position, rows)
        here = bottom
        if (cycle == 82 or cycle == 89) and hole.dwell > 0.0:
            rows.kinds[row], rows.lines[row], rows.data[row, 0] = PAUSE, at.line, hole.dwell
            row += 1
        if cycle == 85 or cycle == 89:
            to = top
            if cycle == 89 and not setup["out_to_retract"]:
                to = (x, y, hole.clear)
            row = _move_to(row, here, to, hole.feed, at, setup, position, rows)
            here = to
    return _move_to(row, here, (x, y, hole.clear), math.nan, at, setup, position, rows)


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
) -> tuple[bool, _Hole, _Series]:  # fmt: skip
    """Return the hole of a line from its words and those of the series; False for none.

    Args:
        words: The words of the line.
        depth: Its word of the axis across the plane, NaN for none.
        columns: Columns of the axes of the plane and of the axis across it.
        setup: Settings.
        now: Modal state before the line.
        position: (n,) the position.
    """
    cycle, k = words.mode, columns[2]
    pecks, waits = cycle == 73 or cycle == 83, cycle == 82 or cycle == 89
    before, plane = int(now["cycle"]), int(now["cycle_plane"])
    goes_on = int(now["mode"]) > LAST_MOTION and before > 0 and plane == words.plane
    stay = goes_on and (before == cycle or setup["words_stay"])
    given = (depth, words.radius, words.time, words.peck)
    old = now["words"]
    depth = given[0] if given[0] == given[0] or not stay else old[DEPTH]
    retract = given[1] if given[1] == given[1] or not stay else old[RETRACT]
    time = given[2] if given[2] == given[2] or not stay else old[WAIT]
    peck = (given[3] if given[3] == given[3] or not stay else old[PECK]) * setup["unit"]
    dwell = time * setup["cycle_dwell"] if waits else 0.0
    known = (words.peck != words.peck or pecks) and (words.time != words.time or waits)
    if waits and time != time and not setup["dwell_needed"]:
        dwell = 0.0
    elif waits:
        # Not for NaN, too.
        known = known and 0.0 <= dwell < setup["longest_dwell"] and setup["cycle_dwell"] != 0.0
    level = (now["start"][k] if goes_on else position[k]) - setup["zero"][k]
    top = retract * setup["scale"][k] + (0.0 if words.absolute else level)
    bottom = depth * setup["scale"][k] + (0.0 if words.absolute else top)
    clear = top if words.initial == 0 or top > level else level
    # A P in effect is a dwell of pecks in one dialect, and none in another.
    known = known and bottom <= top and (not pecks or (peck > 0.0 and time != time))
    known = known and (words.initial != UNCLEAR_LEVEL or clear == top)
    # Heights of a line before count as that line says, in a way that depends on the dialect.
    keeps = stay and (given[0] != given[0] or given[1] != given[1])
    known = known and (not keeps or int(now["cycle_distance"]) == 1 + words.absolute)
    hole = _Hole(bottom, top, clear, peck if pecks else math.inf, dwell, words.linear)
    return bool(known), hole, _Series(bool(goes_on), bool(stay), given)


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
    known, hole, series = _series(words, depth, (i, j, k), setup, now, position)
    if not known:
        return -1
    pecks = (hole.top - hole.bottom) / hole.peck
    if pecks > MOST_ROWS:
        return -1
    start = (position[i] - zero[i], position[j] - zero[j], position[k] - zero[k])
    at = _Place(i, j, k, start, line)
    most = int(now["rows"]) + MOST_ROWS - _HOLE_ROWS - 3 * math.ceil(pecks)
    if setup["blends"]:
        rows.kinds[row], rows.lines[row], rows.data[row, 0] = PATH, line, 0.0
        row += 1
    here, top = start, hole.top
    for number in range(1, repeats + 1):
        if row > most:
            return -1
        if words.absolute:
            x1 = x if x == x else here[0]
            y1 = y if y == y else here[1]
        else:
            x1 = start[0] + number * (x if x == x and x != 0.0 else 0.0)
            y1 = start[1] + number * (y if y == y and y != 0.0 else 0.0)
        if here[2] < top:
            to = (here[0], here[1], top)
            row = _move_to(row, here, to, math.nan, at, setup, position, rows)
            here = to
        to = (x1, y1, here[2])
        row = _move_to(row, here, to, math.nan, at, setup, position, rows)
        row = _move_to(row, to, (x1, y1, top), math.nan, at, setup, position, rows)
        row = _add_hole(row, words.mode, x1, y1, hole, at, setup, position, rows)
        here = (x1, y1, hole.clear)
    if setup["blends"]:
        rows.kinds[row], rows.lines[row], rows.data[row, 0] = PATH, line, 1.0
        row += 1
    _keep_series(words, series, line, now, position)
    if here[0] != start[0]:
        position[i] = here[0] + zero[i]
    if here[1] != start[1]:
        position[j] = here[1] + zero[j]
    if here[2] != start[2]:
        position[k] = here[2] + zero[k]
    return row
