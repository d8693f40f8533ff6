"""G6.2: a NURBS, written over many lines, collected into one block.

Two forms of the same thing, as data below:

    paper   G06.2 K3 U0 X Y Z W1 F / U X Y Z W / U         K degree, U knot, W weight
    fanuc   G06.2 P4 K0 X Y Z R1 F / K X Y Z R / K         P order, K knot, R weight

A line a control point, then as many lines with a knot alone as the order; points + order knots
complete the curve. FANUC's rules hold for both: the first control point is the present position,
both end knots have the multiplicity of the order, nothing but these words stands inside. In FANUC's
form the first line may leave out its point (the present position) and its knot (taken from the
second line). Control points are X Y Z whatever the plane, seen from the last one under G91. Source:
FANUC Series 15i/150i operator's manual, NURBS interpolation, and its alarms 1002 to 1009; ERRATA of
the NURBS look-ahead paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc.gcode.codes.motion import Motion
from cnc.gcode.dialects import Dialect
from cnc.gcode.splines.collecting import (
    MAX_ORDER,
    PointCollector,
    WordLocation,
    check_mode,
    leaving,
    weight_of,
)
from cnc.gcode.state.modal_groups import Code, Codes, ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.model.diagnostics import GcodeError

START_TOLERANCE = 1e-4
"""mm that the first control point may be off the present position: the rounding of a
post-processor. The curve starts at the position.
"""


@dataclass(frozen=True, slots=True)
class Form:
    """A way to write it: the letters, what ``size`` counts (the order, or the degree), and the
    codes of the errors that FANUC numbers.
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
    "fanuc",
    "P",
    True,
    "K",
    "R",
    True,
    "fanuc-1002",
    "fanuc-1004",
    "fanuc-1005",
    "fanuc-1006",
    "fanuc-1007",
    "fanuc-1008",
    "fanuc-1009",
)
PAPER = Form(
    "paper", "K", False, "U", "W", False,
    "nurbs-knot-missing", "nurbs-knots-too-few", "nurbs-left-early", "nurbs-wrong-mode",
    "nurbs-end-multiplicity", "nurbs-inner-multiplicity", "nurbs-start-point",
)  # fmt: skip
FORMS = {form.name: form for form in (PAPER, FANUC)}


def form_of(words: LineWords, allowed: tuple[str, ...]) -> tuple[Form, bool]:
    """Which form the first line is written in, and whether its words tell: U and W are the paper's,
    P and R are FANUC's.

    K alone tells nothing: it is the paper's degree, or FANUC's knot. FANUC's form may begin like
    that, the paper's may not.
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


def register(motion: Motion, dialect: Dialect, state: ModalState, here: SourceLocation) -> None:
    """Let ``motion`` make G6.2."""

    def begin(words: LineWords, code: Code | None) -> None:
        if code is None:
            word = words.first_axis()
            message = f"G6.2 is still in effect: {word.written} needs a new motion code"
            raise fault("nurbs-still-active", message, word, "give G0, G1, G2, G3 or another G6.2")
        form, told = form_of(words, dialect.nurbs)
        check_mode(state, code.word, form.wrong_mode)
        feed = motion.feed(words, motion.position, 0.0, code.word)
        curve = NurbsCollector(form, told, code.word, motion, here, feed)
        curve.first(words)
        motion.collector = curve

    motion.handlers[G.G6_2] = begin


class NurbsCollector(PointCollector):
    """A NURBS in the making. ``first`` takes the G6.2 line and ``line`` each one after it; ``told``
    is whether the form is beyond doubt.
    """

    def __init__(
        self, form: Form, told: bool, start: Word, motion: Motion, here: SourceLocation, feed: float
    ) -> None:
        super().__init__("G6.2", f"{form.knot}, X, Y, Z and {form.weight}", start, motion, here)
        self.form = form
        self._told = told
        self._feed = feed
        self._order = 4
        self._named: frozenset[str] | None = None
        self._knots: list[float] = []
        self._places: list[WordLocation] = []
        self._knot_lines = 0
        self._borrow_knot = False

    def first(self, words: LineWords) -> None:
        """The words of the G6.2 line itself; words of no use here stay for the caller to refuse."""
        form = self.form
        if size := words.take(form.size, "G6.2"):
            least, what = (2, "the order") if form.size_is_order else (1, "the degree")
            most = MAX_ORDER if form.size_is_order else MAX_ORDER - 1
            self._order = whole(size, what, least, most) + (0 if form.size_is_order else 1)
        knot = words.take(form.knot, "G6.2")
        weight = words.take(form.weight, "G6.2")
        self.company(words)
        axes = self._axes(words)
        if axes:
            here = self.points[0]
            point = self.motion.target(words, "G6.2", here)
            if max(abs(a - b) for a, b in zip(point, here, strict=True)) > START_TOLERANCE:
                raise fault(
                    form.start_point,
                    "the first control point is not the present position",
                    axes[0],
                    "move there before G6.2, or mend it",
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
        """A line inside the mode, which is always used up; the curve is made when it is
        complete.
        """
        if code := leaving(codes):
            raise self._left(f"{code.word.written} before the curve is complete", code.word)
        self.no_codes(codes)
        form = self.form
        self._tell(words)
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
        """The program ends inside the mode: an error, which points at the G6.2."""
        raise self.start.put(self._left(what, self.start.word))

    def _tell(self, words: LineWords) -> None:
        """The second line tells the form where the first one did not."""
        if self._told or not (words.rest.keys() & set("UWKR")):
            return
        self._told = True
        if words.rest.keys() & set("UW"):
            message = "the first knot is missing: in the paper's form G6.2 needs a U word, as its other lines have"
            raise self.start.fault(PAPER.knot_missing, message)

    def _axes(self, words: LineWords) -> list[Word]:
        """The axis words of a line; the first block with a point names the axes for all."""
        found = self.axes(words)
        for word in found:
            if self._named is not None and word.letter not in self._named:
                message = f"{word.letter} is not among the axes of the first control point"
                raise fault("nurbs-mixed-axes", message, word, "name all axes in the first one")
        return found

    def _add_point(
        self, words: LineWords, axes: list[Word], knot: Word | None, weight: Word | None
    ) -> None:
        form = self.form
        if self._knot_lines:
            raise fault(
                form.knots_too_few,
                f"a control point after {self._knot_lines} of {self._order} lines with a knot alone",
                axes[0],
                f"the curve ends with {self._order} lines with {form.knot} alone",
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
        """Both ends of multiplicity order, less inside: anything else leaves an end hanging or
        tears the curve apart.
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
                f"the first knot stands {_often(first[1])}",
                f"it must stand {_often(order)}: the order",
            )
        if last[1] - last[0] != order:
            count = last[1] - last[0]
            place = (
                self._places[len(self._knots) - order] if count < order else self._places[last[0]]
            )
            raise place.fault(
                form.end_multiplicity,
                f"the last knot stands {_often(count)}",
                f"it must stand {_often(order)}: the order",
            )
        for begin, end in runs[1:-1]:
            if end - begin > order:
                raise self._places[begin + order].fault(
                    form.inner_multiplicity,
                    f"an inner knot stands {_often(end - begin)}",
                    f"at most {_often(order - 1)}: the order less one",
                )
            if end - begin == order:
                raise self._places[end - 1].fault(
                    "nurbs-position-jump",
                    f"an inner knot that stands {_often(order)} tears the curve apart",
                    f"at most {_often(order - 1)}: the order less one",
                )

    def _left(self, what: str, word: Word) -> GcodeError:
        """The curve is left before it is complete."""
        form, need = self.form, self._order
        hint = f"the curve ends with {need} lines with {form.knot} alone"
        if self._knot_lines:
            return fault(
                form.knots_too_few,
                f"{what}: {self._knot_lines} of {need} lines with a knot alone",
                word,
                hint,
            )
        return fault(form.left_early, f"{what}: no line with a knot alone yet", word, hint)


def _often(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")
