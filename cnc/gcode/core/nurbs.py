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

from dataclasses import dataclass

import numpy as np

from cnc.gcode.core import splines as curves
from cnc.gcode.core.modal_groups import Code, Codes
from cnc.gcode.core.motion import Motion
from cnc.gcode.core.splines import (
    MAX_ORDER,
    PointCollector,
    ReadFeed,
    WordLocation,
    check_mode,
    leaving,
    weight_of,
)
from cnc.gcode.kernels.rules import MIN_FEED
from cnc.gcode.reader.words import G, LineWords, Word, fault, whole
from cnc.model.diagnostics import GcodeError

OPEN, CLOSE = G.G5_2, G.G5_3
DEFAULT_ORDER = 3


def register_g5_2(motion: Motion, read_feed: ReadFeed) -> None:
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
        self._context = motion.context
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
        if self._context.state.feed_mode == "inverse-time":
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
        seen_from = self.points[-1] if self._context.state.absolute else self.points[0]
        self.points.append(self.motion.target(words, "G5.2", seen_from))
        self.weights.append(weight_of(weight) if weight else 1.0)

    def _close(self, words: LineWords, codes: Codes, code: Code) -> None:
        self.no_codes({group: given for group, given in codes.items() if given is not code})
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
            length = curves.curve_length(knots, np.array(self.points), np.array(self.weights))
            feed = self._unit_feed * (length or 1.0)
            if feed < MIN_FEED:
                raise self.start.fault(
                    "feed-too-slow", f"the feed of this curve is less than {MIN_FEED:g} mm/s"
                )
        self._context.state.motion = None
        self.make(knots, feed)


# G6.2: a NURBS over many lines, collected into one block.
#
# It has two forms:
#
#     paper   G06.2 K3 U0 X Y Z W1 F / U X Y Z W / U         K degree, U knot, W weight
#     fanuc   G06.2 P4 K0 X Y Z R1 F / K X Y Z R / K         P order, K knot, R weight
#
# Each line is a control point; then as many lines as the order have a knot alone. points + order
# knots complete the curve. FANUC's rules hold for both forms: the first control point is the
# present position, both end knots have the multiplicity of the order, and no other words are
# allowed inside. In FANUC's form the first line may lack its point (the present position) and its
# knot (that of the second line). Control points are X Y Z whatever the plane; under G91 each counts
# from the last one. Source: FANUC Series 15i/150i operator's manual, NURBS interpolation, and its
# alarms 1002 to 1009; ERRATA of the NURBS look-ahead paper.

START_TOLERANCE = 1e-4
"""mm.

Largest distance of the first control point from the present position: the rounding of a
post-processor. The curve starts at the position.
"""


@dataclass(frozen=True, slots=True)
class Form:
    """A form of G6.2.

    Attributes:
        size: Letter of the order or the degree.
        size_is_order: Whether it is the order.
        knot: Letter of the knot.
        weight: Letter of the weight.
        short_start: Whether the first line may lack its point and its knot.
        knot_missing: Code of an error that FANUC numbers, as are the following.
    """

    name: str
    size: str
    size_is_order: bool
    knot: str
    weight: str
    short_start: bool
    knot_missing: str
    knots_too_few: str
    left_early: str
    wrong_mode: str
    end_multiplicity: str
    inner_multiplicity: str
    start_point: str


FANUC = Form(
    "fanuc", "P", True, "K", "R", True,
    "fanuc-1002", "fanuc-1004", "fanuc-1005", "fanuc-1006", "fanuc-1007", "fanuc-1008",
    "fanuc-1009",
)  # fmt: skip
PAPER = Form(
    "paper", "K", False, "U", "W", False,
    "nurbs-knot-missing", "nurbs-knots-too-few", "nurbs-left-early", "nurbs-wrong-mode",
    "nurbs-end-multiplicity", "nurbs-inner-multiplicity", "nurbs-start-point",
)  # fmt: skip
FORMS = {form.name: form for form in (PAPER, FANUC)}


def form_of(words: LineWords, allowed: tuple[str, ...]) -> tuple[Form, bool]:
    """Return the form of the first line, and whether its words identify it.

    U and W are the paper's, P and R are FANUC's. K alone identifies neither: it is the paper's
    degree, or FANUC's knot. FANUC's form may start with K alone, the paper's may not.
    """
    if len(allowed) == 1:
        return FORMS[allowed[0]], True
    paper = [words.rest[letter] for letter in "UW" if letter in words.rest]
    fanuc = [words.rest[letter] for letter in "PR" if letter in words.rest]
    if paper and fanuc:
        odd = max(paper[0], fanuc[0], key=lambda word: word.column)
        raise fault(
            "nurbs-mixed-forms",
            "G6.2 with words of both forms",
            odd,
            "K U W are the paper's form, P K R are FANUC's",
        )
    return PAPER if paper else FANUC, bool(paper or fanuc)


def register_g6_2(motion: Motion) -> None:
    """Register the handler of G6.2."""

    def begin(words: LineWords, code: Code | None) -> None:
        if code is None:
            word = words.first_axis()
            message = f"G6.2 is still in effect: {word.written} needs a new motion code"
            raise fault("nurbs-still-active", message, word, "give G0, G1, G2, G3 or another G6.2")
        form, identified = form_of(words, motion.context.dialect.nurbs)
        check_mode(motion.context.state, code.word, form.wrong_mode)
        feed = motion.feed(words, motion.position, 0.0, code.word)
        curve = NurbsCollector(form, identified, code.word, motion, feed)
        curve.first(words)
        motion.collector = curve

    motion.handlers[G.G6_2] = begin


class NurbsCollector(PointCollector):
    """Collector of a G6.2.

    ``first`` takes the G6.2 line and ``line`` each one after it. ``identified``: the form is known.
    """

    def __init__(
        self,
        form: Form,
        identified: bool,
        start: Word,
        motion: Motion,
        feed: float,
    ) -> None:
        super().__init__("G6.2", f"{form.knot}, X, Y, Z and {form.weight}", start, motion)
        self.form = form
        self._identified = identified
        self._feed = feed
        self._order = 4
        self._named: frozenset[str] | None = None
        self._knots: list[float] = []
        self._places: list[WordLocation] = []
        self._knot_lines = 0
        self._borrow_knot = False

    def first(self, words: LineWords) -> None:
        """Take the words of the G6.2 line. Words without a use stay for the caller to refuse."""
        form = self.form
        if size := words.take(form.size, "G6.2"):
            least, what = (2, "the order") if form.size_is_order else (1, "the degree")
            most = MAX_ORDER if form.size_is_order else MAX_ORDER - 1
            self._order = whole(size, what, least, most) + (0 if form.size_is_order else 1)
        knot = words.take(form.knot, "G6.2")
        weight = words.take(form.weight, "G6.2")
        self.check_opening_line(words)
        axes = self._axes(words)
        if axes:
            here = self.points[0]
            point = self.motion.target(words, "G6.2", here)
            if max(abs(a - b) for a, b in zip(point, here, strict=True)) > START_TOLERANCE:
                raise fault(
                    form.start_point,
                    "the first control point is not the present position",
                    axes[0],
                    "move there before G6.2, or correct the point",
                )
            self._named = frozenset(word.letter for word in axes)
        elif not form.short_start:
            raise fault(
                "nurbs-point-missing",
                "the first control point is missing",
                self.start.word,
                "give X Y Z of the present position",
            )
        if weight:
            self.weights[0] = weight_of(weight)
        if knot:
            self._add_knot(knot)
        elif form.short_start:
            self._borrow_knot = True
        else:
            raise fault(
                form.knot_missing,
                f"the first knot is missing: G6.2 needs a {form.knot} word",
                self.start.word,
            )

    def line(self, words: LineWords, codes: Codes) -> bool:
        """Take a line inside the curve and return True. The last one makes the curve."""
        if code := leaving(codes):
            raise self._left(f"{code.word.written} before the curve is complete", code.word)
        self.no_codes(codes)
        form = self.form
        self._check_form(words)
        knot = words.take(form.knot, "G6.2")
        weight = words.take(form.weight, "G6.2")
        axes = self._axes(words)
        self.no_words(
            LineWords(
                rest={letter: word for letter, word in words.rest.items() if word not in axes}
            )
        )
        if axes:
            self._add_point(words, axes, knot, weight)
        elif weight:
            raise fault(
                "nurbs-foreign-word",
                f"{weight.written} is a weight without a control point",
                weight,
            )
        elif knot:
            self._knot_only(knot)
        return True

    def end(self, what: str) -> None:
        """Raise the error of a program end inside the curve, at the G6.2."""
        raise self.start.put(self._left(what, self.start.word))

    def _check_form(self, words: LineWords) -> None:
        """Check the form by the second line, if the first one does not identify it."""
        if self._identified or not (words.rest.keys() & set("UWKR")):
            return
        self._identified = True
        if words.rest.keys() & set("UW"):
            message = "the first knot is missing: in the paper's form G6.2 needs a U word"
            raise self.start.fault(PAPER.knot_missing, message)

    def _axes(self, words: LineWords) -> list[Word]:
        """The axis words of a line. The first line with a point sets the axes of all."""
        axes = self.axes(words)
        for word in axes:
            if self._named is not None and word.letter not in self._named:
                message = f"{word.letter} is not among the axes of the first control point"
                raise fault("nurbs-mixed-axes", message, word, "name all axes in the first one")
        return axes

    def _add_point(
        self, words: LineWords, axes: list[Word], knot: Word | None, weight: Word | None
    ) -> None:
        form = self.form
        if self._knot_lines:
            raise fault(
                form.knots_too_few,
                f"a control point after {self._knot_lines} of {self._order} lines with only a knot",
                axes[0],
                f"the curve ends with {self._order} lines with only {form.knot}",
            )
        if not knot:
            raise fault(
                form.knot_missing, f"this control point has no knot ({form.knot} word)", axes[0]
            )
        if self._borrow_knot:
            self._borrow_knot = False
            self._add_knot(knot)
        self._add_knot(knot)
        self.weights.append(weight_of(weight) if weight else 1.0)
        if self._named is None:
            self._named = frozenset(word.letter for word in axes)
        self.points.append(self.motion.target(words, "G6.2", self.points[-1]))

    def _knot_only(self, knot: Word) -> None:
        if len(self.points) == 1:
            raise fault(
                "nurbs-one-point",
                "a NURBS with one control point only",
                knot,
                "give at least as many as the order",
            )
        if len(self.points) < self._order:
            raise fault("nurbs-too-few-points", self.too_few(self._order - 1), knot)
        self._add_knot(knot)
        self._knot_lines += 1
        if self._knot_lines == self._order:
            self._check_multiplicities()
            self.make(np.array(self._knots, dtype=np.float64), self._feed)

    def _add_knot(self, knot: Word) -> None:
        if self._knots and knot.number < self._knots[-1]:
            raise fault(
                "nurbs-knots-decrease",
                f"knot {knot.number:g} after knot {self._knots[-1]:g}",
                knot,
                "knots must not decrease",
            )
        self._knots.append(knot.number)
        self._places.append(WordLocation.of(knot, self.here))

    def _check_multiplicities(self) -> None:
        """Check the knots: multiplicity order at both ends, less inside.

        Otherwise an end is open or the curve is discontinuous.
        """
        order, form = self._order, self.form
        starts = [
            index
            for index, knot in enumerate(self._knots)
            if index == 0 or knot != self._knots[index - 1]
        ]
        runs = list(zip(starts, [*starts[1:], len(self._knots)], strict=True))
        first, last = runs[0], runs[-1]
        if first[1] != order:
            raise self._places[min(first[1], order)].fault(
                form.end_multiplicity,
                f"the first knot occurs {_often(first[1])}",
                f"it must occur {_often(order)}: the order",
            )
        if last[1] - last[0] != order:
            count = last[1] - last[0]
            place = (
                self._places[len(self._knots) - order] if count < order else self._places[last[0]]
            )
            raise place.fault(
                form.end_multiplicity,
                f"the last knot occurs {_often(count)}",
                f"it must occur {_often(order)}: the order",
            )
        for begin, end in runs[1:-1]:
            if end - begin > order:
                raise self._places[begin + order].fault(
                    form.inner_multiplicity,
                    f"an inner knot occurs {_often(end - begin)}",
                    f"at most {_often(order - 1)}: the order less one",
                )
            if end - begin == order:
                raise self._places[end - 1].fault(
                    "nurbs-position-jump",
                    f"an inner knot that occurs {_often(order)} makes the curve discontinuous",
                    f"at most {_often(order - 1)}: the order less one",
                )

    def _left(self, what: str, word: Word) -> GcodeError:
        """The error of a curve that is left before it is complete."""
        form, need = self.form, self._order
        hint = f"the curve ends with {need} lines with only {form.knot}"
        if self._knot_lines:
            return fault(
                form.knots_too_few,
                f"{what}: {self._knot_lines} of {need} lines with only a knot",
                word,
                hint,
            )
        return fault(form.left_early, f"{what}: no line with only a knot yet", word, hint)


def _often(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")
