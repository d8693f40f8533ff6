"""BSPLINE: a B-spline by its control points, in the words of Siemens' SINUMERIK 840D.

    BSPLINE SD=3        SD degree, 2 or 3, by default 3; the line may have the first of the points
    X Y Z PL=1 PW=1     a control point; PL interval length, PW weight, both by default 1
    X Y Z ..
    G1 ..               another motion code, another BSPLINE or the program end completes the curve

The first control point is the position before, with weight 1. The curve starts and ends in its
first and last control point, along the polygon: its knots are clamped. Source: SINUMERIK 840D sl,
Programming Manual Job Planning, "Spline interpolation (ASPLINE, BSPLINE, CSPLINE, BAUTO, BNAT,
BTAN, EAUTO, ENAT, ETAN, PW, SD, PL)": PL is the parameter interval length, the distance between two
knots.

A curve of degree p and n + 1 control points has n + 1 - p pieces, each controlled by p + 1
consecutive points. The manual does not say which line's PL belongs to which piece. Here it is the
piece that the line's point completes: PL = u(i+1) - u(i) for point i of the clamped knots u.
Differences of a CAM system's knots give the same. So the first p - 1 lines after the start complete
no piece: a PL there must be 0, or the one length of all the curve's PLs, when it makes no
difference. A later PL=0 makes a multiple knot.
"""

from __future__ import annotations

from cnc.gcode.codes.motion import Motion
from cnc.gcode.splines import knots
from cnc.gcode.splines.collecting import (
    PointCollector,
    ReadFeed,
    WordLocation,
    check_mode,
    leaving,
    weight_of,
)
from cnc.gcode.state.modal_groups import Code, Codes
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, not_negative, whole

DEFAULT_DEGREE = 3


def register(motion: Motion, read_feed: ReadFeed) -> None:
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
        self.make(knots.clamped(pieces, degree), self._feed)

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
