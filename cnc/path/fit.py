"""Smooth splines within the tolerance for chains of moves under G64.

    moves ──► chains: feed moves that the same axes measure ──► windows
          ──► spline (cnc.kernels.path.fit) ──► records (cnc.kernels.path.fit_records)

Arcs and NURBS are members too, as chords (:mod:`cnc.path.fit_curves`). An arc waits until it is
known what follows. At a corner, at the end of a chain and in the middle of a long arc it is exact.

A chain is fitted in windows of some thousand moves. The last spans of a window may still change
with later moves; they are fitted again in the next window. It begins with position, slope and
second derivative at the end of the spans that were issued. So the spline is C2 throughout.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.fit_chain import KNOT, SHARPEST, Chain, Knots, find_corners, find_polygons
from cnc.kernels.path.fit_pieces import Moves
from cnc.kernels.path.fit_spline import DEGREE, Spline
from cnc.kernels.path.fit_stretches import first_knots
from cnc.path.block_pieces import Frame
from cnc.path.fit_choice import Choice, Duration
from cnc.path.fit_curves import LEFT, SPARE, Arc
from cnc.path.fit_pieces import Pieces
from cnc.path.fit_window import fitted, with_short_ends
from cnc.path.fit_writing import spline_pieces
from cnc.path.records import Floats, line_records, move_classes

LEAST_TOLERANCE = 1e-6
"""mm. A smaller tolerance gives the exact path."""
CORNER_COSINE = math.cos(math.radians(50.0))
"""A sharper turn of straight legs that are long enough is a corner, where the spline ends."""
LEGS = 3.0
"""A corner has legs of so many tolerances at least."""
WINDOW = 4096
"""Moves fitted at once."""
SPANS_OPEN = 16
"""Spans that are fitted again when the chain goes on."""
CARRIED = 8
"""Most knots behind those that are issued which the next window keeps: with them the spline of this
one goes on within the tolerance.
"""


class Fitter:
    """Fits splines to moves that come in order, all with one tolerance.

    Args:
        frame: axes and accuracy.
        tolerance: largest distance from the moves, mm.
        position: (n,): start of the first move, mm.
        curved: whether chords stand for curves: the spline leaves them a part of the tolerance. A
            curve sets it.
        short_legs: polygons stay straight, with up to so many vertices with short legs in a row;
            None where they become splines.
        duration: times a motion where spline or corners may be faster; None for the spline.
    """

    def __init__(
        self,
        frame: Frame,
        tolerance: float,
        position: Floats,
        *,
        curved: bool = False,
        short_legs: int | None = None,
        duration: Duration | None = None,
    ) -> None:
        self._short_legs = short_legs
        self._choice = None if duration is None else Choice(frame, tolerance, duration)
        self._frame = frame
        self._classes = frame.classes
        self._tolerance = tolerance
        self.curved = curved
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
        self._waiting: Arc | None = None
        """An arc at the start of a chain, until it is known what follows."""

    def add(
        self, points: Floats, feeds: Floats, lines: NDArray[np.int32], *, curved: bool = False
    ) -> Iterator[Pieces]:
        """Add moves, each of some length, and yield the pieces that are final.

        Args:
            points: (m, n): ends of the moves, mm.
            feeds: (m,): mm/s, NaN for a traverse.
            lines: (m,): source lines.
            curved: whether they are chords of a curve.
        """
        self.curved |= curved
        ends = np.concatenate((self._position()[None], points))
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
                yield from self._go_behind_arc(ends[first + 1] - ends[first])
                self._put(points[run], feeds[run], lines[run])
                if self._moves >= WINDOW:
                    yield from self._fit(open_end=True)

    def add_arc(self, arc: Arc) -> Iterator[Pieces]:
        """Add an arc, and yield the pieces that are final."""
        if self._class != 0:
            yield from self.flush()
            self._begin(arc.start, 0)
        begins = arc.direction(0.0)
        yield from self._go_behind_arc(begins)
        if self._moves:
            last = self._points[-1]
            before = last[-2] if len(last) > 1 else self._points[-2][-1]
            if self._is_corner(last[-1] - before, begins):
                yield from self.flush()
        if not self._moves:
            self._waiting = arc
            return
        self.curved = True
        bend = arc.bend(self._tolerance)
        if self._keeps_middle(arc):
            self._put_arc(arc.between(0.0, bend))
            yield from self._fit(open_end=False, end=arc.state(bend, self._classes == 0))
            self._waiting = arc.between(bend, 1.0)
        else:
            self._put_arc(arc)
            if self._moves >= WINDOW:
                yield from self._fit(open_end=True)

    def flush(self) -> Iterator[Pieces]:
        """End the chain, and yield the rest of its pieces."""
        if self._waiting is not None:
            yield from self._exact(self._waiting, self._tolerance)
        elif self._moves:
            yield from self._fit(open_end=False)

    def _position(self) -> Floats:
        """Return the end of everything added (n,)."""
        return self._points[-1][-1] if self._waiting is None else self._waiting.end

    def _is_corner(self, before: Floats, after: Floats) -> bool:
        """Return whether the chain ends where these directions meet; lengths are those of the legs.

        Moves that are shorter than a corner's legs are left to the chain.
        """
        a, b = before[self._classes == 0], after[self._classes == 0]
        sizes = float(np.linalg.norm(a)), float(np.linalg.norm(b))
        long = min(sizes) >= LEGS * self._tolerance
        return long and float(a @ b) < math.cos(SHARPEST) * sizes[0] * sizes[1]

    def _keeps_middle(self, arc: Arc) -> bool:
        """Return whether an arc is so long that its middle stays exact."""
        bend = arc.bend(self._tolerance)
        return 2.0 * SPARE * bend < 1.0 and arc.smallest >= 2.0 * self._tolerance

    def _go_behind_arc(self, direction: Floats) -> Iterator[Pieces]:
        """Begin the chain with the arc that waits; the chain goes on in ``direction`` (n,)."""
        arc = self._waiting
        if arc is None:
            return
        if self._is_corner(arc.direction(1.0), direction):
            yield from self._exact(arc, self._tolerance)
            return
        self.curved = True
        bend = arc.bend(self._tolerance)
        if 2.0 * bend < 1.0 and arc.smallest >= 2.0 * self._tolerance:
            yield from self._exact(arc.between(0.0, 1.0 - bend), 0.0)
            self._state = arc.state(1.0 - bend, self._classes == 0)
            arc = arc.between(1.0 - bend, 1.0)
        self._waiting = None
        self._put_arc(arc)

    def _exact(self, arc: Arc, joint: float) -> Iterator[Pieces]:
        """Yield an exact arc, and begin a chain behind it; ``joint``: tolerance there, mm."""
        runs = list(arc.records(self._frame))
        for number, records in enumerate(runs):
            count = len(records.at)
            allowed = np.zeros(count)
            allowed[-1] = joint if number == len(runs) - 1 else 0.0
            yield Pieces(
                np.full(count, records.kind),
                records.at,
                records.data,
                records.length,
                np.full(count, arc.feed),
                np.full(count, arc.line, np.int32),
                allowed,
            )
        self._begin(arc.end, 0)

    def _put_arc(self, arc: Arc) -> None:
        """Put the chords of an arc into the chain."""
        points = arc.chords(self._tolerance)
        count = len(points)
        self._put(points, np.full(count, arc.feed), np.full(count, arc.line, np.int32))

    def _put(self, points: Floats, feeds: Floats, lines: NDArray[np.int32]) -> None:
        """Put moves into the chain; see add."""
        self._points.append(points)
        self._feeds.append(feeds)
        self._lines.append(lines)
        self._moves += len(points)

    def _fit(self, *, open_end: bool, end: Floats | None = None) -> Iterator[Pieces]:
        """Yield the spans of the chain that no later move will change; all if the chain ends.

        end: (5, n): position and derivatives 1 to 4 there.
        """
        tolerance = LEFT * self._tolerance if self.curved else self._tolerance
        x = np.concatenate(self._points)
        moves = Moves(np.concatenate(self._feeds), np.concatenate(self._lines).astype(np.int64))
        metrics = self._classes == self._class
        chain = Chain(x, np.empty(len(x)), np.flatnonzero(metrics), metrics)
        corner = np.empty(len(x), np.bool_)
        find_corners(x, chain.metric, CORNER_COSINE, tolerance, corner)
        if self._short_legs is not None and not self.curved:
            find_polygons(x, chain.metric, tolerance, self._short_legs, corner)
        corner[0] = self._at_corner
        if self._choice is not None and not self.curved:
            whole = math.isnan(self._state[0, 0]), not open_end and end is None
            self._choice.mark(x, moves, metrics, corner, whole)
        knots = first_knots(chain, corner, tolerance, self._carried)
        states = np.stack(
            (self._state, np.full_like(self._state, math.nan) if end is None else end)
        )
        if not len(self._carried):
            knots = with_short_ends(chain, knots, ~np.isnan(states[:, 0, 0]))
        spline = fitted(chain, knots, states, tolerance)
        spans = len(spline.knots) - 1
        if end is not None:
            spline.knots["ends"][-1] = False
        last = self._final_spans(spline) if open_end else spans
        yield from spline_pieces(
            chain, spline, moves, last, self._here(), self._frame.accuracy, self._tolerance
        )
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
