"""The words of a line, and the modal state that they ask for."""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.kernels.gcode.rows import (
    ABSOLUTE,
    CANCEL,
    CANCELLED,
    COOL,
    DWELL,
    IDLE,
    INCREMENTAL,
    INITIAL_LEVEL,
    MOVE,
    NO_MOTION,
    PLANE,
    R_LEVEL,
    STOP,
    TAKEN_WORD,
    TURN,
    Bytes,
    Floats,
    Record,
    Setup,
)
from cnc.kernels.gcode.rules import (
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
from cnc.kernels.jit import njit

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
        if mode != 0 and words.linear != words.linear:
            return False
        if is_arc and not words.curved:
            return False
    elif words.explicit and mode >= 2:
        return False
    return _fits_speed(words, setup, now)
