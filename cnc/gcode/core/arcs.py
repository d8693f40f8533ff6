"""Geometry of arcs in a plane: centre and swept angle from the words of a program.

Coordinates are the first and second axis of the plane in mm; counter-clockwise turns the first
towards the second. Source: LinuxCNC's G-code reference, G2 and G3. The tolerances belong to the
dialect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import interpreted
from cnc.gcode.core.axis_words import MoveFeeds
from cnc.gcode.core.context import Executor
from cnc.gcode.dialects.rules import ArcTolerance
from cnc.gcode.kernels import rules as kernel
from cnc.gcode.kernels.rules import SAME_POINT, Tolerance, Wanted, center_of_word
from cnc.gcode.reader.words import G, LineWords, Word, fault, whole
from cnc.model.blocks import PLANE_AXES, ArcFeed, NurbsFeed

Point = tuple[float, float]

_arc_of = interpreted(kernel.arc_of)


@dataclass(frozen=True, slots=True)
class Arc:
    """Centre, radius at the start and at the end, and signed full turns."""

    center: Point
    radius: float
    end_radius: float
    turns: float

    def length(self, rise: float) -> float:
        """Return the length in mm with an even ``rise`` along the axis across the plane.

        It is exact except for a change of radius within the tolerance.
        """
        return math.hypot(math.pi * (self.radius + self.end_radius) * self.turns, rise)


def from_center(
    start: Point,
    end: Point,
    center: Point,
    *,
    clockwise: bool,
    turns: int,
    tolerance: ArcTolerance,
    word: Word,
) -> Arc:
    """Return an arc about a known centre.

    Args:
        start: Start, mm.
        end: End, mm.
        center: Centre, mm.
        clockwise: Direction.
        turns: The P word: 1 for up to one turn.
        tolerance: Tolerances of the dialect.
        word: Word at which errors are reported.

    Raises:
        GcodeError: ``arc-radius-zero``, ``arc-radius-mismatch``.
    """
    arc = _arc_of(
        Wanted(*start, *end, *center, 0.0, clockwise),
        Tolerance(tolerance.slack, tolerance.relative, tolerance.limit, tolerance.reach),
    )
    if arc.status == kernel.NO_RADIUS:
        which = "start" if arc.radius == 0 else "end"
        hint = "give I, J, K from the start point to the centre"
        raise fault("arc-radius-zero", f"the centre of the arc is its {which} point", word, hint)
    if arc.status == kernel.MISMATCH:
        raise fault(
            "arc-radius-mismatch",
            f"the arc has radius {arc.radius:.6g} mm at its start and {arc.end_radius:.6g} mm "
            "at its end",
            word,
            "the centre must be as far from the end point as from the start point; "
            "absolute I, J and K need G90.1 (LinuxCNC, Mach3)",
        )
    return _with_turns(arc, turns, clockwise=clockwise)


def from_radius(
    start: Point,
    end: Point,
    radius: float,
    *,
    clockwise: bool,
    turns: int,
    tolerance: ArcTolerance,
    word: Word,
) -> Arc:
    """Return an arc of a known radius, mm; a negative one means more than half a turn.

    The other arguments are those of :func:`from_center`.

    Raises:
        GcodeError: ``arc-radius-zero``, ``arc-radius-no-chord``, ``arc-radius-too-small``.
    """
    arc = _arc_of(
        Wanted(*start, *end, math.nan, math.nan, radius, clockwise),
        Tolerance(tolerance.slack, tolerance.relative, tolerance.limit, tolerance.reach),
    )
    if arc.status == kernel.NO_RADIUS:
        raise fault("arc-radius-zero", "the radius of the arc is 0", word)
    if arc.status == kernel.NO_CHORD:
        raise fault(
            "arc-radius-no-chord",
            "an arc with R can't end where it starts",
            word,
            "write a full circle with I, J, K, or as two arcs",
        )
    if arc.status == kernel.TOO_SMALL:
        message = f"R is {arc.radius:.6g} mm, but the end point is {arc.end_radius:.6g} mm away"
        raise fault("arc-radius-too-small", message, word, "R must be at least half of that")
    return _with_turns(arc, turns, clockwise=clockwise)


def _with_turns(arc: kernel.Arc, turns: int, *, clockwise: bool) -> Arc:
    """Return the arc with the full turns that the P word adds."""
    return Arc(
        (arc.x, arc.y),
        arc.radius,
        arc.end_radius,
        arc.turns + (1 - turns if clockwise else turns - 1),
    )


# Arcs in planes that a rotation tilts, as splines.
#
# An arc of the program is a circle in its plane. A rotation about an axis of that plane takes it
# out of the planes of the machine. A rational quadratic spline is an exact circle (Piegl & Tiller,
# The NURBS Book, section 7.3), and a rotation of its control points is one of the curve.

Floats = NDArray[np.float64]

_STEPS = 4
"""Fewest spans of a turn: the weight of a span of half a turn is 0."""
_ALONG = 1e-5
"""Largest error along the other axes, which move evenly with the angle, mm or degrees."""


def spline_of(
    arc: Arc,
    start: Sequence[float],
    end: Sequence[float],
    plane: tuple[int, int],
    to_machine: Callable[[list[float]], list[float]],
) -> tuple[Floats, Floats, Floats]:
    """Return knots, control points (n, axes) and weights (n,) of an arc.

    Args:
        arc: The arc in program coordinates.
        start: (axes,) program coordinates of the start.
        end: (axes,) program coordinates of the end.
        plane: Columns of the arc's plane.
        to_machine: Conversion of a point in program coordinates.
    """
    i, j = plane
    begin, moved = np.array(start), np.array(end) - start
    moved[[i, j]] = 0.0
    sweep = math.tau * arc.turns
    spans = max(1, math.ceil(_STEPS * abs(arc.turns) - 1e-9))
    # Of a span, the parameter differs from the angle by less than its square over 60.
    rise = float(np.abs(moved).max())
    spans = max(spans, math.ceil((rise * sweep * sweep / (60.0 * _ALONG)) ** (1.0 / 3.0)))
    half = 0.5 * sweep / spans
    first = math.atan2(begin[j] - arc.center[1], begin[i] - arc.center[0])
    # Even points lie on the arc, odd ones where the tangents of their neighbours meet.
    share = np.arange(2 * spans + 1) / (2 * spans)
    angle = first + share * sweep
    radius = arc.radius + share * (arc.end_radius - arc.radius)
    radius[1::2] /= math.cos(half)
    points = begin + share[:, None] * moved
    points[:, i] = arc.center[0] + radius * np.cos(angle)
    points[:, j] = arc.center[1] + radius * np.sin(angle)
    points[0], points[-1] = start, end
    weights = np.ones(len(points))
    weights[1::2] = math.cos(half)
    knots = np.concatenate(([0.0], np.repeat(np.arange(spans + 1.0), 2), [float(spans)]))
    return knots, np.array([to_machine(point) for point in points.tolist()]), weights


# Arcs (G2, G3): centre or radius, plane and turns from the words of a line.

MAX_TURNS = 1000
"""Most turns of an arc. More are a typing error in P, and each turn is planned on its own."""
_CLOCKWISE = G.G2
_center_of_word = interpreted(center_of_word)

CENTER_WORDS = {"x": "I", "y": "J", "z": "K"}
"""Letter of the offset along each axis, from the start to a centre or a control point."""
_PLANE_LETTERS = {
    plane: [CENTER_WORDS[axis] for axis in pair] for plane, pair in PLANE_AXES.items()
}


class ArcMoves(Executor):
    """Conversion of the words of a line into an arc."""

    def __init__(self, words: MoveFeeds) -> None:
        super().__init__(words.context)
        self._axis_words = words

    def block(self, words: LineWords, motion: G, code: Word | None) -> ArcFeed | NurbsFeed:
        """Return the arc of a line with G2 or G3, or while one of them is in effect.

        It is a spline where a rotation tilts the plane.

        Args:
            words: The words of the line.
            motion: G2 or G3.
            code: The G word of the line, if it has one.

        Raises:
            GcodeError: The words do not give an arc.
        """
        user, state, mover = motion.written, self._state, self._axis_words
        at = code or words.first()
        i, j = self._columns(at, "an arc")
        if self._dialect.arcs.as_grbl:
            self._check_axis_words(words, user, at)
        opening = words.take(",O", user)
        end = mover.target(words, user, mover.position)
        radius = words.take("R", user)
        letters = _PLANE_LETTERS[state.plane]
        centers = [words.take(letter, user) for letter in letters]
        self._take_idle_center(words, user)
        turns = self._turns(words, user)
        if opening and radius is None and not any(centers):
            radius = self._radius_of_angle(opening, end, (i, j))
        elif opening:
            beside = next(each for each in (radius, *centers) if each)
            message = f"{beside.written} beside the angle of an arc, which has an end point only"
            raise fault("arc-radius-and-center", message, beside)
        if radius:
            self._refuse_center(radius, centers, user)
            arc = self._arc_of(end, motion, (i, j), None, radius.number, turns, radius)
        else:
            self._check_center(letters, centers, user, at)
            offsets = [word.number if word else None for word in centers]
            word = next(filter(None, centers), at)
            arc = self._arc_of(end, motion, (i, j), (offsets[0], offsets[1]), 0.0, turns, word)
        if self._tilted((i, j)):
            return self._tilted_block(words, arc, end, (i, j), at)
        feed = mover.feed(words, end, arc.length(self._rise(end, i, j)), at)
        return self._block(arc, end, feed)

    def _check_axis_words(self, words: LineWords, user: str, at: Word) -> None:
        """Refuse an arc without an axis word of its plane, as GRBL does."""
        names = [axis.upper() for axis in PLANE_AXES[self._state.plane]]
        if words.rest.keys().isdisjoint(names):
            message = f"{user} without {names[0]} and {names[1]}: GRBL refuses the line"
            hint = f"give {names[0]} and {names[1]} of the end, also for a full circle"
            raise fault("axis-words-missing", message, at, hint)

    def _check_single_precision(self, here: Point, there: Point, radius: float, word: Word) -> None:
        """Refuse an R that is less than half of the chord in GRBL's arithmetic (error 34)."""
        x0, y0, x1, y1, r = np.array((*here, *there, radius), np.float32)
        x, y = x1 - x0, y1 - y0
        if np.float32(4.0) * r * r - x * x - y * y < 0.0:
            chord = math.dist(here, there)
            message = (
                f"{word.written}: R is less than half of the chord of {chord:.6g} mm, in the "
                "single precision of GRBL"
            )
            raise fault("arc-radius-too-small", message, word, "write I and J, or a larger R")

    def _tilted_block(
        self, words: LineWords, arc: Arc, end: list[float], plane: tuple[int, int], at: Word
    ) -> NurbsFeed:
        """Return an arc in program coordinates as a spline of the machine."""
        mover, here, coordinates = self._axis_words, self._here, self._axis_words.coordinates
        start, to = coordinates.to_program(mover.position), coordinates.to_program(end)
        rise = math.hypot(
            *(
                to[index] - start[index]
                for index, axis in enumerate(mover.axes)
                if axis in "xyz" and index not in plane
            )
        )
        length = arc.length(rise) * (coordinates.transform.scale(plane) or 1.0)
        feed = mover.feed(words, end, length, at)
        knots, points, weights = spline_of(arc, start, to, plane, coordinates.to_machine)
        points[0], points[-1] = mover.position, end
        return NurbsFeed(here.file, here.line, 2, knots, points, weights, feed)

    def _refuse_center(self, radius: Word, centers: list[Word | None], user: str) -> None:
        """Refuse a centre beside R, or report it where the dialect ignores it."""
        clash = next(filter(None, centers), None)
        if clash is None:
            return
        if self._dialect.arcs.radius_first:
            message = f"{clash.written} has no effect beside {radius.written}"
            hint = "remove it; other controllers refuse the line"
            self._here.report_warning("word-without-effect", message, clash, hint)
            return
        later = max(radius, clash, key=lambda word: word.column)
        raise fault("arc-radius-and-center", f"{user} takes R or a centre, not both", later)

    def _radius_of_angle(self, word: Word, end: list[float], plane: tuple[int, int]) -> Word:
        """Return the radius of an arc whose end and opening angle are given (SINUMERIK's AR).

        It is negative for an arc of more than half a turn.
        """
        i, j = plane
        coordinates, here = self._axis_words.coordinates, self._axis_words.position
        tilted = self._tilted(plane)
        if tilted:
            here, end = coordinates.to_program(here), coordinates.to_program(end)
        chord = math.dist((end[i], end[j]), (here[i], here[j]))
        if not 0.0 < word.number < 360.0 or chord == 0.0:
            message = f"{word.number:g}: an arc has more than 0 and less than 360 degrees"
            raise fault("arc-angle", message, word)
        factor = 1.0 if tilted else coordinates.transform.scale(plane) or 1.0
        radius = chord / (2.0 * math.sin(math.radians(word.number) / 2.0))
        radius *= -1.0 if word.number > 180.0 else 1.0
        return Word(
            "R", radius / self._state.scale / factor, word.written, word.column, word.length
        )

    def plane_columns(self, at: Word, what: str = "an arc") -> tuple[int, int]:
        """Return the columns of the two axes of the plane.

        Args:
            at: Word at which errors are reported.
            what: Name of the move in messages.

        Raises:
            GcodeError: ``axis-missing``, ``arc-rotated``.
        """
        plane = self._columns(at, what)
        if not self._tilted(plane):
            return plane
        coordinates, name = self._axis_words.coordinates, self._state.plane
        if coordinates.rotation:
            message = f"{what} can't be made in the {name} plane of a rotated coordinate system"
            raise fault("arc-rotated", message, at, "use a coordinate system without R")
        message = f"{what} can't be made in the {name} plane under G68 of another one"
        raise fault("arc-rotated", message, at, "give G69 before")

    def _tilted(self, plane: tuple[int, int]) -> bool:
        """Return whether a rotation tilts a plane of the program."""
        coordinates = self._axis_words.coordinates
        tilted = coordinates.transform.plane not in (None, plane)
        return tilted or (coordinates.rotation != 0.0 and self._state.plane != "XY")

    def _columns(self, at: Word, what: str) -> tuple[int, int]:
        """Return the columns of the two axes of the plane, which a rotation may tilt."""
        first, second = PLANE_AXES[self._state.plane]
        column = self._axis_words.in_plane
        for axis in (first, second):
            if axis.upper() not in column:
                raise fault(
                    "axis-missing",
                    f"{what} in the {self._state.plane} plane needs the {axis.upper()} axis, "
                    "which the machine lacks",
                    at,
                )
        plane = column[first.upper()], column[second.upper()]
        if plane[0] == plane[1]:
            message = f"{what} in the {self._state.plane} plane, without the axis of the cylinder"
            raise fault("mantle-plane", message, at, "choose the plane of the mantle before")
        return plane

    def _arc_of(
        self,
        end: list[float],
        motion: G,
        plane: tuple[int, int],
        offsets: tuple[float | None, float | None] | None,
        radius: float,
        turns: int,
        word: Word,
    ) -> Arc:
        """The arc of I, J, K (None for a missing word); of the radius if ``offsets`` is None."""
        state, position = self._state, self._axis_words.position
        tolerance = self._dialect.arcs.mm if state.scale == 1.0 else self._dialect.arcs.inch
        i, j = plane
        coordinates = self._axis_words.coordinates
        transform, tilted = coordinates.transform, self._tilted(plane)
        factor = transform.scale(plane)
        if factor is None:
            message = f"{word.written}: an arc under different factors of G51 would be an ellipse"
            raise fault("scaling-arc", message, word, "give both axes of the plane one factor")
        if tilted:
            position, end = coordinates.to_program(position), coordinates.to_program(end)
        radius *= 1.0 if tilted else factor
        here, there = (position[i], position[j]), (end[i], end[j])
        clockwise = (motion is _CLOCKWISE) != (transform.mirrors(plane) and not tilted)
        if offsets is None:
            if self._dialect.arcs.as_grbl and math.dist(here, there) > SAME_POINT:
                self._check_single_precision(here, there, radius * state.scale, word)
            return from_radius(
                here,
                there,
                radius * state.scale,
                clockwise=clockwise,
                turns=turns,
                tolerance=tolerance,
                word=word,
            )
        center = self._center((i, j), offsets)
        if tilted:
            x, y = (offset * state.scale for offset in (offsets[0] or 0.0, offsets[1] or 0.0))
            center = (x, y) if state.arc_absolute else (here[0] + x, here[1] + y)
        return from_center(
            here, there, center, clockwise=clockwise, turns=turns, tolerance=tolerance, word=word
        )

    def _center(
        self, plane: tuple[int, int], offsets: tuple[float | None, float | None]
    ) -> tuple[float, float]:
        """The centre in machine coordinates."""
        i, j = plane
        state, coordinates = self._state, self._axis_words.coordinates
        if coordinates.turned:
            first, second = (offsets[0] or 0.0) * state.scale, (offsets[1] or 0.0) * state.scale
            place = (
                coordinates.to_program(self._axis_words.position)
                if state.arc_absolute
                else [0.0] * len(self._axis_words.axes)
            )
            place[i], place[j] = first, second
            if state.arc_absolute:
                turned = coordinates.to_machine(place)
                return turned[i], turned[j]
            turned = coordinates.rotated(place)
            return self._axis_words.position[i] + turned[i], self._axis_words.position[j] + turned[
                j
            ]
        position, zero = self._axis_words.position, coordinates.zero
        x, y = (
            _center_of_word(
                offset or 0.0, state.scale, position[column], zero[column], state.arc_absolute
            )
            for column, offset in zip(plane, offsets, strict=True)
        )
        return x, y

    def _check_center(
        self, letters: list[str], words: list[Word | None], user: str, at: Word
    ) -> None:
        if words[0] is None and words[1] is None:
            raise fault("arc-center-missing", f"{user} needs {letters[0]}, {letters[1]} or R", at)
        if self._state.arc_absolute:
            for letter, word in zip(letters, words, strict=True):
                if word is None:
                    message = (
                        f"under G90.1 {user} needs both {letters[0]} and {letters[1]}; "
                        f"{letter} is missing"
                    )
                    raise fault("arc-center-missing", message, at)

    def _take_idle_center(self, words: LineWords, user: str) -> None:
        """Take a centre word of 0 for the axis across the plane, if the dialect allows one."""
        if self._dialect.arcs.idle_center:
            for letter in "IJK":
                if (word := words.rest.get(letter)) and word.number == 0:
                    words.take(letter, user)

    def _turns(self, words: LineWords, user: str) -> int:
        if "P" in words.rest and not self._dialect.arcs.turns:
            raise fault(
                "word-not-in-dialect",
                f"P turns of an arc are not in the {self._dialect.name} dialect",
                words.rest["P"],
            )
        word = words.take("P", user)
        return whole(word, "the turns", 1, MAX_TURNS) if word else 1

    def _rise(self, end: list[float], i: int, j: int) -> float:
        """Length of the move along the axis across the plane, mm."""
        third = next(
            (
                n
                for n, axis in enumerate(self._axis_words.axes)
                if axis in "xyz" and n not in (i, j)
            ),
            None,
        )
        return 0.0 if third is None else end[third] - self._axis_words.position[third]

    def _block(self, arc: Arc, end: list[float], feed: float) -> ArcFeed:
        here, plane = self._here, self._state.plane
        return ArcFeed(
            here.file, here.line, plane, arc.center, np.array(end), arc.radius, arc.turns, feed
        )
