"""Places of the holes of one line: repeats of a step, or steps around a pole."""

from __future__ import annotations

import math
from collections.abc import Iterator

from cnc.gcode.codes.polar import stepped
from cnc.gcode.codes.polar_mode import PolarMode
from cnc.gcode.cycles.cycle_runner import CyclePlane
from cnc.kernels.gcode.holes import Hole, coordinate_of_hole
from cnc.kernels.jit import interpreted

_coordinate = interpreted(coordinate_of_hole)

Heights = tuple[float, float, float]
"""R, the bottom, and the end of the cycle, mm."""


def holes_on_line(
    plane: CyclePlane, given: dict[int, float], heights: Heights, repeats: int, *, absolute: bool
) -> Iterator[Hole]:
    """Yield the holes of a line; ``given`` are its axis values by column, steps under G91."""
    top, bottom, clear = heights
    words = [math.nan if value is None else value for value in plane.in_plane(given)]
    for number in range(1, repeats + 1):
        x, y = (
            _coordinate(number, start, word, absolute)
            for start, word in zip(plane.start, words, strict=False)
        )
        yield Hole(x, y, bottom, top, clear)


def holes_on_circle(
    plane: CyclePlane, polar: tuple[float, float], heights: Heights, repeats: int
) -> Iterator[Hole]:
    """Yield the holes of a line with polar steps: each is a step from the one before."""
    top, bottom, clear = heights
    for number in range(1, repeats + 1):
        x, y = stepped(plane.start[:2], *polar, number)
        yield Hole(x, y, bottom, top, clear)


def holes_in_polar_mode(
    plane: CyclePlane,
    mode: PolarMode,
    given: dict[int, float],
    heights: Heights,
    repeats: int,
) -> Iterator[Hole]:
    """Yield the holes of a line under G16 and G91, whose step is one of the radius and angle.

    ``given`` is the step to the first hole; ``mode`` repeats the words of the line for the others.
    """
    top, bottom, clear = heights
    i, j = plane.columns[:2]
    assert i is not None
    assert j is not None
    x, y = plane.start[0] + given[i], plane.start[1] + given[j]
    for number in range(repeats):
        if number:
            x, y = mode.again((x, y))
        yield Hole(x, y, bottom, top, clear)
