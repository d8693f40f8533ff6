"""Blocks of the rows of compiled code (:mod:`cnc.kernels.gcode.rows`)."""

from __future__ import annotations

from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.state.modal_groups import PLANES, SPINDLE_STATES
from cnc.kernels.gcode import rows as kernel
from cnc.model.blocks import (
    ArcFeed,
    Block,
    CallBoundary,
    Coolant,
    Dwell,
    PathMode,
    Spindle,
)
from cnc.model.many_blocks import blocks_of

_PLANES = tuple(PLANES.values())


class RowBlocks:
    """Conversion of rows that are no straight moves."""

    def __init__(self, rows: kernel.Rows, file: str, tolerance: float, *, laser: bool) -> None:
        """Begin a conversion.

        Args:
            rows: The rows.
            file: The program that they come from.
            tolerance: Tolerance of the blends of G64, mm.
            laser: Whether S is the power of a laser.
        """
        self._rows, self._file = rows, file
        self._tolerance, self._laser = tolerance, laser

    def of(self, numbers: NDArray[np.intp]) -> list[Block]:
        """Return the blocks of some rows, given by their numbers."""
        kinds = self._rows.kinds[numbers]
        different = set(kinds.tolist())
        if len(different) == 1:
            return self._of_kind(different.pop(), numbers)
        found = {kind: iter(self._of_kind(kind, numbers[kinds == kind])) for kind in different}
        # Each next block is the next one of the kind of its row.
        return [next(found[kind]) for kind in kinds.tolist()]

    def _of_kind(self, kind: int, numbers: NDArray[np.intp]) -> list[Block]:
        """Return the blocks of rows of one kind."""
        rows, files = self._rows, repeat(self._file)
        lines, data = rows.lines[numbers].tolist(), rows.data[numbers].T
        if kind == kernel.ARC:
            planes = map(_PLANES.__getitem__, data[4].astype(np.intp).tolist())
            centers = zip(*data[:2].tolist(), strict=True)
            ends, feeds = list(rows.points[numbers]), rows.feeds[numbers].tolist()
            return blocks_of(
                ArcFeed, files, lines, planes, centers, ends, *data[2:4].tolist(), feeds,
                repeat(False),
            )  # fmt: skip
        if kind == kernel.SPINDLE:
            states = map(SPINDLE_STATES.__getitem__, data[0].astype(np.intp).tolist())
            in_motion = map(bool, data[2].tolist()) if self._laser else repeat(False)
            speeds = data[1].tolist()
            return blocks_of(Spindle, files, lines, states, speeds, repeat(0.0), in_motion)
        first = data[0].tolist()
        if kind == kernel.COOLANT:
            return blocks_of(Coolant, files, lines, map(bool, first), map(bool, data[1].tolist()))
        if kind == kernel.BOUNDARY:
            # Calls of the main program are marked, whose file this is.
            return blocks_of(CallBoundary, files, lines, map(bool, first))
        if kind == kernel.PATH:
            controls = ["blend" if blends else "exact-path" for blends in first]
            tolerances = [self._tolerance if blends else 0.0 for blends in first]
            return blocks_of(PathMode, files, lines, controls, tolerances)
        return blocks_of(Dwell, files, lines, first)
