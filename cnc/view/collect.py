"""Takes a plan as it goes by and keeps what a picture needs of it, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import SPAN
from cnc.kernels.view.thinning import (
    AT_END,
    ENTERED,
    FOLLOWED,
    MARK,
    PHASE,
    PIECE,
    STAGE,
    A,
    J,
    T,
    V,
    follow,
)
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell
from cnc.planner.plan import PlanChunk
from cnc.planner.run_clock import RunClock
from cnc.pulses.arrays import kernel_arrays
from cnc.view.tables import Curves, CurveTable, Origins, OriginTable, Strokes, StrokeTable

ROWS = 1 << 15
"""Points that are followed at a time."""
DRAWN_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much of a motion is kept: strokes of the path, rows of the curves, rows of source
    lines.
    """

    strokes: int
    curves: int
    origins: int


@dataclass(frozen=True, slots=True)
class Picture:
    """What there is to draw. ``moves``: so many changes of the source line, or fewer, share a row
    of ``origins``.
    """

    strokes: Strokes
    curves: Curves
    origins: Origins
    files: list[str]
    moves: int
    duration: float


class Collector:
    """``add`` what the planner yields, in order; then ``picture``."""

    def __init__(
        self, machine: Machine, sizes: Sizes, program: str, start: NDArray[np.float64]
    ) -> None:
        """The program's name comes first of the files; ``start`` (axes,) is where it begins, in
        mm.
        """
        names = machine.axis_names
        self._columns = np.array(
            [names.index(axis) if axis in names else -1 for axis in DRAWN_AXES]
        )
        self._start = np.array([start[column] if column >= 0 else 0.0 for column in self._columns])
        self._strokes = StrokeTable(sizes.strokes)
        self._curves = CurveTable(sizes.curves)
        self._origins = OriginTable(sizes.origins, program)
        self._out = np.empty((ROWS, FOLLOWED))
        self._clock = RunClock()
        self._curves.add(np.zeros((1, 4)))

    def add(self, item: PlanChunk | Block) -> None:
        """A stretch of the plan, or a block between the moves."""
        if isinstance(item, PlanChunk):
            self._follow(item)
        elif isinstance(item, Dwell):
            self._origins.add(
                np.array([self._clock.seconds]), np.array([item.line]), item.file, np.array([False])
            )
        self._clock.add(item)

    def picture(self) -> Picture:
        """All of it; nothing may be added after it."""
        origins, files = self._origins.origins()
        strokes, curves = (
            self._strokes.strokes(self._start),
            self._curves.curves(self._clock.seconds),
        )
        return Picture(strokes, curves, origins, files, self._origins.moves, self._clock.seconds)

    def _follow(self, chunk: PlanChunk) -> None:
        arrays = kernel_arrays(chunk)
        kind, line = arrays[0], arrays[4]
        rapid = np.isnan(chunk.path.feed)
        place, now = np.zeros(3, np.int64), np.zeros(1)
        while place[STAGE] != AT_END:
            count = follow(
                *arrays[:4],
                *arrays[5:],
                chunk.t0,
                chunk.s0,
                rapid,
                self._columns,
                self._strokes.fine,
                place,
                now,
                self._out,
            )
            points = self._out[:count]
            self._strokes.add(points)
            marks = points[:, MARK].astype(np.int64)
            self._curves.add(points[(marks & PHASE) != 0][:, [T, V, A, J]])
            entered = points[(marks & ENTERED) != 0]
            pieces = entered[:, PIECE].astype(np.int64)
            self._origins.add(entered[:, T], line[pieces], chunk.path.file, kind[pieces] == SPAN)


def stock_box(machine: Machine) -> list[list[float]] | None:
    """Least and greatest x, y and z of the raw part; None without one."""
    return (
        None
        if machine.stock is None
        else [list(getattr(machine.stock, axis)) for axis in DRAWN_AXES]
    )


def travel_box(machine: Machine) -> list[list[float]] | None:
    """Least and greatest position of x, y and z; None where one of them has no limits."""
    axes: dict[str, tuple[float, float] | None] = {
        letter: axis.travel for letter, axis in machine.axes.items() if letter in DRAWN_AXES
    }
    if not axes or None in axes.values():
        return None
    return [list(axes.get(letter) or (0.0, 0.0)) for letter in DRAWN_AXES]
