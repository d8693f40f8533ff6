"""Modal state and settings of lines, and rows of moves, arcs and events."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
MOST_OTHERS = 2048
"""Rows that are no straight moves, after which compiled code pauses. Each becomes a Python object,
with a run of moves perhaps a second one. The garbage collector of the command line does not begin
while so few exist at once.
"""
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
        ("others", np.int64),
    ]
)
"""Modal state: motion mode, the last of G0 to G3 (-1 for none), plane (0 to 2: G17 to G19), G90,
G98, feeds of linear and rotary axes (mm/s and degrees/s, NaN for none), direction and speed of the
spindle (0 to 2: M5, M3, M4; rpm, NaN for none), coolants, the F and S words that nothing has used
yet (NaN for none) with their lines, what the last blocks of spindle and coolant said (-1 for
unknown), the cycle of the series (0 for none) with its plane, the position at its start and its
words in effect (depth, R, P, Q; NaN for none) with their lines, and the numbers of all rows and of
those that are no straight moves.
"""
DEPTH, RETRACT, WAIT, PECK = range(4)
"""Places of the words of a series."""

SETUP = np.dtype(
    [
        ("column", np.int64, (26,)),
        ("scale", np.float64, (MOST_AXES,)),
        ("zero", np.float64, (MOST_AXES,)),
        ("turns", np.float64, (MOST_AXES,)),
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
the machine position of the program's zero, and 1 for a rotary axis. By plane: columns of its two
axes and of the axis across it, -1 for one that is missing.

mm a program unit; the tolerances of arcs (mm, see :class:`cnc.kernels.gcode.arcs.Tolerance`); s of
P1 in G4, 0 if P is not its word; s of P1 in a cycle, 0 if compiled code does not know it;
retraction of G73 and distance of G83 from the bottom (mm); the largest N number; the highest of G0
to G3 to which G80 returns, -1 for none.

Whether G90.1 is in effect; an arc may have a centre word of 0 for the axis across its plane; arcs
follow GRBL's rules; G96 is in effect; F and S words without effect are reported; a cycle with a
dwell needs P; the words of a cycle stay in effect for another one; K is the number of repeats of a
cycle, as L is; G89 retracts at feed to R only; G64 is in effect.

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
