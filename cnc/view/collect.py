"""Collection of the data of a picture from a plan, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import Block, Dwell
from cnc.model.streams import SampleChunk
from cnc.path.kernels.curve import SPAN
from cnc.planner.joints import Joints
from cnc.planner.plan import PlanChunk, RunClock
from cnc.pulses.arrays import pieces_of, plan_arrays, source_lines
from cnc.pulses.sampled import Sampled
from cnc.view.kernels.motion import (
    AT_END,
    ENTERED,
    PHASE,
    PROGRESS,
    Origin,
    Route,
    follow,
    new_followed,
)
from cnc.view.tables import Curves, CurveTable, Origins, OriginTable, Strokes, StrokeTable

# Curves of the joints over time, for machines whose joints are not the axes of the tool tip.

Floats = NDArray[np.float64]

QUANTITIES = ("position", "velocity", "acceleration")


@dataclass(frozen=True, slots=True)
class JointCurves:
    """Ranges of position, velocity and acceleration of each joint, in rows of equal time.

    Attributes:
        t: (m + 1,) ends of the rows, s.
        low: (m, 3, n) least values in each row: mm or degrees, and s.
        high: (m, 3, n) greatest values.
    """

    t: Floats
    low: Floats
    high: Floats


class JointTable:
    """Collects samples of the joints.

    A row has the least and the greatest values of the samples in its time. A table of more than
    ``most`` rows gets rows of twice the time. Velocity and acceleration are differences of the
    samples, as a drive computes them; each belongs to the row of its last sample.

    Args:
        most: largest number of rows.
        joints: number of joints.
        period: time from sample to sample, s.
    """

    def __init__(self, most: int, joints: int, period: float) -> None:
        self.most = max(most - most % 2, 4)
        self._period = period
        self._width = 1
        self._count = 0
        self._last = np.empty((0, joints))
        self._low = np.full((self.most, 3, joints), np.inf)
        self._high = np.full((self.most, 3, joints), -np.inf)

    def add(self, position: Floats) -> None:
        """Add positions (k, joints), one each period. The first two are at rest."""
        if not len(position):
            return
        before = self._last if len(self._last) else np.repeat(position[:1], 2, axis=0)
        positions = np.concatenate((before, position))
        self._last = positions[-2:]
        speed = np.diff(positions, axis=0) / self._period
        accel = np.diff(speed, axis=0) / self._period
        values = np.stack((position, speed[1:], accel), axis=1)
        while self._count + len(values) > self.most * self._width:
            self._coarsen()
        row = (self._count + np.arange(len(values))) // self._width
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        rows = row[starts]
        low, high = self._low, self._high
        low[rows] = np.minimum(low[rows], np.minimum.reduceat(values, starts))
        high[rows] = np.maximum(high[rows], np.maximum.reduceat(values, starts))
        self._count += len(values)

    def curves(self) -> JointCurves:
        """Return the curves."""
        rows = -(-self._count // self._width)
        t: Floats = np.arange(rows + 1, dtype=np.float64) * (self._width * self._period)
        return JointCurves(t, self._low[:rows], self._high[:rows])

    def _coarsen(self) -> None:
        half = self.most // 2
        for table, reduce, empty in (
            (self._low, np.minimum, np.inf),
            (self._high, np.maximum, -np.inf),
        ):
            table[:half] = reduce(table[::2], table[1::2])
            table[half:] = empty
        self._width *= 2


ROWS = 1 << 15
"""Points that are computed at a time."""
DRAWN_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Sizes:
    """Largest numbers of strokes, of rows of the curves, and of rows of source lines.

    joints: of rows of the joints' curves; 0 for none.
    """

    strokes: int
    curves: int
    origins: int
    joints: int = 0


@dataclass(frozen=True, slots=True)
class Picture:
    """The data to draw.

    Attributes:
        strokes: the path.
        curves: feed, acceleration and jerk over time.
        origins: source lines over time.
        files: files by index; the program is the first.
        moves: largest number of changes of the source line in one row of ``origins``.
        duration: machine time with dwells, s.
        joints: curves of the joints; None where they are the axes.
    """

    strokes: Strokes
    curves: Curves
    origins: Origins
    files: list[str]
    moves: int
    duration: float
    joints: JointCurves | None = None


class Collector:
    """Collects a plan: ``add`` its parts in order, then take the ``picture``."""

    def __init__(
        self, machine: Machine, sizes: Sizes, program: str, start: NDArray[np.float64]
    ) -> None:
        """Prepare the tables.

        Args:
            machine: gives the names of the axes.
            sizes: sizes of the tables.
            program: name of the program, the first of the files.
            start: (axes,) position at the start, mm.
        """
        names = machine.axis_names
        self._columns = np.array(
            [names.index(axis) if axis in names else -1 for axis in DRAWN_AXES]
        )
        self._start = np.array([start[column] if column >= 0 else 0.0 for column in self._columns])
        self._strokes = StrokeTable(sizes.strokes)
        self._curves = CurveTable(sizes.curves)
        self._origins = OriginTable(sizes.origins, program)
        self._out = new_followed(ROWS)
        self._clock = RunClock()
        self._curves.add(np.zeros((1, 4)))
        self._sampler: Sampled | None = None
        if machine.tip_columns and sizes.joints:
            self._sampler = Sampled(machine.path.period, Joints(machine).columns(start))
            self._joints = JointTable(sizes.joints, len(machine.joint_tables), machine.path.period)
            self._first_joint = machine.tip_columns

    def add(self, item: PlanChunk | Block) -> None:
        """Add a part of the plan, or a block between the moves."""
        if isinstance(item, PlanChunk):
            self._follow(item)
            if self._sampler is not None:
                self._take_samples(self._sampler.samples(item))
        elif isinstance(item, Dwell):
            self._origins.add(
                np.array([self._clock.seconds]), np.array([item.line]), item.file, np.array([False])
            )
        self._clock.add(item)

    def picture(self) -> Picture:
        """Return the picture. Nothing may be added afterwards."""
        origins, files = self._origins.origins()
        joints = None
        if self._sampler is not None:
            self._take_samples(self._sampler.finish(self._clock.seconds))
            joints = self._joints.curves()
        return Picture(
            self._strokes.strokes(self._start),
            self._curves.curves(self._clock.seconds),
            origins,
            files,
            self._origins.moves,
            self._clock.seconds,
            joints,
        )

    def _take_samples(self, samples: Iterator[SampleChunk]) -> None:
        for chunk in samples:
            self._joints.add(chunk.position[:, self._first_joint :])

    def _follow(self, chunk: PlanChunk) -> None:
        pieces, plan, line = pieces_of(chunk.path), plan_arrays(chunk), source_lines(chunk.path)
        rapid = np.isnan(chunk.path.feed)
        progress = np.zeros(1, PROGRESS)
        out = self._out
        while progress[0]["stage"] != AT_END:
            route = Route(pieces, rapid, self._columns, self._strokes.chord_tolerance)
            count = follow(route, plan, Origin(chunk.t0, chunk.s0), progress, out)
            points = out.points.part(0, count)
            self._strokes.add(points)
            phases = out.mark[:count] & PHASE != 0
            rows = np.stack((points.t, out.speed[:count], points.accel, points.jerk), axis=1)
            self._curves.add(rows[phases])
            entered = out.mark[:count] & ENTERED != 0
            index = out.piece[:count][entered]
            smooth = pieces.kind[index] == SPAN
            self._origins.add(points.t[entered], line[index], chunk.path.file, smooth)


def stock_box(machine: Machine) -> list[list[float]] | None:
    """Return [least, greatest] x, y and z of the stock in mm; None without one."""
    return (
        None
        if machine.stock is None
        else [list(getattr(machine.stock, axis)) for axis in DRAWN_AXES]
    )


def travel_box(machine: Machine) -> list[list[float]] | None:
    """Return [least, greatest] x, y and z of the travel in mm; None if an axis has no travel."""
    axes: dict[str, tuple[float, float] | None] = {
        letter: axis.travel for letter, axis in machine.axes.items() if letter in DRAWN_AXES
    }
    if not axes or None in axes.values():
        return None
    return [list(axes.get(letter) or (0.0, 0.0)) for letter in DRAWN_AXES]
