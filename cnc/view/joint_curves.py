"""Curves of the joints over time, for machines whose joints are not the axes of the tool tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

QUANTITIES = ("position", "velocity", "acceleration")


@dataclass(frozen=True, slots=True)
class JointCurves:
    """Ranges of position, velocity and acceleration of each joint, in rows of equal time.

    Attributes:
        t: (m + 1,) ends of the rows, s.
        low: (m, 3, n) least values in each row: mm or degrees, and s.
        high: (m, 3, n) greatest values.
    """

    t: Floats
    low: Floats
    high: Floats


class JointTable:
    """Collects samples of the joints.

    A row has the least and the greatest values of the samples in its time. A table of more than
    ``most`` rows gets rows of twice the time. Velocity and acceleration are differences of the
    samples, as a drive computes them; each belongs to the row of its last sample.

    Args:
        most: largest number of rows.
        joints: number of joints.
        period: time from sample to sample, s.
    """

    def __init__(self, most: int, joints: int, period: float) -> None:
        self.most = max(most - most % 2, 4)
        self._period = period
        self._width = 1
        self._count = 0
        self._last = np.empty((0, joints))
        self._low = np.full((self.most, 3, joints), np.inf)
        self._high = np.full((self.most, 3, joints), -np.inf)

    def add(self, position: Floats) -> None:
        """Add positions (k, joints), one each period. The first two are at rest."""
        if not len(position):
            return
        before = self._last if len(self._last) else np.repeat(position[:1], 2, axis=0)
        known = np.concatenate((before, position))
        self._last = known[-2:]
        speed = np.diff(known, axis=0) / self._period
        accel = np.diff(speed, axis=0) / self._period
        values = np.stack((position, speed[1:], accel), axis=1)
        while self._count + len(values) > self.most * self._width:
            self._coarsen()
        row = (self._count + np.arange(len(values))) // self._width
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        rows = row[starts]
        low, high = self._low, self._high
        low[rows] = np.minimum(low[rows], np.minimum.reduceat(values, starts))
        high[rows] = np.maximum(high[rows], np.maximum.reduceat(values, starts))
        self._count += len(values)

    def curves(self) -> JointCurves:
        """Return the curves."""
        rows = -(-self._count // self._width)
        t: Floats = np.arange(rows + 1, dtype=np.float64) * (self._width * self._period)
        return JointCurves(t, self._low[:rows], self._high[:rows])

    def _coarsen(self) -> None:
        half = self.most // 2
        for table, reduce, empty in (
            (self._low, np.minimum, np.inf),
            (self._high, np.maximum, -np.inf),
        ):
            table[:half] = reduce(table[::2], table[1::2])
            table[half:] = empty
        self._width *= 2
