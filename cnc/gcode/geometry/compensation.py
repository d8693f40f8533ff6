"""Cutter radius compensation, G40 to G42.1: moves of the contour in, moves of the tool's centre
out.

Where a move ends is known only when the next one in the plane is: each move is held back until
then, with everything that comes between (moves across the plane, dwells, spindle codes), which
happens where it ends. Never more than one move is held.

    first move        from the uncompensated point to beside the end of the programmed move (an arc: tangentially)
    outside corner    an arc about the corner; for a traverse, straight moves that stay outside of that arc
    inside corner     both moves end where their offsets cross; a corner that the tool can't get into is an error
    each move         is an error, too, where the tool cuts into the one before or after it anywhere else
    G40               the last move ends beside its end point; the next move leads from there to its own

Source: LinuxCNC, "Cutter compensation", and NISTIR 6556, appendix A. LinuxCNC sends traverses
straight across outside corners, which cuts the corner with a tool that is down, and refuses moves
across the plane before the first one in it; neither is followed.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from cnc.gcode.geometry.clearance import clearance
from cnc.gcode.geometry.offset_curves import (
    SLACK,
    Curve,
    OffsetArc,
    OffsetLine,
    TrueArc,
    angle,
    is_nearly_closed,
    join,
    lead_in_arc,
    programmed,
    round_offset,
    straight_offset,
    true_arcs,
)
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import Word, fault
from cnc.model.blocks import ArcFeed, Block, Plane
from cnc.model.diagnostics import CncError

MAX_WAITING = 1000
"""Blocks between two moves in the plane: a bound to the memory that a program can ask for."""

Side = Literal["left", "right"]
_MOTIONS = tuple(code.code for code in (G.G0, G.G1, G.G2, G.G3))
_STRAIGHT_OUT = "the first move after G40 must be a straight one", "lead out with G0 or G1"


class MoveSink(Protocol):
    """Where the moves of the tool's centre go."""

    def place(self, end: list[float], feed: float, line: int, file: str) -> None:
        """A straight move to ``end`` (axes,); NaN feed for a traverse."""

    def put(self, block: Block) -> None:
        """Any other block."""


@dataclass(slots=True)
class _SourceLine:
    """A line that an error may have to point at when it has gone by."""

    file: str
    line: int
    text_of: Callable[[int], str]
    words_of: Callable[[int], tuple[Word, ...]]

    def fault(self, code: str, message: str, hint: str) -> CncError:
        """An error at the line's motion code, or at its first word."""
        words = [word for word in self.words_of(self.line) if word.letter != "N"]
        codes = (word for word in words if word.letter == "G" and word.number in _MOTIONS)
        error = fault(code, message, next(codes, words[0] if words else None), hint)
        return error.at(file=self.file, line=self.line, text=self.text_of(self.line))


@dataclass(slots=True)
class _WaitingMove:
    """A straight move that waits behind the one that is held: its plane axes follow from where that
    ends.
    """

    end: list[float]
    feed: float
    line: int
    file: str


@dataclass(slots=True)
class _HeldMove:
    """A move whose end is not yet known.

    ``template`` is the arc as it was programmed. ``around`` is the way around the outside corner
    before it: nothing of that is sent before the move itself is known to be possible. ``entry``
    marks the move that leads in, ``circle`` one that is part of a full circle or nearly one.
    ``before`` is the move before, unless that leads in.
    """

    curve: Curve
    end: list[float]
    feed: float
    place: _SourceLine
    template: ArcFeed | None = None
    around: tuple[Curve, ...] = ()
    entry: bool = False
    circle: bool = False
    before: Curve | None = None


class Compensation:
    """The filter that turns programmed moves into those of the tool's centre.

    Positions are machine coordinates, mm (degrees for rotary axes), in the machine's order of axes.
    ``on`` from G41 or G42 to G40; ``active`` also until the first move after G40 has led back: as
    long as it says so, every move has to come through here; as long as it is on, every other block,
    too. ``here`` tells in which file the lines stand.
    """

    def __init__(self, emit: MoveSink, here: SourceLocation) -> None:
        self.on = False
        self._emit = emit
        self._text = here
        self._side = 0
        self._radius = 0.0
        self._shift = 0j
        self._plane: Plane = "XY"
        self._columns = (0, 1)
        self._programmed = 0j
        self._here = 0j
        self._last: list[float] = []
        self._first = False
        self._leaving = False
        self._held: _HeldMove | None = None
        self._waiting: list[_WaitingMove | Block] = []

    @property
    def active(self) -> bool:
        """Whether moves have to come through here."""
        return self.on or self._leaving

    def start(
        self,
        side: Side,
        radius: float,
        plane: Plane,
        columns: tuple[int, int],
        position: list[float],
        at: Word | None = None,
        *,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """G41 or G42 at the programmed ``position``; ``at`` is its word.

        ``radius`` mm of the tool; a negative one swaps the sides, as a contour programmed for a
        bigger tool needs it. ``columns`` are those of the plane's axes. ``shift`` (first, second
        axis) leads from the centre of a lathe tool's nose to its control point, mm.

        Raises GcodeError ``compensation-already-on`` at ``at``.
        """
        if self.on:
            raise fault(
                "compensation-already-on",
                "cutter compensation is on already",
                at,
                "give G40 before",
            )
        self.on, self._first = True, True
        self._radius = abs(radius)
        self._side = 0 if radius == 0.0 else 1 if (side == "left") == (radius > 0.0) else -1
        self._shift = complex(*shift)
        self._plane, self._columns = plane, columns
        self._programmed = self._point(position)
        if self._side and not self._leaving:
            self._last = position.copy()
        if self._side:
            self._here = self._point(self._last) - self._shift
            self._leaving = False

    def led_out(self) -> None:
        """A move that does not come through here has led back to the programmed path."""
        self._leaving = False

    def stop(self) -> None:
        """G40, or the end of the program: the move that is held ends beside its end point."""
        if self._held is not None:
            self._check_clearance(self._held, 0.0)
            self._finish(self._held, self._held.curve.last, 0.0)
            self._held = None
        if self._side:
            self._leaving = abs(self._here + self._shift - self._programmed) > SLACK
        self.on, self._first = False, False
        self._side = 0

    def move(self, end: list[float], feed: float, line: int) -> None:
        """A straight move of a line to ``end`` (axes,), NaN feed for a traverse.

        Raises GcodeError ``compensation-gouge``, ``compensation-entry``,
        ``compensation-look-ahead``; the first of them may be about the move before.
        """
        if self._side == 0:
            self._leaving = False
            self._emit.place(end, feed, line, self._text.file)
            return
        point = self._point(end)
        if abs(point - self._programmed) <= SLACK:
            self._wait(_WaitingMove(end, feed, line, self._text.file))
            return
        curve = straight_offset(self._programmed, point, self._side, self._radius)
        held = _HeldMove(curve, end, feed, self._place(line))
        if self._first and curve.length <= self._radius:
            message = f"the first compensated move is {curve.length:.6g} mm long, which must be more than the tool radius, {self._radius:.6g} mm"
            raise held.place.fault(
                "compensation-entry", message, "start farther away from the contour"
            )
        self._next(held)

    def arc(self, block: ArcFeed) -> None:
        """An arc or a helix in the plane of compensation.

        Raises GcodeError ``compensation-arc-radius``, ``compensation-exit``, and those of
        :meth:`move`.
        """
        if self._side == 0:
            if self._leaving:
                raise self._place(block.line).fault("compensation-exit", *_STRAIGHT_OUT)
            self._emit.put(block)
            return
        if self._first and abs(block.turns) >= 1.0:
            message = "the first compensated move can't be a full circle"
            hint = "lead in with a straight move, or an arc of less than a turn"
            raise self._place(block.line).fault("compensation-entry", message, hint)
        start = self._programmed
        first = np.asarray(self._last if self._held is None else self._held.end)
        for waiting in self._waiting:
            first = np.asarray(waiting.end) if isinstance(waiting, _WaitingMove) else first
        last, center = self._point(block.end.tolist()), complex(*block.center)
        circle = abs(block.turns) >= 1.0 or is_nearly_closed(start, last, center, block.turns)
        for arc in true_arcs(start, last, center, block.turns):
            end = block.end if arc.share == 1.0 else first + arc.share * (block.end - first)
            held = self._held_arc(start, arc, block, end.tolist())
            held.circle = circle
            self._next(held)
            start = arc.end

    def refuse_curve(self, at: Word | None = None) -> None:
        """GcodeError ``compensation-exit`` where the next move has to lead out: it must be a
        straight one.
        """
        if self._leaving:
            message, hint = _STRAIGHT_OUT
            raise fault("compensation-exit", message, at, hint)

    def add(self, block: Block) -> None:
        """A block that is no move: it happens where the move before it ends.

        Raises GcodeError ``compensation-look-ahead``.
        """
        self._wait(block)

    def _held_arc(
        self, start: complex, arc: TrueArc, block: ArcFeed, end: list[float]
    ) -> _HeldMove:
        curve, place = round_offset(start, arc, self._side, self._radius), self._place(block.line)
        if curve is None:
            message = f"an arc of radius {block.radius:.6g} mm, cut on its inside by a tool of radius {self._radius:.6g} mm"
            raise place.fault(
                "compensation-arc-radius", message, "the radius must be more than the tool's"
            )
        if self._first:
            curve = lead_in_arc(self._here, curve)
            if curve is None or curve.radius <= self._radius:
                message = "no arc larger than the tool leads from here tangentially to the end of this one"
                raise place.fault("compensation-entry", message, "lead in with a straight move")
        end = end.copy()
        end[self._columns[0]], end[self._columns[1]] = arc.end.real, arc.end.imag
        return _HeldMove(curve, end, block.feed, place, block)

    # Holding back

    def _next(self, new: _HeldMove) -> None:
        """A move in the plane: now the end of the one before is known."""
        old = self._held
        if old is not None:
            corner = join(old.curve, new.curve, self._side, self._radius, entry=old.entry)
            if corner is not None:
                self._check_length(old, corner.cut)
            if corner is None or (corner.begin - new.curve.length) * new.curve.scale > SLACK:
                raise self._gouge(new, "the move before it")
            if corner.around:
                new.around = self._around(
                    old.curve.corner, corner.leave, corner.enter, rapid=math.isnan(new.feed)
                )
            self._check_clearance(old, corner.cut, new)
            self._finish(old, corner.leave, corner.cut)
            new.curve.begin = corner.begin
            new.before = None if old.entry else old.curve
        new.entry, self._first = self._first, False
        self._held = new
        self._programmed = new.curve.corner

    def _wait(self, item: _WaitingMove | Block) -> None:
        if self._held is None:
            self._pass(item)
            return
        if len(self._waiting) >= MAX_WAITING:
            message = f"more than {MAX_WAITING} blocks after a compensated move without the next one in its plane"
            raise self._held.place.fault("compensation-look-ahead", message, "give G40 before them")
        self._waiting.append(item)

    def _pass(self, item: _WaitingMove | Block) -> None:
        """What leaves the plane's axes where they are."""
        if not isinstance(item, _WaitingMove):
            self._emit.put(item)
            return
        if self._first:
            self._here = self._point(item.end) - self._shift
        end = self._placed(item.end, self._here)
        self._emit.place(end, item.feed, item.line, item.file)
        self._last = end

    def _finish(self, held: _HeldMove, leave: complex, cut: float) -> None:
        """Sends a move, which ends at ``leave``, ``cut`` units of its curve before its natural end;
        then what waited for it.
        """
        curve = held.curve
        part = curve.length - curve.begin - cut
        for path in held.around:
            self._go_around(path, held)
        end = self._placed(held.end, leave)
        block = held.template
        if isinstance(curve, OffsetArc) and block is not None and part * curve.scale > SLACK:
            center = curve.center + self._shift
            turns = curve.spin * part / math.tau
            around, radius = (center.real, center.imag), abs(self._here - curve.center)
            self._emit.put(
                replace(block, center=around, end=np.array(end), radius=radius, turns=turns)
            )
        elif abs(leave - self._here) > SLACK or self._moves_across(end):
            self._emit.place(end, held.feed, held.place.line, held.place.file)
        self._here, self._last = leave, end
        for item in self._waiting:
            self._pass(item)
        self._waiting.clear()

    def _check_length(self, held: _HeldMove, cut: float) -> None:
        """Refuses a move of which the corners at its ends take more than there is."""
        curve = held.curve
        if (curve.length - curve.begin - cut) * curve.scale < -SLACK:
            raise self._gouge(held, "the moves before and after it")

    def _check_clearance(self, held: _HeldMove, cut: float, after: _HeldMove | None = None) -> None:
        """Refuses a move that ends where it meets the one ``after`` it, or a way around their
        corner, where the tool cuts into either.

        The move that leads in does so from anywhere. A full circle is a contour of its own, and the
        moves beside it lead to it and away from it: on its way around the tool passes over them.
        """
        curve = held.curve
        if not held.entry and not held.circle:
            stop = curve.length - cut
            if held.before is not None and not self._clear(curve, curve.begin, stop, held.before):
                raise self._gouge(held, "the move before it")
            if after is not None and not self._clear(curve, curve.begin, stop, after.curve):
                raise self._gouge(held, "the move after it")
        if after is not None:
            for path in after.around:
                if not self._clear(path, 0.0, path.length, after.curve):
                    raise self._gouge(after, "its own")
                if not held.entry and not self._clear(path, 0.0, path.length, curve):
                    raise self._gouge(after, "the move before it")

    def _clear(self, path: Curve, start: float, stop: float, offset: Curve) -> bool:
        """Whether a part of a path is nowhere nearer to the move of an offset curve than the tool's
        radius.

        That is so of straight moves that have a corner: the offset of one does not come back to the
        other.
        """
        if isinstance(path, OffsetLine) and isinstance(offset, OffsetLine):
            return True
        return clearance(path, start, stop, programmed(offset)) >= self._radius - SLACK

    def _around(
        self, corner: complex, leave: complex, enter: complex, *, rapid: bool
    ) -> tuple[Curve, ...]:
        """The way around an outside corner: an arc, or the polygon about it, in steps of up to 45
        degrees.
        """
        ray = leave - corner
        turned = abs(angle((enter - corner) * ray.conjugate()))
        if not rapid:
            return (
                OffsetArc(corner, leave, enter, corner, self._radius, -self._side, turned, 0.0),
            )
        steps = math.ceil(turned / (math.pi / 4))
        far = 1.0 / math.cos(turned / steps / 2)
        ends = [
            corner + ray * cmath.rect(far, -self._side * turned * (step + 0.5) / steps)
            for step in range(steps)
        ]
        starts = [leave, *ends]
        return tuple(
            straight_offset(start, end, 0, 0.0)
            for start, end in zip(starts, [*ends, enter], strict=True)
        )

    def _go_around(self, path: Curve, held: _HeldMove) -> None:
        """A part of the way around an outside corner, as part of the move after it."""
        end, place = self._placed(self._last, path.last), held.place
        if isinstance(path, OffsetLine):
            self._emit.place(end, held.feed, place.line, place.file)
        else:
            center, turns = path.center + self._shift, path.spin * path.length / math.tau
            around = (center.real, center.imag)
            self._emit.put(
                ArcFeed(
                    place.file,
                    place.line,
                    self._plane,
                    around,
                    np.array(end),
                    self._radius,
                    turns,
                    held.feed,
                )
            )
        self._here, self._last = path.last, end

    def _gouge(self, held: _HeldMove, what: str) -> CncError:
        message = f"a tool of radius {self._radius:.6g} mm can't make this move without cutting into the contour of {what}"
        return held.place.fault(
            "compensation-gouge", message, "take a smaller tool, or give its corners larger radii"
        )

    def _place(self, line: int) -> _SourceLine:
        text = self._text
        return _SourceLine(text.file, line, text.text_of, text.words_of)

    # Points of the plane

    def _point(self, position: list[float]) -> complex:
        first, second = self._columns
        return complex(position[first], position[second])

    def _placed(self, position: list[float], point: complex) -> list[float]:
        """A position whose plane axes are those of a point of the tool's centre."""
        placed = position.copy()
        point += self._shift
        placed[self._columns[0]], placed[self._columns[1]] = point.real, point.imag
        return placed

    def _moves_across(self, end: list[float]) -> bool:
        return any(
            a != b
            for index, (a, b) in enumerate(zip(end, self._last, strict=True))
            if index not in self._columns
        )
