"""Polar coordinate interpolation on the face of a turned part: G12.1, G112, TRANSMIT.

While it is on, a program moves a driven tool in the plane of X and a virtual axis, in mm from the
axis of the spindle. The virtual axis has the letter C in FANUC's language, where X stays a
diameter and C begins at 0; on a Haas it is Y and X is a radius; in SINUMERIK's it is Y and X is as
before. X and the C axis follow by short chords: a chord, of which X and C are linear, stays within
:data:`TOLERANCE` of the programmed curve. F is the feed on the face. Sources: FANUC, "Operator's
Manual for Lathe System", "Polar coordinate interpolation (G12.1, G13.1)"; Haas, "Lathe Operator's
Manual", G112 and G113; Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job Planning",
TRANSMIT.
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
from cnc.gcode.reader.words import G, LineWords, Word, fault
from cnc.model.blocks import ArcFeed, PathMode, Plane
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
        middle, sweep = self._point(centre), block.turns * math.tau
        radius, last = abs(a - middle), abs(b - middle)

        def place(share: float) -> complex:
            turn = complex(math.cos(sweep * share), math.sin(sweep * share))
            grown = 1.0 + share * (last - radius) / radius
            return middle + (a - middle) * turn * grown if share < 1.0 else b

        def error(point: complex) -> float:
            return abs(abs(point - middle) - (radius + last) / 2.0)

        count = max(1, math.ceil(abs(block.turns) * 16.0))
        for number in range(count):
            part = number / count, (number + 1) / count
            yield from self._part(end, _Curve(place, error, abs(sweep) * radius), part, feed)

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


class FaceCodes(MotionCodes):
    """Execution of G12.1 and G13.1, and of what they are called in other languages."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._face: Face | None = None
        self._before: tuple[bool, Plane] = False, "ZX"
        self._lathe = self._dialect.turning.lathe
        self._fanuc = self._lathe and self._dialect.turning.two_line_cycles

    @property
    def active(self) -> bool:
        """Whether the mode is on."""
        return self._face is not None

    def execute(self, number: G, at: Word) -> None:
        """Begin or end the mode.

        Raises:
            GcodeError: ``axis-missing``, ``compensation-active``, ``figure-active``,
                ``face-start``, ``code-not-supported``.
        """
        motion = self._motion
        if motion.compensated:
            hint = "give G40 and a move before"
            raise fault("compensation-active", f"{at.written} under G41 or G42", at, hint)
        if number == G.G12_1 and not self.active:
            self._begin(at)
        elif number != G.G12_1 and self.active:
            self._end()

    def _begin(self, at: Word) -> None:
        motion, state = self._motion, self._state
        if not self._lathe:
            at = replace(at, written="TRANSMIT")
        if not self._lathe and not self._policy.lathe:
            hint = 'set kind = "lathe" under [machine] of the machine file'
            raise fault("code-not-supported", f"{at.written} is for a lathe", at, hint)
        x, c = (motion.column.get(letter) for letter in "XC")
        if x is None or c is None:
            hint = "give the machine file an axis C, such as [axes.c]"
            raise fault("axis-missing", f"{at.written} needs the axes X and C", at, hint)
        if motion.coordinates.turned:
            raise fault("figure-active", f"{at.written} in a turned coordinate system", at)
        program = motion.coordinates.to_program(motion.position)
        if program[x] < 0.0:
            message = f"{at.written} with X below the axis of the spindle"
            raise fault("face-start", message, at, "go to a positive X before")
        turned = math.radians(program[c]) if self._fanuc else 0.0
        self._face = Face((x, c), motion.coordinates, program, turned)
        self._before = state.diameter, state.plane
        if self._lathe and not self._fanuc:
            state.diameter = False
        if self._fanuc:
            state.plane = "XY"
        motion.position = self._face.here
        motion.begin_virtual(c)
        self._out.face = self._face.chords
        self._blend(BLEND)

    def _end(self) -> None:
        motion, face, state = self._motion, self._face, self._state
        assert face is not None
        state.diameter = self._before[0]
        if self._fanuc:
            state.plane = self._before[1]
        motion.position = face.real(motion.position)
        motion.end_virtual()
        self._out.face = self._face = None
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
        if not self.active:
            return
        name = "G12.1" if self._fanuc else "G112" if self._lathe else "TRANSMIT"
        for group, code in codes.items():
            known = group in _ALLOWED or code.number in (G.G4, G.G49)
            if not known or (group == "motion" and code.number not in (*_MOVES, G.G80)):
                raise self._refused(code.word, name)
        moving = codes.get("motion")
        rapid = moving is not None and moving.number == G.G0
        if self._fanuc and rapid and words.has_axis():
            assert moving is not None
            raise self._refused(moving.word, name)
        for letter in ("T", "Y" if self._fanuc else "C"):
            if letter in words.rest:
                raise self._refused(words.rest[letter], name)

    @staticmethod
    def _refused(word: Word, name: str) -> GcodeError:
        end = {"G12.1": "G13.1", "G112": "G113"}.get(name, "TRAFOOF")
        message = f"{word.written} in polar coordinate interpolation ({name})"
        return fault("face-code", message, word, f"end it before, with {end}")
