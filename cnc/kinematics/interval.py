"""Intervals of numbers, as arrays: bounds of a formula over a range of its arguments.

The result of an operation contains every value that the operation has on numbers of its operands
(Moore, Kearfott, Cloud, Introduction to Interval Analysis, 2009, chapter 2). Rounding is not
counted: the bounds are used for errors that are many orders of magnitude above it. An operation
that is not defined somewhere in its operand gives infinite bounds there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Closed intervals.

    Attributes:
        lo: (m,): lower ends.
        hi: (m,): upper ends.
    """

    __array_ufunc__ = None
    """numpy leaves an operation with an array on the left to this class."""

    lo: Floats
    hi: Floats

    def __add__(self, other: Interval | Floats | float) -> Interval:
        low, high = _ends(other)
        return Interval(self.lo + low, self.hi + high)

    __radd__ = __add__

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __sub__(self, other: Interval | Floats | float) -> Interval:
        low, high = _ends(other)
        return Interval(self.lo - high, self.hi - low)

    def __rsub__(self, other: Floats | float) -> Interval:
        return -self + other

    def __mul__(self, other: Interval | Floats | float) -> Interval:
        with np.errstate(over="ignore", invalid="ignore"):  # an infinite end is right
            if isinstance(other, Interval):
                a, b = self.lo * other.lo, self.lo * other.hi
                c, d = self.hi * other.lo, self.hi * other.hi
                return _hull(a, b, c, d)
            return _hull(self.lo * other, self.hi * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Interval | Floats | float) -> Interval:
        low, high = _ends(other)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            inverse = Interval(np.asarray(1.0 / high), np.asarray(1.0 / low))
        through_zero = (np.asarray(low) <= 0.0) & (np.asarray(high) >= 0.0)
        return self * _unbounded(inverse, through_zero)

    def square(self) -> Interval:
        """Return the squares, which are not negative."""
        low, high = np.abs(self.lo), np.abs(self.hi)
        across = (self.lo <= 0.0) & (self.hi >= 0.0)
        return Interval(
            np.where(across, 0.0, np.minimum(low, high) ** 2), np.maximum(low, high) ** 2
        )

    def sqrt(self) -> Interval:
        """Return the square roots."""
        root = Interval(np.sqrt(np.maximum(self.lo, 0.0)), np.sqrt(np.maximum(self.hi, 0.0)))
        return _unbounded(root, ~(self.lo >= 0.0))


def atan2(y: Interval, x: Interval) -> Interval:
    """Return the angles of the points of boxes, rad.

    They are [-pi, pi] where a box meets the negative x axis. The angle of another box is extreme at
    a corner.
    """
    corners = [np.arctan2(b, a) for b in (y.lo, y.hi) for a in (x.lo, x.hi)]
    angles = _hull(*corners)
    jumps = (x.lo <= 0.0) & (y.lo <= 0.0) & (y.hi >= 0.0)
    return Interval(np.where(jumps, -np.pi, angles.lo), np.where(jumps, np.pi, angles.hi))


def _ends(value: Interval | Floats | float) -> tuple[Floats | float, Floats | float]:
    return (value.lo, value.hi) if isinstance(value, Interval) else (value, value)


def _hull(*numbers: Floats) -> Interval:
    """Return the least intervals that hold all of the numbers; unbounded where one is undefined."""
    low = high = numbers[0]
    for number in numbers[1:]:
        low, high = np.minimum(low, number), np.maximum(high, number)
    # Both are undefined where a number is.
    undefined = np.isnan(low)
    hull = Interval(low, high)
    return _unbounded(hull, undefined) if undefined.any() else hull


def _unbounded(value: Interval, where: NDArray[np.bool_]) -> Interval:
    return Interval(np.where(where, -np.inf, value.lo), np.where(where, np.inf, value.hi))


def cosine(angle: Interval) -> Interval:
    """Return the cosines of ranges of angles, rad."""
    ends = np.cos(angle.lo), np.cos(angle.hi)
    turn = 2.0 * np.pi
    # A multiple of the turn inside makes the cosine 1 there; half a turn further it is -1.
    top = np.floor(angle.hi / turn) >= np.ceil(angle.lo / turn)
    bottom = np.floor((angle.hi - np.pi) / turn) >= np.ceil((angle.lo - np.pi) / turn)
    return Interval(
        np.where(bottom, -1.0, np.minimum(*ends)), np.where(top, 1.0, np.maximum(*ends))
    )
