r"""The travel that is left to lines, so that no soft limit stops what the program itself keeps to.

GRBL compares every target with its travel to the last bit of a 32-bit float (gcode_guide.md and
settings.md, ``$20``; ALARM:2), but tells its offsets with three decimals only: what a line names
may lie by half a micrometre elsewhere than it was meant to. And an arc that is fitted to a path may
bulge by the tolerance.

         travel ............................................    what lies in the margin along it is moved inside, at most by
         margin  _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _ _    its width; no arc turns back beyond its middle
                   path  ________________________
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.grbl_lines.arc_fit import arc_stays
from cnc.machine.models import Machine

Floats = NDArray[np.float64]

MARGIN = 8e-4
"""mm: half a thousandth by which an offset may have been rounded, and what the digits of words and
32-bit floats add to that.
"""
BULGE = 1e-4
"""mm: by which an arc may come nearer to the travel than the margin."""
LEAST = 3e-4
"""mm: from the travel to an arc, where there is no margin."""


@dataclass(frozen=True, slots=True)
class TravelMargin:
    """Of x, y, z (3,), mm, infinite without travel: lowest and highest place of the travel, and
    between which arcs turn back.
    """

    bottom: Floats
    top: Floats
    low: Floats
    high: Floats
    margin: float

    @classmethod
    def of(cls, machine: Machine, margin: float) -> TravelMargin:
        """The travel of a machine. margin: mm, by which lines keep away from its ends."""
        axes = [machine.axes.get(letter) for letter in ("x", "y", "z")]
        spans = [
            (-np.inf, np.inf) if axis is None or axis.travel is None else axis.travel
            for axis in axes
        ]
        bottom, top = np.array(spans).T
        away = max(margin - BULGE, LEAST)
        return cls(bottom, top, bottom + away, top - away, margin)

    def inside(self, points: Floats) -> Floats:
        """Points (k, 3) with those in the margin moved out of it; what is beyond the travel stays,
        because there nothing is right.
        """
        if not self.margin:
            return points
        low, high = self.bottom + self.margin, self.top - self.margin
        points = np.where((points < low) & (points >= self.bottom - self.margin), low, points)
        return np.where((points > high) & (points <= self.top + self.margin), high, points)

    def holds(
        self, plane: tuple[int, int], center: tuple[float, float], start: Floats, sweep: float
    ) -> bool:
        """Whether an arc from ``start`` (3,) about a centre in the plane of two columns keeps
        inside where it turns back.
        """
        i, j = plane
        x, y = float(start[i]) - center[0], float(start[j]) - center[1]
        return bool(arc_stays(i, j, center[0], center[1], x, y, sweep, self.low, self.high))
