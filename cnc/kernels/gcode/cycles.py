"""Lines with canned cycles for holes (G73, G81 to G83, G85, G89) as rows.

The rules of the cycles are in :mod:`cnc.kernels.gcode.holes`. The other cycles turn or stop the
spindle; they and wrong lines are left to the interpreter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.kernels.gcode.holes import (
    DWELLING,
    GOES_ON,
    NEW,
    PECKING,
    Hole,
    HoleSettings,
    Point,
    Steps,
    add_hole,
    coordinate_of_hole,
    heights_of,
    machine_coordinate,
    most_steps,
    series_at,
)
from cnc.kernels.gcode.line_words import LAST_MOTION, LineWords
from cnc.kernels.gcode.rows import (
    DEPTH,
    MOST_ROWS,
    PATH,
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
from cnc.kernels.gcode.rules import DWELL_OK, dwell_of
from cnc.kernels.jit import njit

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
