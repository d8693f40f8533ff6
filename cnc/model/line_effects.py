"""The effect of a line that is sent to a board with a planner of its own.

Whoever writes a line knows its motion. The line carries it, so that no receiver parses the text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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

    # That of enum is a Python function, and each line is looked up in sets.
    __hash__ = int.__hash__


MOTIONS = frozenset(
    (
        LineKind.RAPID,
        LineKind.FEED,
        LineKind.CLOCKWISE,
        LineKind.COUNTERCLOCKWISE,
        LineKind.PROBE,
    )
)
KINDS = (*LineKind, None)
"""The kinds by number, and None for UNKNOWN."""
ARCS = frozenset((LineKind.CLOCKWISE, LineKind.COUNTERCLOCKWISE))


class LineEffect(NamedTuple):
    """The effect of one line, in the numbers that stand in its text.

    Attributes:
        kind: What the line does.
        target: X, Y, Z in mm, and the rotary axes of the board in degrees, in the coordinates of
            the line; NaN for an axis that it does not name.
        feed: The feed in effect, mm/s; 0 before the first F word.
        plane: The plane of an arc: 0 for XY, 1 for ZX, 2 for YZ.
        center: The centre of an arc from its start, mm, along the two axes of its plane.
        seconds: The time of a dwell.
    """

    kind: LineKind
    target: tuple[float, ...] = NOT_NAMED
    feed: float = 0.0
    plane: int = 0
    center: tuple[float, float] = (0.0, 0.0)
    seconds: float = 0.0


MODES = LineEffect(LineKind.MODES)
REST = LineEffect(LineKind.REST)


TOGETHER = 64
"""Rows that are read at once: it costs less than one by one."""
UNKNOWN = -1
"""In place of a kind: the line carries no effect."""


def row_type(axes: int) -> np.dtype[np.void]:
    """Return the type of a row with a source line and an effect, for a board with these axes."""
    return np.dtype(
        [
            ("line", np.int32),
            ("kind", np.int8),
            ("plane", np.int8),
            ("target", np.float64, (axes,)),
            ("feed", np.float64),
            ("center", np.float64, (2,)),
            ("seconds", np.float64),
        ]
    )


def rows_of(lines: Sequence[int], effects: Sequence[LineEffect | None]) -> NDArray[np.void]:
    """Return the rows of lines with these source lines and effects."""
    complete = [effect or MODES for effect in effects]
    axes = max((len(effect.target) for effect in complete), default=len(NOT_NAMED))
    rows = np.empty(len(complete), row_type(axes))
    rows["line"] = lines
    rows["kind"] = [UNKNOWN if effect is None else effect.kind for effect in effects]
    rows["plane"] = [effect.plane for effect in complete]
    missing = (math.nan,) * axes
    rows["target"] = [
        effect.target if len(effect.target) == axes else (*effect.target, *missing)[:axes]
        for effect in complete
    ] or np.empty((0, axes))
    rows["feed"] = [effect.feed for effect in complete]
    rows["center"] = [effect.center for effect in complete] or np.empty((0, 2))
    rows["seconds"] = [effect.seconds for effect in complete]
    return rows


new_effect: Callable[[tuple[object, ...]], LineEffect] = partial(tuple.__new__, LineEffect)
"""Make an effect of all its fields. A call of the type would take a function of Python."""


def effects_of(rows: NDArray[np.void]) -> Iterator[tuple[int, LineEffect | None]]:
    """Yield source line and effect of rows."""
    for first in range(0, len(rows), TOGETHER):
        some = rows[first : first + TOGETHER]
        line, kind, plane, target, feed, center, seconds = (
            some[name].tolist() for name in some.dtype.names or ()
        )
        kinds = map(KINDS.__getitem__, kind)
        wholes = zip(
            kinds, map(tuple, target), feed, plane, map(tuple, center), seconds, strict=True
        )
        for number, whole in zip(line, wholes, strict=True):
            yield number, None if whole[0] is None else new_effect(whole)
