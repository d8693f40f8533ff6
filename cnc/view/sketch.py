"""A coarse picture of a program from its blocks, long before its plan is known.

The points are thinned while they come: of a long program every k-th point is kept, and k doubles
whenever there are too many. The times are those of constant speed, without acceleration.
"""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline, Probe
from cnc.path.block_pieces import Frame
from cnc.path.fit_curves import arc_chords, nurbs_chords
from cnc.path.records import axis_classes
from cnc.report.result import Report
from cnc.view.collect import DRAWN_AXES, Picture
from cnc.view.page import about_picture, packed_columns
from cnc.view.tables import Curves, Origins, Strokes

Floats = NDArray[np.float64]
MOST_POINTS = 40_000
SAGITTA = 0.05
"""Distance of the chords from arcs and splines, mm."""


class Sketch:
    """Collects the path of blocks: ``add`` them in order, then take the ``data``.

    Args:
        machine: Gives the axes and the speed of traverses.
        program: Name of the program.
        start: Start position (axes,), mm.
        most: Largest number of points.
    """

    def __init__(
        self, machine: Machine, program: str, start: Floats, most: int = MOST_POINTS
    ) -> None:
        self._machine, self._program, self._most = machine, program, most
        self._axes = machine.axis_names
        self._frame = Frame(self._axes, axis_classes(self._axes), 1e-9)
        self._position = np.array(start, np.float64)
        # The column behind the axes has zeros, for an axis that the machine lacks.
        none = len(self._axes)
        self._columns = [
            self._axes.index(axis) if axis in self._axes else none for axis in DRAWN_AXES
        ]
        self._rows = [self._row(self._position[None], np.zeros(1))]
        self._kept, self._stride, self._skip = 1, 1, 0
        self._last = self._rows[0]

    def add(self, block: Block) -> None:
        """Add a block; one that does not move has no effect."""
        if isinstance(block, Polyline):
            self._take(block.points, block.feeds)
        elif isinstance(block, Probe):
            self._take(block.end[None], np.array([block.feed]))
        elif isinstance(block, ArcFeed):
            points = arc_chords(block, self._position, self._axes, SAGITTA)
            self._take(points, np.full(len(points), block.feed))
        elif isinstance(block, NurbsFeed):
            runs = nurbs_chords(block, self._position, self._frame, SAGITTA)
            for points in [block.control_points] if runs is None else runs:
                self._take(points, np.full(len(points), block.feed))

    def _take(self, points: Floats, feeds: Floats) -> None:
        self._position = points[-1]
        rows = self._row(points, feeds)
        self._last = rows[-1:]
        some = rows[self._skip :: self._stride]
        self._skip = (self._skip - len(rows)) % self._stride
        self._rows.append(some)
        self._kept += len(some)
        while self._kept > self._most:
            every = np.concatenate(self._rows)
            self._rows = [every[::2]]
            if len(every) % 2:
                # The last point stays, so the next one is two strides behind it.
                self._skip += self._stride
            self._stride *= 2
            self._kept = len(self._rows[0])

    def _row(self, points: Floats, feeds: Floats) -> Floats:
        """Return x, y, z and feed (n, 4)."""
        wide = np.column_stack((points, np.zeros(len(points)), feeds))
        return wide[:, [*self._columns, len(self._axes) + 1]]

    def data(self) -> str:
        """Return the data of the page as JSON, as :func:`cnc.view.page.write_data` writes it."""
        rows = np.concatenate([*self._rows, self._last])
        position, feed = rows[:, :3], rows[:, 3]
        rapid = np.append(np.isnan(feed[1:]), False)
        fastest = min(axis.max_velocity for axis in self._machine.axes.values())
        speed = np.append(np.where(rapid[:-1], fastest, feed[1:]), 0.0)
        length = np.linalg.norm(np.diff(position, axis=0), axis=1)
        t = np.concatenate(([0.0], np.cumsum(length / np.maximum(speed[:-1], 1e-6))))
        none = np.zeros(len(rows))
        size = float(np.ptp(position, axis=0).max())
        strokes = Strokes(t, position, speed, none, none, rapid, max(size / 1000.0, SAGITTA))
        ends = np.array([0.0, t[-1]])
        curves = Curves(ends, 0.0, np.zeros((3, 1)), np.zeros((3, 0)), np.zeros((3, 0)))
        zero = np.zeros(1, np.int64)
        origins = Origins(np.zeros(1), zero + 1, zero + 1, zero)
        picture = Picture(strokes, curves, origins, [self._program], 1, float(t[-1]))
        about = about_picture(picture, Report(self._program, self._machine))
        about["facts"] = "a coarse picture: the check is under way"
        about["note"] = ""
        columns = {
            name: base64.b64encode(zlib.compress(column.tobytes(), 6)).decode()
            for name, column in packed_columns(picture, about)
        }
        return json.dumps({"about": about, "columns": columns}, allow_nan=False)
