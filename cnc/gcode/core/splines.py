"""Splines: G5 and G5.1, BSPLINE, their knots and lengths, and the base of their collectors.

:mod:`cnc.gcode.core.nurbs` uses the base and the lengths, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.core.arcs import CENTER_WORDS
from cnc.gcode.core.block_buffer import SourceLocation
from cnc.gcode.core.modal_groups import GROUP_OF_G, Code, Codes, ModalState
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.reader.words import AXES, G, LineWords, M, Word, fault, not_negative, whole
from cnc.model.blocks import PLANE_AXES, NurbsFeed, Plane
from cnc.model.diagnostics import GcodeError

# G5 and G5.1: Bezier curves in the plane, each in one line.
#
#     G5 X Y I J P Q   cubic: I J from the start to the first control point,
#                      P Q from the end to the second
#     G5.1 X Y I J     quadratic: I J from the start to the control point, 0 where one is missing
#
# They are as in LinuxCNC ("G5 Cubic Spline", "G5.1 Quadratic Spline"), but in every plane: I
# belongs to X, J to Y and K to Z, and P and Q are the second point's offsets along the plane's
# first and second axis (X Y, Z X, Y Z). The offsets count from the start or the end, also under
# G90.1. Only the plane's two axes move. A G5 directly after another may have no I and J: it
# continues in the direction and with the speed of its end (-P -Q). "Directly" means that there is
# no move between them.

CUBIC, QUADRATIC = G.G5, G.G5_1

Vector = list[float]


def register_g5(motion: Motion) -> None:
    """Register the handlers of G5 and G5.1."""
    splines = _Splines(motion)
    motion.handlers[CUBIC] = splines.cubic
    motion.handlers[QUADRATIC] = splines.quadratic


class _Splines(MotionCodes):
    """Execution of G5 and G5.1. The end of a G5 is stored for the next one."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._end: list[float] | None = None
        self._plane: Plane = "XY"
        self._tangent: Vector = []

    def cubic(self, words: LineWords, code: Code | None) -> None:
        """Execute G5."""
        at = self._begin(words, code, "G5")
        start = self._motion.position
        end = self._motion.target(words, "G5", start)
        first = self._first(words, at)
        p, q = words.take("P", "G5"), words.take("Q", "G5")
        if p is None or q is None:
            given, missing = p or q or at, "P and Q" if not (p or q) else "Q" if p else "P"
            raise fault(
                "spline-control-point-missing",
                f"G5 needs P and Q: {missing} missing",
                given,
                "P and Q are the second control point's offset from the end",
            )
        second = self._vector(p, q)
        self._make("G5", words, [start, _plus(start, first), _plus(end, second), end], at)
        self._end, self._plane, self._tangent = (
            self._motion.position,
            self._state.plane,
            [-value for value in second],
        )

    def quadratic(self, words: LineWords, code: Code | None) -> None:
        """Execute G5.1."""
        at = self._begin(words, code, "G5.1")
        start = self._motion.position
        end = self._motion.target(words, "G5.1", start)
        letters = self._letters()
        offsets = [words.take(letter, "G5.1") for letter in letters]
        if not any(word and word.number for word in offsets):
            given = next((word for word in offsets if word), at)
            message = f"G5.1 needs {letters[0]} or {letters[1]}, not both 0"
            raise fault(
                "spline-control-point-missing",
                message,
                given,
                "they are the control point's offset from the start",
            )
        self._make("G5.1", words, [start, _plus(start, self._vector(*offsets)), end], at)

    def _begin(self, words: LineWords, code: Code | None, user: str) -> Word:
        """Check the modes and the axis words. Returns the word at which errors are reported."""
        at = code.word if code else words.first_axis()
        check_mode(self._state, at, inverse_time=True)
        first, second = self._axes()
        for word in sorted(words.rest.values(), key=lambda word: word.column):
            if word.letter in AXES and word.letter.lower() not in (first, second):
                message = (
                    f"{word.written}: {user} moves only along {first.upper()} and "
                    f"{second.upper()}, the axes of its plane"
                )
                raise fault("spline-axis", message, word, "choose the plane by G17, G18 or G19")
        if not words.has_axis():
            look_ahead = words.rest.keys() <= {"P", "Q"}
            hint = (
                "FANUC's look-ahead modes (G05 P10000, G05.1 Q1) have no use: remove them"
                if look_ahead
                else ""
            )
            raise fault("axis-words-missing", f"{user} needs axis words: its end point", at, hint)
        return at

    def _axes(self) -> tuple[str, str]:
        return PLANE_AXES[self._state.plane]

    def _letters(self) -> list[str]:
        return [CENTER_WORDS[axis] for axis in self._axes()]

    def _first(self, words: LineWords, at: Word) -> Vector:
        """Offset of the first control point of a G5 from the start."""
        letters = self._letters()
        offsets = [words.take(letter, "G5") for letter in letters]
        given = [word for word in offsets if word]
        if len(given) == 1:
            message = (
                f"G5 needs both {letters[0]} and {letters[1]}, or neither right after another G5"
            )
            raise fault(
                "spline-control-point-missing",
                message,
                given[0],
                "they are the first control point's offset from the start",
            )
        if given:
            return self._vector(*offsets)
        if self._motion.position is not self._end or self._state.plane != self._plane:
            message = (
                f"G5 without {letters[0]} and {letters[1]} must directly follow another G5 of "
                "this plane"
            )
            raise fault(
                "spline-tangent-missing", message, at, f"give {letters[0]} and {letters[1]}"
            )
        return self._tangent

    def _vector(self, first: Word | None, second: Word | None) -> Vector:
        """Two offsets along the plane's axes as a vector in machine directions."""
        motion, state = self._motion, self._state
        offset = [0.0] * len(motion.axes)
        for axis, word in zip(self._axes(), (first, second), strict=True):
            index = motion.column.get(axis.upper())
            if word and index is None:
                message = (
                    f"{word.written}: a spline in the {state.plane} plane needs the {axis.upper()} "
                    "axis, which the machine lacks"
                )
                raise fault("axis-missing", message, word)
            if word and index is not None:
                offset[index] = word.number * state.scale
        return motion.coordinates.rotated(offset)

    def _make(self, user: str, words: LineWords, control: Sequence[Vector], at: Word) -> None:
        points, weights = np.array(control), np.ones(len(control))
        knots = bezier_knots(len(control) - 1)
        # Only inverse time needs the length.
        length = (
            curve_length(knots, points, weights) if self._state.feed_mode == "inverse-time" else 0.0
        )
        motion, here = self._motion, self._here
        feed = motion.feed(words, list(control[-1]), length, at)
        motion.spline(
            NurbsFeed(here.file, here.line, len(control) - 1, knots, points, weights, feed)
        )


def _plus(point: Vector, offset: Vector) -> Vector:
    return [a + b for a, b in zip(point, offset, strict=True)]


# Base of the collectors of curves that are written over many lines.
#
# A collector takes the lines from the code that opens a curve to the one that completes it;
# ``motion.collector`` is the active one.

MAX_ORDER = 10
POINT_AXES = "XYZ"
ReadFeed = Callable[[LineWords, Codes], None]
"""Takes the F word of a line, if it has one, into the modal state."""

_ROTARY = frozenset("ABC")
_ENDS = (M.M2, M.M30)


@dataclass(frozen=True, slots=True)
class WordLocation:
    """A word and its line, for errors that are found later."""

    word: Word
    file: str
    line: int
    text_of: Callable[[int], str]

    @classmethod
    def of(cls, word: Word, here: SourceLocation) -> WordLocation:
        """Return the location of a word of the current line."""
        return cls(word, here.file, here.line, here.text_of)

    def fault(self, code: str, message: str, hint: str = "") -> GcodeError:
        """Return an error at this word."""
        return self.put(fault(code, message, self.word, hint))

    def put(self, error: GcodeError) -> GcodeError:
        """Return the error with the place of this line."""
        return GcodeError(
            replace(error.diagnostic, file=self.file, line=self.line, text=self.text_of(self.line))
        )


class PointCollector:
    """Control points in machine coordinates and their weights.

    The first point is the position at the start.

    Attributes:
        takes_rotary: Whether A, B and C may be coordinates of the points.
        name: Code that opens the curve, for messages.
        holds: Words that its lines may have, for messages.
    """

    takes_rotary = True

    def __init__(self, name: str, holds: str, start: Word, motion: Motion) -> None:
        self.name = name
        self.holds = holds
        self.motion, self.here = motion, motion.context.here
        self.start = WordLocation.of(start, self.here)
        self.points = [motion.position]
        self.weights = [1.0]

    def check_opening_line(self, words: LineWords) -> None:
        """Refuse words that can't stand in the line that opens a curve; only modal codes can."""
        refused = [
            *words.m,
            *(word for word in words.g if _is_non_modal(word)),
        ]
        refused += [words.users[letter][1] for letter in "ST" if letter in words.users]
        for word in refused[:1]:
            message = f"{word.written} can't stand in the line of {self.name}"
            raise fault("nurbs-foreign-word", message, word, "write it on the line before")

    def axes(self, words: LineWords) -> list[Word]:
        """Return the axis words of a line from left to right: X, Y, Z, and rotary axes."""
        letters = sorted(
            (word for word in words.rest.values() if word.letter in AXES),
            key=lambda word: word.column,
        )
        for word in letters:
            if word.letter in _ROTARY and not self.takes_rotary:
                raise fault(
                    "nurbs-rotary-axis",
                    f"{word.written}: rotary axes can't move along {self.name}",
                    word,
                )
            if word.letter not in POINT_AXES and word.letter not in _ROTARY:
                raise self.foreign(word)
        return letters

    def directions(self, words: LineWords) -> list[Word]:
        """Return the words of the direction of the tool in a line."""
        return [words.rest[letter] for letter in self.motion.vector_letters if letter in words.rest]

    def no_codes(self, codes: Codes) -> None:
        """Refuse codes in a line inside the curve."""
        for code in codes.values():
            raise self.foreign(code.word)

    def no_words(self, words: LineWords) -> None:
        """Refuse remaining words in a line inside the curve."""
        for word in words.rest.values():
            raise self.foreign(word)

    def foreign(self, word: Word) -> GcodeError:
        """Return the error for a word that can't stand inside the curve."""
        return fault(
            "nurbs-foreign-word",
            f"{word.written} can't stand inside {self.name}",
            word,
            f"its lines hold {self.holds} only",
        )

    def too_few(self, degree: int) -> str:
        """Return the message of a curve with too few points."""
        return (
            f"{len(self.points)} control points are too few: a curve of degree {degree} has "
            f"{degree + 1} or more"
        )

    def make(self, knots: NDArray[np.float64], feed: float) -> None:
        """Make the move of the complete curve."""
        degree = len(knots) - len(self.points) - 1
        points, weights = (
            np.array(self.points, dtype=np.float64),
            np.array(self.weights, dtype=np.float64),
        )
        self.motion.collector = None
        feed *= self.motion.feed_of_rotary_curve(points)
        self._check_ends(points)
        self.motion.spline(
            NurbsFeed(self.start.file, self.start.line, degree, knots, points, weights, feed)
        )

    def _check_ends(self, points: NDArray[np.float64]) -> None:
        """Refuse a curve whose tip rests at an end, where rotary axes would turn at any speed.

        Raises:
            GcodeError: ``nurbs-tip-rests``.
        """
        linear = [letter.upper() not in _ROTARY for letter in self.motion.axes]
        moved = points != points[0]
        if not moved[:, linear].any():
            return
        for step, which in ((points[1] - points[0], "first"), (points[-1] - points[-2], "last")):
            if step.any() and not step[linear].any():
                raise self.start.fault(
                    "nurbs-tip-rests",
                    f"rotary axes turn between the {which} two control points, but the tip rests",
                    "turn the axes in a move of their own, or move the tip",
                )


def weight_of(word: Word) -> float:
    """Return the weight of a control point."""
    if word.number <= 0:
        raise fault("nurbs-weight-not-positive", f"{word.written}: a weight must be positive", word)
    return word.number


def _is_non_modal(word: Word) -> bool:
    tenths = word.tenths
    return tenths is not None and GROUP_OF_G[G(tenths)] == "non-modal"


def leaving(codes: Codes) -> Code | None:
    """Return the code that leaves the curve: another motion code, or the program end; else None."""
    if code := codes.get("motion"):
        return code
    code = codes.get("stop")
    return code if code and code.number in _ENDS else None


def check_mode(
    state: ModalState, word: Word, code: str = "", *, inverse_time: bool = False
) -> None:
    """Refuse a spline under cutter compensation or G93.

    Args:
        state: The modal state.
        word: The G word, for errors.
        code: Code of both errors; by default each has its own.
        inverse_time: G93 is allowed.

    Raises:
        GcodeError: The mode is not allowed.
    """
    if state.compensation != G.G40:
        raise fault(
            code or "compensation-active",
            f"{word.written} under cutter compensation",
            word,
            "give G40 and a move before",
        )
    if state.feed_mode == "inverse-time" and not inverse_time:
        raise fault(
            code or "nurbs-wrong-mode", f"{word.written} under G93", word, "give G94 before"
        )


# BSPLINE: a B-spline by its control points, in the words of Siemens' SINUMERIK 840D.
#
#    BSPLINE SD=3        SD degree, 2 or 3, by default 3; the line may have the first of the points
#    X Y Z PL=1 PW=1     a control point; PL interval length, PW weight, both by default 1
#    X Y Z ..
#    G1 ..               another motion code, another BSPLINE or the program end completes the curve
#
# The first control point is the position before, with weight 1. The curve starts and ends in its
# first and last control point, along the polygon: its knots are clamped. Source: SINUMERIK 840D sl,
# Programming Manual Job Planning, "Spline interpolation (ASPLINE, BSPLINE, CSPLINE, BAUTO, BNAT,
# BTAN, EAUTO, ENAT, ETAN, PW, SD, PL)": PL is the parameter interval length, the distance between
# two knots.
#
# A curve of degree p and n + 1 control points has n + 1 - p pieces, each controlled by p + 1
# consecutive points. The manual does not say which line's PL belongs to which piece. Here it is the
# piece that the line's point completes: PL = u(i+1) - u(i) for point i of the clamped knots u.
# Differences of a CAM system's knots give the same. So the first p - 1 lines after the start
# complete no piece: a PL there must be 0, or the one length of all the curve's PLs, when it makes
# no difference. A later PL=0 makes a multiple knot.

DEFAULT_DEGREE = 3


def register_bspline(motion: Motion, read_feed: ReadFeed) -> None:
    """Register the handler of BSPLINE."""

    def begin(words: LineWords, code: Code | None) -> None:
        assert code is not None, "while BSPLINE is in effect its collector takes the lines"
        check_mode(motion.context.state, code.word)
        curve = ControlPolygon(code.word, motion, read_feed)
        curve.first(words)
        motion.collector = curve

    motion.handlers[G.BSPLINE] = begin


class ControlPolygon(PointCollector):
    """Collector of a BSPLINE.

    ``first`` takes the BSPLINE line and ``line`` each one after it.
    """

    def __init__(self, start: Word, motion: Motion, read_feed: ReadFeed) -> None:
        super().__init__("BSPLINE", "X, Y, Z, PL= and PW=", start, motion)
        self._read_feed = read_feed
        self._degree = DEFAULT_DEGREE
        self._feed = 0.0
        self._intervals: list[WordLocation | None] = []

    def first(self, words: LineWords) -> None:
        """Take the words of the BSPLINE line. Words without a use stay for the caller to refuse."""
        if size := words.take("SD", "BSPLINE"):
            self._degree = whole(size, "the degree", 2, 3)
        self.check_opening_line(words)
        self._point(words, self.start.word)

    def line(self, words: LineWords, codes: Codes) -> bool:
        """Take a line while BSPLINE is in effect.

        Returns:
            False for the line that completes the curve and must still be executed.
        """
        if leaving(codes):
            self._complete()
            return False
        self.no_codes(codes)
        if len(self.points) == 1:
            self._read_feed(words, {})
        elif feed := words.rest.get("F"):
            message = f"{feed.written} inside a curve, which has one feed"
            raise fault(
                "nurbs-foreign-word", message, feed, "give F before the second control point"
            )
        self._point(words, None)
        self.no_words(words)
        return True

    def end(self, what: str) -> None:
        """Complete the curve at the program end."""
        self._complete()

    def _point(self, words: LineWords, at: Word | None) -> None:
        interval, weight = words.take("PL", "BSPLINE"), words.take("PW", "BSPLINE")
        axes = self.axes(words) or self.directions(words)
        if axes:
            if len(self.points) == 1:
                self._feed = self.motion.feed(words, self.motion.position, 0.0, at or axes[0])
            if interval:
                not_negative(interval, "the interval")
            self.points.append(self._place(words))
            self.weights.append(weight_of(weight) if weight else 1.0)
            self._intervals.append(WordLocation.of(interval, self.here) if interval else None)
        elif word := interval or weight:
            what = "an interval" if interval else "a weight"
            raise fault(
                "nurbs-foreign-word", f"{word.written} is {what} without a control point", word
            )

    def _place(self, words: LineWords) -> list[float]:
        """Return the control point of a line; a direction of the tool gives its angles."""
        turn = self.motion.turn_with_vector
        before = self.points[-1].copy()
        if turn is not None:
            turn(words, before, "BSPLINE")
        return self.motion.target(words, "BSPLINE", before)

    def _complete(self) -> None:
        degree, count = self._degree, len(self.points)
        if count <= degree:
            raise self.start.fault(
                "nurbs-too-few-points", self.too_few(degree), "the position before BSPLINE counts"
            )
        lengths = [place.word.number if place else 1.0 for place in self._intervals]
        early, pieces = self._intervals[: degree - 1], lengths[degree - 1 :]
        if len(set(lengths)) > 1:
            for place in early:
                if place and place.word.number:
                    message = (
                        f"{place.word.written}: this control point completes no piece of the curve"
                    )
                    hint = (
                        f"the first {degree - 1} of a curve of degree {degree} have PL=0 or no PL"
                    )
                    raise place.fault("nurbs-interval-unused", message, hint)
        self._check_multiplicities(pieces)
        self.make(clamped(pieces, degree), self._feed)

    def _check_multiplicities(self, pieces: list[float]) -> None:
        """Check the empty pieces.

        There must be none at the ends, and at most degree - 1 consecutive ones between.
        """
        empty = 0
        for index, piece in enumerate(pieces):
            empty = 0 if piece else empty + 1
            place = self._intervals[index + self._degree - 1]
            if not place or piece:
                continue
            if index == 0 or index == len(pieces) - 1:
                which = "last" if index else "first"
                message = (
                    f"{place.word.written} for the {which} piece of the curve, which can't be empty"
                )
                raise place.fault("nurbs-end-multiplicity", message, "give its length")
            if empty == self._degree:
                message = f"{empty} consecutive empty pieces make the curve discontinuous"
                raise place.fault("nurbs-position-jump", message, f"at most {self._degree - 1}")


# Knots and lengths of the splines of a program.
#
# Source: Piegl and Tiller, "The NURBS Book", 2nd edition: clamped knots (2.1), de Boor's algorithm
# (A3.1, A4.1), derivatives of a rational curve (4.8).

Floats = NDArray[np.float64]

_TOLERANCE = 1e-11
"""Error of the length of a piece, as a part of the control polygon."""
_HALVINGS = 40


@cache
def _gauss() -> tuple[Floats, Floats]:
    """Return nodes (12,) and weights (12,) of Gaussian quadrature on -1 to 1.

    They are computed when a length is needed: that imports a part of numpy.
    """
    return np.polynomial.legendre.leggauss(12)


def clamped(intervals: Sequence[float], degree: int) -> Floats:
    """Return clamped knots from 0, (pieces + 2 degree + 1,).

    Args:
        intervals: (pieces,) parameter interval of each piece.
        degree: Degree; both ends have multiplicity degree + 1.
    """
    steps = np.cumsum([0.0, *intervals])
    return np.concatenate([np.zeros(degree), steps, np.full(degree, steps[-1])])


def clamped_uniform(points: int, degree: int) -> Floats:
    """Return knots with equal intervals for a number of control points, (points + degree + 1,)."""
    return clamped([1.0] * (points - degree), degree)


def bezier_knots(degree: int) -> Floats:
    """Return the knots of one piece from 0 to 1, (2 degree + 2,)."""
    return clamped([1.0], degree)


def curve_length(knots: Floats, control_points: Floats, weights: Floats) -> float:
    """Return the length of a NURBS in mm, cusps included.

    Each piece is measured by Gaussian quadrature, and again in halves, until both agree. The error
    is at most 1e-10 of the length of the control polygon.

    Args:
        knots: (points + degree + 1,).
        control_points: (points, axes), mm.
        weights: (points,), more than 0.
    """
    degree = len(knots) - len(control_points) - 1
    form = np.column_stack([control_points * weights[:, None], weights])
    polygon = float(np.linalg.norm(np.diff(control_points, axis=0), axis=1).sum())
    total = 0.0
    for span in range(degree, len(control_points)):
        if knots[span] < knots[span + 1]:
            total += _piece(knots, form, degree, span, _TOLERANCE * polygon)
    return total


def _piece(knots: Floats, form: Floats, degree: int, span: int, tolerance: float) -> float:
    """Length of one piece."""

    def measured(a: float, b: float) -> float:
        half = (b - a) / 2
        nodes, factors = _gauss()
        return half * float(factors @ _speed(knots, form, degree, span, a + half + half * nodes))

    total = 0.0
    a, b = float(knots[span]), float(knots[span + 1])
    stack = [(a, b, measured(a, b), _HALVINGS)]
    while stack:
        a, b, whole, left = stack.pop()
        middle = (a + b) / 2
        first, second = measured(a, middle), measured(middle, b)
        if abs(first + second - whole) <= tolerance or not left:
            total += first + second
        else:
            stack += [(a, middle, first, left - 1), (middle, b, second, left - 1)]
    return total


def _speed(knots: Floats, form: Floats, degree: int, span: int, u: Floats) -> Floats:
    """|dr/du| of one piece at the parameters u (n,).

    ``form`` (points, axes + 1) holds the weighted control points and the weights.
    """
    d = [np.broadcast_to(row, (len(u), form.shape[1])) for row in form[span - degree : span + 1]]
    slope = np.zeros((len(u), form.shape[1]))
    for level in range(1, degree + 1):
        if level == degree:
            slope = degree * (d[1] - d[0]) / (knots[span + 1] - knots[span])
        following = []
        for at in range(degree - level + 1):
            low, high = knots[span - degree + level + at], knots[span + 1 + at]
            fraction = ((u - low) / (high - low))[:, None]
            following.append((1 - fraction) * d[at] + fraction * d[at + 1])
        d = following
    value = d[0]
    point = value[:, :-1] / value[:, -1:]
    speeds: Floats = np.linalg.norm((slope[:, :-1] - slope[:, -1:] * point) / value[:, -1:], axis=1)
    return speeds
