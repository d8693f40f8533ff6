"""Moves as the shortest lines that GRBL 1.1 reads correctly.

A modal word stands only where the mode changes, an F word where the feed changes, an axis where it
moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from cnc.grbl_lines.board_limits import PLANNER_MOVES
from cnc.grbl_lines.kernels.arc_fit import board_chord
from cnc.grbl_lines.number_format import (
    CENTER_LETTERS,
    FEED_STEP,
    LETTERS,
    LONGEST,
    PLANE_COLUMNS,
    PLANE_WORDS,
    Move,
    PlaneArc,
    Point,
    feed_word,
)
from cnc.model.diagnostics import Diagnostic
from cnc.model.line_effects import REST, LineEffect, LineKind, new_effect
from cnc.model.streams import GcodeLine, new_line
from cnc.model.units import decimal_text, per_minute, per_second

# Points and arcs in the rounded numbers of a line.
#
# An arc is given by its centre (I J K from the start), never by its radius. GRBL takes the radius
# from the start and turns towards the end as it reads it. It refuses (error:33) radii that differ
# by more than 0.005 mm and 0.1 % (gcode.c). Therefore, for an arc up to half a turn:
#
#               centre         The centre is put on the bisector of the two printed points, so that
#                /|\           both radii are equal. The angle that the board computes from the
#         start / | \ end      printed numbers is computed before they are sent.
#
# Where rounding would turn a short arc into a full circle, or the reverse, chords are sent instead.
#
# GRBL takes an angle below 5e-7 rad for a full circle (motion_control.c, mc_arc). With 32-bit
# floats the angle between the two ends of a full circle is 0 only within 3e-5 mm / radius, at 300
# mm from zero: half of the circles of 10 mm would be left out. So a full circle is sent as two
# halves.
#
# Along the axis across an arc the board adds a part of the climb at each chord and rounds each sum.
# After n chords at height z the error is up to n ulp(z) / 2, until the end point corrects it. So a
# helix of many chords far from zero is sent in several parts.

TURN = 2.0 * math.pi
SHORTEST_ANGLE = 1e-3
SHORTEST_ARC = 1e-3
"""rad, mm. An arc that turns less or is shorter is sent as a line: the board could take it for a
full circle.
"""
CHORDS = 0.2
"""Part of the tolerance for chords that replace a fitted arc where rounded numbers would spoil
it.
"""
COARSE = 0.8
"""Part of the tolerance that the board's own chords may be from an arc of the program. Beyond it,
chords are sent instead.
"""
DIGITS = 0.02
"""Part of the tolerance for the effect of rounded numbers on the board's chords."""
HELIX_SUM, FITTED_HELIX_SUM = 0.5, 0.04
"""Part of the tolerance that rounding may add up to along a helix of the program, and along one
that is fitted to a path.
"""


class Printed(NamedTuple):
    """A point as a line gives it: a number for each axis of the board, and its text.

    The text of an axis is None where its position is known only roughly.
    """

    values: Point
    texts: tuple[str | None, ...]


@dataclass(frozen=True, slots=True)
class PrintedArc:
    """An arc as a line gives it, mm and rad.

    end: end point. center, texts: centre from the start along the two axes of the plane, as numbers
    and as text. radius: from the start. angle: absolute angle that the board computes from these
    numbers. closed: whether start and end are the same in the plane.
    """

    end: Printed
    center: tuple[float, float]
    texts: tuple[str, str]
    radius: float
    angle: float
    closed: bool


@dataclass(frozen=True)
class ArcPrinter:
    """The rules by which arcs become lines.

    Attributes:
        offset: Work offset that the board adds to the coordinates of a line, mm.
        tolerance: Largest distance of lines from the program, mm.
        chord: Largest distance of the board's own chords from an arc, mm.
    """

    offset: Sequence[float]
    tolerance: float
    chord: float

    @cached_property
    def digits(self) -> int:
        """Decimals of coordinates: four for the usual hundredth of a millimetre.

        Rounding then adds a hundredth of the tolerance.
        """
        return max(3, math.ceil(-math.log10(self.tolerance / 50.0)))

    def printed(self, point: Point) -> Printed:
        """Return the coordinates of a line for a point in machine coordinates."""
        texts = tuple(self.text(value, axis) for axis, value in enumerate(point))
        return Printed(tuple(map(float, texts)), texts)

    def text(self, value: float, axis: int) -> str:
        """Return the number of a line for a machine coordinate of an axis, from 0."""
        return decimal_text(value - self.offset[axis], self.digits)

    def chords_of(self, printed: PrintedArc, arc: PlaneArc) -> int:
        """Return the number of chords that replace an arc."""
        off = (CHORDS if arc.fitted else COARSE) * self.tolerance
        radius = printed.radius
        turn = 2.0 * math.acos(max(1.0 - off / radius, 0.5)) if radius > 0.0 else TURN
        return max(1, math.ceil(abs(arc.sweep) / turn))

    def arc_parts(self, here: Printed, end: Printed, arc: PlaneArc) -> int:
        """Return the number of lines for an arc, by its angle and its climb."""
        i, j, across = PLANE_COLUMNS[arc.plane]
        sweep = abs(arc.sweep)
        parts = math.ceil(sweep / (0.5 * TURN)) if sweep > 0.75 * TURN else 1
        if end.texts[across] == here.texts[across]:
            return parts
        height = max(
            abs(values[across] + self.offset[across]) for values in (end.values, here.values)
        )
        center = arc.center[0] - self.offset[i], arc.center[1] - self.offset[j]
        radius = math.dist((here.values[i], here.values[j]), center)
        rounding = 0.5 * float(np.spacing(np.float32(height)))
        share = FITTED_HELIX_SUM if arc.fitted else HELIX_SUM
        most_chords = max(share * self.tolerance / rounding, 1.0)
        half = (
            math.sqrt(self.chord * (2.0 * radius - self.chord))
            if self.chord < 2.0 * radius
            else math.inf
        )
        return max(parts, math.ceil(0.5 * sweep * radius / half / most_chords))

    def printed_arc(self, at: Printed, end: Printed, arc: PlaneArc) -> PrintedArc:
        """Return the numbers of an arc as a line gives them."""
        i, j, _ = PLANE_COLUMNS[arc.plane]
        here = at.values[i], at.values[j]
        there = end.values[i], end.values[j]
        cx, cy = arc.center[0] - self.offset[i], arc.center[1] - self.offset[j]
        radius = math.dist(here, (cx, cy))
        closed = end.texts[i] == at.texts[i] and end.texts[j] == at.texts[j]
        if abs(arc.sweep) <= 0.5 * TURN and not closed:
            # onto the bisector
            tx, ty = there[0] - here[0], there[1] - here[1]
            off = (
                (cx - 0.5 * (here[0] + there[0])) * tx + (cy - 0.5 * (here[1] + there[1])) * ty
            ) / (tx * tx + ty * ty)
            cx, cy = cx - off * tx, cy - off * ty
        texts = decimal_text(cx - here[0], self.digits), decimal_text(cy - here[1], self.digits)
        center = float(texts[0]), float(texts[1])
        angle = abs(angle_read(here, there, center, arc.sweep > 0.0))
        return PrintedArc(end, center, texts, radius, angle, closed)

    def needs_chords(self, printed: PrintedArc, arc: PlaneArc) -> bool:
        """Return whether chords must be sent in place of an arc."""
        sweep, radius = abs(arc.sweep), printed.radius
        # From the printed numbers the board may make one chord less than from the arc itself.
        inside = board_chord(
            math.hypot(printed.center[0], printed.center[1]), printed.angle, self.chord
        )
        allowed = (
            board_chord(radius, sweep, self.chord) + DIGITS * self.tolerance
            if arc.fitted
            else COARSE * self.tolerance
        )
        return (
            sweep < SHORTEST_ANGLE
            or sweep * radius < SHORTEST_ARC
            or printed.closed
            or inside > allowed
            or abs(printed.angle - sweep) * radius > CHORDS * self.tolerance
        )


def angle_read(
    here: tuple[float, float],
    there: tuple[float, float],
    center: tuple[float, float],
    counterclockwise: bool,
) -> float:
    """Return the signed angle of an arc as GRBL computes it (mc_arc of motion_control.c).

    Args:
        here: Start along the two axes of the plane, mm.
        there: End along them, mm.
        center: Centre from ``here``, mm.
        counterclockwise: Sense of the arc.
    """
    x0, y0 = -center[0], -center[1]
    x1, y1 = there[0] - here[0] + x0, there[1] - here[1] + y0
    angle = math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    if counterclockwise:
        return angle + TURN if angle <= 5e-7 else angle
    return angle - TURN if angle >= -5e-7 else angle


# Feeds that lines lower, because of small arcs or the rate at which the board takes lines.

Cause = Literal["small arcs", "short lines"]

MARKED = 0.95
"""Part of the programmed feed below which it counts as lowered."""
WORTH_A_NOTE = 0.005
"""Part of the feed time from which on lowered feeds are reported."""
ADVICE = {
    "small arcs": "the acceleration of the axes limits the speed on an arc",
    "short lines": (
        "the board takes no more lines a second: use a coarser tolerance in the CAM system"
    ),
}


class LoweredFeeds:
    """Adds up the time of the moves with a lowered feed."""

    def __init__(self) -> None:
        self._total = 0.0
        self._seconds: dict[Cause, float] = {}
        self._first: dict[Cause, int] = {}

    def moved(self, length: float, speed: float) -> None:
        """Note a feed move: its length in mm and its speed in mm/s."""
        self._total += length / max(speed, 1e-6)

    def lowered(self, cause: Cause, line: int, length: float, speed: float, feed: float) -> None:
        """Note a cause that limits a move to a speed, mm/s, of the programmed feed, mm/s."""
        if speed < MARKED * feed:
            self._seconds[cause] = self._seconds.get(cause, 0.0) + length / max(speed, 1e-6)
            self._first.setdefault(cause, line)

    def findings(self) -> list[Diagnostic]:
        """Return a note for each cause, at its first line."""
        return [
            Diagnostic(
                "feed-lowered",
                f"{cause} lower the feed from here on, in {100.0 * share:.0f} % of the feed time",
                line=self._first[cause],
                hint=ADVICE[cause],
                severity="note",
            )
            for cause, seconds in self._seconds.items()
            if (share := min(seconds / max(self._total, 1e-9), 1.0)) >= WORTH_A_NOTE
        ]


LINE_TIME, BYTE_TIME = 2.1e-3, 30e-6
"""s. GRBL on an AVR plans a line in the first and reads each byte of it in the second, at any baud
rate: 385 lines of 17 bytes a second.
"""
LINE_END = 2
"""Bytes of a line beside its words: a blank before the last one, and the line feed."""
BITS_PER_BYTE = 10
MOST_AHEAD = PLANNER_MOVES * LINE_TIME
"""Seconds by which motion may be ahead of the line rate."""

MOTION_WORDS = {
    LineKind.RAPID: "G0",
    LineKind.FEED: "G1",
    LineKind.CLOCKWISE: "G2",
    LineKind.COUNTERCLOCKWISE: "G3",
}


def line_time(characters: int, baud: int) -> float:
    """Return the time in which the board receives, reads and plans a line, s."""
    return max(characters * BITS_PER_BYTE / baud, LINE_TIME + characters * BYTE_TIME)


class LineWriter:
    """Writes lines from the present position of the board.

    Args:
        offset: Work offset that the board adds to the coordinates of a line, mm.
        tolerance: Largest distance of lines from the program, mm.
        baud: Speed of the link, bit/s.
        letters: The axes of the board.
        named: Those of them that the machine has.
        chord: Largest distance of the board's own chords from an arc, mm.

    Attributes:
        lowered: Feeds that the lines lower.
    """

    def __init__(
        self,
        offset: Sequence[float],
        tolerance: float,
        baud: int,
        letters: str,
        named: str,
        chord: float,
    ) -> None:
        self._arcs = ArcPrinter(offset, tolerance, chord)
        self._line_times = [line_time(characters, baud) for characters in range(LONGEST + 1)]
        self._letters = letters
        self._axes = [(k, letter) for k, letter in enumerate(letters) if letter in named]
        self._unknown = (None,) * len(letters)
        self._at = Printed((0.0,) * len(letters), self._unknown)
        self._point: Point | None = None
        self._motion = self._feed_text = ""
        self._plane = 0
        self._feed = self._printed_feed = 0.0
        self._ahead = 0.0
        self._power = ""
        self.lowered = LoweredFeeds()
        self._named: set[str] = set()

    @property
    def position_known(self) -> bool:
        """Whether the position of the board is known exactly."""
        return all(self._at.texts[k] is not None for k, _ in self._axes)

    def stands_at(self, point: Point) -> None:
        """Set the position of the board, mm (machine coordinates)."""
        self._point = point
        self._at = self._arcs.printed(point)

    def position_lost(self) -> None:
        """The board is near its last position only: the next line names all axes."""
        self._at, self._point = Printed(self._at.values, self._unknown), None

    def program_ended(self) -> None:
        """M2 sets the modes back: G1, G17, and others that never change."""
        self._motion, self._plane = "G1", 0
        self._feed_text, self._feed, self._printed_feed = "", 0.0, 0.0

    def set_power(self, word: str) -> None:
        """Let the next move have an S word: GRBL changes the power of a laser where it begins."""
        self._power = word or self._power

    def power_alone(self, line: int) -> Iterator[GcodeLine]:
        """Yield the S word that no move has taken; the board comes to rest for it."""
        if self._power:
            yield GcodeLine(self._power, line, REST)
            self._power = ""

    def name_axes(self, letters: str, move: Move) -> Iterator[GcodeLine]:
        """Yield lines to the present position for axes that no line has named yet.

        X and Y go by a traverse, Z at the speed of the move. The axes that a straight move names
        itself are left out.

        Args:
            letters: The axes.
            move: The move to come.
        """
        coming = self._at.texts if move.arc is not None else self._arcs.printed(move.end).texts
        missing = [
            letter
            for letter, here, there in zip(self._letters, self._at.texts, coming, strict=True)
            if letter in letters
            and letter not in self._named
            and here is not None
            and (move.arc is not None or here == there)
        ]
        level = [letter for letter in missing if letter != "Z"]
        if level:
            yield self._line(move, LineKind.RAPID, self._at, level)
        if "Z" in missing:
            # The length is not known: far enough for the line rate.
            feed = self._feed_word(math.inf, 0, move)
            yield self._line(move, LineKind.FEED, self._at, ["Z"], feed=feed)

    def move(self, move: Move) -> Iterator[GcodeLine]:
        """Yield the lines of a move: one, or several for an arc."""
        if move.arc is None:
            yield from self.straights((move,))
        else:
            yield from self._arc(move, move.arc)

    def probe(self, word: str, end: Point, feed: float, line: int) -> GcodeLine:
        """Return the line of a probing move. Its end position is not known afterwards.

        Args:
            word: G38.2 to G38.5.
            end: Farthest position, mm (machine coordinates).
            feed: mm/s.
            line: Source line.
        """
        printed = self._arcs.printed(end)
        named = [letter for _, letter in self._axes if letter in LETTERS]
        letters = self._changed(printed) or named
        self._set_feed(feed, feed_word(per_minute(feed)))
        self._motion = ""
        self.position_lost()
        words = [letter + self._text(printed, letter) for letter in letters]
        return GcodeLine(
            " ".join((word, *words, self._feed_text)),
            line,
            LineEffect(LineKind.PROBE, self._target(printed, letters), self._printed_feed),
        )

    def straights(self, moves: Iterable[Move]) -> list[GcodeLine]:
        """Return the lines of straight moves: most lines of most programs are made here."""
        lines: list[GcodeLine] = []
        places = f"%.{self._arcs.digits}f"
        values, texts = list(self._at.values), list(self._at.texts)
        axes = [(k, letter, self._arcs.offset[k]) for k, letter in self._axes]
        before, unnamed = self._point or (math.nan,) * len(values), [math.nan] * len(values)
        kind, distance, is_nan = LineKind.FEED, math.dist, math.isnan
        for move in moves:
            point = move.end
            words: list[str] = []
            start, target = values.copy(), unnamed.copy()
            for k, letter, offset in axes:
                at = point[k]
                if at != before[k] or texts[k] is None:
                    text = places % (at - offset)
                    if text[-1] == "0":
                        text = text.rstrip("0").rstrip(".")
                        text = "0" if text == "-0" else text
                    if text != texts[k]:
                        words.append(letter + text)
                        texts[k] = text
                        values[k] = target[k] = float(text)
            before = point
            if not words:
                continue
            if len(self._named) < len(self._axes):
                self._named.update(word[0] for word in words)
            length, text = distance(values, start), " ".join(words)
            if is_nan(move.feed):
                kind, feed = LineKind.RAPID, ""
                seconds = length / max(move.speed, 1e-6)
                self._ahead = min(self._ahead + seconds, MOST_AHEAD)
            else:
                kind, feed = LineKind.FEED, self._feed_word(length, len(text), move)
            if feed:
                text += " " + feed
            if MOTION_WORDS[kind] != self._motion:
                self._motion = MOTION_WORDS[kind]
                text = self._motion + " " + text
            if self._power:
                text += " " + self._power
                self._power = ""
            effect = new_effect(
                (kind, tuple(target), self._printed_feed, self._plane, (0.0, 0.0), 0.0)
            )
            lines.append(new_line((text, move.line, effect)))
        self._at = Printed(tuple(values), tuple(texts))
        self._point = None if any(map(is_nan, before)) else before
        return lines

    def _arc(self, move: Move, arc: PlaneArc) -> Iterator[GcodeLine]:
        end = self._arcs.printed(move.end)
        parts = self._arcs.arc_parts(self._at, end, arc)
        if parts > 1:
            yield from self._in_parts(move, arc, parts)
            return
        printed = self._arcs.printed_arc(self._at, end, arc)
        if self._arcs.needs_chords(printed, arc):
            yield from self._in_parts(move, arc, self._arcs.chords_of(printed, arc), chords=True)
            return
        i, j, across = PLANE_COLUMNS[arc.plane]
        letters = [LETTERS[k] for k in sorted((i, j)) if end.texts[k] != self._at.texts[k]]
        letters += [LETTERS[across]] if end.texts[across] != self._at.texts[across] else []
        centers = [
            CENTER_LETTERS[k] + text
            for k, text in sorted(((i, printed.texts[0]), (j, printed.texts[1])))
            if text != "0"
        ]
        length = math.hypot(
            printed.radius * arc.sweep, end.values[across] - self._at.values[across]
        )
        words = [letter + self._text(end, letter) for letter in letters] + centers
        feed = self._feed_word(length, len(" ".join(words)), move)
        kind = LineKind.COUNTERCLOCKWISE if arc.sweep > 0.0 else LineKind.CLOCKWISE
        yield self._line(
            move, kind, end, letters, feed=feed, arc=(arc.plane, printed.center, centers)
        )
        self._at, self._point = end, move.end

    def _in_parts(
        self, move: Move, arc: PlaneArc, parts: int, *, chords: bool = False
    ) -> Iterator[GcodeLine]:
        """Yield an arc as several arcs, or as chords."""
        i, j, across = PLANE_COLUMNS[arc.plane]
        begin = [
            here + offset for here, offset in zip(self._at.values, self._arcs.offset, strict=True)
        ]
        x, y = begin[i] - arc.center[0], begin[j] - arc.center[1]
        part = None if chords else replace(arc, sweep=arc.sweep / parts)
        for k in range(1, parts + 1):
            turned = arc.sweep * k / parts
            cos, sin = math.cos(turned), math.sin(turned)
            to = list(begin)
            to[i], to[j] = arc.center[0] + cos * x - sin * y, arc.center[1] + sin * x + cos * y
            to[across] += (move.end[across] - begin[across]) * k / parts
            end = move.end if k == parts else tuple(to)
            yield from self.move(move._replace(end=end, arc=part))

    def _changed(self, printed: Printed) -> list[str]:
        """Return those of X, Y, Z that a line to a point has to name."""
        return [
            letter
            for k, letter in self._axes
            if letter in LETTERS and printed.texts[k] != self._at.texts[k]
        ]

    def _feed_word(self, length: float, characters: int, move: Move) -> str:
        """Return the F word for the planned speed; "" where the feed in effect will do.

        Lines that would arrive too slowly for the speed lower it.

        Args:
            length: Length of the move, mm.
            characters: Characters of the line's axis words.
            move: The move.
        """
        feed = move.feed
        characters += LINE_END + len(self._power)
        needed = self._line_times[min(characters, LONGEST)]
        speed = max(move.speed if move.speed < feed else feed, 1e-6)
        if length / speed + self._ahead < needed:
            speed = length / (needed - self._ahead)
            self.lowered.lowered("short lines", move.line, length, speed, feed)
        if length < math.inf:
            self.lowered.moved(length, speed)
        ahead = self._ahead + length / speed - needed
        self._ahead = ahead if ahead < MOST_AHEAD else MOST_AHEAD
        wanted = feed if speed >= (1.0 - FEED_STEP) * feed else speed
        if (
            abs(self._feed - wanted) <= FEED_STEP * wanted
            and self._feed <= feed
            and (wanted != feed or self._feed == feed)
        ):
            return ""
        text = feed_word(per_minute(wanted))
        same = text == self._feed_text
        self._set_feed(wanted, text)
        return "" if same else text

    def _set_feed(self, feed: float, text: str) -> None:
        self._feed, self._feed_text = feed, text
        self._printed_feed = per_second(float(text[1:]))

    def _line(
        self,
        move: Move,
        kind: LineKind,
        end: Printed,
        letters: list[str],
        *,
        feed: str = "",
        arc: tuple[int, tuple[float, float], list[str]] | None = None,
    ) -> GcodeLine:
        """Return a line: the modes that change, then the words.

        Args:
            move: The move that the line belongs to.
            kind: Its motion.
            end: The end point.
            letters: The axes that it names.
            feed: The F word; "" for none.
            arc: Plane, centre (numbers) and centre words of an arc.
        """
        self._named.update(letters)
        words = []
        plane, center, centers = arc if arc is not None else (self._plane, (0.0, 0.0), [])
        if plane != self._plane:
            self._plane = plane
            words.append(PLANE_WORDS[plane])
        if MOTION_WORDS[kind] != self._motion:
            self._motion = MOTION_WORDS[kind]
            words.append(self._motion)
        words += [letter + self._text(end, letter) for letter in letters]
        words += centers
        if feed:
            words.append(feed)
        if self._power:
            words.append(self._power)
            self._power = ""
        effect = LineEffect(kind, self._target(end, letters), self._printed_feed, plane, center)
        return GcodeLine(" ".join(words), move.line, effect)

    def _text(self, printed: Printed, letter: str) -> str:
        return str(printed.texts[self._letters.index(letter)])

    def _target(self, printed: Printed, letters: list[str]) -> tuple[float, ...]:
        return tuple(
            value if letter in letters else math.nan
            for letter, value in zip(self._letters, printed.values, strict=True)
        )
