"""Smooth splines within the tolerance for chains of straight moves under G64.

    moves ──► chains: feed moves that the same axes measure ──► windows
          ──► spline (cnc.kernels.path.fit) ──► records (cnc.kernels.path.fit_records)

A chain is fitted in windows of some thousand moves. The last spans of a window may still change
with later moves; they are fitted again in the next window. It begins with position, slope and
second derivative at the end of the spans that were issued. So the spline is C2 throughout.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.fit_chain import KNOT, Chain, Knots, find_corners
from cnc.kernels.path.fit_pieces import Moves, Written, write_pieces
from cnc.kernels.path.fit_records import new_writer
from cnc.kernels.path.fit_spline import DEGREE, Spline
from cnc.kernels.path.fit_stretches import first_knots
from cnc.path.fit_window import fitted
from cnc.path.records import Floats, Ints, line_records, move_classes

LEAST_TOLERANCE = 1e-6
"""mm. A smaller tolerance gives the exact path."""
CORNER_COSINE = math.cos(math.radians(30.0))
"""A sharper turn is a corner, where the spline ends."""
WINDOW = 4096
"""Moves fitted at once."""
SPANS_OPEN = 16
"""Spans that are fitted again when the chain goes on."""
CARRIED = 8
"""Most knots behind those that are issued which the next window keeps: with them the spline of this
one goes on within the tolerance.
"""
NUMBERS = 1 << 18
"""Numbers in an array of records to begin with."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces that follow each other, one entry each.

    Attributes:
        kind: LINE, ARC or SPAN.
        at: index of the record in ``data``.
        data: the records.
        length: mm.
        feed: mm/s, NaN for a traverse.
        line: source line.
        tolerance: of the joint behind the piece, mm.
    """

    kind: Ints
    at: Ints
    data: Floats
    length: Floats
    feed: Floats
    line: NDArray[np.int32]
    tolerance: Floats


class Fitter:
    """Fits splines to moves that come in order, all with one tolerance.

    Args:
        classes: (n,): class of each axis, see :func:`cnc.path.records.axis_classes`.
        tolerance: largest distance from the moves, mm.
        accuracy: largest error of arc lengths, mm.
        position: (n,): start of the first move, mm.
    """

    def __init__(self, classes: Ints, tolerance: float, accuracy: float, position: Floats) -> None:
        self._classes = classes
        self._tolerance = tolerance
        self._accuracy = accuracy
        self._begin(position.copy(), 0)

    def _begin(self, position: Floats, metric_class: int) -> None:
        """Begin a chain at ``position`` (n,), measured over the axes of ``metric_class``."""
        self._class = metric_class
        self._points = [position[None]]
        self._feeds: list[Floats] = []
        self._lines: list[NDArray[np.int32]] = []
        self._moves = 0
        self._state = np.full((DEGREE, len(position)), math.nan)
        self._carried = np.zeros(0, KNOT)
        self._at_corner = False

    def add(self, points: Floats, feeds: Floats, lines: NDArray[np.int32]) -> Iterator[Pieces]:
        """Add moves, each of some length, and yield the pieces that are final.

        Args:
            points: (m, n): ends of the moves, mm.
            feeds: (m,): mm/s, NaN for a traverse.
            lines: (m,): source lines.
        """
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
        """End the chain, and yield the rest of its pieces."""
        if self._moves:
            yield from self._fit(open_end=False)

    def _fit(self, *, open_end: bool) -> Iterator[Pieces]:
        """Yield the spans of the chain that no later move will change; all if the chain ends."""
        x = np.concatenate(self._points)
        moves = Moves(np.concatenate(self._feeds), np.concatenate(self._lines).astype(np.int64))
        metrics = self._classes == self._class
        chain = Chain(x, np.empty(len(x)), np.flatnonzero(metrics), metrics)
        corner = np.empty(len(x), np.bool_)
        find_corners(x, chain.metric, CORNER_COSINE, self._tolerance, corner)
        corner[0] = self._at_corner
        knots = first_knots(chain, corner, self._tolerance, self._carried)
        spline = fitted(chain, knots, self._state, self._tolerance)
        spans = len(spline.knots) - 1
        last = self._final_spans(spline) if open_end else spans
        yield from self._write(chain, spline, moves, last)
        if last == spans:
            self._begin(x[-1], self._class)
        elif last > 0:
            self._go_on(chain, spline, moves, last)

    def _final_spans(self, spline: Spline) -> int:
        """Return the number of spans that no later move will change.

        The last one ends at a corner, between two straight spans, or near a vertex with another one
        behind it.
        """
        knots = spline.knots
        spans = len(knots) - 1
        off = spline.bezier[:, 0] - spline.p[:-1]
        metrics = self._classes == self._class
        distance = np.linalg.norm(off[:, metrics], axis=1)
        distance = np.maximum(distance, np.abs(off[:, ~metrics]).max(axis=1, initial=0.0))
        whole = distance <= self._tolerance
        whole &= (knots["on"] & ~knots["straight"] & ~knots["polyline"])[:-1]
        for k in range(spans - SPANS_OPEN, 0, -1):
            between_lines = knots["straight"][k - 1] and knots["straight"][k]
            if knots["ends"][k] or between_lines or (whole[k] and self._kept(knots, k)):
                return k
        return spans if self._moves >= 4 * WINDOW else 0

    def _kept(self, knots: Knots, last: int) -> int:
        """Return the number of knots behind knot ``last`` that the next window keeps.

        They end with a vertex, before the next straight or broken span.
        """
        behind = knots[last : last + CARRIED + 1]
        barred = behind["straight"] | behind["polyline"] | behind["ends"]
        reach = int(np.argmax(barred)) if barred.any() else len(behind) - 1
        on = np.flatnonzero(behind["on"][1 : reach + 1])
        return int(on[-1]) + 1 if len(on) else 0

    def _write(self, chain: Chain, spline: Spline, moves: Moves, last: int) -> Iterator[Pieces]:
        """Yield the pieces of the first ``last`` spans."""
        here = self._here()
        numbers = NUMBERS
        span = 0
        most = len(spline.knots) + len(chain.x)
        while span < last:
            writer = new_writer(np.empty(numbers), chain.metric, here, self._accuracy)
            out = Written(
                np.empty(most, np.int64),
                np.empty(most, np.int64),
                np.empty(most),
                np.empty(most),
                np.empty(most, np.int64),
                np.empty(most, np.bool_),
            )
            following, pieces, used = write_pieces(chain, spline, moves, span, last, writer, out)
            if following == span:
                numbers *= 2
                continue
            span = following
            if pieces:
                some = slice(pieces)
                yield Pieces(
                    out.kind[some],
                    out.at[some],
                    writer.data[:used].copy(),
                    out.length[some],
                    out.feed[some],
                    out.line[some].astype(np.int32),
                    np.where(out.joint[some], self._tolerance, 0.0),
                )

    def _go_on(self, chain: Chain, spline: Spline, moves: Moves, last: int) -> None:
        """Keep the moves behind span ``last``, and the state of the spline there."""
        knot = spline.knots[last]
        first = int(knot["vertex"])
        self._points = [spline.p[last : last + 1], chain.x[first + 1 :]]
        self._feeds = [moves.feed[first:]]
        self._lines = [moves.line[first:].astype(np.int32)]
        self._moves = len(chain.x) - 1 - first
        self._at_corner = bool(knot["ends"])
        self._state = np.full((DEGREE, chain.x.shape[1]), math.nan)
        self._carried = np.zeros(0, KNOT)
        if not self._at_corner:
            h = knot["t"] - spline.knots[last - 1]["t"]
            difference, factor = spline.bezier[last - 1], 1.0
            for k in range(DEGREE):
                self._state[k] = factor * difference[-1]
                difference, factor = np.diff(difference, axis=0), factor * (DEGREE - k) / h
            if not knot["straight"]:
                kept = self._kept(spline.knots, last)
                self._carried = spline.knots[last + 1 : last + 1 + kept].copy()
                self._carried["t"] -= chain.along[self._carried["vertex"]]
                self._carried["vertex"] -= first

    def _here(self) -> Floats:
        """Return the end of the spans issued so far (n,)."""
        begin: Floats = self._points[0][0] if math.isnan(self._state[0, 0]) else self._state[0]
        return begin.copy()
