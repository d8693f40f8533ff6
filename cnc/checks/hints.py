"""Findings that end nothing: what a program asks for that its writer may not have meant.

The canonical blocks go by once, runs of moves as arrays. What may be true of thousands of moves is
told once, at the first of them, with their number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.checks.arcs import Arcs
from cnc.checks.stock_collision import Material
from cnc.machine.models import Machine
from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline, Probe, Spindle, SpindleSync
from cnc.model.diagnostics import Diagnostic
from cnc.model.units import per_minute
from cnc.path.chunk import PathChunk
from cnc.report.result import Report

ROUNDING = 1e-6
"""Relative: by how much a number may pass its limit, for it was computed."""

Floats = NDArray[np.float64]


@dataclass(slots=True)
class _Moves:
    """Moves of one kind: how many, the source line of the first, and the largest amount of all,
    with that move's feed.
    """

    count: int = 0
    file: str = ""
    line: int = 0
    worst: float = 0.0
    feed: float = 0.0

    def add(self, file: str, lines: NDArray[np.int32], amounts: Floats, feeds: Floats) -> None:
        if not len(lines):
            return
        if not self.count:
            self.file, self.line = file, int(lines[0])
        self.count += len(lines)
        worst = int(np.argmax(amounts))
        if amounts[worst] > self.worst:
            self.worst, self.feed = float(amounts[worst]), float(feeds[worst])


class Hints:
    """Takes blocks in their order; ``start`` (axes,) mm is where the first move begins."""

    def __init__(self, machine: Machine, start: Floats) -> None:
        self._machine = machine
        self._here = np.array(start, np.float64)
        self._steps_per_mm = machine.steps_per_mm
        self._linear = np.flatnonzero([letter in "xyz" for letter in machine.axes])
        self._fastest = np.array([axis.max_velocity for axis in machine.axes.values()])[
            self._linear
        ]
        self._unreachable, self._short = _Moves(), _Moves()
        self._arcs = Arcs(machine)
        self._material = None if machine.stock is None else Material(machine, machine.stock)
        self._entered: list[Diagnostic] = []
        self._synchronized = False
        self._turning = self._turned = self._told = False
        self._idle: list[tuple[str, int]] = []

    def passed(self, blocks: Iterable[Block]) -> Iterator[Block]:
        """The same blocks, each looked at as it goes by."""
        for block in blocks:
            self._see(block)
            yield block

    def see_path(self, chunk: PathChunk) -> None:
        """The path that the blocks become, in its order."""
        if self._material is not None:
            self._entered += self._material.add(chunk)

    def findings(self) -> Iterator[Diagnostic]:
        """What was found, once all blocks have gone by."""
        if self._turned:
            for file, line in self._idle:
                message, hint = (
                    "a feed move with the spindle off",
                    "start the spindle (M3, M4) before it, or make it a rapid move (G0)",
                )
                yield Diagnostic("spindle-off", message, file, line, hint=hint, severity="warning")
        moves = self._unreachable
        if moves.count:
            message = (
                f"a feed of {per_minute(moves.feed):.6g} mm/min is {moves.worst:.3g} times what the machine reaches; "
                f"{_counted(moves.count)} slower than programmed"
            )
            hint = "lower F, or raise path.max_feed and the axes' max_velocity in the machine file if the machine can do more"
            yield Diagnostic(
                "feed-unreachable", message, moves.file, moves.line, hint=hint, severity="note"
            )
        moves = self._short
        if moves.count:
            message = f"less than a step of every axis; {_counted(moves.count)} as short"
            hint = "a coarser tolerance in the CAM system gives a shorter program and the same part"
            yield Diagnostic(
                "move-below-step", message, moves.file, moves.line, hint=hint, severity="note"
            )
        yield from self._arcs.findings()
        yield from self._entered

    def _see(self, block: Block) -> None:
        if isinstance(block, Polyline):
            self._see_moves(block)
        elif isinstance(block, ArcFeed | NurbsFeed):
            if isinstance(block, ArcFeed):
                self._arcs.see(block, self._here)
            self._here = np.array(
                block.end if isinstance(block, ArcFeed) else block.control_points[-1]
            )
            self._cut(block.file, block.line)
            excess = block.feed / self._machine.path.max_feed
            if excess > 1.0 + ROUNDING:
                self._unreachable.add(
                    block.file,
                    np.array([block.line], np.int32),
                    np.array([excess]),
                    np.array([block.feed]),
                )
        elif isinstance(block, Probe):
            self._here = np.array(block.end)
        elif isinstance(block, SpindleSync):
            self._synchronized = block.pitch != 0.0
        elif isinstance(block, Spindle):
            self._turning = block.state != "off"
            self._turned |= self._turning
            self._told = False

    def _see_moves(self, block: Polyline) -> None:
        feeding = ~np.isnan(block.feeds)
        if feeding.any():
            self._cut(block.file, int(block.lines[np.argmax(feeding)]))
        ways = np.diff(np.vstack((self._here[None], block.points)), axis=0)
        self._here = np.array(block.points[-1])
        steps = np.abs(ways * self._steps_per_mm).max(axis=1)
        short = feeding & (steps > 0.0) & (steps < 1.0 - ROUNDING)
        self._short.add(block.file, block.lines[short], steps[short], block.feeds[short])
        if not self._synchronized and len(self._linear):
            ways = ways[:, self._linear]
            lengths = np.sqrt((ways * ways).sum(axis=1))
            some = feeding & (lengths > 0.0)
            feeds, lines = block.feeds[some], block.lines[some]
            share = (np.abs(ways[some]) / lengths[some, None] / self._fastest).max(
                axis=1, initial=0.0
            )
            excess = feeds * np.maximum(share, 1.0 / self._machine.path.max_feed)
            above = excess > 1.0 + ROUNDING
            self._unreachable.add(block.file, lines[above], excess[above], feeds[above])

    def _cut(self, file: str, line: int) -> None:
        """A feed move: with the spindle off it is noted, the first between two spindle words."""
        if not self._turning and not self._told:
            self._told = True
            self._idle.append((file, line))


def step_rate(report: Report) -> Iterator[Diagnostic]:
    """Axes that step more often than the board can, once it is known how fast they go."""
    rate = report.machine.board.max_step_rate
    for letter, axis in report.machine.axes.items():
        steps = (report.largest.axes.get(letter, {}).get("velocity") or 0.0) * axis.steps_per_mm
        if steps > rate * (1.0 + ROUNDING):
            message = f"{letter.upper()} makes {steps:.6g} steps/s, the board at most {rate:.6g}"
            hint = f"lower axes.{letter}.max_velocity, or raise board.max_step_rate in the machine file if the board can do more"
            yield Diagnostic("step-rate", message, report.program, hint=hint, severity="warning")


def _counted(moves: int) -> str:
    return "1 move is" if moves == 1 else f"{moves} moves are"
