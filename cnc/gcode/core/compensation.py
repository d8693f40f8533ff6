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

import cmath
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from cnc.gcode.core.block_buffer import SourceLocation
from cnc.gcode.core.offset_curves import (
    SLACK,
    Curve,
    OffsetArc,
    OffsetLine,
    TrueArc,
    angle,
    is_nearly_closed,
    join,
    lead_in_arc,
    meet,
    programmed,
    round_offset,
    straight_offset,
    true_arcs,
)
from cnc.gcode.reader.words import G, Word, fault
from cnc.model.blocks import ArcFeed, Block, Plane
from cnc.model.diagnostics import CncError

# Least distance between the path of the tool's centre and a move of the contour, exact.
#
# A corner can be possible, although the tool does not fit farther along the moves: an arc may lead
# back to the move before it, into a pocket that is narrower at its mouth than at the corner.
#
#          a
#       .------P      The tool fits into the corner at Q and along both moves there, but not past P:
#    .'    o    \     its centre is beside b along the whole arc, and comes nearer to P than its
#    b '.       a     radius.
#         `- - -Q
#
# The distance from a move is least at an end of the path, beside an end of the move, where both are
# perpendicular to the line between them, or where they cross. Each of these points is tested by its
# distance from the move. A point that is slightly wrong is harmless: the tool does come to the
# distance there.


def is_clear(path: Curve, start: float, stop: float, offset: Curve, radius: float) -> bool:
    """Return whether no point of a part of a path is nearer to a move than the tool radius.

    Two straight moves with a corner never are.

    Args:
        path: Path of the tool's centre.
        start: Start of the part, in the units of the path.
        stop: End of the part.
        offset: Offset curve of the move.
        radius: Tool radius, mm.
    """
    if isinstance(path, OffsetLine) and isinstance(offset, OffsetLine):
        return True
    return clearance(path, start, stop, programmed(offset)) >= radius - SLACK


def clearance(path: Curve, start: float, stop: float, move: Curve) -> float:
    """Return the least distance of a part of a path from a whole move, mm.

    Args:
        path: Path of the tool's centre.
        start: Start of the part, in the units of the path.
        stop: End of the part.
        move: The move.
    """
    stop = max(start, stop)
    least = min(distance(place(path, start), move), distance(place(path, stop), move))
    for point in _least(path, move):
        along = path.distance_along(point)
        if isinstance(path, OffsetArc):
            along = start + (along - start) % math.tau
        if start < along < stop:
            least = min(least, distance(point, move))
    return least


def place(curve: Curve, along: float) -> complex:
    """Return the point at a distance, in the units of the curve, after its start."""
    if isinstance(curve, OffsetLine):
        return curve.first + along * curve.heading
    return curve.center + (curve.first - curve.center) * cmath.rect(1.0, curve.spin * along)


def distance(point: complex, move: Curve) -> float:
    """Return the distance of a point from a move, mm."""
    if isinstance(move, OffsetLine):
        along = min(max(move.distance_along(point), 0.0), move.length)
        return abs(point - move.first - along * move.heading)
    if move.distance_along(point) % math.tau <= move.length:
        return abs(abs(point - move.center) - move.radius)
    return min(abs(point - move.first), abs(point - move.last))


def _least(path: Curve, move: Curve) -> Iterator[complex]:
    """Points at which the distance of a path from a move may be least.

    They are those of curves without ends, and the points beside the ends of the move.
    """
    centers = (
        (move.first, move.last, move.center)
        if isinstance(move, OffsetArc)
        else (move.first, move.last)
    )
    if isinstance(path, OffsetLine):
        for center in centers:
            yield place(path, path.distance_along(center))
    else:
        across = [center - path.center for center in centers]
        if isinstance(move, OffsetLine):
            across.append(1j * move.heading)
        for direction in across:
            if direction != 0.0:
                out = direction / abs(direction) * path.radius
                yield path.center + out
                yield path.center - out
    for left in (1, -1):
        crossing = meet(path, move, left)
        if crossing is not None:
            yield crossing


# Paths of the tool's centre around outside corners.


def around_corner(
    corner: complex, ends: tuple[complex, complex], side: int, radius: float, *, rapid: bool
) -> tuple[Curve, ...]:
    """Return the path around an outside corner.

    Args:
        corner: The corner, mm.
        ends: Start and end of the path.
        side: Side of the tool, 1 for left and -1 for right.
        radius: Tool radius, mm.
        rapid: Return the lines of a polygon outside the arc, in steps of at most 45 degrees.

    Returns:
        An arc, or lines.
    """
    leave, enter = ends
    ray = leave - corner
    turned = abs(angle((enter - corner) * ray.conjugate()))
    if not rapid:
        return (OffsetArc(corner, leave, enter, corner, radius, -side, turned, 0.0),)
    steps = math.ceil(turned / (math.pi / 4))
    far = 1.0 / math.cos(turned / steps / 2)
    corners = [
        corner + ray * cmath.rect(far, -side * turned * (step + 0.5) / steps)
        for step in range(steps)
    ]
    return tuple(
        straight_offset(start, end, 0, 0.0)
        for start, end in zip([leave, *corners], [*corners, enter], strict=True)
    )


# Moves that cutter compensation holds back until their end is known.

_MOTIONS = tuple(code.code for code in (G.G0, G.G1, G.G2, G.G3))


class MoveSink(Protocol):
    """Receiver of the moves of the tool's centre."""

    def place(self, end: list[float], feed: float, line: int, file: str) -> None:
        """Add a straight move to ``end`` (axes,); NaN feed for a traverse."""

    def put(self, block: Block) -> None:
        """Add any other block."""


@dataclass(slots=True)
class SourceLine:
    """An earlier line of the program, for errors."""

    file: str
    line: int
    text_of: Callable[[int], str]
    words_of: Callable[[int], tuple[Word, ...]]

    def fault(self, code: str, message: str, hint: str) -> CncError:
        """Return an error at the line's motion code, or at its first word."""
        words = [word for word in self.words_of(self.line) if word.letter != "N"]
        codes = (word for word in words if word.letter == "G" and word.number in _MOTIONS)
        error = fault(code, message, next(codes, words[0] if words else None), hint)
        return error.at(file=self.file, line=self.line, text=self.text_of(self.line))


@dataclass(slots=True)
class WaitingMove:
    """A straight move after the held one. Its plane axes follow from the end of that."""

    end: list[float]
    feed: float
    line: int
    file: str


@dataclass(slots=True)
class HeldMove:
    """A move whose end is not known yet.

    Attributes:
        curve: Path of the tool's centre.
        end: (axes,) programmed end.
        feed: mm/s; NaN for a traverse.
        place: Line of the move.
        template: The arc as it was programmed.
        around: Path around the outside corner before it. It is sent when the move itself is known
            to be possible.
        entry: The move leads in.
        circle: The move is part of a full circle, or nearly one.
        before: The move before, unless that leads in.
    """

    curve: Curve
    end: list[float]
    feed: float
    place: SourceLine
    template: ArcFeed | None = None
    around: tuple[Curve, ...] = ()
    entry: bool = False
    circle: bool = False
    before: Curve | None = None


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
