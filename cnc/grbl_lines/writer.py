r"""Moves as the shortest lines that GRBL 1.1 reads right: modal words are said once, a feed when it
changes, an axis when it moves.

An arc goes by its centre (I J K from where the board stands), never by its radius. GRBL takes the
radius from the start, turns towards the end as it reads it, and refuses (error:33) what differs by
more than 0.005 mm and 0.1 % (gcode.c). So of an arc up to half a turn

              centre         the centre is put on the bisector of the two points as they are printed: both radii are the same.
               /|\           The angle that the board will make of the printed numbers is computed before they are sent: where rounding
        start / | \ end      would turn a short arc into a full circle, or the other way round, chords are sent instead.

GRBL takes an angle below 5e-7 rad for a full circle (motion_control.c, mc_arc). But of 32-bit
floats the angle between the two ends of a full circle is only 0 within 3e-5 mm / radius, at 300 mm
from zero: half of the circles of 10 mm would be left out. So a circle is two halves.

Along the axis across an arc it adds a part of the climb at each of its chords, each sum being
rounded: of n chords at z the last is up to n ulp(z) / 2 off before it is put right by the end. A
helix of many chords far from zero is made of several.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from cnc.grbl_lines.number_format import (
    CENTER_LETTERS,
    FEED_STEP,
    LETTERS,
    PLANE_COLUMNS,
    PLANE_WORDS,
    feed_word,
    number,
)
from cnc.kernels.grbl_lines.arc_fit import board_chord
from cnc.model.units import per_minute

TURN = 2.0 * math.pi
SHORTEST_ANGLE = 1e-3
SHORTEST_ARC = 1e-3
"""rad, mm. What turns by less, or is shorter, is a line: it could be taken for a full circle."""
LINES_PER_S = 385.0
"""Short lines that GRBL on an AVR takes in a second, whatever the baud rate: it reads and plans
each.
"""
CHORDS = 0.2
"""Part of the tolerance for chords in place of a fitted arc that the digits of numbers would
spoil.
"""
COARSE = 0.8
"""Part of the tolerance that the board's own chords may be off an arc of the program: what would be
off by more is said as chords of ours.
"""
DIGITS = 0.02
"""Part of the tolerance for what rounding may make of the board's chords."""
SUMMED, SUMMED_FITTED = 0.5, 0.04
"""Part of the tolerance that rounding may add up to along a helix: of the program's own, and of one
that has been fitted to a path.
"""
BITS_PER_BYTE = 10
BLOCKS_AHEAD = 15
"""Moves that GRBL's planner holds."""

Point = tuple[float, float, float]


class LineWriter:
    """Says where the board goes from where it stands.

    offset: what the board adds to the coordinates of a line, mm. tolerance: mm, how far lines may
    be from the program. baud: of the link. letters: which of XYZ the machine has. chord: mm, by
    which the board's own chords may be off an arc.
    """

    def __init__(
        self, offset: Sequence[float], tolerance: float, baud: int, letters: str, chord: float
    ) -> None:
        self._offset = offset
        self._chord = chord
        self._tolerance = tolerance
        self._byte_time = BITS_PER_BYTE / baud
        self._letters = letters
        # four digits for the usual hundredth of a millimetre: what rounding adds is a hundredth of
        # that
        self._digits = max(3, math.ceil(-math.log10(tolerance / 50.0)))
        self._words: list[str | None] = [None] * 3
        self._at = (0.0, 0.0, 0.0)
        self._motion = self._feed_text = ""
        self._plane = PLANE_WORDS[0]
        self._feed = 0.0
        self._ahead = 0.0
        self._ever_said: set[str] = set()

    def stands_at(self, point: Point) -> None:
        """The board stands here, mm (machine coordinates)."""
        self._at, self._words = self._printed(point)

    def stated(self, letters: str, named: Point | None, speed: float, feed: float) -> Iterator[str]:
        """Lines to where the board stands, for those of the axes that no line has named yet: X and
        Y by a traverse, Z as fast as the move.

        named: the end of the straight move to come, if it is one; the axes that it names may be
        anywhere.
        """
        coming = self._words if named is None else self._printed(named)[1]
        missing = [
            (letter, f"{letter}{here}")
            for letter, here, there in zip(LETTERS, self._words, coming, strict=True)
            if letter in letters
            and letter not in self._ever_said
            and (named is None or here == there)
        ]
        level = [word for letter, word in missing if letter != "Z"]
        height = [word for letter, word in missing if letter == "Z"]
        if level:
            yield self._said("G0", level, "")
        if height:
            # how far that is nobody knows: far enough for the line rate
            yield self._said("G1", height, self._feed_word(math.inf, 0, speed, feed))

    def lost(self) -> None:
        """Where the board stands is known roughly: the next line says all axes."""
        self._words = [None] * 3

    @property
    def placed(self) -> bool:
        """Whether it is known where the board stands."""
        return None not in self._words

    def forget_motion(self) -> None:
        """The motion mode in effect isn't one of G0 to G3."""
        self._motion = ""

    def program_ended(self) -> None:
        """M2 puts the modes back: G1, G17, and more that were never changed."""
        self._motion, self._plane, self._feed_text, self._feed = "G1", PLANE_WORDS[0], "", 0.0

    def line(self, end: Point, speed: float, feed: float) -> Iterator[str]:
        """A straight move at the planned speed, mm/s; a traverse where the programmed ``feed`` is
        NaN.
        """
        at, words = self._printed(end)
        axes = self._axis_words(words)
        if not axes:
            return
        length = math.dist(at, self._at)
        if math.isnan(feed):
            yield self._said("G0", axes, "")
            self._ahead = min(self._ahead + length / max(speed, 1e-6), BLOCKS_AHEAD / LINES_PER_S)
        else:
            yield self._said("G1", axes, self._feed_word(length, len(" ".join(axes)), speed, feed))
        self._at, self._words = at, words

    def probe(self, word: str, end: Point, feed: float) -> str:
        """A probing move; where it ends is not known."""
        _, words = self._printed(end)
        axes = self._axis_words(words) or [
            letter + str(text)
            for letter, text in zip(LETTERS, words, strict=True)
            if letter in self._letters
        ]
        self._feed, self._feed_text = feed, feed_word(per_minute(feed))
        self._motion = ""
        self.lost()
        return " ".join((word, *axes, self._feed_text))

    def arc(
        self,
        end: Point,
        plane: int,
        center: tuple[float, float],
        sweep: float,
        speed: float,
        feed: float,
        *,
        fitted: bool = False,
    ) -> Iterator[str]:
        """An arc or helix about ``center`` (mm, machine coordinates) by ``sweep`` rad,
        counter-clockwise positive, any number of turns.
        """
        i, j, across = PLANE_COLUMNS[plane]
        at, words = self._printed(end)
        here, there = (self._at[i], self._at[j]), (at[i], at[j])
        cx, cy = center[0] - self._offset[i], center[1] - self._offset[j]
        radius = math.dist(here, (cx, cy))
        closed = words[i] == self._words[i] and words[j] == self._words[j]
        parts = math.ceil(abs(sweep) / (0.5 * TURN)) if abs(sweep) > 0.75 * TURN else 1
        if words[across] != self._words[across]:
            height = max(abs(value[across] + self._offset[across]) for value in (at, self._at))
            parts = max(
                parts, self._helix_parts(radius, sweep, height, SUMMED_FITTED if fitted else SUMMED)
            )
        if parts > 1:
            yield from self._in_parts(parts, end, plane, center, sweep, speed, feed, fitted=fitted)
            return
        if abs(sweep) <= 0.5 * TURN and not closed:
            # onto the bisector
            tx, ty = there[0] - here[0], there[1] - here[1]
            off = (
                (cx - 0.5 * (here[0] + there[0])) * tx + (cy - 0.5 * (here[1] + there[1])) * ty
            ) / (tx * tx + ty * ty)
            cx, cy = cx - off * tx, cy - off * ty
        first, second = number(cx - here[0], self._digits), number(cy - here[1], self._digits)
        read = abs(angle_read(here, there, (float(first), float(second)), sweep > 0.0))
        short = abs(sweep) < SHORTEST_ANGLE or abs(sweep) * radius < SHORTEST_ARC
        # by the numbers as they are printed: the board may make one chord less than of the arc as
        # it was meant
        inside = board_chord(math.hypot(float(first), float(second)), read, self._chord)
        allowed = (
            board_chord(radius, abs(sweep), self._chord) + DIGITS * self._tolerance
            if fitted
            else COARSE * self._tolerance
        )
        coarse = inside > allowed
        if short or closed or coarse or abs(read - abs(sweep)) * radius > CHORDS * self._tolerance:
            off = (CHORDS if fitted else COARSE) * self._tolerance
            turn = 2.0 * math.acos(max(1.0 - off / radius, 0.5)) if radius > 0.0 else TURN
            yield from self._in_parts(
                max(1, math.ceil(abs(sweep) / turn)),
                end,
                plane,
                center,
                sweep,
                speed,
                feed,
                chords=True,
            )
            return
        plane_words = [
            LETTERS[k] + str(words[k]) for k in sorted((i, j)) if words[k] != self._words[k]
        ]
        axes = plane_words + (
            [LETTERS[across] + str(words[across])] if words[across] != self._words[across] else []
        )
        axes += [
            CENTER_LETTERS[k] + text for k, text in sorted(((i, first), (j, second))) if text != "0"
        ]
        length = math.hypot(radius * sweep, at[across] - self._at[across])
        said = self._feed_word(length, len(" ".join(axes)), speed, feed)
        yield self._said("G3" if sweep > 0.0 else "G2", axes, said, PLANE_WORDS[plane])
        self._at, self._words = at, words

    def _helix_parts(self, radius: float, sweep: float, height: float, part: float) -> int:
        """Into how many helices of few chords one is cut, ``height`` mm being the largest
        coordinate along it.
        """
        rounding = 0.5 * float(np.spacing(np.float32(height)))
        most = max(part * self._tolerance / rounding, 1.0)
        half = (
            math.sqrt(self._chord * (2.0 * radius - self._chord))
            if self._chord < 2.0 * radius
            else math.inf
        )
        return math.ceil(0.5 * abs(sweep) * radius / half / most)

    def _in_parts(
        self,
        parts: int,
        end: Point,
        plane: int,
        center: tuple[float, float],
        sweep: float,
        speed: float,
        feed: float,
        *,
        chords: bool = False,
        fitted: bool = False,
    ) -> Iterator[str]:
        """An arc as several, or as chords."""
        i, j, across = PLANE_COLUMNS[plane]
        begin = [here + offset for here, offset in zip(self._at, self._offset, strict=True)]
        x, y = begin[i] - center[0], begin[j] - center[1]
        for k in range(1, parts + 1):
            turned = sweep * k / parts
            cos, sin = math.cos(turned), math.sin(turned)
            to = list(begin)
            to[i], to[j] = center[0] + cos * x - sin * y, center[1] + sin * x + cos * y
            to[across] += (end[across] - begin[across]) * k / parts
            there = end if k == parts else (to[0], to[1], to[2])
            if chords:
                yield from self.line(there, speed, feed)
            else:
                yield from self.arc(there, plane, center, sweep / parts, speed, feed, fitted=fitted)

    def _printed(self, point: Point) -> tuple[Point, list[str | None]]:
        """The coordinates of a line for a point, as numbers and as text."""
        texts = [
            number(value - offset, self._digits)
            for value, offset in zip(point, self._offset, strict=True)
        ]
        x, y, z = (float(text) for text in texts)
        return (x, y, z), [*texts]

    def _axis_words(self, words: Sequence[str | None]) -> list[str]:
        return [
            f"{letter}{word}"
            for letter, word, before in zip(LETTERS, words, self._words, strict=True)
            if word != before and letter in self._letters
        ]

    def _feed_word(self, length: float, characters: int, speed: float, feed: float) -> str:
        """F for the planned speed, "" where the one in effect will do. Lines that would come too
        slowly for it slow it down.
        """
        line_time = max((characters + 8) * self._byte_time, 1.0 / LINES_PER_S)
        speed = max(min(speed, feed), 1e-6)
        if length / speed + self._ahead < line_time:
            speed = length / (line_time - self._ahead)
        self._ahead = min(self._ahead + length / speed - line_time, BLOCKS_AHEAD / LINES_PER_S)
        wanted = feed if speed >= (1.0 - FEED_STEP) * feed else speed
        if (
            abs(self._feed - wanted) <= FEED_STEP * wanted
            and self._feed <= feed
            and (wanted != feed or self._feed == feed)
        ):
            return ""
        text = feed_word(per_minute(wanted))
        self._feed = wanted
        if text == self._feed_text:
            return ""
        self._feed_text = text
        return text

    def _said(self, motion: str, axes: list[str], feed: str, plane: str = "") -> str:
        """The line: the modes that change, then the words."""
        self._ever_said.update(axis[0] for axis in axes)
        words = []
        if plane and plane != self._plane:
            self._plane = plane
            words.append(plane)
        if motion != self._motion:
            self._motion = motion
            words.append(motion)
        words += axes
        if feed:
            words.append(feed)
        return " ".join(words)


def angle_read(
    here: tuple[float, float],
    there: tuple[float, float],
    center: tuple[float, float],
    counterclockwise: bool,
) -> float:
    """The signed angle that GRBL turns by (mc_arc of motion_control.c), ``center`` being counted
    from ``here``.
    """
    x0, y0 = -center[0], -center[1]
    x1, y1 = there[0] - here[0] + x0, there[1] - here[1] + y0
    angle = math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    if counterclockwise:
        return angle + TURN if angle <= 5e-7 else angle
    return angle - TURN if angle >= -5e-7 else angle
