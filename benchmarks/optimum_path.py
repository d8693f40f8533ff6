"""A path between two rests, and grids of points along it, for the fastest motions.

Points are even in time in a motion that is near to the optimum. Knots, ends of stretches of
constant speed, and tight bends are points too: between two points of a grid a motion could pass a
bend of a few micrometres at any speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.path.chunk import PathChunk
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import LINE, METRIC, METRICS, curve_eval_s
from cnc.planner.known_path import KnownPath
from cnc.planner.limits import Limits

Floats = NDArray[np.float64]

CLOSE = 0.25
"""Part of the distance of the grid's points within which a knot takes the place of a point."""
TIGHT = 0.9
"""A bend is tight where the speed bound falls to this part of the bounds around it."""


class Grid(NamedTuple):
    """A stretch of path between two rests, at n + 1 points.

    Attributes:
        s: (n + 1,): arc length, mm.
        q: (n, 3, 3, axes): q', q'', q''' at the start and the end of each cell, and where a motion
            near the optimum is after half of its time.
        top: (n, 2): largest speeds at the start and the end, mm/s.
        flat: (n,): whether the speed is constant in the cell.
    """

    s: Floats
    q: Floats
    top: Floats
    flat: NDArray[np.bool_]


class Route:
    """A path between two rests: the pieces of consecutive chunks."""

    def __init__(self, chunks: Sequence[PathChunk], limits: Limits) -> None:
        """Use all pieces of the chunks; the motion rests at the start and behind the last."""
        self.limits = limits
        self.pieces = [(chunk, k) for chunk in chunks for k in range(len(chunk))]
        lengths = np.concatenate([chunk.length for chunk in chunks])
        self.feed = np.concatenate([limits.feeds(chunk) for chunk in chunks])
        self.ends = np.concatenate(([0.0], np.cumsum(lengths)))
        known = KnownPath(limits)
        for i, chunk in enumerate(chunks):
            following = chunks[i + 1] if i + 1 < len(chunks) else None
            known.add(chunk, chunks[i - 1] if i else None, following)
        found = known.intervals(limits, 0.0, float(self.ends[-1]))
        flat = np.flatnonzero(found.flat)
        starts = np.concatenate(([0.0], found.end))[flat]
        self.level = list(
            zip(starts.tolist(), found.end[flat].tolist(), found.speed[flat].tolist(), strict=True)
        )
        from scipy.signal import find_peaks  # it takes a second

        dips, _ = find_peaks(-np.log(np.maximum(found.top, 1e-9)), prominence=-np.log(TIGHT))
        starts = np.concatenate(([0.0], found.end[:-1]))
        self.bends = np.concatenate((starts[dips], found.end[dips])).tolist()
        self.stops = sorted({0.0, float(self.ends[-1]), *(s for _, s, v in self.level if v == 0.0)})

    def at(self, s: float, piece: int) -> tuple[Floats, float]:
        """Return q', q'', q''' (3, axes) at ``s`` on a piece, and the largest speed there."""
        chunk, k = self.pieces[piece]
        kind, place = int(chunk.kind[k]), int(chunk.at[k])
        here = min(max(s - float(self.ends[piece]), 0.0), float(chunk.length[k]))
        out = np.zeros((4, len(chunk.axes)))
        u = 0.0 if kind == LINE else curve_inv_arclen(kind, chunk.data, place, here)
        curve_eval_s(kind, chunk.data, place, u, out)
        metric = chunk.data[place + METRIC : place + METRIC + int(chunk.data[place + METRICS])]
        curvature = float(np.linalg.norm(out[2, metric.astype(int)]))
        return out[1:], min(float(self.feed[piece]), self._top(out, curvature))

    def _top(self, q: Floats, curvature: float) -> float:
        """Return the speed that velocity, normal acceleration and the chord permit."""
        limits = self.limits
        with np.errstate(divide="ignore"):
            top = float((limits.axis_velocity / np.abs(q[1])).min())
        if curvature > 0.0:
            radius = 1.0 / curvature
            depth = min(limits.chord_error, radius)
            chord = 2.0 / limits.period * np.sqrt(depth * (2.0 * radius - depth))
            step = np.sqrt(24.0 * limits.step_deviation) * radius / limits.period
            top = min(top, np.sqrt(limits.normal_acceleration * radius), chord, step)
        return top

    def points(self, first: float, last: float, places: Floats) -> Floats:
        """Return the points of a grid from ``first`` to ``last``: ``places``, knots and bends."""
        knots = [*self.ends.tolist(), *self.bends]
        levels = [level for level in self.level if level[0] >= first and level[1] <= last]
        levels = [(low, high, v) for low, high, v in levels if high > low]
        knots = sorted({*knots, *(s for low, high, _ in levels for s in (low, high))})
        knots = [s for s in knots if first < s < last]
        apart = np.gradient(places) if len(places) > 1 else np.ones(len(places))
        fixed = np.array([first, *knots, last])
        near = np.abs(fixed[:, None] - places[None]).min(axis=0)
        s = np.sort(np.concatenate((fixed, places[near > CLOSE * apart])))
        s = s[np.append(True, np.diff(s) > 1e-9)]
        s[-1] = last
        return np.asarray(s)

    def grid(self, s: Floats, halves: Floats) -> Grid:
        """Return the grid with points ``s`` (n + 1,), and ``halves`` (n,) of the time of cells."""
        piece = np.searchsorted(self.ends, 0.5 * (s[1:] + s[:-1])) - 1
        piece = np.clip(piece, 0, len(self.pieces) - 1)
        n = len(s) - 1
        q, top = np.empty((n, 3, 3, len(self.pieces[0][0].axes))), np.empty((n, 2))
        flat = np.zeros(n, bool)
        for m in range(n):
            for side in range(2):
                q[m, side], top[m, side] = self.at(float(s[m + side]), int(piece[m]))
            q[m, 2], _ = self.at(float(halves[m]), int(piece[m]))
            for low, high, v in self.level:
                if low < high and low < 0.5 * (s[m] + s[m + 1]) < high:
                    top[m] = np.minimum(top[m], v)
                    flat[m] = True
        return Grid(s, q, top, flat)
