"""One line of words: modal state, and rows of moves, arcs and events.

A line is executed wholly or not at all. It is left to the interpreter if it has a word or a code
that this module does not know, or if it is wrong. The arithmetic is that of the interpreter,
operation by operation, so that the bits of the results are equal.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.gcode.kernels.cycles import add_cycle
from cnc.gcode.kernels.rows import (
    ARC,
    COOLANT,
    LAST_MOTION,
    MOST_ROWS,
    PAUSE,
    SPINDLE,
    STRAIGHT,
    Bytes,
    Counts,
    Floats,
    LineWords,
    Record,
    Rows,
    Setup,
    fits,
    read_words,
)
from cnc.gcode.kernels.rules import (
    FEED_OK,
    OK,
    Tolerance,
    Wanted,
    arc_of,
    center_of_word,
    coolants_after,
    dwell_of,
    end_of_word,
    feed_of_move,
    feed_of_time,
    feed_status,
    keeps_motion,
    length_of_move,
    rpm_of,
    speed_waits,
    spindle_after,
)
from cnc.gcode.kernels.statements import Words

_A = 65
_SINGLE = 1e-5
"""Far above the rounding of single precision, relative."""


@njit
def _is_near_refusal(radius: float, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Return whether GRBL may refuse an arc: no axis word, or R (NaN for none) of half the chord.

    GRBL computes in single precision, as the interpreter does for such an arc.
    """
    if x0 == x1 and y0 == y1:
        return True
    room = 2.0 * abs(radius) - math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    return radius == radius and room < _SINGLE * (
        abs(radius) + abs(x0) + abs(y0) + abs(x1) + abs(y1)
    )


@njit
def _arc_row(
    setup: Setup,
    plane: int,
    clockwise: bool,
    center: tuple[float, float, float],
    radius: float,
    position: Floats,
    end: Floats,
    data: Floats,
) -> bool:
    """Fill the data of an arc from I, J, K and R (NaN for a missing word); False for no arc."""
    i, j = setup["planes"][plane, 0], setup["planes"][plane, 1]
    if i < 0 or j < 0:
        return False
    # I, J, K go with X, Y, Z; the axes of the planes are XY, ZX and YZ.
    first, second, across = center[0], center[1], center[2]
    if plane == 1:
        first, second, across = center[2], center[0], center[1]
    elif plane == 2:
        first, second, across = center[1], center[2], center[0]
    if across == across and not (setup["idle_center"] and across == 0.0):
        return False
    if setup["grbl_arcs"] and _is_near_refusal(
        radius * setup["unit"], position[i], position[j], end[i], end[j]
    ):
        return False
    x = y = math.nan
    has_first, has_second = first == first, second == second
    if radius == radius:
        if has_first or has_second:
            return False
    else:
        if not (has_first and has_second) and (
            setup["arc_absolute"] or not (has_first or has_second)
        ):
            return False
        unit, zero, absolute = setup["unit"], setup["zero"], setup["arc_absolute"]
        x = center_of_word(first, unit, position[i], zero[i], absolute)
        y = center_of_word(second, unit, position[j], zero[j], absolute)
    arc = arc_of(
        Wanted(position[i], position[j], end[i], end[j], x, y, radius * setup["unit"], clockwise),
        Tolerance(setup["slack"], setup["relative"], setup["limit"], setup["reach"]),
    )
    if arc.status != OK:
        return False
    data[0], data[1], data[2], data[3], data[4] = arc.x, arc.y, arc.radius, arc.turns, plane
    return True


@njit
def _add_events(words: LineWords, line: int, seconds: float, now: Record, rows: Rows) -> int:
    """Fill the rows of the events of a line, which stand before its move.

    Args:
        words: The words of the line.
        line: Its number.
        seconds: Time of its dwell.
        now: Modal state before the line.
        rows: Takes the rows.

    Returns:
        The number of rows with them. A block that would say what the last one said has none.
    """
    row = int(now["rows"])
    if words.turn >= 0 or (words.speed == words.speed and now["spindle"] > 0):
        before = int(now["spindle"])
        turn = spindle_after(before, words.turn)
        rpm = rpm_of(turn, words.speed if words.speed == words.speed else float(now["speed"]))
        if turn != now["turning"] or rpm != now["rpm"]:
            rows.data[row, 0], rows.data[row, 1] = turn, rpm
            rows.data[row, 2] = keeps_motion(before, turn, words.turn)
            rows.kinds[row], rows.lines[row] = SPINDLE, line
            row += 1
    if words.cool >= 0:
        mist, flood = coolants_after(now["mist"] != 0, now["flood"] != 0, words.cool)
        if mist != now["misting"] or flood != now["flooding"]:
            rows.data[row, 0], rows.data[row, 1] = mist, flood
            rows.kinds[row], rows.lines[row] = COOLANT, line
            row += 1
    if words.pausing:
        rows.kinds[row], rows.lines[row] = PAUSE, line
        rows.data[row, 0] = seconds
        row += 1
    return row


@njit
def _commit(words: LineWords, line: int, timed: bool, now: Record, is_feed: bool) -> None:
    """Put the modal state of a line into effect. ``timed``: its F is that of its move alone."""
    if words.feed == words.feed and not timed and now["feed_word"] != now["feed_word"]:
        now["feed_word"], now["feed_line"] = words.feed, line
    if is_feed:
        now["feed_word"] = math.nan
    if 0 <= words.mode <= LAST_MOTION:
        now["resting"] = words.mode
    now["mode"], now["plane"], now["absolute"] = words.mode, words.plane, words.absolute
    now["linear"], now["rotary"], now["initial"] = words.linear, words.rotary, words.initial
    if words.speed == words.speed:
        now["speed"] = words.speed
        waits = speed_waits(words.speed, int(now["spindle"]), words.turn)
        if waits and now["speed_word"] != now["speed_word"]:
            now["speed_word"], now["speed_line"] = words.speed, line
    if words.turn >= 0 or (words.speed == words.speed and now["spindle"] > 0):
        turn = spindle_after(int(now["spindle"]), words.turn)
        if words.turn >= 0 and turn > 0:
            now["speed_word"] = math.nan
        now["spindle"] = now["turning"] = turn
        now["rpm"] = rpm_of(turn, float(now["speed"]))
    if words.cool >= 0:
        mist, flood = coolants_after(now["mist"] != 0, now["flood"] != 0, words.cool)
        now["mist"], now["flood"] = mist, flood
        now["misting"], now["flooding"] = now["mist"], now["flood"]


@njit
def _end(
    letters: Bytes, numbers: Floats, absolute: int, setup: Setup, position: Floats, end: Floats
) -> tuple[bool, bool]:
    """Fill the end of a move from its words; return whether linear and rotary axes move."""
    turned = shifted = False
    for i in range(len(position)):
        end[i] = position[i]
    for w in range(len(letters)):
        i = setup["column"][int(letters[w]) - _A]
        if i >= 0:
            value = numbers[w] * setup["scale"][i]
            target = end_of_word(value, position[i], setup["zero"][i], absolute != 0)
            if target != position[i]:
                if setup["turns"][i] != 0.0:
                    turned = True
                else:
                    shifted = True
            end[i] = target
    return shifted, turned


@njit
def _execute_any(
    letters: Bytes,
    numbers: Floats,
    line: int,
    setup: Setup,
    now: Record,
    position: Floats,
    rows: Rows,
) -> bool:
    """Execute a line of any words. Arguments as of `execute_line`; ``now`` is its modal state."""
    known, words = read_words(letters, numbers, setup, now)
    if not known or not fits(words, setup, now):
        return False
    row = int(now["rows"])
    if words.speed == words.speed or words.turn >= 0 or words.cool >= 0 or words.pausing:
        seconds, _ = dwell_of(words.time, setup["dwell"])
        row = _add_events(words, line, seconds, now, rows)
    is_move = not words.pausing and (words.moving or words.curved)
    if is_move and words.mode > LAST_MOTION:
        row = add_cycle(words, letters, numbers, line, row, setup, now, position, rows)
        if row < 0:
            return False
    elif is_move:
        end = rows.points[row]
        shifts, turns = _end(letters, numbers, words.absolute, setup, position, end)
        rows.kinds[row] = STRAIGHT
        if words.mode >= 2:
            if not _arc_row(
                setup, words.plane, words.mode == 2, words.center, words.radius, position, end,
                rows.data[row],
            ):  # fmt: skip
                return False
            rows.kinds[row] = ARC
        rate = feed_of_move(words.linear, words.rotary, shifts, turns)
        if setup["timed"] and words.mode != 0:
            length = length_of_move(position, end, setup["groups"])
            rate = feed_of_time(words.feed, length)
            if feed_status(words.feed, rate if length > 0.0 else math.inf) != FEED_OK:
                return False
        rows.feeds[row] = math.nan if words.mode == 0 else rate
        rows.lines[row] = line
        for i in range(len(position)):
            position[i] = end[i]
        row += 1
    _commit(words, line, setup["timed"], now, is_move and words.mode != 0)
    now["rows"] = row
    return True


@njit
def execute_line(
    letters: Bytes,
    numbers: Floats,
    line: int,
    setup: Setup,
    state: Record,
    position: Floats,
    rows: Rows,
) -> bool:
    """Execute a line. Each letter but G and M is in it at most once.

    Args:
        letters: Codes of the letters of its words.
        numbers: Numbers of its words.
        line: Number of the line.
        setup: Settings.
        state: Modal state, brought up to date.
        position: (n,) the position, brought up to date.
        rows: Takes the rows of the line, for which it must have space.

    Returns:
        Whether the line was executed. If not, nothing was done.
    """
    now = state[0]
    # Most lines of a long program are straight moves of axis words alone.
    straight = now["mode"] == 0 or (now["mode"] == 1 and now["linear"] == now["linear"])
    for w in range(len(letters)):
        straight = straight and setup["column"][int(letters[w]) - _A] >= 0
    if straight:
        row = int(now["rows"])
        shifts, turns = _end(letters, numbers, now["absolute"], setup, position, rows.points[row])
        rate = feed_of_move(now["linear"], now["rotary"], shifts, turns)
        rows.kinds[row] = STRAIGHT
        rows.feeds[row] = math.nan if now["mode"] == 0 else rate
        rows.lines[row] = line
        for i in range(len(position)):
            position[i] = rows.points[row, i]
        if now["mode"] == 1:
            now["feed_word"] = math.nan
        now["rows"] = row + 1
        return True
    return _execute_any(letters, numbers, line, setup, now, position, rows)


@njit
def execute_lines(
    first: Counts,
    words: Words,
    begin: int,
    end: int,
    line: int,
    setup: Setup,
    state: Record,
    position: Floats,
    rows: Rows,
) -> int:
    """Execute lines of a scan, and stop before the first one that is left to the interpreter.

    Args:
        first: Index of the first word of each line, and one entry more.
        words: The words of the scan.
        begin: Index of the first line.
        end: Index after the last line.
        line: Number of the first line in the program.
        setup: Settings.
        state: Modal state, brought up to date.
        position: (n,) the position, brought up to date.
        rows: Takes the rows. It stops where they may have no space for a line.

    Returns:
        The number of lines that were executed.
    """
    now = state[0]
    for k in range(begin, end):
        a, b = first[k], first[k + 1]
        if a == b:
            continue
        full = now["rows"] + MOST_ROWS > len(rows.kinds)
        if full or not execute_line(
            words.letter[a:b], words.number[a:b], line + k - begin, setup, state, position, rows
        ):
            return k - begin
    return end - begin
