"""A first look at a path, before anything moves: how far it reaches, how long it is, and where it leaves the axes' travel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.canon import ROTARY_LETTERS
from cnc.errors import Diagnostic, MotionLimitError
from cnc.machine.models import Machine
from cnc.path.bounds import bounding_box
from cnc.path.chunk import PathChunk

ROUNDING = 1e-6
"""mm (degrees) by which a path may pass the travel: what arithmetic alone can do to a move that ends on the limit."""

Floats = NDArray[np.float64]


class Survey:
    """Takes a path chunk by chunk.

    length: mm so far. lo, hi (axes,): extent so far, infinite before the first chunk. last_line: source line of the last motion.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.length = 0.0
        self.last_line = 0
        n = len(machine.axes)
        self.lo: Floats = np.full(n, np.inf)
        self.hi: Floats = np.full(n, -np.inf)
        travels = [axis.travel or (-np.inf, np.inf) for axis in machine.axes.values()]
        self._lowest = np.array([low for low, _ in travels]) - ROUNDING
        self._highest = np.array([high for _, high in travels]) + ROUNDING
        self._reported: set[tuple[int, int]] = set()

    def add(self, chunk: PathChunk) -> Iterator[MotionLimitError]:
        """Measure a chunk and yield a ``soft-limit`` fault, without its text, for each line and axis that leaves the travel.

        Bulges count: of arcs and splines the whole curve is compared, not only its end points.
        """
        lo, hi = bounding_box(chunk)
        self.length += float(chunk.length.sum())
        self.lo = np.minimum(self.lo, lo.min(axis=0))
        self.hi = np.maximum(self.hi, hi.max(axis=0))
        self.last_line = int(chunk.line[-1])
        outside = (lo < self._lowest) | (hi > self._highest)
        if outside.any():
            for piece, axis in np.argwhere(outside).tolist():
                line = int(chunk.line[piece])
                if (line, axis) not in self._reported:
                    self._reported.add((line, axis))
                    yield self._fault(chunk, line, axis, float(lo[piece, axis]), float(hi[piece, axis]))

    def box(self) -> dict[str, tuple[float, float]]:
        """Extent by axis; empty without motion."""
        if not np.isfinite(self.lo).all():
            return {}
        return {axis: (low, high) for axis, low, high in zip(self.machine.axes, self.lo.tolist(), self.hi.tolist(), strict=True)}

    def _fault(self, chunk: PathChunk, line: int, axis: int, lo: float, hi: float) -> MotionLimitError:
        letter, limits = list(self.machine.axes.items())[axis]
        travel = limits.travel or (-np.inf, np.inf)
        unit = "degrees" if letter in ROTARY_LETTERS else "mm"
        reached = hi if hi > self._highest[axis] else lo
        return MotionLimitError(
            Diagnostic(
                "soft-limit",
                f"{letter.upper()} would reach {_plain(reached)} {unit}, its travel is {_plain(travel[0])} to {_plain(travel[1])} {unit}",
                chunk.file,
                line,
                hint="move the work offset or the part, or correct axes."
                f"{letter}.travel in the machine file; positions are machine coordinates, after all offsets",
            )
        )


def _plain(value: float) -> str:
    """A coordinate to a micrometre; to more digits where it is less than that beyond a round limit."""
    return f"{value:.7g}"
