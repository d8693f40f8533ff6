"""Arcs that may be meant for something else: nearly full circles, and radii that differ within the
dialect's tolerance.

An arc that ends where it begins is a full circle. One that ends a rounding error beside that is a
circle with a gap, or, on the other side, an arc of next to nothing where a circle was meant to be
cut:

      .--.              .--.
     (    ) <- gap           ' <- all that is cut
      '--'
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.geometry.arcs import SAME_POINT
from cnc.machine.models import Machine
from cnc.model.blocks import PLANE_AXES, ArcFeed
from cnc.model.diagnostics import Diagnostic

NEARLY_CLOSED, OF_RADIUS = 0.01, 0.01
"""mm, and share of the radius: an arc whose ends are as near, and not the same, was meant for a
full circle.
"""
DRIFT = 2.5e-3
"""mm. Less is what start, end and centre with three decimals each can make the radii at both ends
differ by.
"""

Floats = NDArray[np.float64]


class Arcs:
    """Takes arcs in their order."""

    def __init__(self, machine: Machine) -> None:
        self._names = machine.axis_names
        self._open: list[Diagnostic] = []
        self._drifting = 0
        self._worst = 0.0
        self._first: tuple[str, int] = "", 0

    def see(self, arc: ArcFeed, start: Floats) -> None:
        """An arc that begins at ``start`` (axes,) mm."""
        columns = [self._names.index(axis) for axis in PLANE_AXES[arc.plane]]
        begin, end = start[columns].tolist(), arc.end[columns].tolist()
        gap = math.dist(begin, end)
        if SAME_POINT < gap <= min(NEARLY_CLOSED, OF_RADIUS * arc.radius):
            cut = (
                "it does not close"
                if abs(arc.turns) > 0.5
                else f"next to nothing is cut, {abs(arc.turns):.2g} of a turn"
            )
            message = f"this circle ends {gap:.3g} mm from where it begins: {cut}"
            hint = (
                "let it end where it begins, to the last digit; if a short move is meant, write G1"
            )
            self._open.append(
                Diagnostic(
                    "arc-not-closed", message, arc.file, arc.line, hint=hint, severity="warning"
                )
            )
        drift = abs(math.dist(end, arc.center) - arc.radius)
        if drift > DRIFT:
            if not self._drifting:
                self._first = arc.file, arc.line
            self._drifting += 1
            self._worst = max(self._worst, drift)

    def findings(self) -> Iterator[Diagnostic]:
        """What was found, once all arcs have gone by."""
        yield from self._open
        if self._drifting:
            count = "1 arc is" if self._drifting == 1 else f"{self._drifting} arcs are"
            message = f"the radius changes by up to {self._worst:.3g} mm between the arc's ends; {count} cut as a spiral"
            hint = "write centre and end with more digits, or mend the centre"
            yield Diagnostic("arc-radius-drift", message, *self._first, hint=hint, severity="note")
