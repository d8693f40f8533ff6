"""Error map of a machine: errors at the points of a grid in its volume, a csv file.

    x,y,z,dx,dy,dz
    0,0,-100,0.012,-0.003,0.001        place to which the tip is sent, and its error there, mm
    50,0,-100,0.015,-0.002,0.001

The rows may have any order. Each point of the grid has one. An axis with one place alone has the
same errors everywhere along it.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, InstanceOf, WithJsonSchema

from cnc.kinematics.volume import Floats, Ints, Volume
from cnc.machine.compensation import TableError, numbered_lines, numbers_of_row

HEADING = ("x", "y", "z", "dx", "dy", "dz")
MOST_POINTS = 20_000
"""Points of a map: each has 3 kB of coefficients."""
LEAST_WAY = 1.0
"""Least distance of two places of the grid, mm."""
STEEPEST = 0.1
"""Largest slope of an error: no machine is so wrong, and no two places go to the same one."""
COARSE = 0.02
"""Largest distance of the spline from straight lines in the middle between points, mm: where they
differ more, the points do not say what the error is."""
TRUE = 0.0005
"""Largest error that the correction leaves in the middle between points, mm."""


class ErrorMap:
    """A map: places of the grid, errors, and the line of each point in its file.

    Args:
        grid: Places along X, Y, Z, ascending, mm.
        errors: Errors (nx, ny, nz, 3): place reached less place sent, mm.
        lines: Lines of the points (nx, ny, nz).
        name: Name of the file.

    Attributes:
        grid: The places.
    """

    def __init__(
        self, grid: tuple[Floats, ...], errors: Floats, lines: Ints, name: str = ""
    ) -> None:
        self.grid, self._errors, self._lines, self._name = grid, errors, lines, name

    @cached_property
    def volume(self) -> Volume:
        """The corrections."""
        return Volume(self.grid, self._errors)

    def faults(self) -> Iterator[str]:
        """Yield why the errors are not those of a machine."""
        for axis, letter in enumerate("xyz"):
            ways = np.diff(self.grid[axis])
            if (ways < LEAST_WAY).any():
                near = self.grid[axis][int(np.argmin(ways))]
                yield f"places along {letter} are closer than {LEAST_WAY:g} near {near:g}"
                return
            steps = np.abs(np.diff(self._errors, axis=axis))
            shape = [1] * 4
            shape[axis] = len(ways)
            slopes = steps / ways.reshape(shape)
            if slopes.size and slopes.max() > STEEPEST:
                *at, column = np.unravel_index(int(np.argmax(slopes)), slopes.shape)
                behind = list(at)
                behind[axis] += 1
                first, second = int(self._lines[tuple(at)]), int(self._lines[tuple(behind)])
                yield (
                    f"lines {first} and {second} of {self._name}: d{'xyz'[column]} changes by "
                    f"{float(steps[(*at, column)]):.3g} over {ways[at[axis]]:g} mm, which no "
                    "machine does"
                )
                return
        yield from self._faults_between()

    def _faults_between(self) -> Iterator[str]:
        """Yield where the points are too far from each other to say what is between them."""
        middles = [0.5 * (p[1:] + p[:-1]) if len(p) > 1 else p for p in self.grid]
        places = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 3)
        straight = self._errors
        for axis, along in enumerate(self.grid):
            if len(along) > 1:
                ends = np.moveaxis(straight, axis, 0)
                straight = np.moveaxis(0.5 * (ends[1:] + ends[:-1]), 0, axis)
        bent = np.abs(self.volume.error(places) - straight.reshape(-1, 3)).max(axis=1)
        tips = self.volume.reached(places)
        left = np.abs(places + self.volume.error(places) - tips).max(axis=1)
        for values, most, what in (
            (bent, COARSE, "is off a straight line"),
            (left, TRUE, "is left after the correction"),
        ):
            worst = int(np.argmax(values))
            if values[worst] > most:
                near = self._nearest_line(places[worst])
                yield (
                    f"line {near} of {self._name}: the map is too coarse there: between this point "
                    f"and its neighbours {values[worst]:.3g} mm of the error {what}"
                )
                return

    def _nearest_line(self, place: Floats) -> int:
        at = (int(np.argmin(np.abs(p - x))) for p, x in zip(self.grid, place, strict=True))
        return int(self._lines[tuple(at)])


def read_error_map(file: Path) -> ErrorMap:
    """Return the map of a file.

    Raises:
        TableError: The file is not readable, a row is not as the heading says, the points are no
            grid, or the errors are not those of a machine.
    """
    rows = [(n, next(csv.reader([line]))) for n, line in numbered_lines(file)]
    if not rows or tuple(name.strip().lower() for name in rows[0][1]) != HEADING:
        raise TableError(f"the first line of {file.name} must be {','.join(HEADING)}")
    points: dict[tuple[float, ...], tuple[int, list[float]]] = {}
    for number, cells in rows[1:]:
        values = numbers_of_row(file, number, cells, len(HEADING))
        at = tuple(values[:3])
        if at in points:
            first = points[at][0]
            raise TableError(f"lines {first} and {number} of {file.name} are for one point")
        points[at] = number, values[3:]
    if not 2 <= len(points) <= MOST_POINTS:
        raise TableError(f"{file.name} has {len(points)} points: a map has 2 to {MOST_POINTS}")
    result = _of_points(points, file.name)
    for fault in result.faults():
        raise TableError(fault)
    return result


def _of_points(points: dict[tuple[float, ...], tuple[int, list[float]]], name: str) -> ErrorMap:
    """Return the map of points. TableError where they are no grid."""
    places = [sorted({at[axis] for at in points}) for axis in range(3)]
    shape = tuple(map(len, places))
    if math.prod(shape) > len(points):
        missing = next(at for at in product(*places) if at not in points)
        words = " ".join(f"{n}{x:g}" for n, x in zip("XYZ", missing, strict=True))
        near = min(points, key=lambda at: math.dist(at, missing))
        raise TableError(
            f"{name} has no point {words}: the points must be a grid, "
            f"{' x '.join(map(str, shape))} here; the nearest one is in line {points[near][0]}"
        )
    ordered = [points[at] for at in product(*places)]
    errors = np.array([values for _, values in ordered]).reshape(*shape, 3)
    lines = np.array([line for line, _ in ordered]).reshape(shape)
    return ErrorMap(tuple(np.array(along) for along in places), errors, lines, name)


def _file(value: Any) -> Any:
    """Return a file name as a path."""
    if isinstance(value, str) and value:
        return Path(value)
    if not isinstance(value, ErrorMap | Path):
        raise ValueError("must be the name of a csv file")
    return value


ErrorMapFile = Annotated[
    Path | InstanceOf[ErrorMap],
    BeforeValidator(_file),
    WithJsonSchema({"type": "string", "minLength": 1}),
]
"""A file, or its map."""
