"""Straight moves under G64 on their way to records: chains of them become a smooth spline within
the tolerance.

    moves ──► chains: feed moves that the same axes measure ──► windows ──► spline (cnc.kernels.path.fit) ──► records (cnc.kernels.path.fit_records)

A chain is fitted in windows of some thousand moves. Of what a window yields, the last spans may
still change with the moves to come; they are fitted again in the next one, which begins with
position, slope and second derivative where the spans that were handed out end. So the spline is C2
throughout whatever comes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.fit import AT, ENDS, T, find_corners, first_knots, refined
from cnc.kernels.path.fit_records import write_pieces
from cnc.path.records import Floats, Ints, line_records, move_classes

LEAST_TOLERANCE = 1e-6
"""mm. Less is the exact path."""
CORNER_COSINE = math.cos(math.radians(30.0))
"""A sharper turn is a corner: the spline ends there."""
REACH = 3.0
"""Parts of the tolerance: a corner is what still turns as sharply seen from this far."""
WINDOW = 4096
"""Moves that are fitted at once."""
SPANS_OPEN = 4
"""Spans at least that are fitted again when the chain goes on."""
ROOM = 1 << 18


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces that follow each other: kind, place in data, length, feed, line, and tolerance of the
    joint behind, of each.
    """

    kind: Ints
    at: Ints
    data: Floats
    length: Floats
    feed: Floats
    line: NDArray[np.int32]
    tolerance: Floats


class Fitter:
    """Fits the moves that it is given in order, all with one tolerance; ``position`` (n,) is where
    they have got.
    """

    def __init__(self, classes: Ints, tolerance: float, accuracy: float, position: Floats) -> None:
        self._classes = classes
        self._tolerance = tolerance
        self._accuracy = accuracy
        self._begin(position.copy(), 0)

    def _begin(self, position: Floats, metric_class: int) -> None:
        """Nothing is known but where a chain begins."""
        self._class = metric_class
        self._points = [position[None]]
        self._feeds: list[Floats] = []
        self._lines: list[NDArray[np.int32]] = []
        self._moves = 0
        self._state = np.full((3, len(position)), math.nan)
        self._at_corner = False

    def add(self, points: Floats, feeds: Floats, lines: NDArray[np.int32]) -> Iterator[Pieces]:
        """Moves to points (m, n), none of them of no length, at feeds (m,), NaN for a traverse."""
        ends = np.concatenate((self._points[-1][-1:], points))
        which = np.where(np.isnan(feeds), -1, move_classes(np.diff(ends, axis=0), self._classes))
        borders = np.concatenate(([0], np.flatnonzero(np.diff(which)) + 1, [len(which)]))
        for first, last in zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True):
            run = slice(first, last)
            if which[first] != self._class:
                yield from self.flush()
                self._begin(ends[first], int(which[first]))
            if which[first] < 0:
                records = line_records(ends[first], points[run], self._classes)
                kind = np.full(last - first, records.kind)
                allowed = np.full(last - first, self._tolerance)
                yield Pieces(
                    kind, records.at, records.data, records.length, feeds[run], lines[run], allowed
                )
                self._begin(points[last - 1], -1)
            else:
                self._points.append(points[run])
                self._feeds.append(feeds[run])
                self._lines.append(lines[run])
                self._moves += last - first
                if self._moves >= WINDOW:
                    yield from self._fit(open_end=True)

    def flush(self) -> Iterator[Pieces]:
        """What is left: the chain ends here."""
        if self._moves:
            yield from self._fit(open_end=False)

    def _fit(self, *, open_end: bool) -> Iterator[Pieces]:
        """Hand out the spans of the chain that nothing to come will change; all of them if it ends
        here.
        """
        x, feeds, lines = (
            np.concatenate(self._points),
            np.concatenate(self._feeds),
            np.concatenate(self._lines),
        )
        metric = np.flatnonzero(self._classes == self._class)
        metrics = self._classes == self._class
        corner = np.empty(len(x), np.bool_)
        find_corners(x, metric, CORNER_COSINE, REACH * self._tolerance, corner)
        corner[0] = self._at_corner
        along = np.empty(len(x))
        knots, p, bezier = refined(
            first_knots(x, metric, corner, self._tolerance, along),
            x,
            along,
            metric,
            metrics,
            self._tolerance,
            self._state,
        )
        spans = last = len(knots) - 1
        if open_end:
            size = np.diff(knots[:, T])
            safe = knots[-1, T] - knots[1:, T] >= np.maximum(
                2.0 * size, 2.0 * REACH * self._tolerance
            )
            safe[max(spans - SPANS_OPEN, 0) :] = False
            last = int(np.argmin(safe))
            if last == 0 and self._moves >= 4 * WINDOW:
                last = spans
        here = self._here()
        room = ROOM
        span = 0
        lines64 = lines.astype(np.int64)
        most = len(knots) + len(x)
        while span < last:
            data = np.empty(room)
            kind, at, line = (
                np.empty(most, np.int64),
                np.empty(most, np.int64),
                np.empty(most, np.int64),
            )
            length, feed = np.empty(most), np.empty(most)
            joint = np.empty(most, np.bool_)
            following, pieces, used = write_pieces(
                knots, p, bezier, x, along, feeds, lines64, span, last, metric, metrics, here, self._accuracy,
                data, kind, at, length, feed, line, joint,
            )  # fmt: skip
            if following == span:
                room *= 2
                continue
            span = following
            if pieces:
                some = slice(pieces)
                allowed = np.where(joint[some], self._tolerance, 0.0)
                yield Pieces(
                    kind[some],
                    at[some],
                    data[:used].copy(),
                    length[some],
                    feed[some],
                    line[some].astype(np.int32),
                    allowed,
                )
        if last == spans:
            self._begin(x[-1], self._class)
            return
        if last == 0:
            return
        first = int(knots[last, AT])
        self._points = [p[last : last + 1], x[first + 1 :]]
        self._feeds, self._lines = [feeds[first:]], [lines[first:]]
        self._moves = len(x) - 1 - first
        self._at_corner = bool(knots[last, ENDS])
        self._state = np.full((3, x.shape[1]), math.nan)
        if not self._at_corner:
            h, b = knots[last, T] - knots[last - 1, T], bezier[last - 1]
            self._state = np.stack(
                (b[3], 3.0 * (b[3] - b[2]) / h, 6.0 * (b[3] - 2.0 * b[2] + b[1]) / (h * h))
            )

    def _here(self) -> Floats:
        """Where the motion is that was handed out."""
        begin: Floats = self._points[0][0] if math.isnan(self._state[0, 0]) else self._state[0]
        return begin.copy()
