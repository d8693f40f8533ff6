r"""A margin at the ends of the travel, so that rounding never trips a soft limit of the board.

GRBL compares every target with its travel to the last bit of a 32-bit float (gcode_guide.md and
settings.md, ``$20``; ALARM:2). It reports its offsets with three decimals only, so a target may lie
half a micrometre from where the line was meant to lead. An arc that is fitted to a path may bulge
by the tolerance.

    travel ..............................    points in the margin are moved inside, at most
    margin  _ _ _ _ _ _ _ _ _ _ _ _ _ _ _    by the width of the margin; no arc turns back
              path  ____________________       beyond its middle
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.number_format import board_axes
from cnc.kernels.grbl_lines.arc_fit import arc_stays_inside
from cnc.machine.models import Machine

Floats = NDArray[np.float64]

MARGIN = 8e-4
"""mm: half a thousandth of rounding in the offset, and the rounding of words and 32-bit floats."""
BULGE = 1e-4
"""mm by which an arc may come nearer to the end of the travel than the margin."""
MIN_ARC_CLEARANCE = 3e-4
"""mm from the end of the travel to an arc, where there is no margin."""


@dataclass(frozen=True, slots=True)
class TravelMargin:
    """The travel of a machine and the limits of lines and arcs in it.

    Attributes:
        bottom: Lowest position of each axis of the board (n,), mm; minus infinity without travel.
        top: Highest position (n,), mm.
        low: Lowest position at which an arc may turn back (n,), mm.
        high: Highest position at which an arc may turn back (n,), mm.
        margin: Distance of lines from the ends of the travel, mm.
    """

    bottom: Floats
    top: Floats
    low: Floats
    high: Floats
    margin: float

    @classmethod
    def of(cls, machine: Machine, margin: float) -> TravelMargin:
        """Return the travel of a machine with a margin in mm."""
        letters = board_axes(machine.axes)
        axes = [machine.axes.get(letter) for letter in letters]
        spans = [
            (-np.inf, np.inf) if axis is None or axis.travel is None else axis.travel
            for axis in axes
        ]
        bottom, top = np.array(spans).T
        away = max(margin - BULGE, MIN_ARC_CLEARANCE)
        return cls(bottom, top, bottom + away, top - away, margin)

    def inside(self, points: Floats) -> Floats:
        """Return points (k, n) with those in the margin moved out of it.

        Points beyond the travel stay, because no place is right for them.
        """
        if not self.margin:
            return points
        low, high = self.bottom + self.margin, self.top - self.margin
        points = np.where((points < low) & (points >= self.bottom - self.margin), low, points)
        return np.where((points > high) & (points <= self.top + self.margin), high, points)

    def holds_arc(
        self, plane: tuple[int, int], center: tuple[float, float], start: Floats, sweep: float
    ) -> bool:
        """Return whether an arc stays inside where it turns back along an axis.

        Args:
            plane: Columns of the two axes of its plane.
            center: Centre along these axes, mm.
            start: Start point (n,), mm.
            sweep: Angle in rad, positive for counter-clockwise.
        """
        i, j = plane
        x, y = float(start[i]) - center[0], float(start[j]) - center[1]
        return bool(arc_stays_inside(plane, center, (x, y), sweep, self.low, self.high))
