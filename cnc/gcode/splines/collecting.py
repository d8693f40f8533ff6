"""What the ways to write a NURBS over many lines share: points and weights so far, and what may not
stand inside.

A collector holds the lines between the code that opens a curve and the one that completes it;
``motion.collector`` is the one at work.
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
    """A word in a line that has gone by: an error may have to point back at it."""

    word: Word
    file: str
    line: int
    text_of: Callable[[int], str]

    @classmethod
    def of(cls, word: Word, here: SourceLocation) -> WordLocation:
        """A word of the line that is being executed."""
        return cls(word, here.file, here.line, here.text_of)

    def fault(self, code: str, message: str, hint: str = "") -> GcodeError:
        """An error at this word."""
        return self.put(fault(code, message, self.word, hint))

    def put(self, error: GcodeError) -> GcodeError:
        """The error, in this line."""
        return GcodeError(
            replace(error.diagnostic, file=self.file, line=self.line, text=self.text_of(self.line))
        )


class PointCollector:
    """Control points in machine coordinates and their weights, the first point being the position
    where the curve begins.

    ``name`` is the code that opens the curve and ``holds`` what its lines may hold, both as errors
    name them.
    """

    def __init__(
        self, name: str, holds: str, start: Word, motion: Motion, here: SourceLocation
    ) -> None:
        self.name = name
        self.holds = holds
        self.start = WordLocation.of(start, here)
        self.motion = motion
        self.here = here
        self.points = [motion.position]
        self.weights = [1.0]

    def company(self, words: LineWords) -> None:
        """Refuse what may not stand in the line that opens a curve: nothing but modes of the
        language goes with it.
        """
        strangers = [
            *words.m,
            *(word for word in words.g if _is_non_modal(word)),
        ]
        strangers += [words.users[letter][1] for letter in "ST" if letter in words.users]
        for word in strangers[:1]:
            message = f"{word.written} can't stand in the line of {self.name}"
            raise fault("nurbs-foreign-word", message, word, "write it on the line before")

    def axes(self, words: LineWords) -> list[Word]:
        """The axis words of a line from left to right: X, Y and Z alone move along a NURBS."""
        found = sorted(
            (word for word in words.rest.values() if word.letter in AXES),
            key=lambda word: word.column,
        )
        for word in found:
            if word.letter in _ROTARY:
                raise fault(
                    "nurbs-rotary-axis",
                    f"{word.written}: rotary axes can't move along a NURBS",
                    word,
                )
            if word.letter not in POINT_AXES:
                raise self.foreign(word)
        return found

    def no_codes(self, codes: Codes) -> None:
        """Refuse a code in a line inside the curve."""
        for code in codes.values():
            raise self.foreign(code.word)

    def no_words(self, words: LineWords) -> None:
        """Refuse whatever is left in a line inside the curve."""
        for word in words.rest.values():
            raise self.foreign(word)

    def foreign(self, word: Word) -> GcodeError:
        """The error for a word that may not stand inside the curve."""
        return fault(
            "nurbs-foreign-word",
            f"{word.written} can't stand inside {self.name}",
            word,
            f"its lines hold {self.holds} only",
        )

    def too_few(self, degree: int) -> str:
        """What is wrong with so few points."""
        return f"{len(self.points)} control points are too few: a curve of degree {degree} has {degree + 1} or more"

    def make(self, knots: NDArray[np.float64], feed: float) -> None:
        """The curve is complete: make the move."""
        degree = len(knots) - len(self.points) - 1
        points, weights = (
            np.array(self.points, dtype=np.float64),
            np.array(self.weights, dtype=np.float64),
        )
        self.motion.collector = None
        self.motion.spline(
            NurbsFeed(self.start.file, self.start.line, degree, knots, points, weights, feed)
        )


def weight_of(word: Word) -> float:
    """The weight of a control point."""
    if word.number <= 0:
        raise fault("nurbs-weight-not-positive", f"{word.written}: a weight must be positive", word)
    return word.number


def _is_non_modal(word: Word) -> bool:
    tenths = word.tenths
    return tenths is not None and GROUP_OF_G[G(tenths)] == "non-modal"


def leaving(codes: Codes) -> Code | None:
    """The code that would leave the curve: another motion, or the end of the program."""
    if code := codes.get("motion"):
        return code
    code = codes.get("stop")
    return code if code and code.number in _ENDS else None


def check_mode(
    state: ModalState, word: Word, code: str = "", *, inverse_time: bool = False
) -> None:
    """Refuse a spline under cutter compensation, and, unless ``inverse_time`` goes, under G93;
    ``code`` is that of both errors.
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
