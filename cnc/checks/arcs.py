"""Suspicious arcs: circles that do not close, and radii that change along the arc.

An arc that ends at its start point is a full circle. If the end misses the start by a rounding
error, the circle has a gap. If it lies on the other side, hardly anything is cut:

      .--.              .--.
     (    ) <- gap           ' <- all that is cut
      '--'
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.arcs import SAME_POINT
from cnc.machine.models import Machine
from cnc.model.blocks import PLANE_AXES, ArcFeed
from cnc.model.diagnostics import Diagnostic

MAX_GAP, MAX_GAP_RATIO = 0.01, 0.01
"""mm, and ratio to the radius. An arc with a smaller gap is probably intended as a full circle."""
MIN_DRIFT = 2.5e-3
"""mm. Start, end and centre with three decimals each explain a smaller difference of the radii."""

Floats = NDArray[np.float64]


class ArcCheck:
    """Checks the arcs of a program in their order."""

    def __init__(self, machine: Machine) -> None:
        self._names = machine.axis_names
        self._open: list[Diagnostic] = []
        self._drifting = 0
        self._max_drift = 0.0
        self._first: tuple[str, int] = "", 0

    def add(self, arc: ArcFeed, start: Floats) -> None:
        """Check an arc that begins at ``start`` (axes,) mm."""
        columns = [self._names.index(axis) for axis in PLANE_AXES[arc.plane]]
        begin, end = start[columns].tolist(), arc.end[columns].tolist()
        gap = math.dist(begin, end)
        if SAME_POINT < gap <= min(MAX_GAP, MAX_GAP_RATIO * arc.radius):
            cut = (
                "it does not close"
                if abs(arc.turns) > 0.5
                else f"only {abs(arc.turns):.2g} of a turn is cut"
            )
            message = f"this circle ends {gap:.3g} mm from its start point: {cut}"
            hint = "write exactly the start point as the end point; for a short move write G1"
            self._open.append(
                Diagnostic(
                    "arc-not-closed", message, arc.file, arc.line, hint=hint, severity="warning"
                )
            )
        drift = abs(math.dist(end, arc.center) - arc.radius)
        if drift > MIN_DRIFT:
            if not self._drifting:
                self._first = arc.file, arc.line
            self._drifting += 1
            self._max_drift = max(self._max_drift, drift)

    def findings(self) -> Iterator[Diagnostic]:
        """Yield the findings after the last arc."""
        yield from self._open
        if self._drifting:
            count = "1 arc is" if self._drifting == 1 else f"{self._drifting} arcs are"
            message = (
                f"the radius changes by up to {self._max_drift:.3g} mm along the arc; "
                f"{count} cut as a spiral"
            )
            hint = "write centre and end point with more digits, or correct the centre"
            yield Diagnostic("arc-radius-drift", message, *self._first, hint=hint, severity="note")
