"""Straight moves: the Curve protocol over a line record, with u as the arc length."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

import numpy as np

from cnc.path.curve import RecordCurve
from cnc.path.records import Floats, Records, line_records, moving


class Line(RecordCurve):
    """A straight move from ``start`` to ``end`` (n,), longer than 1e-9 mm."""

    def __init__(self, axes: tuple[str, ...], start: Floats, end: Floats) -> None:
        super().__init__(axes)
        self.start = np.array(start, np.float64)
        self.end = np.array(end, np.float64)

    def records(self, accuracy: float) -> Iterable[Records]:
        """Yield one record, if there is any motion."""
        if moving(self.start, self.end[None])[0]:
            yield line_records(self.start, self.end[None], self._classes)

    def subsegment(self, ua: float, ub: float) -> Self:
        """Return the part from ua to ub, its parameter starting at 0 again."""
        return type(self)(self.axes, self.eval(ua), self.eval(ub))
