"""Base of the collectors of curves that are written over many lines.

A collector takes the lines from the code that opens a curve to the one that completes it;
``motion.collector`` is the active one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.codes.motion import Motion
from cnc.gcode.state.modal_groups import GROUP_OF_G, Code, Codes, ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G, M
from cnc.gcode.syntax.words import AXES, LineWords, Word, fault
from cnc.model.blocks import NurbsFeed
from cnc.model.diagnostics import GcodeError

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
        found = sorted(
            (word for word in words.rest.values() if word.letter in AXES),
            key=lambda word: word.column,
        )
        for word in found:
            if word.letter in _ROTARY and not self.takes_rotary:
                raise fault(
                    "nurbs-rotary-axis",
                    f"{word.written}: rotary axes can't move along {self.name}",
                    word,
                )
            if word.letter not in POINT_AXES and word.letter not in _ROTARY:
                raise self.foreign(word)
        return found

    def directions(self, words: LineWords) -> list[Word]:
        """Return the words of the direction of the tool in a line."""
        return [words.rest[each] for each in self.motion.vector_letters if each in words.rest]

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
