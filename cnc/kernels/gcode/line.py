"""One line of words: modal state, and rows of moves, arcs and events.

A line is executed wholly or not at all. It is left to the interpreter if it has a word or a code
that this module does not know, or if it is wrong. The arithmetic is that of the interpreter,
operation by operation, so that the bits of the results are equal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.arcs import OK, Tolerance, Wanted, arc_of
from cnc.kernels.gcode.scanner import Words
from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Record = NDArray[np.void]

OTHER_WORD, TAKEN_WORD = -1, -2
"""Columns of letters that are no axes: words of the interpreter, and words that are known here."""
NO_MOTION = -1
"""The motion mode if it is none of G0 to G3, whose modes are 0 to 3."""
STOP, IDLE, MOVE, CANCEL, PLANE, ABSOLUTE, INCREMENTAL, DWELL, TURN, COOL = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    9,
)
"""Actions of codes. STOP leaves the line to the interpreter; IDLE changes nothing."""
STRAIGHT, ARC, SPINDLE, COOLANT, PAUSE, BOUNDARY = 0, 1, 2, 3, 4, 5
"""Kinds of rows. BOUNDARY is the begin or the end of a call."""
MOST_ROWS = 4
"""Most rows of a line."""
MOST_OTHERS = 512
"""Rows that are no straight moves, after which compiled code pauses. Each becomes a Python object,
and the garbage collector takes less time if few of them exist at once.
"""

STATE = np.dtype(
    [
        ("mode", np.int64),
        ("plane", np.int64),
        ("absolute", np.int64),
        ("linear", np.float64),
        ("rotary", np.float64),
        ("spindle", np.int64),
        ("speed", np.float64),
        ("mist", np.int64),
        ("flood", np.int64),
        ("feed_word", np.float64),
        ("feed_line", np.int64),
        ("speed_word", np.float64),
        ("speed_line", np.int64),
        ("rows", np.int64),
        ("others", np.int64),
    ]
)
"""Modal state: motion mode, plane (0 to 2: G17 to G19), G90, feeds of linear and rotary axes (mm/s
and degrees/s, NaN for none), direction and speed of the spindle (0 to 2: M5, M3, M4; rpm, NaN for
none), coolants, the F and S words that nothing has used yet (NaN for none) with their lines, and
the numbers of all rows and of those that are no straight moves.
"""


class Rules(NamedTuple):
    """Settings that are one number each.

    Attributes:
        unit: mm a program unit.
        min_feed: Slowest feed, mm/s.
        arc_absolute: G90.1 is in effect.
        idle_center: An arc may have a centre word of 0 for the axis across its plane.
        surface_speed: G96 is in effect.
        notes: F and S words without effect are reported.
        dwell: s of P1 in G4; 0 if P is not its word.
        longest_dwell: A dwell of so many seconds or more is left to the interpreter.
    """

    unit: float
    min_feed: float
    arc_absolute: bool
    idle_center: bool
    surface_speed: bool
    notes: bool
    dwell: float
    longest_dwell: float


class Setup(NamedTuple):
    """What stays the same for all lines; n is the number of axes.

    Attributes:
        column: (26,) the column of the axis of each letter, TAKEN_WORD or OTHER_WORD.
        scale: (n,) mm or degrees a program unit.
        zero: (n,) machine position of the program's zero, mm or degrees.
        turns: (n,) 1 for a rotary axis, 0 for a linear one.
        planes: (3, 2) columns of the axes of each plane, -1 for an axis that is missing.
        g_action: (1000,) action of each G-code, by tenths.
        g_group: (1000,) modal group of each G-code.
        m_action: (100,) action of each M-code.
        tolerance: Tolerances of arcs.
        rules: The other settings.
    """

    column: Ints
    scale: Floats
    zero: Floats
    turns: Floats
    planes: Ints
    g_action: Bytes
    g_group: Bytes
    m_action: Bytes
    tolerance: Tolerance
    rules: Rules


class Rows(NamedTuple):
    """Moves, arcs and events in order; n axes.

    Attributes:
        points: (m, n) end positions, mm or degrees.
        feeds: (m,) mm/s or degrees/s, NaN for a traverse.
        lines: (m,) line numbers.
        kinds: (m,) kinds.
        data: (m, 5) centre, radius, turns and plane of an arc; direction and speed of the spindle,
            and 1 if only the speed changes; mist and flood; seconds; 1 at the begin of a call and 0
            at its end.
    """

    points: Floats
    feeds: Floats
    lines: Counts
    kinds: Bytes
    data: Floats


_A, _F, _G, _I, _J, _K, _M, _N, _P, _R, _S = 65, 70, 71, 73, 74, 75, 77, 78, 80, 82, 83


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
    i, j = setup.planes[plane, 0], setup.planes[plane, 1]
    if i < 0 or j < 0:
        return False
    # I, J, K go with X, Y, Z; the axes of the planes are XY, ZX and YZ.
    first, second, across = center[0], center[1], center[2]
    if plane == 1:
        first, second, across = center[2], center[0], center[1]
    elif plane == 2:
        first, second, across = center[1], center[2], center[0]
    rules = setup.rules
    if across == across and not (rules.idle_center and across == 0.0):
        return False
    x = y = math.nan
    has_first, has_second = first == first, second == second
    if radius == radius:
        if has_first or has_second:
            return False
    else:
        if not (has_first and has_second) and (rules.arc_absolute or not (has_first or has_second)):
            return False
        x = (first if has_first else 0.0) * rules.unit
        y = (second if has_second else 0.0) * rules.unit
        x += setup.zero[i] if rules.arc_absolute else position[i]
        y += setup.zero[j] if rules.arc_absolute else position[j]
    arc = arc_of(
        Wanted(position[i], position[j], end[i], end[j], x, y, radius * rules.unit, clockwise),
        setup.tolerance,
    )
    if arc.status != OK:
        return False
    data[0], data[1], data[2], data[3], data[4] = arc.x, arc.y, arc.radius, arc.turns, plane
    return True


class _Words(NamedTuple):
    """The words of a line, NaN or -1 for a missing one, and the modal state that it asks for."""

    mode: int
    plane: int
    absolute: int
    linear: float
    rotary: float
    feed: float
    speed: float
    turn: int
    cool: int
    pausing: bool
    time: float
    moving: bool
    curved: bool
    explicit: bool
    center: tuple[float, float, float]
    radius: float


@njit
def _read_words(letters: Bytes, numbers: Floats, setup: Setup, now: Record) -> tuple[bool, _Words]:
    """Sort the words of a line; False if it has one that is left to the interpreter."""
    mode, plane, absolute = int(now["mode"]), int(now["plane"]), int(now["absolute"])
    linear, rotary = float(now["linear"]), float(now["rotary"])
    feed = speed = time = radius = ci = cj = ck = math.nan
    turn = cool = -1
    groups = 0
    moving = curved = pausing = explicit = False
    known = True
    for w in range(len(letters)):
        char, value = int(letters[w]), numbers[w]
        place = setup.column[char - _A]
        if place >= 0:
            moving = True
        elif char == _G or char == _M:
            # A code with a minus is wrong, even -0.
            tenths = int(value * 10.0 + 0.5) if 0.0 <= value < 100.0 else 0
            known = known and tenths / 10.0 == value and math.copysign(1.0, value) > 0.0
            if char == _G:
                action, group = int(setup.g_action[tenths]), int(setup.g_group[tenths])
            else:
                known = known and tenths % 10 == 0
                action = int(setup.m_action[tenths // 10])
                group = action + 32
            known = known and action != STOP and groups >> group & 1 == 0
            groups |= 1 << group
            if action == MOVE:
                mode = tenths // 10
                explicit = True
            elif action == CANCEL:
                mode = NO_MOTION
            elif action == PLANE:
                plane = tenths // 10 - 17
            elif action == ABSOLUTE:
                absolute = 1
            elif action == INCREMENTAL:
                absolute = 0
            elif action == DWELL:
                pausing = True
            elif action == TURN:
                turn = (tenths // 10 - 2) % 3
            elif action == COOL:
                cool = tenths // 10
        elif char == _F:
            feed = value
            linear = value * setup.rules.unit / 60.0
            rotary = value / 60.0
            known = known and value > 0.0 and rotary >= setup.rules.min_feed
        elif char == _S:
            speed = value
            known = known and not value < 0.0
        elif char == _P:
            time = value
        elif char == _R:
            curved = True
            radius = value
        elif char == _I or char == _J or char == _K:
            curved = True
            ci = value if char == _I else ci
            cj = value if char == _J else cj
            ck = value if char == _K else ck
        else:
            known = known and place == TAKEN_WORD
    return known, _Words(
        mode, plane, absolute, linear, rotary, feed, speed, turn, cool, pausing, time, moving,
        curved, explicit, (ci, cj, ck), radius,
    )  # fmt: skip


@njit
def _is_kept(words: _Words, now: Record) -> bool:
    """Return whether the S word of a line waits for a start of the spindle."""
    return (
        words.speed == words.speed
        and words.speed != 0.0
        and (words.turn >= 0 or now["spindle"] == 0)
    )


@njit
def _fits(words: _Words, setup: Setup, now: Record) -> bool:
    """Return whether the words of a line fit together, so that none is left over."""
    mode, rules = words.mode, setup.rules
    if words.pausing:
        seconds = words.time * rules.dwell
        # Not for NaN, too.
        if not 0.0 <= seconds < rules.longest_dwell or rules.dwell == 0.0:
            return False
        if words.moving or words.curved or words.explicit:
            return False
        # In some dialects F or S is the time.
        if words.feed == words.feed or words.speed == words.speed:
            return False
    elif words.time == words.time:
        return False
    elif words.moving or words.curved:
        is_arc = mode >= 2
        if mode == NO_MOTION or (words.curved and not is_arc):
            return False
        if mode != 0 and words.linear != words.linear:
            return False
        if is_arc and not words.curved:
            return False
    elif words.explicit and mode >= 2:
        return False
    has_speed = words.speed == words.speed
    if words.turn > 0 and not has_speed and now["speed"] != now["speed"]:
        return False
    if (has_speed or words.turn >= 0) and rules.surface_speed:
        return False
    if rules.notes:
        # The interpreter reports a word that replaces another one without effect.
        kept_feed, kept_speed = float(now["feed_word"]), float(now["speed_word"])
        if words.feed == words.feed and kept_feed == kept_feed and words.feed != kept_feed:
            return False
        if _is_kept(words, now) and kept_speed == kept_speed and words.speed != kept_speed:
            return False
    return True


@njit
def _count_events(words: _Words, now: Record) -> int:
    """Return the number of rows after the events of a line, which stand before its move."""
    speaks = words.speed == words.speed and now["spindle"] > 0 and words.turn < 0
    return (
        int(now["rows"])
        + int(speaks or words.turn >= 0)
        + int(words.cool >= 0)
        + int(words.pausing)
    )


@njit
def _commit(
    words: _Words, line: int, seconds: float, now: Record, rows: Rows, is_feed: bool
) -> None:
    """Put the modal state of a line into effect, and append the rows of its events."""
    if words.feed == words.feed and now["feed_word"] != now["feed_word"]:
        now["feed_word"], now["feed_line"] = words.feed, line
    if is_feed:
        now["feed_word"] = math.nan
    now["mode"], now["plane"], now["absolute"] = words.mode, words.plane, words.absolute
    now["linear"], now["rotary"] = words.linear, words.rotary
    row = int(now["rows"])
    if words.speed == words.speed:
        now["speed"] = words.speed
        if _is_kept(words, now) and now["speed_word"] != now["speed_word"]:
            now["speed_word"], now["speed_line"] = words.speed, line
    if words.turn >= 0 or (words.speed == words.speed and now["spindle"] > 0):
        if words.turn > 0:
            now["speed_word"] = math.nan
        rows.data[row, 2] = words.turn < 0 or (words.turn > 0 and words.turn == now["spindle"])
        if words.turn >= 0:
            now["spindle"] = words.turn
        rows.kinds[row], rows.lines[row] = SPINDLE, line
        rows.data[row, 0], rows.data[row, 1] = now["spindle"], now["speed"]
        row += 1
    if words.cool >= 0:
        mist, flood = now["mist"], now["flood"]
        now["mist"] = words.cool == 7 or (mist != 0 and words.cool == 8)
        now["flood"] = words.cool == 8 or (flood != 0 and words.cool == 7)
        rows.kinds[row], rows.lines[row] = COOLANT, line
        rows.data[row, 0], rows.data[row, 1] = now["mist"], now["flood"]
        row += 1
    if words.pausing:
        rows.kinds[row], rows.lines[row] = PAUSE, line
        rows.data[row, 0] = seconds


@njit
def _end(
    letters: Bytes, numbers: Floats, absolute: int, setup: Setup, position: Floats, end: Floats
) -> bool:
    """Fill the end of a move from its axis words; return whether only rotary axes move."""
    turned = shifted = False
    for i in range(len(position)):
        end[i] = position[i]
    for w in range(len(letters)):
        i = setup.column[int(letters[w]) - _A]
        if i >= 0:
            target = numbers[w] * setup.scale[i]
            target = target + setup.zero[i] if absolute else position[i] + target
            if target != position[i]:
                if setup.turns[i] != 0.0:
                    turned = True
                else:
                    shifted = True
            end[i] = target
    return turned and not shifted


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
    known, words = _read_words(letters, numbers, setup, now)
    if not known or not _fits(words, setup, now):
        return False
    is_move = not words.pausing and (words.moving or words.curved)
    row = int(now["rows"])
    if words.speed == words.speed or words.turn >= 0 or words.cool >= 0 or words.pausing:
        row = _count_events(words, now)
    if is_move:
        end = rows.points[row]
        rotates = _end(letters, numbers, words.absolute, setup, position, end)
        rows.kinds[row] = STRAIGHT
        if words.mode >= 2:
            if not _arc_row(
                setup, words.plane, words.mode == 2, words.center, words.radius, position, end,
                rows.data[row],
            ):  # fmt: skip
                return False
            rows.kinds[row] = ARC
        rate = words.rotary if rotates else words.linear
        rows.feeds[row] = math.nan if words.mode == 0 else rate
        rows.lines[row] = line
        for i in range(len(position)):
            position[i] = end[i]
    _commit(words, line, words.time * setup.rules.dwell, now, rows, is_move and words.mode != 0)
    now["others"] += row - now["rows"] + int(is_move and words.mode >= 2)
    now["rows"] = row + is_move
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
        straight = straight and setup.column[int(letters[w]) - _A] >= 0
    if straight:
        row = int(now["rows"])
        rotates = _end(letters, numbers, now["absolute"], setup, position, rows.points[row])
        rate = now["rotary"] if rotates else now["linear"]
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
        full = now["rows"] + MOST_ROWS > len(rows.kinds) or now["others"] >= MOST_OTHERS
        if full or not execute_line(
            words.letter[a:b], words.number[a:b], line + k - begin, setup, state, position, rows
        ):
            return k - begin
    return end - begin
