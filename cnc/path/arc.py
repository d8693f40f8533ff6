"""Arcs, helices and slight spirals: the Curve protocol over arc records, one for each turn."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Self

import numpy as np

from cnc.model.blocks import PLANE_AXES, ArcFeed, Plane
from cnc.path.curve import RecordCurve
from cnc.path.records import Floats, Records, arc_records


class Arc(RecordCurve):
    """An arc, helix or spiral.

    Args:
        axes: names of the axes.
        start: (n,) mm.
        end: (n,) mm.
        plane: its plane.
        center: first and second axis of the plane, mm.
        turns: whole and part turns, counter-clockwise positive.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        start: Floats,
        end: Floats,
        plane: Plane,
        center: tuple[float, float],
        turns: float,
    ) -> None:
        super().__init__(axes)
        self.start = np.array(start, np.float64)
        self.end = np.array(end, np.float64)
        self.plane: Plane = plane
        self.center = center
        self.turns = turns

    def records(self, accuracy: float) -> Iterable[Records]:
        """Yield one record for each turn."""
        first, second = PLANE_AXES[self.plane]
        plane = self.axes.index(first), self.axes.index(second)
        yield from arc_records(
            self.start, self.end, plane, self.center, self.turns, self._classes, accuracy
        )

    def subsegment(self, ua: float, ub: float) -> Self:
        """Return the part from ua to ub, its parameter starting at 0 again.

        The angle is proportional to u, and so are the turns.
        """
        u0, u1 = self.u_range
        return type(self)(
            self.axes,
            self.eval(ua),
            self.eval(ub),
            self.plane,
            self.center,
            self.turns * (ub - ua) / (u1 - u0),
        )


def arc_chords(block: ArcFeed, begin: Floats, axes: tuple[str, ...], sagitta: float) -> Floats:
    """Return the ends (n, axes) of chords within ``sagitta`` mm of an arc from ``begin`` (axes,).

    The sagitta of a chord over an angle h is at most r h^2 / 8. A spiral bends little more.
    """
    plane = [axes.index(letter) for letter in PLANE_AXES[block.plane]]
    center, end = np.array(block.center), np.asarray(block.end, np.float64)
    here = begin[plane] - center
    radius, last = float(np.hypot(*here)), float(np.hypot(*(end[plane] - center)))
    sweep = 2.0 * math.pi * block.turns
    part = math.sqrt(8.0 * sagitta / (1.1 * max(radius, last, 1e-9)))
    count = max(math.ceil(abs(sweep) / min(part, math.pi / 4.0)), 1)
    share = np.arange(1, count + 1) / count
    points: Floats = begin + share[:, None] * (end - begin)
    angle = math.atan2(here[1], here[0]) + share * sweep
    radii = radius + share * (last - radius)
    points[:, plane[0]] = center[0] + radii * np.cos(angle)
    points[:, plane[1]] = center[1] + radii * np.sin(angle)
    points[-1] = end
    return points
