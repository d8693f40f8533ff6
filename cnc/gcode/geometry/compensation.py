"""Cutter radius compensation (G40 to G42.1): programmed moves to moves of the tool's centre.

The next move in the plane determines the end of a move. So each move is held back until then, with
the blocks between (moves across the plane, dwells, spindle codes), which take place at its end.
Never more than one move in the plane is held.

- First move: from the uncompensated point to beside the end of the programmed move; an arc leads
  in tangentially.
- Outside corner: an arc about the corner; for a traverse, straight moves outside that arc.
- Inside corner: both moves end where their offsets cross. A corner that the tool does not fit into
  is an error.
- Each move: an error if the tool cuts into the move before or after it anywhere else.
- G40: the last move ends beside its end point; the next move leads from there to its own end.

Source: LinuxCNC, "Cutter compensation", and NISTIR 6556, appendix A. Two rules of LinuxCNC are not
used. Its traverses go straight across outside corners, which cuts the corner if the tool is down.
And it refuses moves across the plane before the first one in it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from cnc.gcode.geometry.clearance import is_clear
from cnc.gcode.geometry.corner_paths import around_corner
from cnc.gcode.geometry.held_moves import HeldMove, MoveSink, SourceLine, WaitingMove
from cnc.gcode.geometry.offset_curves import (
    SLACK,
    Curve,
    OffsetArc,
    OffsetLine,
    TrueArc,
    is_nearly_closed,
    join,
    lead_in_arc,
    round_offset,
    straight_offset,
    true_arcs,
)
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.words import Word, fault
from cnc.model.blocks import ArcFeed, Block, Plane
from cnc.model.diagnostics import CncError

MAX_WAITING = 1000
"""Most blocks between two moves in the plane; it limits the memory."""

Side = Literal["left", "right"]
_STRAIGHT_OUT = "the first move after G40 must be a straight one", "lead out with G0 or G1"


class Compensation:
    """Conversion of programmed moves into moves of the tool's centre.

    Positions are machine coordinates in mm (degrees for rotary axes), in the machine's order of
    axes.

    Attributes:
        on: From G41 or G42 to G40. All blocks must pass through :meth:`add` meanwhile.
    """

    def __init__(self, sink: MoveSink, here: SourceLocation) -> None:
        self.on = False
        self._sink = sink
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
        self._held: HeldMove | None = None
        self._waiting: list[WaitingMove | Block] = []

    @property
    def active(self) -> bool:
        """Whether moves must pass through here: until the first move after G40 is complete."""
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
        """Start the compensation (G41, G42).

        Args:
            side: Side of the path.
            radius: Tool radius in mm. A negative one swaps the sides, for a contour that was
                programmed for a larger tool.
            plane: Plane of the compensation.
            columns: Columns of the plane's axes.
            position: (axes,) programmed position.
            at: The G word, for errors.
            shift: From the centre of a turning tool's nose to its control point, mm.

        Raises:
            GcodeError: ``compensation-already-on``.
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
        """End the return to the programmed path: another move, such as a probe, has made it."""
        self._leaving = False

    def stop(self) -> None:
        """End the compensation (G40, program end). The held move ends beside its end point."""
        if self._held is not None:
            self._check_clearance(self._held, 0.0)
            self._finish(self._held, self._held.curve.last, 0.0)
            self._held = None
        if self._side:
            self._leaving = abs(self._here + self._shift - self._programmed) > SLACK
        self.on, self._first = False, False
        self._side = 0

    def move(self, end: list[float], feed: float, line: int) -> None:
        """Add a straight move.

        Args:
            end: (axes,) programmed end.
            feed: mm/s; NaN for a traverse.
            line: Line of the program.

        Raises:
            GcodeError: ``compensation-gouge``, which may be about the move before;
                ``compensation-entry``, ``compensation-look-ahead``.
        """
        if self._side == 0:
            self._leaving = False
            self._sink.place(end, feed, line, self._text.file)
            return
        point = self._point(end)
        if abs(point - self._programmed) <= SLACK:
            self._wait(WaitingMove(end, feed, line, self._text.file))
            return
        curve = straight_offset(self._programmed, point, self._side, self._radius)
        held = HeldMove(curve, end, feed, self._place(line))
        if self._first and curve.length <= self._radius:
            message = (
                f"the first compensated move is {curve.length:.6g} mm long; it must be longer "
                f"than the tool radius, {self._radius:.6g} mm"
            )
            raise held.place.fault(
                "compensation-entry", message, "start farther away from the contour"
            )
        self._next(held)

    def arc(self, block: ArcFeed) -> None:
        """Add an arc or a helix in the plane of compensation.

        Raises:
            GcodeError: ``compensation-arc-radius``, ``compensation-exit``, and those of
                :meth:`move`.
        """
        if self._side == 0:
            if self._leaving:
                raise self._place(block.line).fault("compensation-exit", *_STRAIGHT_OUT)
            self._sink.put(block)
            return
        if self._first and abs(block.turns) >= 1.0:
            message = "the first compensated move can't be a full circle"
            hint = "lead in with a straight move, or an arc of less than a turn"
            raise self._place(block.line).fault("compensation-entry", message, hint)
        start = self._programmed
        first = np.asarray(self._last if self._held is None else self._held.end)
        for waiting in self._waiting:
            first = np.asarray(waiting.end) if isinstance(waiting, WaitingMove) else first
        last, center = self._point(block.end.tolist()), complex(*block.center)
        circle = abs(block.turns) >= 1.0 or is_nearly_closed(start, last, center, block.turns)
        for arc in true_arcs(start, last, center, block.turns):
            end = block.end if arc.share == 1.0 else first + arc.share * (block.end - first)
            held = self._held_arc(start, arc, block, end.tolist())
            held.circle = circle
            self._next(held)
            start = arc.end

    def refuse_curve(self, at: Word | None = None) -> None:
        """Raise GcodeError ``compensation-exit`` if the next move must be straight."""
        if self._leaving:
            message, hint = _STRAIGHT_OUT
            raise fault("compensation-exit", message, at, hint)

    def add(self, block: Block) -> None:
        """Add a block that is not a move. It takes place at the end of the move before.

        Raises:
            GcodeError: ``compensation-look-ahead``.
        """
        self._wait(block)

    def _held_arc(self, start: complex, arc: TrueArc, block: ArcFeed, end: list[float]) -> HeldMove:
        curve, place = round_offset(start, arc, self._side, self._radius), self._place(block.line)
        if curve is None:
            message = (
                f"a tool of radius {self._radius:.6g} mm does not fit into an arc of radius "
                f"{block.radius:.6g} mm"
            )
            raise place.fault(
                "compensation-arc-radius", message, "the radius must be more than the tool's"
            )
        if self._first:
            curve = lead_in_arc(self._here, curve)
            if curve is None or curve.radius <= self._radius:
                message = (
                    "no arc larger than the tool leads tangentially from the position to the end "
                    "of this arc"
                )
                raise place.fault("compensation-entry", message, "lead in with a straight move")
        end = end.copy()
        end[self._columns[0]], end[self._columns[1]] = arc.end.real, arc.end.imag
        return HeldMove(curve, end, block.feed, place, block)

    # Holding back

    def _next(self, new: HeldMove) -> None:
        """Hold a move of the plane. It determines the end of the one before, which is sent."""
        old = self._held
        if old is not None:
            corner = join(old.curve, new.curve, self._side, self._radius, entry=old.entry)
            if corner is not None:
                self._check_length(old, corner.cut)
            if corner is None or (corner.begin - new.curve.length) * new.curve.scale > SLACK:
                raise self._gouge(new, "the move before it")
            if corner.around:
                new.around = around_corner(
                    old.curve.corner,
                    (corner.leave, corner.enter),
                    self._side,
                    self._radius,
                    rapid=math.isnan(new.feed),
                )
            self._check_clearance(old, corner.cut, new)
            self._finish(old, corner.leave, corner.cut)
            new.curve.begin = corner.begin
            new.before = None if old.entry else old.curve
        new.entry, self._first = self._first, False
        self._held = new
        self._programmed = new.curve.corner

    def _wait(self, item: WaitingMove | Block) -> None:
        if self._held is None:
            self._pass(item)
            return
        if len(self._waiting) >= MAX_WAITING:
            message = (
                f"more than {MAX_WAITING} blocks follow a compensated move without the next move "
                "in its plane"
            )
            raise self._held.place.fault("compensation-look-ahead", message, "give G40 before them")
        self._waiting.append(item)

    def _pass(self, item: WaitingMove | Block) -> None:
        """Send a block that does not move the plane's axes."""
        if not isinstance(item, WaitingMove):
            self._sink.put(item)
            return
        if self._first:
            self._here = self._point(item.end) - self._shift
        end = self._placed(item.end, self._here)
        self._sink.place(end, item.feed, item.line, item.file)
        self._last = end

    def _finish(self, held: HeldMove, leave: complex, cut: float) -> None:
        """Send a move and the blocks that waited for it.

        It ends at ``leave``, ``cut`` units before its natural end.
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
            self._sink.put(
                replace(block, center=around, end=np.array(end), radius=radius, turns=turns)
            )
        elif abs(leave - self._here) > SLACK or self._moves_across(end):
            self._sink.place(end, held.feed, held.place.line, held.place.file)
        self._here, self._last = leave, end
        for item in self._waiting:
            self._pass(item)
        self._waiting.clear()

    def _check_length(self, held: HeldMove, cut: float) -> None:
        """Refuse a move that is shorter than its two corners need."""
        curve = held.curve
        if (curve.length - curve.begin - cut) * curve.scale < -SLACK:
            raise self._gouge(held, "the moves before and after it")

    def _check_clearance(self, held: HeldMove, cut: float, after: HeldMove | None = None) -> None:
        """Refuse a move, or the path around its corner, where the tool cuts into its neighbours.

        The move that leads in may start anywhere. A full circle is a contour of its own: the moves
        beside it lead to it and away from it, and the tool passes over them.
        """
        curve = held.curve
        if not held.entry and not held.circle:
            stop = curve.length - cut
            if held.before is not None and not is_clear(
                curve, curve.begin, stop, held.before, self._radius
            ):
                raise self._gouge(held, "the move before it")
            if after is not None and not is_clear(
                curve, curve.begin, stop, after.curve, self._radius
            ):
                raise self._gouge(held, "the move after it")
        if after is not None:
            for path in after.around:
                if not is_clear(path, 0.0, path.length, after.curve, self._radius):
                    raise self._gouge(after, "its own")
                if not held.entry and not is_clear(path, 0.0, path.length, curve, self._radius):
                    raise self._gouge(after, "the move before it")

    def _go_around(self, path: Curve, held: HeldMove) -> None:
        """Send a part of the path around an outside corner, as part of the move after it."""
        end, place = self._placed(self._last, path.last), held.place
        if isinstance(path, OffsetLine):
            self._sink.place(end, held.feed, place.line, place.file)
        else:
            center, turns = path.center + self._shift, path.spin * path.length / math.tau
            around = (center.real, center.imag)
            source, at = (place.file, place.line), np.array(end)
            self._sink.put(
                ArcFeed(*source, self._plane, around, at, self._radius, turns, held.feed)
            )
        self._here, self._last = path.last, end

    def _gouge(self, held: HeldMove, what: str) -> CncError:
        message = (
            f"a tool of radius {self._radius:.6g} mm can't make this move without cutting into the "
            f"contour of {what}"
        )
        return held.place.fault(
            "compensation-gouge", message, "use a smaller tool, or larger corner radii"
        )

    def _place(self, line: int) -> SourceLine:
        text = self._text
        return SourceLine(text.file, line, text.text_of, text.words_of)

    # Points of the plane

    def _point(self, position: list[float]) -> complex:
        first, second = self._columns
        return complex(position[first], position[second])

    def _placed(self, position: list[float], point: complex) -> list[float]:
        """The position with its plane axes at a point of the tool's centre."""
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
