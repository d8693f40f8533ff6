"""G5 and G5.1: Bezier curves in the plane, each in one line.

    G5 X Y I J P Q   cubic: I J from the start to the first control point,
                     P Q from the end to the second
    G5.1 X Y I J     quadratic: I J from the start to the control point, 0 where one is missing

They are as in LinuxCNC ("G5 Cubic Spline", "G5.1 Quadratic Spline"), but in every plane: I belongs
to X, J to Y and K to Z, and P and Q are the second point's offsets along the plane's first and
second axis (X Y, Z X, Y Z). The offsets count from the start or the end, also under G90.1. Only the
plane's two axes move. A G5 directly after another may have no I and J: it continues in the
direction and with the speed of its end (-P -Q). "Directly" means that there is no move between
them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cnc.gcode.codes.arc_words import CENTER_WORDS
from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.splines import knots as curves
from cnc.gcode.splines.collecting import check_mode
from cnc.gcode.state.modal_groups import Code
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import AXES, LineWords, Word, fault
from cnc.model.blocks import PLANE_AXES, NurbsFeed, Plane

CUBIC, QUADRATIC = G.G5, G.G5_1

Vector = list[float]


def register(motion: Motion) -> None:
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
        knots = curves.bezier_knots(len(control) - 1)
        # Only inverse time needs the length.
        length = (
            curves.length(knots, points, weights)
            if self._state.feed_mode == "inverse-time"
            else 0.0
        )
        motion, here = self._motion, self._here
        feed = motion.feed(words, list(control[-1]), length, at)
        motion.spline(
            NurbsFeed(here.file, here.line, len(control) - 1, knots, points, weights, feed)
        )


def _plus(point: Vector, offset: Vector) -> Vector:
    return [a + b for a, b in zip(point, offset, strict=True)]
