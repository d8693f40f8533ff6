"""G5.2 to G5.3: a NURBS by its control points, with knots computed by the controller.

    G5.2 P1 L3     P weight of the first control point, the present position;
                   L order (degree + 1), by default 3
    X Y P          a control point and its weight, by default 1
    X Y P
    G5.3           the curve is complete

It is as in LinuxCNC ("G5.2 G5.3 NURBS Block"): if the G5.2 line has axis words they are the second
control point, and P is its weight; the knots are uniform and clamped, 0 .. 0 1 2 .. n .. n. Control
points are points in space: two of X Y Z or all three, the same in every line, whatever the plane.
Two details differ from LinuxCNC: a missing weight in the first line is 1, and words of another axis
are an error. Under G91 control points count from the start of the curve, as in LinuxCNC. One feed
holds for the whole curve: the last F before G5.3; under G93 that of the G5.2 line, for the whole
curve.
"""

from __future__ import annotations

import numpy as np

from cnc.gcode.codes.motion import Motion
from cnc.gcode.splines import knots as curves
from cnc.gcode.splines.collecting import (
    MAX_ORDER,
    PointCollector,
    ReadFeed,
    check_mode,
    leaving,
    weight_of,
)
from cnc.gcode.state.modal_groups import Code, Codes
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.kernels.gcode.rules import MIN_FEED

OPEN, CLOSE = G.G5_2, G.G5_3
DEFAULT_ORDER = 3


def register(motion: Motion, read_feed: ReadFeed) -> None:
    """Register the handlers of G5.2 and G5.3."""

    def begin(words: LineWords, code: Code | None) -> None:
        assert code is not None, "G5.2 is not in effect when its curve is complete"
        check_mode(motion.context.state, code.word, inverse_time=True)
        block = NurbsBlock(code.word, motion, read_feed)
        block.first(words)
        motion.collector = block

    def close(words: LineWords, code: Code | None) -> None:
        assert code is not None, "G5.3 is not in effect after its line"
        raise fault(
            "nurbs-not-open",
            f"{code.word.written} without a G5.2 before",
            code.word,
            "open the curve by G5.2",
        )

    motion.handlers[OPEN] = begin
    motion.handlers[CLOSE] = close


class NurbsBlock(PointCollector):
    """Collector of a curve between G5.2 and G5.3.

    ``first`` takes the G5.2 line and ``line`` each one after it.
    """

    takes_rotary = False

    def __init__(self, start: Word, motion: Motion, read_feed: ReadFeed) -> None:
        super().__init__("G5.2", "X, Y, Z, P and F", start, motion)
        self._state = motion.context.state
        self._read_feed = read_feed
        self._order = DEFAULT_ORDER
        self._named: frozenset[str] | None = None
        self._unit_feed: float | None = None

    def first(self, words: LineWords) -> None:
        """Take the words of the G5.2 line. Words without a use stay for the caller to refuse."""
        if size := words.take("L", "G5.2"):
            self._order = whole(size, "the order", 2, MAX_ORDER)
        weight = words.take("P", "G5.2")
        self.check_opening_line(words)
        if axes := self.axes(words):
            self._add_point(words, axes, weight)
        elif weight:
            self.weights[0] = weight_of(weight)
        if self._state.feed_mode == "inverse-time":
            self._unit_feed = self.motion.feed(words, self.motion.position, 1.0, self.start.word)

    def line(self, words: LineWords, codes: Codes) -> bool:
        """Take a line inside the curve and return True. G5.3 makes the curve."""
        code = codes.get("motion")
        if code and code.number == CLOSE:
            self._close(words, codes, code)
            return True
        if (code := leaving(codes)) and code.number != OPEN:
            message = f"{code.word.written} before the curve is complete"
            raise fault("nurbs-left-early", message, code.word, "the curve ends with G5.3")
        self.no_codes({group: other for group, other in codes.items() if group != "motion"})
        if self._unit_feed is None:
            self._read_feed(words, {})
        weight = words.take("P", "G5.2")
        if axes := self.axes(words):
            self._add_point(words, axes, weight)
        elif weight:
            raise fault(
                "nurbs-foreign-word",
                f"{weight.written} is a weight without a control point",
                weight,
            )
        self.no_words(words)
        return True

    def end(self, what: str) -> None:
        """Raise the error of a program end inside the curve, at the G5.2."""
        raise self.start.fault("nurbs-left-early", what, "the curve ends with G5.3")

    def _add_point(self, words: LineWords, axes: list[Word], weight: Word | None) -> None:
        letters = frozenset(word.letter for word in axes)
        if self._named is None:
            if len(letters) == 1:
                message = f"{axes[0].written} alone is not a control point"
                raise fault(
                    "nurbs-point-incomplete",
                    message,
                    axes[0],
                    "give two of X, Y and Z, or all three, in every line",
                )
            self._named = letters
        elif letters != self._named:
            names = " ".join(sorted(self._named))
            odd = next((word for word in axes if word.letter not in self._named), axes[0])
            raise fault(
                "nurbs-mixed-axes",
                f"the first control point has {names}, this one does not",
                odd,
                f"give {names} in every line",
            )
        seen_from = self.points[-1] if self._state.absolute else self.points[0]
        self.points.append(self.motion.target(words, "G5.2", seen_from))
        self.weights.append(weight_of(weight) if weight else 1.0)

    def _close(self, words: LineWords, codes: Codes, code: Code) -> None:
        self.no_codes({group: other for group, other in codes.items() if other is not code})
        self.no_words(words)
        degree = self._order - 1
        if len(self.points) < self._order:
            raise fault(
                "nurbs-too-few-points",
                self.too_few(degree),
                code.word,
                "the present position counts",
            )
        knots = curves.clamped_uniform(len(self.points), degree)
        if self._unit_feed is None:
            feed = self.motion.feed(words, self.points[-1], 0.0, code.word)
        else:
            length = curves.length(knots, np.array(self.points), np.array(self.weights))
            feed = self._unit_feed * (length or 1.0)
            if feed < MIN_FEED:
                raise self.start.fault(
                    "feed-too-slow", f"the feed of this curve is less than {MIN_FEED:g} mm/s"
                )
        self._state.motion = None
        self.make(knots, feed)
