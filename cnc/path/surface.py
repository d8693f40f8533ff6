"""A surface over a grid in X and Y, bilinear or a bicubic natural spline.

Each cell of the grid is a bicubic polynomial in Bernstein form; a bilinear cell is one of degree 1,
raised to degree 3. The second differences of its 16 coefficients bound its second derivatives,
because a polynomial lies in the hull of its coefficients (Farin, Curves and Surfaces for CAGD,
section 6.3). The natural spline solves the usual equations of its slopes (de Boor, A Practical
Guide to Splines, chapter IV).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Bends(NamedTuple):
    """Upper bounds of the second derivatives in each cell (rows, columns), 1/mm."""

    xx: Floats
    xy: Floats
    yy: Floats


class Surface:
    """Heights over a rectangle.

    Args:
        x: Positions of the columns (m,), ascending, mm.
        y: Positions of the rows (n,), ascending, mm.
        heights: Heights (n, m), mm.
        smooth: Whether it is the bicubic natural spline; else it is bilinear.

    Attributes:
        bends: Bounds of the second derivatives in each cell.
        highest: Upper bound of the heights, mm.
    """

    def __init__(self, x: Floats, y: Floats, heights: Floats, *, smooth: bool) -> None:
        self.x, self.y = np.asarray(x, np.float64), np.asarray(y, np.float64)
        values = np.asarray(heights, np.float64)
        self._cells = _cells(self.x, self.y, values, smooth=smooth)
        self.bends = _bends(self.x, self.y, self._cells)
        self.highest = float(self._cells.max())

    def inside(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Return whether points lie on the grid; rounding of 1e-6 mm is allowed."""
        found: NDArray[np.bool_] = (
            (x >= self.x[0] - 1e-6)
            & (x <= self.x[-1] + 1e-6)
            & (y >= self.y[0] - 1e-6)
            & (y <= self.y[-1] + 1e-6)
        )
        return found

    def cell_of(self, x: Floats, y: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return row and column of the cells of points."""
        column = np.clip(np.searchsorted(self.x, x, "right") - 1, 0, len(self.x) - 2)
        row = np.clip(np.searchsorted(self.y, y, "right") - 1, 0, len(self.y) - 2)
        return row, column

    def heights(self, x: Floats, y: Floats) -> Floats:
        """Return the heights at points on the grid, mm."""
        row, column = self.cell_of(x, y)
        u = _basis((x - self.x[column]) / (self.x[column + 1] - self.x[column]))
        v = _basis((y - self.y[row]) / (self.y[row + 1] - self.y[row]))
        found: Floats = np.einsum("nb,nba,na->n", v, self._cells[row, column], u)
        return found


def _basis(u: Floats) -> Floats:
    """Return the cubic Bernstein polynomials (n, 4) at u (n,), limited to 0 to 1."""
    u = np.clip(u, 0.0, 1.0)
    w = 1.0 - u
    return np.stack((w * w * w, 3.0 * w * w * u, 3.0 * w * u * u, u * u * u), axis=1)


def _cells(x: Floats, y: Floats, values: Floats, *, smooth: bool) -> Floats:
    """Return the coefficients of the cells (rows, columns, 4 in y, 4 in x)."""
    if not smooth:
        along = _raised(values)
        return np.swapaxes(_raised(np.swapaxes(along, 0, 2)), 0, 2).transpose(0, 1, 3, 2)
    along_x, along_y = _slopes(x), _slopes(y)
    in_x = _hermite(values, values @ along_x.T, np.diff(x))
    slope_y = along_y @ values
    slope_in_x = _hermite(slope_y, slope_y @ along_x.T, np.diff(x))
    wide = np.moveaxis(in_x, 0, -1), np.moveaxis(slope_in_x, 0, -1)
    both = _hermite(*wide, np.diff(y))
    return np.moveaxis(both, (2, 0, 3, 1), (0, 1, 2, 3))


def _raised(values: Floats) -> Floats:
    """Return straight lines between the last axis' values as cubics (..., n - 1, 4)."""
    part = np.arange(4.0) / 3.0
    found: Floats = values[..., :-1, None] * (1.0 - part) + values[..., 1:, None] * part
    return found


def _hermite(values: Floats, slopes: Floats, steps: Floats) -> Floats:
    """Return cubics (..., n - 1, 4) of the values and slopes along the last axis."""
    third = steps / 3.0
    first, last = values[..., :-1], values[..., 1:]
    found: Floats = np.stack(
        (first, first + slopes[..., :-1] * third, last - slopes[..., 1:] * third, last), axis=-1
    )
    return found


def _slopes(x: Floats) -> Floats:
    """Return the matrix (n, n) from the values of the natural spline to its slopes."""
    n, steps = len(x), np.diff(x)
    left, right = np.zeros((n, n)), np.zeros((n, n))
    for end, inner, first in ((0, 1, 0), (n - 1, n - 2, n - 2)):
        left[end, end], left[end, inner] = 2.0, 1.0
        right[end, first], right[end, first + 1] = -3.0 / steps[first], 3.0 / steps[first]
    for k in range(1, n - 1):
        before, behind = 1.0 / steps[k - 1], 1.0 / steps[k]
        left[k, k - 1 : k + 2] = before, 2.0 * (before + behind), behind
        a, b = 3.0 * before * before, 3.0 * behind * behind
        right[k, k - 1 : k + 2] = -a, a - b, b
    return np.asarray(np.linalg.solve(left, right), np.float64)


def _bends(x: Floats, y: Floats, cells: Floats) -> Bends:
    """Return the bounds of the second derivatives of cells."""
    wide, high = np.diff(x)[None, :], np.diff(y)[:, None]

    def largest(differences: Floats) -> Floats:
        found: Floats = np.abs(differences).max(axis=(2, 3))
        return found

    return Bends(
        6.0 * largest(np.diff(cells, 2, axis=3)) / wide**2,
        9.0 * largest(np.diff(np.diff(cells, axis=3), axis=2)) / (wide * high),
        6.0 * largest(np.diff(cells, 2, axis=2)) / high**2,
    )
