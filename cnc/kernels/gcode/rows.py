"""Modal state and settings of lines, and rows of moves, arcs and events."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.arcs import Tolerance

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Record = NDArray[np.void]

OTHER_WORD, TAKEN_WORD = -1, -2
"""Columns of letters that are no axes: words of the interpreter, and words that are known here."""
NO_MOTION = -1
"""The motion mode if it is none of those known here. G0 to G3 and cycles have their number."""
STOP, IDLE, MOVE, CANCEL, PLANE, ABSOLUTE, INCREMENTAL, DWELL, TURN, COOL = range(10)
INITIAL_LEVEL, R_LEVEL = 10, 11
"""Actions of codes. STOP leaves the line to the interpreter; IDLE changes nothing."""
STRAIGHT, ARC, SPINDLE, COOLANT, PAUSE, BOUNDARY, PATH = range(7)
"""Kinds of rows. BOUNDARY is the begin or the end of a call."""
MOST_ROWS = 64
"""Most rows of a line. A cycle with more is left to the interpreter."""
MOST_OTHERS = 512
"""Rows that are no straight moves, after which compiled code pauses. Each becomes a Python object,
and the garbage collector takes less time if few of them exist at once.
"""
MOST_AXES = 9

STATE = np.dtype(
    [
        ("mode", np.int64),
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
        ("start", np.float64, (MOST_AXES,)),
        ("words", np.float64, (4,)),
        ("word_lines", np.int64, (4,)),
        ("rows", np.int64),
        ("others", np.int64),
    ]
)
"""Modal state: motion mode, plane (0 to 2: G17 to G19), G90, G98, feeds of linear and rotary axes
(mm/s and degrees/s, NaN for none), direction and speed of the spindle (0 to 2: M5, M3, M4; rpm, NaN
for none), coolants, the F and S words that nothing has used yet (NaN for none) with their lines,
what the last blocks of spindle and coolant said (-1 for unknown), the cycle of the series (0 for
none) with its plane, the position at its start and its words in effect (depth, R, P, Q; NaN for
none) with their lines, and the numbers of all rows and of those that are no straight moves.
"""
DEPTH, RETRACT, WAIT, PECK = range(4)
"""Places of the words of a series."""


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
        cycle_dwell: s of P1 in a cycle; 0 if compiled code does not know it.
        dwell_needed: A cycle with a dwell needs P.
        words_stay: The words of a cycle stay in effect for another one.
        repeats_k: K is the number of repeats of a cycle, as L is.
        clearance: Retraction of G73, and distance of G83 from the bottom, mm.
        out_to_retract: G89 retracts at feed to R only.
        blends: G64 is in effect.
    """

    unit: float
    min_feed: float
    arc_absolute: bool
    idle_center: bool
    surface_speed: bool
    notes: bool
    dwell: float
    longest_dwell: float
    cycle_dwell: float
    dwell_needed: bool
    words_stay: bool
    repeats_k: bool
    clearance: float
    out_to_retract: bool
    blends: bool


class Setup(NamedTuple):
    """What stays the same for all lines; n is the number of axes.

    Attributes:
        column: (26,) the column of the axis of each letter, TAKEN_WORD or OTHER_WORD.
        scale: (n,) mm or degrees a program unit.
        zero: (n,) machine position of the program's zero, mm or degrees.
        turns: (n,) 1 for a rotary axis, 0 for a linear one.
        planes: (3, 3) columns of the two axes of each plane and of the axis across it, -1 for one
            that is missing.
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
            at its end; 1 for the blends of G64 and 0 for the exact path.
    """

    points: Floats
    feeds: Floats
    lines: Counts
    kinds: Bytes
    data: Floats
