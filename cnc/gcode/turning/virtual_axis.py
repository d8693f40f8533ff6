"""Driven tools beside a C axis: polar coordinate and cylindrical interpolation.

Polar coordinate interpolation (G12.1, G112, TRANSMIT): a program moves the tool on the face of the
part, in the plane of X and a virtual axis, in mm from the axis of the spindle. The virtual axis has
the letter C in FANUC's language, where X stays a diameter and C begins at 0; on a Haas it is Y and
X is a radius; in SINUMERIK's it is Y and X is as before. X and the C axis follow by short chords.

Cylindrical interpolation (G7.1, G107, TRACYL): a program moves the tool on the mantle, which is
unrolled: the way along it is the angle of the rotary axis times a radius that the program gives.
FANUC's words stay angles of the rotary axis; on a Haas and in SINUMERIK's language Y is the way, in
mm. A straight move on the mantle is one of Z and C; an arc is made of chords.

A chord stays within :data:`TOLERANCE` of the programmed curve. F is the feed on the face or the
mantle. Sources: FANUC, "Operator's Manual for Lathe System", "Polar coordinate interpolation
(G12.1, G13.1)", "Cylindrical interpolation (G07.1)"; Haas, "Lathe Operator's Manual", G112 and
G113, "Mill Operator's Manual", G107; Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job
Planning", TRANSMIT, TRACYL.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from cnc.gcode.core.coordinates import Coordinates
from cnc.gcode.core.modal_groups import Codes
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tip_control import refuse_under_tip_control
from cnc.gcode.reader.words import G, LineWords, Word, fault, not_negative
from cnc.model.blocks import PLANE_AXES, ArcFeed, PathMode, Plane
from cnc.model.diagnostics import GcodeError

TOLERANCE = 5e-4
"""Largest distance of a chord from the programmed curve, mm."""
BLEND = 1e-3
"""Tolerance within which chords follow each other without a stop, mm and degrees."""
_POLE = 1e-6
"""Distances from the axis below this are rounding, mm."""
_WIDEST = math.pi / 8
"""Largest turn of C in a chord."""
_DEEPEST = 40
_MOVES = (G.G0, G.G1, G.G2, G.G3)
_ALONG = {"A": "X", "B": "Y", "C": "Z"}
"""The axis about which each rotary axis turns, which is that of the cylinder."""
_ALLOWED = frozenset(
    ("motion", "plane", "distance", "compensation", "feed-mode", "spindle", "spindle-mode",
     "coolant", "stop", "face", "path", "overrides")
)  # fmt: skip
"""Groups of codes that may stand in the mode."""


class _Curve(NamedTuple):
    """A curve in the plane: its point at a share of its length, how far a point is from it, mm."""

    place: Callable[[float], complex]
    error: Callable[[complex], float]
    length: float


def _circle(a: complex, b: complex, middle: complex, turns: float) -> _Curve:
    """Return an arc from a to b about a centre, whose radius changes evenly."""
    sweep, radius, last = turns * math.tau, abs(a - middle), abs(b - middle)

    def place(share: float) -> complex:
        turn = complex(math.cos(sweep * share), math.sin(sweep * share))
        grown = 1.0 + share * (last - radius) / radius
        return middle + (a - middle) * turn * grown if share < 1.0 else b

    def error(point: complex) -> float:
        return abs(abs(point - middle) - (radius + last) / 2.0)

    return _Curve(place, error, abs(sweep) * radius)


class Chord(NamedTuple):
    """A move of the axes: its end (axes,) in machine coordinates and its feed, mm/s or deg/s."""

    end: list[float]
    feed: float


class Face:
    """The map from the plane to X and C, and the place that the tool has reached.

    Args:
        columns: Columns of X and C.
        coordinates: The coordinate systems; the axis of the spindle is their zero.
        program: (axes,) present position in program coordinates.
        turned: Angle of C at which the virtual axis points where it does at C 0, radians.

    Attributes:
        here: (axes,) the virtual machine position that is reached.
    """

    def __init__(
        self,
        columns: tuple[int, int],
        coordinates: Coordinates,
        program: list[float],
        turned: float,
    ) -> None:
        x, c = self.columns = columns
        self._coordinates, self._turned = coordinates, turned
        self._zero = self._zeros()
        self._radius, self._angle = program[x], math.radians(program[c])
        angle = self._angle - turned
        point = self._radius * complex(math.cos(angle), math.sin(angle))
        self.here = [value + zero for value, zero in zip(program, coordinates.zero, strict=True)]
        self.here[x] = self._zero[0] + point.real
        self.here[c] = self._zero[1] + point.imag

    def chords(self, item: list[float] | ArcFeed, feed: float) -> Iterator[Chord]:
        """Yield the chords of a straight move to a virtual machine position, or of an arc.

        Raises:
            GcodeError: ``face-code``: the zero of X or C has moved.
        """
        if self._zeros() != self._zero:
            raise fault("face-code", "the zero of X or C moves in the mode", hint="end it before")
        if isinstance(item, ArcFeed):
            end = item.end.tolist()
            yield from self._arc(item, end, feed)
        else:
            end = item
            yield from self._straight(end, feed)
        self.here = list(end)

    def real(self, position: list[float]) -> list[float]:
        """Return a machine position with X and C where the tool is."""
        place = position.copy()
        x, c = self.columns
        place[x] = self._radius + self._zero[0]
        place[c] = math.degrees(self._angle) + self._zero[1]
        return place

    def _zeros(self) -> tuple[float, float]:
        x, c = self.columns
        return self._coordinates.zero[x], self._coordinates.zero[c]

    def _straight(self, end: list[float], feed: float) -> Iterator[Chord]:
        a, b = self._point(self.here), self._point(end)
        way = b - a
        if abs(way) <= _POLE:
            yield from self._part(end, _Curve(lambda _: a, lambda _: 0.0, 0.0), (0.0, 1.0), feed)
            return
        nearest = -(a * way.conjugate()).real / abs(way) ** 2
        shares = [0.0, nearest, 1.0] if 1e-9 < nearest < 1.0 - 1e-9 else [0.0, 1.0]
        through = abs(a + nearest * way) <= _POLE

        def place(share: float) -> complex:
            return 0j if through and share == nearest else a + share * way

        def error(point: complex) -> float:
            return abs(((point - a) * way.conjugate()).imag) / abs(way)

        for part in pairwise(shares):
            yield from self._part(end, _Curve(place, error, abs(way)), part, feed)

    def _arc(self, block: ArcFeed, end: list[float], feed: float) -> Iterator[Chord]:
        a, b = self._point(self.here), self._point(end)
        centre = self.here.copy()
        centre[self.columns[0]], centre[self.columns[1]] = block.center
        curve = _circle(a, b, self._point(centre), block.turns)
        count = max(1, math.ceil(abs(block.turns) * 16.0))
        for number in range(count):
            part = number / count, (number + 1) / count
            yield from self._part(end, curve, part, feed)

    def _point(self, position: list[float]) -> complex:
        x, c = self.columns
        return complex(position[x] - self._zero[0], position[c] - self._zero[1])

    def _polar(self, point: complex) -> tuple[float, float]:
        """Radius and angle of a point; of the angles that mean the same, the nearest."""
        radius = abs(point)
        if radius <= _POLE:
            return 0.0, self._angle
        angle = math.atan2(point.imag, point.real) + self._turned
        return radius, angle + round((self._angle - angle) / math.tau) * math.tau

    def _part(
        self, end: list[float], curve: _Curve, part: tuple[float, float], feed: float
    ) -> Iterator[Chord]:
        """Yield the chords of a part of a curve, given by the shares of its length.

        At the pole C turns first, in the direction in which the curve leaves it.
        """
        first, last = part
        if self._radius <= _POLE and abs(curve.place(last)) > _POLE:
            _, angle = self._polar(curve.place(last))
            if abs(angle - self._angle) > 1e-12:
                self._angle = angle
                yield Chord(self._ends(end, first), math.nan)
        yield from self._between(end, curve, (first, last, 0), feed)

    def _between(
        self, end: list[float], curve: _Curve, part: tuple[float, float, int], feed: float
    ) -> Iterator[Chord]:
        """Yield the chords between two shares of a curve, which is halved until they fit."""
        first, last, depth = part
        to = curve.place(last)
        radius, angle = self._polar(to)
        turn = (self._angle + angle) / 2.0 - self._turned
        between = (self._radius + radius) / 2.0 * complex(math.cos(turn), math.sin(turn))
        wide = abs(angle - self._angle) > _WIDEST or curve.error(between) > TOLERANCE
        if wide and depth < _DEEPEST:
            half = (first + last) / 2.0
            yield from self._between(end, curve, (first, half, depth + 1), feed)
            yield from self._between(end, curve, (half, last, depth + 1), feed)
            return
        if abs(radius - self._radius) <= _POLE:
            radius = self._radius
        steps = (b - a for k, (a, b) in enumerate(zip(self.here, end, strict=True))
                 if k not in self.columns)  # fmt: skip
        across = (last - first) * math.hypot(*steps)
        length = math.hypot((last - first) * curve.length, across)
        moved = math.hypot(radius - self._radius, across)
        moved = moved or math.degrees(abs(angle - self._angle))
        self._radius, self._angle = radius, angle
        if moved and length:
            yield Chord(self._ends(end, last), feed * moved / length)

    def _ends(self, end: list[float], share: float) -> list[float]:
        """The machine position at a share of the move."""
        if share >= 1.0:
            return self.real(end)
        return self.real([a + share * (b - a) for a, b in zip(self.here, end, strict=True)])


class Mantle:
    """The map from the unrolled cylinder to its rotary axis, and the place that is reached.

    Args:
        column: Column of the rotary axis.
        radius: Radius of the cylinder, mm.
        motion: The moves; their position becomes that on the mantle.

    Attributes:
        here: (axes,) the virtual machine position that is reached.
        way: mm on the mantle of a degree.
    """

    def __init__(self, column: int, radius: float, motion: Motion) -> None:
        self._column, self._motion, self._coordinates = column, motion, motion.coordinates
        self.way = math.radians(radius)
        self._zero = self._coordinates.zero[column]
        self._linear = [index for index, axis in enumerate(motion.axes) if axis in "xyz"]
        self._real = motion.position.copy()
        self.here = motion.position.copy()
        self.here[column] = self._zero + (self.here[column] - self._zero) * self.way

    def chords(self, item: list[float] | ArcFeed, feed: float) -> Iterator[Chord]:
        """Yield the moves of a straight move to a virtual machine position, or of an arc.

        Raises:
            GcodeError: ``face-code``: the zero of the rotary axis has moved.
        """
        if self._coordinates.zero[self._column] != self._zero:
            message = "the zero of the rotary axis moves in the mode"
            raise fault("face-code", message, hint="end it before")
        if not isinstance(item, ArcFeed):
            yield self._chord(item, feed)
            return
        columns = self._motion.in_plane
        i, j = (columns[axis.upper()] for axis in PLANE_AXES[item.plane])
        begin, end = self.here, item.end.tolist()
        a, b = complex(begin[i], begin[j]), complex(end[i], end[j])
        curve = _circle(a, b, complex(*item.center), item.turns)
        step = 2.0 * math.acos(max(1.0 - TOLERANCE / abs(a - complex(*item.center)), 0.0))
        count = math.ceil(abs(item.turns) * math.tau / min(step, _WIDEST))
        for number in range(1, count + 1):
            share = number / count
            place = [p + share * (q - p) for p, q in zip(begin, end, strict=True)]
            point = curve.place(share)
            place[i], place[j] = point.real, point.imag
            yield self._chord(end if number == count else place, feed)

    def _chord(self, end: list[float], feed: float) -> Chord:
        """The move to a virtual machine position, with the feed of the axes that count."""
        steps = [there - here for here, there in zip(self.here, end, strict=True)]
        real = self.real(end)
        for index in self._linear:
            if abs(steps[index]) <= _POLE:
                real[index] = self._real[index]
        moved = math.dist(*([place[k] for k in self._linear] for place in (real, self._real)))
        length = math.hypot(moved, steps[self._column])
        moved = moved or abs(steps[self._column]) / self.way
        self.here, self._real = list(end), real
        return Chord(real, feed * moved / length if length else feed)

    def real(self, position: list[float]) -> list[float]:
        """Return a machine position with the angle of the rotary axis."""
        place, column = position.copy(), self._column
        place[column] = self._zero + (place[column] - self._zero) / self.way
        if position[column] == self.here[column]:
            place[column] = self._real[column]
        return place


class _Mode(NamedTuple):
    """The mode that is on: its map, its names in messages, the letters that it refuses.

    Attributes:
        map: Makes the moves of the axes.
        name: Its code.
        end: The code that ends it.
        what: Its name.
        refused: Letters without a meaning in it.
        rapid: Whether G0 may move.
    """

    map: Face | Mantle
    name: str
    end: str
    what: str
    refused: tuple[str, ...]
    rapid: bool


class VirtualAxis(MotionCodes):
    """Execution of G12.1 and G13.1, G7.1, and of what they are called in other languages."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._mode: _Mode | None = None
        self._before: tuple[bool, Plane | None] = False, None
        self._lathe = self._dialect.turning.lathe
        self._fanuc = self._lathe and self._dialect.turning.two_line_cycles

    def execute(self, number: G, at: Word) -> None:
        """Begin polar coordinate interpolation, or end the mode that is on.

        Raises:
            GcodeError: ``axis-missing``, ``compensation-active``, ``figure-active``,
                ``face-start``, ``code-not-supported``.
        """
        if number == G.G12_1 and self._mode is None:
            self._begin_face(at)
        elif number != G.G12_1:
            self._end(at)

    def _begin_face(self, at: Word) -> None:
        motion, state = self._motion, self._state
        if not self._lathe:
            at = replace(at, written="TRANSMIT")
            self._needs_lathe(at)
        x, c = self._column("X", at), self._column("C", at)
        self._refuse_modes(at)
        program = motion.coordinates.to_program(motion.position)
        if program[x] < 0.0:
            message = f"{at.written} with X below the axis of the spindle"
            raise fault("face-start", message, at, "go to a positive X before")
        turned = math.radians(program[c]) if self._fanuc else 0.0
        face = Face((x, c), motion.coordinates, program, turned)
        name, end = ("G12.1", "G13.1") if self._fanuc else ("G112", "G113")
        if not self._lathe:
            name, end = "TRANSMIT", "TRAFOOF"
        refused = ("T", "Y" if self._fanuc else "C")
        self._before = state.diameter, state.plane if self._fanuc else None
        if self._lathe and not self._fanuc:
            state.diameter = False
        if self._fanuc:
            state.plane = "XY"
        what = "polar coordinate interpolation"
        self._start(_Mode(face, name, end, what, refused, rapid=not self._fanuc))
        motion.begin_virtual(c, "Y")

    def cylinder(self, words: LineWords, at: Word) -> None:
        """Begin or end cylindrical interpolation (G7.1, G107, TRACYL).

        Raises:
            GcodeError: ``axis-missing``, ``compensation-active``, ``figure-active``,
                ``code-not-supported``, ``face-code``, ``mantle-words``, ``value-out-of-range``.
        """
        language = self._dialect.motion.cylinder
        if language == "siemens":
            self._needs_lathe(at := replace(at, written="TRACYL"))
            letter, virtual, end = "C", "Y", "TRAFOOF"
            radius = self._given(words, {"TRACYL": 0.5}, at)
        elif language == "mapped":
            letter, virtual = self._mapped(words, at)
            end = at.written
            radius = self._given(words, {"Q": 0.5, "R": 1.0}, at) if letter else 0.0
        else:
            letter = virtual = next((name for name in "CAB" if name in words.rest), "")
            if not letter:
                hint = "give the letter of the rotary axis and the radius of the cylinder, mm"
                raise fault("mantle-words", f"{at.written} needs a rotary axis", at, hint)
            radius, end = self._given(words, {letter: 1.0}, at), f"{at.written} {letter}0"
        if radius == 0.0 and language != "siemens":
            self._end(at)
            return
        if self._mode is not None:
            raise self._refused(at)
        self._begin_mantle(at, letter, virtual, radius, end)

    def _begin_mantle(self, at: Word, letter: str, virtual: str, radius: float, end: str) -> None:
        motion = self._motion
        column = self._column(letter, at)
        self._column(_ALONG[letter], at)
        if radius == 0.0:
            raise fault("value-out-of-range", f"{at.written}: the cylinder has no radius", at)
        self._refuse_modes(at)
        mantle, around = Mantle(column, radius, motion), "YXY"["ABC".index(letter)]
        what, name = "cylindrical interpolation", at.written
        self._before = self._state.diameter, None
        if virtual != letter:
            self._start(_Mode(mantle, name, end, what, ("T", letter), rapid=True))
            motion.begin_virtual(column, virtual)
            return
        # The rotary axis is parallel to the other axis of a plane, as the choice of the plane says.
        others = "XYZ".replace(_ALONG[letter], "")
        refused = ("T", around, *"IJK")
        self._start(_Mode(mantle, name, end, what, refused, rapid=False))
        motion.begin_virtual(column, letter, unit=mantle.way, in_plane=others)

    def _mapped(self, words: LineWords, at: Word) -> tuple[str, str]:
        """Take the axes of Haas' G107: the rotary axis, and the linear one that it stands for."""
        turns = [name for name in "ABC" if words.take(name, at.written)]
        linear = [name for name in "XYZ" if words.take(name, at.written)]
        if not turns and not linear:
            return "", ""
        if len(turns) != 1 or len(linear) != 1:
            message = f"{at.written} needs one rotary axis and one linear axis"
            raise fault("mantle-words", message, at, f"such as {at.written} A0 Y0 R20.")
        around = "YXY"["ABC".index(turns[0])]
        if linear[0] != around:
            message = f"{at.written}: {linear[0]} on {turns[0]} is not supported"
            raise fault("code-not-supported", message, at, f"{turns[0]} stands for {around}")
        return turns[0], around

    def _given(self, words: LineWords, letters: dict[str, float], at: Word) -> float:
        """Take the radius of the cylinder, mm; ``letters`` with the factor to a radius."""
        given = [(word, factor) for name, factor in letters.items()
                 if (word := words.take(name, at.written))]  # fmt: skip
        if len(given) != 1:
            message = f"{at.written} needs {' or '.join(letters)}, the size of the cylinder"
            raise fault("mantle-words", message, at, "the control's settings are not known here")
        ((word, factor),) = given
        size = not_negative(word, "the size of the cylinder") * self._state.scale * factor
        counts = self._dialect.turning.least_increments and "." not in word.written
        if counts and "#" not in word.written:
            size /= 1000.0 if self._state.scale == 1.0 else 10_000.0
        return size

    def _needs_lathe(self, at: Word) -> None:
        if not self._policy.lathe:
            hint = 'set kind = "lathe" under [machine] of the machine file'
            raise fault("code-not-supported", f"{at.written} is for a lathe", at, hint)

    def _column(self, letter: str, at: Word) -> int:
        """Return the column of an axis that the mode needs."""
        column = self._motion.column.get(letter)
        if column is None:
            hint = f"give the machine file an axis {letter}, such as [axes.{letter.lower()}]"
            raise fault("axis-missing", f"{at.written} needs the axis {letter}", at, hint)
        return column

    def _refuse_modes(self, at: Word) -> None:
        motion = self._motion
        self._refuse_compensation(at)
        refuse_under_tip_control(motion, at)
        if motion.coordinates.turned or motion.polar.plane is not None:
            message = f"{at.written} in a turned or polar coordinate system"
            raise fault("figure-active", message, at)

    def _refuse_compensation(self, at: Word) -> None:
        if self._motion.compensated:
            hint = "give G40 and a move before"
            raise fault("compensation-active", f"{at.written} under G41 or G42", at, hint)

    def _start(self, mode: _Mode) -> None:
        self._mode = mode
        self._motion.position = mode.map.here
        self._out.map_move = mode.map.chords
        self._blend(BLEND)

    def _end(self, at: Word) -> None:
        motion, mode, state = self._motion, self._mode, self._state
        self._refuse_compensation(at)
        if mode is None:
            return
        state.diameter, plane = self._before
        state.plane = plane or state.plane
        motion.position = mode.map.real(motion.position)
        motion.end_virtual()
        self._out.map_move = self._mode = None
        self._blend(state.tolerance if state.path == "blend" else None)

    def _blend(self, tolerance: float | None) -> None:
        """Let chords follow each other within a tolerance, mm; None ends it."""
        here = self._here
        if tolerance is None:
            self._out.add(PathMode(here.file, here.line, self._state.path))
        else:
            self._out.add(PathMode(here.file, here.line, "blend", tolerance))

    def check(self, words: LineWords, codes: Codes) -> None:
        """Refuse what has no meaning in the mode.

        Raises:
            GcodeError: ``face-code``.
        """
        mode = self._mode
        if mode is None:
            return
        allowed = _ALLOWED - {"face"} if isinstance(mode.map, Mantle) else _ALLOWED
        ends = (G.G4, G.G49, G.G7_1) if isinstance(mode.map, Mantle) else (G.G4, G.G49)
        for group, code in codes.items():
            known = group in allowed or code.number in ends
            if not known or (group == "motion" and code.number not in (*_MOVES, G.G80)):
                raise self._refused(code.word)
        for letter in mode.refused:
            if letter in words.rest:
                raise self._refused(words.rest[letter])
        explicit = codes.get("motion")
        moving = explicit.number if explicit else self._state.motion
        rapid = moving == G.G0 and words.has_axis() and "non-modal" not in codes
        if rapid and not mode.rapid:
            at = words.first_axis()
            under = replace(at, written=f"{at.written} under G0")
            raise self._refused(explicit.word if explicit else under)

    def _refused(self, word: Word) -> GcodeError:
        mode = self._mode
        assert mode is not None
        message = f"{word.written} in {mode.what} ({mode.name})"
        return fault("face-code", message, word, f"end it before, with {mode.end}")
