"""Warnings and notes about a program, found in its canonical blocks.

The blocks pass once, runs of moves as arrays. A finding that may concern thousands of moves is
reported once, at the first of them, with their number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.kernels.rules import SAME_POINT
from cnc.machine.models import Machine
from cnc.model.blocks import (
    PLANE_AXES,
    ArcFeed,
    Block,
    NurbsFeed,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
)
from cnc.model.diagnostics import Diagnostic
from cnc.model.units import per_minute
from cnc.path.block_pieces import FEW
from cnc.report.result import Report

# Suspicious arcs: circles that do not close, and radii that change along the arc.
#
# An arc that ends at its start point is a full circle. If the end misses the start by a rounding
# error, the circle has a gap. If it lies on the other side, hardly anything is cut:
#
#       .--.              .--.
#      (    ) <- gap           ' <- all that is cut
#       '--'

MAX_GAP, MAX_GAP_RATIO = 0.01, 0.01
"""mm, and ratio to the radius. An arc with a smaller gap is probably intended as a full circle."""
MIN_DRIFT = 2.5e-3
"""mm. Start, end and centre with three decimals each explain a smaller difference of the radii."""


class ArcCheck:
    """Checks the arcs of a program in their order."""

    def __init__(self, machine: Machine) -> None:
        self._names = machine.axis_names
        self._open: list[Diagnostic] = []
        self._drifting = 0
        self._max_drift = 0.0
        self._first: tuple[str, int] = "", 0

    def add(self, arc: ArcFeed, from_place: list[float], to_place: list[float]) -> None:
        """Check an arc from one place to another, (axes,) mm."""
        i, j = (self._names.index(axis) for axis in PLANE_AXES[arc.plane])
        begin, end = (from_place[i], from_place[j]), (to_place[i], to_place[j])
        gap = math.dist(begin, end)
        if SAME_POINT < gap <= min(MAX_GAP, MAX_GAP_RATIO * arc.radius):
            cut = (
                "it does not close"
                if abs(arc.turns) > 0.5
                else f"only {abs(arc.turns):.2g} of a turn is cut"
            )
            message = f"this circle ends {gap:.3g} mm from its start point: {cut}"
            hint = "write exactly the start point as the end point; for a short move write G1"
            self._open.append(
                Diagnostic(
                    "arc-not-closed", message, arc.file, arc.line, hint=hint, severity="warning"
                )
            )
        drift = abs(math.dist(end, arc.center) - arc.radius)
        if drift > MIN_DRIFT:
            if not self._drifting:
                self._first = arc.file, arc.line
            self._drifting += 1
            self._max_drift = max(self._max_drift, drift)

    def findings(self) -> Iterator[Diagnostic]:
        """Yield the findings after the last arc."""
        yield from self._open
        if self._drifting:
            count = "1 arc is" if self._drifting == 1 else f"{self._drifting} arcs are"
            message = (
                f"the radius changes by up to {self._max_drift:.3g} mm along the arc; "
                f"{count} cut as a spiral"
            )
            hint = "write centre and end point with more digits, or correct the centre"
            yield Diagnostic("arc-radius-drift", message, *self._first, hint=hint, severity="note")


ROUNDING = 1e-6
"""Relative. Rounding alone may take a computed number this far beyond its limit."""

Floats = NDArray[np.float64]


@dataclass(slots=True)
class _Moves:
    """Moves with the same finding.

    Attributes:
        count: number of moves.
        file: file of the first move.
        line: source line of the first move.
        largest: largest amount of all moves.
        feed: feed of the move with the largest amount, mm/s.
    """

    count: int = 0
    file: str = ""
    line: int = 0
    largest: float = 0.0
    feed: float = 0.0

    def add(self, file: str, lines: NDArray[np.int32], amounts: Floats, feeds: Floats) -> None:
        if len(lines):
            index = int(np.argmax(amounts))
            self.add_one(file, int(lines[0]), float(amounts[index]), float(feeds[index]))
            self.count += len(lines) - 1

    def add_one(self, file: str, line: int, amount: float, feed: float) -> None:
        if not self.count:
            self.file, self.line = file, line
        self.count += 1
        if amount > self.largest:
            self.largest, self.feed = amount, feed


class Hints:
    """Collects the findings of a program.

    Args:
        machine: gives limits and steps per mm.
        start: (axes,) position at which the first move starts, mm.
    """

    def __init__(self, machine: Machine, start: Floats) -> None:
        self._machine = machine
        self._position: list[float] = np.array(start, np.float64).tolist()
        self._steps_per_mm = machine.steps_per_mm
        self._linear = np.flatnonzero([letter in "xyz" for letter in machine.axes])
        self._max_velocity = np.array([axis.max_velocity for axis in machine.axes.values()])[
            self._linear
        ]
        # No move at this feed is slower than programmed.
        self._slow = min(float(self._max_velocity.min(initial=np.inf)), machine.path.max_feed)
        self._unreachable, self._short = _Moves(), _Moves()
        self._arcs = ArcCheck(machine)
        self._synchronized = False
        self._spindle_on = self._spindle_used = False
        self._spindle_off_noted = False
        self._spindle_off: list[tuple[str, int]] = []

    def passed(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """Yield the same blocks and check each of them."""
        for block in blocks:
            self._add(block)
            yield block

    def findings(self) -> Iterator[Diagnostic]:
        """Yield the findings after the last block."""
        if self._spindle_used:
            for file, line in self._spindle_off:
                message = "a feed move with the spindle off"
                hint = "start the spindle (M3, M4) before it, or use a rapid move (G0)"
                yield Diagnostic("spindle-off", message, file, line, hint=hint, severity="warning")
        moves = self._unreachable
        if moves.count:
            message = (
                f"a feed of {per_minute(moves.feed):.6g} mm/min is {moves.largest:.3g} times the "
                f"highest speed of the machine; {_counted(moves.count)} slower than programmed"
            )
            hint = (
                "lower F, or raise path.max_feed and max_velocity of the axes in the machine file "
                "if the machine permits"
            )
            yield Diagnostic(
                "feed-unreachable", message, moves.file, moves.line, hint=hint, severity="note"
            )
        moves = self._short
        if moves.count:
            message = f"shorter than one step of every axis; {_counted(moves.count)} as short"
            hint = "a coarser tolerance in the CAM system gives a shorter program and the same part"
            yield Diagnostic(
                "move-below-step", message, moves.file, moves.line, hint=hint, severity="note"
            )
        yield from self._arcs.findings()

    def _add(self, block: Block) -> None:
        if isinstance(block, Polyline):
            self._add_moves(block)
        elif isinstance(block, ArcFeed | NurbsFeed):
            if isinstance(block, ArcFeed):
                end = block.end.tolist()
                self._arcs.add(block, self._position, end)
            else:
                end = block.control_points[-1].tolist()
            self._position = end
            self._note_feed_move(block.file, block.line)
            excess = block.feed / self._machine.path.max_feed
            if excess > 1.0 + ROUNDING:
                self._unreachable.add_one(block.file, block.line, excess, block.feed)
        elif isinstance(block, Probe):
            self._position = block.end.tolist()
        elif isinstance(block, SpindleSync):
            self._synchronized = block.pitch != 0.0
        elif isinstance(block, Spindle):
            self._spindle_on = block.state != "off"
            self._spindle_used |= self._spindle_on
            self._spindle_off_noted = False

    def _add_moves(self, block: Polyline) -> None:
        if len(block.points) <= FEW:
            feeds = block.feeds.tolist()
            if not any(feed > self._slow for feed in feeds):
                self._add_few(block, feeds)
                return
        feeding = ~np.isnan(block.feeds)
        if feeding.any():
            self._note_feed_move(block.file, int(block.lines[np.argmax(feeding)]))
        # Axis by axis: numpy takes several times as long for the largest of each short row.
        ends = np.vstack((self._position, block.points)).T
        steps_mm = np.diff(np.ascontiguousarray(ends))
        self._position = block.points[-1].tolist()
        steps = np.abs(steps_mm * self._steps_per_mm[:, None]).max(axis=0)
        short = feeding & (steps > 0.0) & (steps < 1.0 - ROUNDING)
        self._short.add(block.file, block.lines[short], steps[short], block.feeds[short])
        fastest = float(np.fmax.reduce(block.feeds))
        if not self._synchronized and len(self._linear) and fastest > self._slow:
            steps_mm = steps_mm[self._linear]
            lengths = np.sqrt((steps_mm * steps_mm).sum(axis=0))
            moving = feeding & (lengths > 0.0)
            feeds, lines = block.feeds[moving], block.lines[moving]
            shares = np.abs(steps_mm[:, moving]) / lengths[moving]
            slowness = (shares / self._max_velocity[:, None]).max(axis=0, initial=0.0)
            excess = feeds * np.maximum(slowness, 1.0 / self._machine.path.max_feed)
            above = excess > 1.0 + ROUNDING
            self._unreachable.add(block.file, lines[above], excess[above], feeds[above])

    def _add_few(self, block: Polyline, feeds: list[float]) -> None:
        """Check the moves of a short row, for which arrays take longer; all are slow enough."""
        here, per_mm = self._position, self._steps_per_mm.tolist()
        for end, feed, line in zip(block.points.tolist(), feeds, block.lines.tolist(), strict=True):
            if not math.isnan(feed):
                self._note_feed_move(block.file, line)
                moved = zip(here, end, per_mm, strict=True)
                steps = max(abs((b - a) * steps) for a, b, steps in moved)
                if 0.0 < steps < 1.0 - ROUNDING:
                    self._short.add_one(block.file, line, steps, feed)
            here = end
        self._position = here

    def _note_feed_move(self, file: str, line: int) -> None:
        """Keep the place of a feed move with the spindle off, one between two spindle words."""
        if not self._spindle_on and not self._spindle_off_noted:
            self._spindle_off_noted = True
            self._spindle_off.append((file, line))


def empty_program(report: Report) -> Iterator[Diagnostic]:
    """Yield ``program-empty`` where a program makes no block."""
    if not report.blocks:
        message = "the program has no move and no command"
        hint = "check the file: it may be empty, cut off, or of another kind"
        yield Diagnostic("program-empty", message, report.program, hint=hint, severity="warning")


def step_rate(report: Report) -> Iterator[Diagnostic]:
    """Yield a ``step-rate`` for each axis that steps more often than the board can.

    Args:
        report: the result of the run, which has the largest speeds of the axes.
    """
    rate = report.machine.board.max_step_rate
    for letter, axis in report.machine.joint_tables.items():
        steps = (report.largest.axes.get(letter, {}).get("velocity") or 0.0) * axis.steps_per_mm
        if steps > rate * (1.0 + ROUNDING):
            message = f"{letter.upper()} makes {steps:.6g} steps/s; the board at most {rate:.6g}"
            hint = (
                f"lower axes.{letter}.max_velocity, or raise board.max_step_rate in the machine "
                "file if the board permits"
            )
            yield Diagnostic("step-rate", message, report.program, hint=hint, severity="warning")


def _counted(moves: int) -> str:
    return "1 move is" if moves == 1 else f"{moves} moves are"
