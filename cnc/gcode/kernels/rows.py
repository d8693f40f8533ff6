"""Modal state and settings of lines, and rows of moves, arcs and events."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.gcode.kernels.rules import (
    DWELL_OK,
    FEED_OK,
    SPINDLE_OFF,
    dwell_of,
    feed_status,
    feeds_of_word,
    motion_after_cancel,
    speed_waits,
    spindle_after,
)

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Floats = NDArray[np.float64]
Record = NDArray[np.void]

OTHER_WORD, TAKEN_WORD = -1, -2
"""Columns of letters that are no axes: words of the interpreter, and words that are known here."""
NO_MOTION, CANCELLED = -1, -2
"""The motion mode if there is none, or after a G80 that returned to none. G0 to G3 and cycles have
their number."""
STOP, IDLE, MOVE, CANCEL, PLANE, ABSOLUTE, INCREMENTAL, DWELL, TURN, COOL = range(10)
INITIAL_LEVEL, R_LEVEL = 10, 11
"""Actions of codes. STOP leaves the line to the interpreter; IDLE changes nothing."""
STRAIGHT, ARC, SPINDLE, COOLANT, PAUSE, BOUNDARY, PATH = range(7)
"""Kinds of rows. BOUNDARY is the begin or the end of a call."""
MOST_ROWS = 76
"""Most rows of a line. A cycle with more is left to the interpreter."""
MOST_AXES = 9

UNCLEAR_LEVEL = 2
"""Value of ``initial`` where neither G98 nor G99 was given, and dialects differ."""

STATE = np.dtype(
    [
        ("mode", np.int64),
        ("resting", np.int64),
        ("plane", np.int64),
        ("absolute", np.int64),
        ("initial", np.int64),
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
        ("turning", np.int64),
        ("rpm", np.float64),
        ("misting", np.int64),
        ("flooding", np.int64),
        ("cycle", np.int64),
        ("cycle_plane", np.int64),
        ("cycle_distance", np.int64),
        ("start", np.float64, (MOST_AXES,)),
        ("words", np.float64, (4,)),
        ("word_lines", np.int64, (4,)),
        ("rows", np.int64),
    ]
)
"""Modal state: motion mode, the last of G0 to G3 (-1 for none), plane (0 to 2: G17 to G19), G90,
G98, feeds of linear and rotary axes (mm/s and degrees/s, NaN for none), direction and speed of the
spindle (0 to 2: M5, M3, M4; rpm, NaN for none), coolants, the F and S words that nothing has used
yet (NaN for none) with their lines, what the last blocks of spindle and coolant said (-1 for
unknown), the cycle of the series (0 for none) with its plane, the position at its start and its
words in effect (depth, R, P, Q; NaN for none) with their lines, and the number of rows.
"""
DEPTH, RETRACT, WAIT, PECK = range(4)
"""Places of the words of a series."""

SETUP = np.dtype(
    [
        ("column", np.int64, (26,)),
        ("scale", np.float64, (MOST_AXES,)),
        ("zero", np.float64, (MOST_AXES,)),
        ("turns", np.float64, (MOST_AXES,)),
        ("groups", np.int64, (MOST_AXES,)),
        ("planes", np.int64, (3, 3)),
        ("unit", np.float64),
        ("slack", np.float64),
        ("relative", np.float64),
        ("limit", np.float64),
        ("reach", np.float64),
        ("dwell", np.float64),
        ("cycle_dwell", np.float64),
        ("clearance", np.float64),
        ("most_line_number", np.float64),
        ("restored", np.int64),
        ("arc_absolute", np.bool_),
        ("idle_center", np.bool_),
        ("grbl_arcs", np.bool_),
        ("timed", np.bool_),
        ("surface_speed", np.bool_),
        ("notes", np.bool_),
        ("dwell_needed", np.bool_),
        ("words_stay", np.bool_),
        ("repeats_k", np.bool_),
        ("out_to_retract", np.bool_),
        ("blends", np.bool_),
        ("g_action", np.uint8, (1000,)),
        ("g_group", np.uint8, (1000,)),
        ("m_action", np.uint8, (100,)),
        ("m_group", np.uint8, (100,)),
    ],
    align=True,
)
"""What stays the same for all lines. One record takes less time to pass on than many arrays.

By letter: the column of its axis, TAKEN_WORD or OTHER_WORD. By axis: mm or degrees a program unit,
the machine position of the program's zero, 1 for a rotary axis, and the group of
:func:`cnc.gcode.kernels.rules.length_of_move`. By plane: columns of its two
axes and of the axis across it, -1 for one that is missing.

mm a program unit; the tolerances of arcs (mm, see :class:`cnc.gcode.kernels.rules.Tolerance`); s of
P1 in G4, 0 if P is not its word; s of P1 in a cycle, 0 if compiled code does not know it;
retraction of G73 and distance of G83 from the bottom (mm); the largest N number; the highest of G0
to G3 to which G80 returns, -1 for none.

Whether G90.1 is in effect; an arc may have a centre word of 0 for the axis across its plane; arcs
follow GRBL's rules; G93 is in effect; G96 is in effect; F and S words without effect are reported;
a cycle with a dwell needs P; the words of a cycle stay in effect for another one; K is the number
of repeats of a cycle, as L is; G89 retracts at feed to R only; G64 is in effect.

By tenths of a G-code, and by M-code: its action and its modal group (0 to 62).
"""

Setup = Any
"""A record of SETUP."""


class Rows(NamedTuple):
    """Moves, arcs and events in order; n axes.

    Attributes:
        points: (m, n) end positions, mm or degrees.
        feeds: (m,) mm/s or degrees/s, NaN for a traverse.
        lines: (m,) line numbers.
        kinds: (m,) kinds.
        data: (m, 5) centre, radius, turns and plane of an arc; direction and speed of the spindle,
            and 1 if only the speed changes; mist and flood; seconds; 1 at the begin of a call and 0
            at its end; 1 for the blends of G64 and 0 for the exact path.
    """

    points: Floats
    feeds: Floats
    lines: Counts
    kinds: Bytes
    data: Floats


# The words of a line, and the modal state that they ask for.

_A, _F, _G, _I, _J, _K, _L, _M, _N = 65, 70, 71, 73, 74, 75, 76, 77, 78
_P, _Q, _R, _S = 80, 81, 82, 83
LAST_MOTION = 3
"""The last motion mode that is no cycle."""


class LineWords(NamedTuple):
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
    initial: int
    peck: float
    repeats: float


@njit
def read_words(
    letters: Bytes, numbers: Floats, setup: Setup, now: Record
) -> tuple[bool, LineWords]:
    """Sort the words of a line; False if it has one that is left to the interpreter."""
    mode, plane, absolute = int(now["mode"]), int(now["plane"]), int(now["absolute"])
    initial = int(now["initial"])
    linear, rotary = float(now["linear"]), float(now["rotary"])
    feed = speed = time = radius = ci = cj = ck = peck = repeats = math.nan
    turn = cool = -1
    groups = done = 0
    moving = curved = pausing = explicit = False
    known = True
    for w in range(len(letters)):
        char, value = int(letters[w]), numbers[w]
        place = setup["column"][char - _A]
        if place >= 0:
            moving = True
        elif char == _G or char == _M:
            # A code with a minus is wrong, even -0.
            tenths = int(value * 10.0 + 0.5) if 0.0 <= value < 100.0 else 0
            known = known and tenths / 10.0 == value and math.copysign(1.0, value) > 0.0
            if char == _G:
                action, group = int(setup["g_action"][tenths]), int(setup["g_group"][tenths])
            else:
                m = tenths // 10
                known = known and tenths % 10 == 0
                action, group = int(setup["m_action"][m]), int(setup["m_group"][m])
            known = known and action != STOP and groups >> group & 1 == 0
            # Codes of different groups, but of one action, are left to the interpreter.
            known = known and (action == IDLE or done >> action & 1 == 0)
            groups |= 1 << group
            done |= 1 << action
            if action == MOVE:
                mode = tenths // 10
                explicit = True
            elif action == CANCEL:
                resting = mode if 0 <= mode <= LAST_MOTION else int(now["resting"])
                after = motion_after_cancel(resting, int(setup["restored"]))
                if after >= 0:
                    mode = after
                elif mode != NO_MOTION:
                    mode = CANCELLED
            elif action == PLANE:
                plane = tenths // 10 - 17
            elif action == ABSOLUTE:
                absolute = 1
            elif action == INCREMENTAL:
                absolute = 0
            elif action == DWELL:
                pausing = True
            elif action == TURN:
                turn = tenths // 10
            elif action == COOL:
                cool = tenths // 10
            elif action == INITIAL_LEVEL:
                initial = 1
            elif action == R_LEVEL:
                initial = 0
        elif char == _F:
            feed = value
            if not setup["timed"]:
                linear, rotary = feeds_of_word(value, setup["unit"], False)
                known = known and feed_status(value, rotary) == FEED_OK
        elif char == _S:
            speed = value
            known = known and not value < 0.0
        elif char == _P:
            time = value
        elif char == _R:
            curved = True
            radius = value
        elif char == _Q:
            peck = value
        elif char == _L:
            repeats = value
        elif char == _I or char == _J or char == _K:
            curved = True
            ci = value if char == _I else ci
            cj = value if char == _J else cj
            ck = value if char == _K else ck
        elif char == _N:
            known = known and value <= setup["most_line_number"]
        else:
            known = known and place == TAKEN_WORD
    return known, LineWords(
        mode, plane, absolute, linear, rotary, feed, speed, turn, cool, pausing, time, moving,
        curved, explicit, (ci, cj, ck), radius, initial, peck, repeats,
    )  # fmt: skip


@njit
def _fits_speed(words: LineWords, setup: Setup, now: Record) -> bool:
    """Return whether the F and S words of a line fit the state of the spindle and earlier words."""
    has_speed = words.speed == words.speed
    starts = spindle_after(SPINDLE_OFF, words.turn) != SPINDLE_OFF
    if starts and not has_speed and now["speed"] != now["speed"]:
        return False
    if (has_speed or words.turn >= 0) and setup["surface_speed"]:
        return False
    if setup["notes"]:
        # The interpreter reports a word that replaces another one without effect.
        kept_feed, kept_speed = float(now["feed_word"]), float(now["speed_word"])
        if words.feed == words.feed and kept_feed == kept_feed and words.feed != kept_feed:
            return False
        waits = speed_waits(words.speed, int(now["spindle"]), words.turn)
        if waits and kept_speed == kept_speed and words.speed != kept_speed:
            return False
    return True


@njit
def fits(words: LineWords, setup: Setup, now: Record) -> bool:
    """Return whether the words of a line fit together, so that none is left over."""
    mode = words.mode
    if setup["timed"]:
        # F belongs to the move of its line. The interpreter knows the lengths of arcs.
        feeds = (words.moving or words.curved) and mode != 0
        if feeds != (words.feed == words.feed) or (feeds and mode != 1):
            return False
    if mode > LAST_MOTION and words.moving and not words.pausing:
        return _fits_speed(words, setup, now)
    # Q and L are words of cycles.
    if words.peck == words.peck or words.repeats == words.repeats:
        return False
    if words.pausing:
        _, status = dwell_of(words.time, setup["dwell"])
        if status != DWELL_OK:
            return False
        if words.moving or words.curved or words.explicit:
            return False
        # In some dialects F or S is the time.
        if words.feed == words.feed or words.speed == words.speed:
            return False
    elif words.time == words.time:
        return False
    elif words.moving or words.curved:
        is_arc = mode == 2 or mode == 3
        if mode < 0 or mode > LAST_MOTION or (words.curved and not is_arc):
            return False
        if mode != 0 and words.linear != words.linear and not setup["timed"]:
            return False
        if is_arc and not words.curved:
            return False
    elif words.explicit and mode >= 2:
        return False
    return _fits_speed(words, setup, now)
