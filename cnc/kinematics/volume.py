"""The error of a machine in its volume, between the points of a grid at which it is given.

The machine that is sent to S stands at S + e(S). It must be sent to T - c(T) to stand at T, so the
correction is c(T) = e(T - c(T)). At the points of the grid this is solved; between them, c is the
tensor product of natural cubic splines through these corrections (de Boor, A Practical Guide to
Splines, chapter XVII). It is linear beyond the grid, and the same everywhere along an axis with one
place. Its first and second derivatives have no jump.

On a cell of the grid, c is a polynomial of the distances u, v, w from its lowest point:

    c = sum of a_ijk u^i v^j w^k,   i, j, k = 0 .. 3
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series
from cnc.kinematics.splines import natural_spline

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PASSES = 64
"""Most passes of an inverse: each halves its error at least."""
CLOSE = 1e-12
"""Accuracy of an inverse, mm."""
SLACK = 1e-6
"""Distance beyond a cell at which its polynomial still stands for the spline, mm."""


class CellsOfVolume(NamedTuple):
    """Cells in which parts of a path lie.

    Attributes:
        numbers: Numbers of the cell of each part along X, Y, Z (m, 3).
        ends_inside: Whether both ends of each part lie in it, along each axis (m, 3).
    """

    numbers: Ints
    ends_inside: NDArray[np.bool_]


class Volume:
    """Corrections in a volume: the place where the tip shall be less that to which it is sent.

    Args:
        grid: Places of the points along X, Y, Z, ascending, mm; one at least.
        errors: Errors at the points (nx, ny, nz, 3): place reached less place sent, mm.

    Attributes:
        grid: The places.
        errors: The errors.
        largest: Largest part of a correction along an axis at a point, mm.
    """

    def __init__(self, grid: Sequence[Floats], errors: Floats) -> None:
        self.grid = tuple(grid)
        self.errors = errors
        self._origins = [np.concatenate((places[:1], places)) for places in self.grid]
        points = np.stack(np.meshgrid(*self.grid, indexing="ij"), axis=-1).reshape(-1, 3)
        self._errors = self._through(errors)
        corrections = errors.reshape(-1, 3)
        for _ in range(PASSES):
            before, corrections = corrections, self.error(points - corrections)
            if not np.any(np.abs(corrections - before) > CLOSE):
                break
        self._corrections = self._through(corrections.reshape(errors.shape))
        self.largest = float(np.abs(corrections).max())

    def _through(self, values: Floats) -> Floats:
        """Return the coefficients (nx + 1, ny + 1, nz + 1, 4, 4, 4, 3) of values at the points."""
        along_x = natural_spline(self.grid[0], values)  # cell, power, ny, nz, 3
        along_y = natural_spline(self.grid[1], np.moveaxis(along_x, 2, 0))
        along_z = natural_spline(self.grid[2], np.moveaxis(along_y, 4, 0))
        # z cell, z power, y cell, y power, x cell, x power, 3
        return np.ascontiguousarray(along_z.transpose(4, 2, 0, 5, 3, 1, 6))

    def cells(self, start: Floats, middle: Floats, end: Floats) -> CellsOfVolume:
        """Return the cells of parts of a path from three tips (m, 3) of each."""
        numbers, inside = np.empty(middle.shape, np.int64), np.empty(middle.shape, np.bool_)
        for axis, places in enumerate(self.grid):
            numbers[:, axis] = np.searchsorted(places, middle[:, axis], "right")
            low, high = self._range(axis, numbers[:, axis])
            first, last = start[:, axis], end[:, axis]
            inside[:, axis] = (np.minimum(first, last) >= low) & (np.maximum(first, last) <= high)
        return CellsOfVolume(numbers, inside)

    def _range(self, axis: int, number: Ints) -> tuple[Floats, Floats]:
        """Return the lowest and the highest place for which a cell stands."""
        places = self.grid[axis]
        low = np.concatenate(([-np.inf], places))[number] - SLACK
        return low, np.concatenate((places, [np.inf]))[number] + SLACK

    def series(self, tip: Sequence[Series], cells: CellsOfVolume) -> list[Series]:
        """Return the series of the three corrections on parts of a path (m,).

        Args:
            tip: The series of X, Y, Z.
            cells: The cell of each part. A part that leaves its cell has no bounds.
        """
        numbers = cells.numbers
        cubics = self._corrections[tuple(numbers.T)]
        powers: list[list[Series | None]] = []
        for axis in range(3):
            way = tip[axis] - self._origins[axis][numbers[:, axis]]
            square = way.square()
            powers.append([None, way, square, square * way])
        zero = tip[0] * 0.0
        totals: list[Series] = [zero, zero, zero]
        for i, along_x in enumerate(powers[0]):
            for j, along_y in enumerate(powers[1]):
                plane = _product(along_x, along_y)
                for k, along_z in enumerate(powers[2]):
                    weights = cubics[:, i, j, k]
                    if not weights.any():
                        continue
                    power = _product(plane, along_z)
                    for axis, weight in enumerate(weights.T):
                        share = weight if power is None else power * weight
                        totals[axis] = totals[axis] + share
        if not isinstance(tip[0].terms[0], Interval):
            return totals
        beyond = np.where(self._leaves(tip, cells), np.inf, 0.0)
        unbounded = Interval(-beyond, beyond)
        return [Series([*total.terms[:-1], unbounded + total.terms[-1]]) for total in totals]

    def _leaves(self, tip: Sequence[Series], cells: CellsOfVolume) -> NDArray[np.bool_]:
        """Return whether parts may leave their cells (m,), from intervals of the tip."""
        leaves = np.zeros(len(cells.numbers), np.bool_)
        for axis, series in enumerate(tip):
            place, rate = series.terms[0], series.terms[1]
            low, high = self._range(axis, cells.numbers[:, axis])
            # A place that only rises or only falls lies between its ends.
            turns = (rate.lo < 0.0) & (rate.hi > 0.0) if isinstance(rate, Interval) else False
            beyond = (place.lo < low) | (place.hi > high)
            leaves |= beyond & (turns | ~cells.ends_inside[:, axis])
        return leaves

    def correction(self, tips: Floats) -> Floats:
        """Return the corrections (m, 3) at places where the tip shall be (m, 3), mm."""
        return self._values(self._corrections, tips)

    def error(self, places: Floats) -> Floats:
        """Return the errors (m, 3) at places to which the tip is sent (m, 3), mm."""
        return self._values(self._errors, places)

    def _values(self, cubics: Floats, places: Floats) -> Floats:
        cells = self.cells(places, places, places).numbers
        values: Floats = cubics[tuple(cells.T)]
        for axis in range(3):
            way = (places[:, axis] - self._origins[axis][cells[:, axis]])[
                (...,) + (None,) * (3 - axis)
            ]
            values = values[:, 0] + way * (values[:, 1] + way * (values[:, 2] + way * values[:, 3]))
        return values

    def reached(self, places: Floats) -> Floats:
        """Return the tips (m, 3) where the machine stands that is sent to places (m, 3), mm."""
        tips = places + self.correction(places)
        for _ in range(PASSES):
            before, tips = tips, places + self.correction(tips)
            if not np.any(np.abs(tips - before) > CLOSE):
                break
        return tips


def _product(a: Series | None, b: Series | None) -> Series | None:
    """Return a product; None stands for 1."""
    if a is None or b is None:
        return b if a is None else a
    return a * b
