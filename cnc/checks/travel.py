"""A first look at a path, before anything moves: its reach and length, where it leaves the axes'
travel, where a spindle outruns it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import AXES, LENGTH, START
from cnc.machine.models import Machine
from cnc.model.blocks import ROTARY_LETTERS, Block, SpindleSync
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.bounds import bounding_box
from cnc.path.chunk import PathChunk

ROUNDING = 1e-6
"""mm (degrees) by which a path may pass the travel: what arithmetic alone can do to a move that
ends on the limit.
"""

Floats = NDArray[np.float64]


class Survey:
    """Takes a path chunk by chunk. slack: mm by which it may leave the travel.

    length: mm so far. lo, hi (axes,): extent so far, infinite before the first chunk. last_line:
    source line of the last motion.
    """

    def __init__(self, machine: Machine, slack: float = ROUNDING) -> None:
        self.machine = machine
        self.length = 0.0
        self.last_line = 0
        n = len(machine.axes)
        self.lo: Floats = np.full(n, np.inf)
        self.hi: Floats = np.full(n, -np.inf)
        travels = [axis.travel or (-np.inf, np.inf) for axis in machine.axes.values()]
        self._lowest = np.array([low for low, _ in travels]) - slack
        self._highest = np.array([high for _, high in travels]) + slack
        self._reported: set[tuple[int, int]] = set()
        self._pitch = 0.0
        self._fastest = np.array([axis.max_velocity for axis in machine.axes.values()])

    def add(self, chunk: PathChunk) -> Iterator[MotionLimitError]:
        """Measure a chunk and yield a ``soft-limit`` fault, without its text, for each line and
        axis that leaves the travel.

        Bulges count: of arcs and splines the whole curve is compared, not only its end points.
        Moves that follow the spindle faster than the machine goes are a ``spindle-too-fast`` fault:
        to make them slower would spoil the thread.
        """
        if self._pitch:
            yield from self._driven(chunk)
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
                    yield self._fault(
                        chunk, line, axis, float(lo[piece, axis]), float(hi[piece, axis])
                    )

    def between(self, block: Block) -> None:
        """Take note of a block between the moves."""
        if isinstance(block, SpindleSync):
            self._pitch = block.pitch

    def _driven(self, chunk: PathChunk) -> Iterator[MotionLimitError]:
        """Straight moves, all of them following the spindle."""
        most = self.machine.path.max_feed
        for at, feed, line in zip(
            chunk.at.tolist(), chunk.feed.tolist(), chunk.line.tolist(), strict=True
        ):
            n = int(chunk.data[at + AXES])
            start, end = chunk.data[at + START : at + START + 2 * n].reshape(2, n)
            speed = np.abs(end - start) / chunk.data[at + LENGTH] * feed
            excess = float(max((speed / self._fastest).max(), feed / most))
            if excess > 1.0 + ROUNDING and (line, -1) not in self._reported:
                self._reported.add((line, -1))
                message = f"to follow the spindle the tool would have to move at {feed:.7g} mm/s, {excess:.3g} times what the machine can do"
                hint = "lower S, or raise the axes' max_velocity or path.max_feed in the machine file if the machine can do more"
                yield MotionLimitError(
                    Diagnostic("spindle-too-fast", message, chunk.file, line, hint=hint)
                )

    def box(self) -> dict[str, tuple[float, float]]:
        """Extent by axis; empty without motion."""
        if not np.isfinite(self.lo).all():
            return {}
        return {
            axis: (low, high)
            for axis, low, high in zip(
                self.machine.axes, self.lo.tolist(), self.hi.tolist(), strict=True
            )
        }

    def _fault(
        self, chunk: PathChunk, line: int, axis: int, lo: float, hi: float
    ) -> MotionLimitError:
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
    """A coordinate to a micrometre; to more digits where it is less than that beyond a round
    limit.
    """
    return f"{value:.7g}"
