"""The plan stream as lines of G-code for a GRBL 1.1 board: arcs stay arcs, all else becomes lines
and arcs within a tolerance.

    PlanChunk ──► PathSampler ──► pending samples ──► fewest lines and arcs between its cuts ──► LineWriter ──► GcodeLine
    Block ──────────────────► CommandLines ─────────────────────────────────────────────────────────────►

**Coordinates.** The plan is in machine coordinates; GRBL takes those only of straight moves (G53
holds for one line and not for arcs), so lines are in work coordinates with G54 selected, and the
Translator has to be told what the board adds to them:

    work_offset = G54 + G92 + tool length, x y z in mm: the ``WCO`` of a status report while G54 is
    selected.

The first line selects G54 and nothing that would change an offset is ever sent, so that WCO stays
what it was. Who drives a board asks it for these numbers (``$#``, or ``?`` after G54), has the
program read with the same offsets, and compares WCO with ``work_offset`` once the first line has
been carried out, before any motion. For a file it is the offset of G54 with which the program was
read: the file runs wherever G54 is set on the part.

**Speed.** A line is sent with the highest speed that the plan has on it, so that curves and corners
are taken as planned; the board makes its own ramps. F is said where that differs by more than 5 %
from the one in effect, and is never more than programmed. Traverses are G0.

**Rests.** Where the path itself rests between two moves (G61.1) G4 P0 stands, for which GRBL comes
to rest. It does so by itself for everything that CommandLines sends but comments.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cnc.grbl_lines.arc_fit import Move, moves
from cnc.grbl_lines.commands import CommandLines, probe_word
from cnc.grbl_lines.number_format import LETTERS, PLANE_COLUMNS
from cnc.grbl_lines.path_samples import PathSampler, PathSamples, PlaneArc
from cnc.grbl_lines.smooth import SMOOTHING
from cnc.grbl_lines.travel_margin import TravelMargin
from cnc.grbl_lines.writer import LineWriter, Point
from cnc.machine.models import Machine
from cnc.model.blocks import Block, BoardCommand, End, Message, Probe
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.streams import GcodeLine
from cnc.planner.plan import PlanChunk

PREAMBLE = "G21 G90 G94 G17 G54"
REST = "G4 P0"
DENSE = 0.02
"""Part of the tolerance by which the points of a curve stand for it."""
FITTING = 0.96 - DENSE - SMOOTHING
"""Part of the tolerance that lines and arcs may be off those points. The rest is for the digits of
numbers, and for what sums of 32-bit floats lose.
"""
ARC_TOLERANCE = 0.002
"""mm: GRBL's default for $12."""
LEAST_TOLERANCE = 1e-3
"""mm. The board computes with 32-bit floats: at 300 mm that is good for a hundredth of it."""


class Translator:
    """Lines for the items of one plan, in their order.

    tolerance: mm, how far the lines may be from the program, the path being that of
    :func:`~cnc.grbl_lines.smooth.smooth_path` for the same one; None for the machine's
    (``path.tolerance``). work_offset: see above. arc_tolerance: the board's $12, mm, by which its
    own chords may be off an arc. mist: the board has M7. margin: mm, by which lines keep away from
    the ends of the travel (:mod:`cnc.grbl_lines.travel_margin`). moving: for a program that may run
    anywhere, the axes (of "xyz") that move in it: the first feed move finds all of them where they
    should be, because a traverse has said so; None for a board that stands where the plan begins.
    Raises GcodeError ``not-on-board``, ``axis-not-on-board``, ``board-command-moves`` at the line
    of what GRBL can't do.
    """

    def __init__(
        self,
        machine: Machine,
        tolerance: float | None = None,
        *,
        work_offset: Sequence[float] = (0.0, 0.0, 0.0),
        arc_tolerance: float = ARC_TOLERANCE,
        mist: bool = False,
        margin: float = 0.0,
        moving: str | None = None,
    ) -> None:
        axes = machine.axis_names
        self.tolerance = max(
            machine.path.tolerance if tolerance is None else tolerance, LEAST_TOLERANCE
        )
        letters = "".join(letter for letter in LETTERS if letter.lower() in axes)
        self._axes = axes
        self._commands = CommandLines(mist=mist)
        self._chord = arc_tolerance
        given = [machine.axes.get(letter) for letter in ("x", "y", "z")]
        self._accelerations = [
            math.inf if axis is None else axis.max_acceleration or math.inf for axis in given
        ]
        self._normal = machine.path.max_normal_acceleration or math.inf
        self._fit = FITTING * self.tolerance
        self._room = TravelMargin.of(machine, margin)
        self._strands = PathSampler(axes, DENSE * self.tolerance, self._room)
        self._writer = LineWriter(
            work_offset, self.tolerance, machine.board.baud, letters, arc_tolerance
        )
        self._to_state = "" if moving is None else moving.upper()
        self._pending: PathSamples | None = None
        self._begun = False
        self._rests = False
        self._probing: Probe | None = None
        self._guessed: Probe | None = None
        self._position: Point | None = None

    @property
    def position(self) -> Point | None:
        """Where the lines so far lead to, x y z in mm (machine coordinates); None where nobody
        knows: at first, and behind a probe.
        """
        return self._position

    def lines(self, item: PlanChunk | Block) -> Iterator[GcodeLine]:
        """The lines that the next item of the plan makes certain; the others come with later items,
        or with :meth:`end`.
        """
        if isinstance(item, PlanChunk):
            samples = self._strands.made(item)
            if samples is None:
                return
            if self._probing is not None:
                # the way of a probe that has been sent as a line of its own
                if samples.rest[-1]:
                    self._guessed = self._probing if self._probing.answer.values is None else None
                    self._probing = None
                return
            self._pending = (
                samples if self._pending is None else PathSamples.joined(self._pending, samples)
            )
            yield from self._moves(whole=bool(samples.rest[-1]))
            return
        if not isinstance(item, Message):
            yield from self.end()
            self._rests = False
            self._probing = None
        yield from self._begin(item.line)
        if isinstance(item, Probe):
            yield self._probe(item)
            return
        for text in self._commands.lines(item):
            yield GcodeLine(text, item.line)
        if isinstance(item, BoardCommand):
            self._writer.lost()
        elif isinstance(item, End):
            self._writer.program_ended()

    def end(self) -> Iterator[GcodeLine]:
        """What is left."""
        yield from self._moves(whole=True)

    def _begin(self, line: int) -> Iterator[GcodeLine]:
        if not self._begun:
            self._begun = True
            yield GcodeLine(PREAMBLE, line)

    def _moves(self, *, whole: bool) -> Iterator[GcodeLine]:
        """The moves of the pending samples."""
        samples, self._pending = self._pending, None
        if samples is None:
            return
        first = int(samples.line[0])
        yield from self._begin(first)
        if self._guessed is not None:
            yield GcodeLine(
                f"M0 (MSG, the probe of line {self._guessed.line} was not made: go on in a dry run only)",
                first,
            )
            self._guessed = None
        if self._position is None or not self._writer.placed:
            # where the board stands when nothing has moved; behind a probe it may stand a little
            # farther
            known = self._position is None and not self._commands.moved
            self._position = _point(samples.points[0].tolist())
            if known:
                self._writer.stands_at(self._position)
        self._commands.moved = True
        last: Move | None = None
        for move in moves(samples, self._fit, self._chord, self._room):
            if last is not None:
                yield from self._said(last)
            last = move
        if last is not None and whole:
            yield from self._said(last)
        elif last is not None:
            # what comes may go on with it
            self._pending = samples.behind(last.first)

    def _said(self, move: Move) -> Iterator[GcodeLine]:
        """The lines of one move."""
        writer, arc = self._writer, move.arc
        if self._rests:
            yield GcodeLine(REST, move.line)
        if self._to_state and not math.isnan(move.feed):
            missing, self._to_state = self._to_state, ""
            for text in writer.stated(
                missing, move.end if arc is None else None, move.speed, move.feed
            ):
                yield GcodeLine(text, move.line)
        if arc is None:
            texts = writer.line(move.end, move.speed, move.feed)
        else:
            if not writer.placed and self._position is not None:
                for text in writer.line(self._position, move.speed, move.feed):
                    yield GcodeLine(text, move.line)
            speed = (
                min(move.speed, self._fastest_round(arc, move.end)) if arc.fitted else move.speed
            )
            texts = writer.arc(
                move.end, arc.plane, arc.center, arc.sweep, speed, move.feed, fitted=arc.fitted
            )
        for text in texts:
            yield GcodeLine(text, move.line)
        self._position, self._rests = move.end, move.rests

    def _fastest_round(self, arc: PlaneArc, end: Point) -> float:
        """The speed, mm/s, at which an arc takes up the acceleration of its axes: it may be bent
        more than the path that it is for.
        """
        i, j, across = PLANE_COLUMNS[arc.plane]
        radius = math.dist((end[i], end[j]), arc.center)
        climb = 0.0 if self._position is None else end[across] - self._position[across]
        level = radius * abs(arc.sweep)
        pull = min(self._normal, self._accelerations[i], self._accelerations[j])
        return math.sqrt(pull * radius) * math.hypot(level, climb) / max(level, 1e-9)

    def _probe(self, probe: Probe) -> GcodeLine:
        for axis, end in zip(self._axes, probe.end.tolist(), strict=True):
            if axis.upper() not in LETTERS and end:
                message = f"a GRBL board probes along X, Y and Z, not along {axis.upper()}"
                raise GcodeError(Diagnostic("axis-not-on-board", message, probe.file, probe.line))
        ends = dict(zip(self._axes, probe.end.tolist(), strict=True))
        wanted = np.array([[ends.get(letter.lower(), 0.0) for letter in LETTERS]])
        end = _point(self._room.inside(wanted)[0].tolist())
        self._probing = probe
        self._commands.moved = True
        self._position = None
        return GcodeLine(self._writer.probe(probe_word(probe), end, probe.feed), probe.line)


def _point(row: Sequence[float]) -> Point:
    x, y, z = row
    return x, y, z
