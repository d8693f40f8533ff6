"""Places of the holes of one line: repeats of a step, or steps around the zero point."""

from __future__ import annotations

from collections.abc import Iterator

from cnc.gcode.codes.polar import stepped
from cnc.gcode.cycles.cycle_runner import CyclePlane
from cnc.gcode.cycles.drilling_steps import Hole

Heights = tuple[float, float, float]
"""R, the bottom, and the end of the cycle, mm."""


def holes_on_line(
    plane: CyclePlane, given: dict[int, float], heights: Heights, repeats: int, *, absolute: bool
) -> Iterator[Hole]:
    """Yield the holes of a line; ``given`` are its axis values by column, steps under G91."""
    first, second, _ = plane.start
    x, y = plane.in_plane(given)
    top, bottom, clear = heights
    for number in range(1, repeats + 1):
        if absolute:
            yield Hole(first if x is None else x, second if y is None else y, bottom, top, clear)
        else:
            yield Hole(
                first + number * (x or 0.0), second + number * (y or 0.0), bottom, top, clear
            )


def holes_on_circle(
    plane: CyclePlane, polar: tuple[float, float], heights: Heights, repeats: int
) -> Iterator[Hole]:
    """Yield the holes of a line with polar steps: each is a step from the one before."""
    top, bottom, clear = heights
    for number in range(1, repeats + 1):
        x, y = stepped(plane.start[:2], *polar, number)
        yield Hole(x, y, bottom, top, clear)
