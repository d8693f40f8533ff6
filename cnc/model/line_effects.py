"""The effect of a line that is sent to a board with a planner of its own.

Whoever writes a line knows its motion. The line carries it, so that no receiver parses the text.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

NOT_NAMED = (math.nan, math.nan, math.nan)
"""The target of a line that names no axis."""


class LineKind(IntEnum):
    """What a line does.

    MODES: it changes modes or shows a message, and motion continues. REST: the board comes to rest
    before it. DWELL: the board rests for a time. The others are motions.
    """

    MODES = 0
    REST = 1
    DWELL = 2
    RAPID = 3
    FEED = 4
    CLOCKWISE = 5
    COUNTERCLOCKWISE = 6
    PROBE = 7


MOTIONS = frozenset(
    (
        LineKind.RAPID,
        LineKind.FEED,
        LineKind.CLOCKWISE,
        LineKind.COUNTERCLOCKWISE,
        LineKind.PROBE,
    )
)
ARCS = frozenset((LineKind.CLOCKWISE, LineKind.COUNTERCLOCKWISE))


class LineEffect(NamedTuple):
    """The effect of one line, in the numbers that stand in its text.

    Attributes:
        kind: What the line does.
        target: X, Y and Z in mm, in the coordinates of the line; NaN for an axis that it does not
            name.
        feed: The feed in effect, mm/s; 0 before the first F word.
        plane: The plane of an arc: 0 for XY, 1 for ZX, 2 for YZ.
        center: The centre of an arc from its start, mm, along the two axes of its plane.
        seconds: The time of a dwell.
    """

    kind: LineKind
    target: tuple[float, float, float] = NOT_NAMED
    feed: float = 0.0
    plane: int = 0
    center: tuple[float, float] = (0.0, 0.0)
    seconds: float = 0.0


MODES = LineEffect(LineKind.MODES)
REST = LineEffect(LineKind.REST)
