"""Canned cycles for holes (G73, G74, G81 to G89, FANUC's G76): words of a line to steps.

The rules of their steps are in :mod:`cnc.gcode.kernels.cycles`.

Consecutive lines with cycles are a series. It starts at a line after another motion code, or none,
and G98 returns to the level at its start. Within a series, the words that a cycle needs except X, Y
and the repeats stay in effect: in LinuxCNC for the same cycle, in FANUC's dialect for all cycles.
The words are kept as written, and read again under the units and the distance mode of each line.
Under G91 R counts from the level at the start of the series and the depth from R; X and Y are
increments, one for each repeat.

Sources: LinuxCNC 2.9, "G-codes", G80-G89; FANUC Series 0i operator's manual, "canned cycle for
drilling".
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from cnc.compiled.jit import interpreted
from cnc.gcode.core.context import Context
from cnc.gcode.core.cycle_runner import (
    CyclePlane,
    CycleRunner,
    holes_in_polar_mode,
    holes_on_circle,
    holes_on_line,
    refuse_axes,
    refuse_modes,
    steps,
)
from cnc.gcode.core.machine_codes import Dwells
from cnc.gcode.core.modal_groups import Code, ModalState, Turning
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.kernels import cycles as kernel
from cnc.gcode.kernels.cycles import Hole, HoleSettings
from cnc.gcode.reader.words import G, LineWords, Word, fault, positive, whole
from cnc.model.blocks import Plane
from cnc.model.diagnostics import GcodeError

# Words of Fagor's cycles for holes: Z is the level R, I the bottom, K the dwell.
#
# In G83 I is a peck with its sign, and J the number of pecks. Source: Autodesk, post "FAGOR
# 8037/8055", its cycles.

FAGOR_MOST_PECKS = 10_000
"""Most pecks of a hole."""


Make = Callable[[LineWords, Code | None], None]
"""A function that makes the holes of a line."""


def with_own_words(make: Make, context: Context) -> Make:
    """Return the function with the words of a line as Fagor's controls have them."""

    def make_own(words: LineWords, code: Code | None) -> None:
        state = context.state
        cycle, at = state.motion, code.word if code else words.first()
        assert cycle is not None
        _take_plane_and_depth(words, state, cycle, at)
        try:
            make(words, code)
        except GcodeError as error:
            if error.diagnostic.code != "cycle-word-missing":
                raise
            message = f"{cycle.written} needs Z, the level, and I, the bottom"
            raise fault("cycle-word-missing", message, at, "give both in its first line") from None

    return make_own


def _take_plane_and_depth(words: LineWords, state: ModalState, cycle: G, at: Word) -> None:
    """Give the words of a cycle the letters that the other controls have: R, Z, P and Q.

    Raises:
        GcodeError: ``cycle-plane``, ``cycle-distance-mode``, ``cycle-word-missing``,
            ``value-out-of-range``, ``word-unused``.
    """
    rest = words.rest
    for letter in "RPQ":
        if word := rest.get(letter):
            message = f"{word.written} is no word of {cycle.written} on Fagor's controls"
            raise fault("word-unused", message, word, "Z is the level, I the bottom, K the dwell")
    if state.plane != "XY":
        message = f"{cycle.written} is supported in the plane G17 only"
        raise fault("cycle-plane", message, at, "give G17 before")
    if not state.absolute:
        message = f"{cycle.written} under G91 is not supported"
        raise fault("cycle-distance-mode", message, at, "give G90 before")
    depth, level = rest.pop("I", None), rest.pop("Z", None)
    if "K" in rest:
        rest["P"] = rest.pop("K")
    if level is not None:
        rest["R"] = level
    if cycle != G.G83:
        if depth is not None:
            rest["Z"] = depth
        return
    count = rest.pop("J", None)
    if level is None and depth is None and count is None:
        return
    if level is None or depth is None or count is None:
        message = f"{cycle.written} needs Z, I and J together"
        raise fault("cycle-word-missing", message, at, "give the level, a peck, their number")
    pecks = whole(count, "the number of pecks", 1, FAGOR_MOST_PECKS)
    rest["Z"] = replace(depth, number=level.number + depth.number * pecks)
    rest["Q"] = replace(depth, number=-depth.number)


FINE_BORING = G.G76
TAPS: dict[G, Turning] = {G.G74: "ccw", G.G84: "cw"}
PECKING = tuple(G(10 * number) for number in kernel.PECKING)
DWELLING = tuple(G(10 * number) for number in kernel.DWELLING)
NEEDS_SPINDLE = (G.G74, FINE_BORING, G.G84, G.G86, G.G88)
DRILLING = (
    G.G73, G.G74, G.G81, G.G82, G.G83, G.G84, G.G85, G.G86, G.G88, G.G89,
)  # fmt: skip

MOST_REPEATS = 10_000
_series_at, _heights_of = interpreted(kernel.series_at), interpreted(kernel.heights_of)
_NEAR = 1e-9
"""Distance of two equal places, mm."""
MOST_PECKS = 100_000
"""Most feed moves of one line. More are a typing error in Q or L."""


@dataclass(slots=True)
class Series:
    """Consecutive cycles: the cycle, its plane, the position at the start, the words in effect.

    ``absolute`` has the distance mode of the line that gave each word.
    """

    cycle: G
    plane: Plane
    start: list[float]
    words: dict[str, Word] = field(default_factory=dict)
    absolute: dict[str, bool] = field(default_factory=dict)


def register(motion: Motion, performer: CycleRunner, dwells: Dwells) -> DrillingCycles:
    """Register the canned cycles of the dialect as handlers, and return them."""
    cycles, dialect = DrillingCycles(motion, performer, dwells), motion.context.dialect
    own = dialect.cycles.plane_and_depth
    make = with_own_words(cycles.make, motion.context) if own else cycles.make
    motion.handlers |= dict.fromkeys(cycles.cycles, make)
    if dialect.cycles.words_stay:
        motion.repeat_words |= dict.fromkeys(cycles.cycles, frozenset("R"))
    return cycles


class DrillingCycles(MotionCodes):
    """Execution of the canned cycles for holes.

    Attributes:
        cycles: The cycles of the dialect.
        series: The last series; None before the first.
    """

    def __init__(self, motion: Motion, performer: CycleRunner, dwells: Dwells) -> None:
        super().__init__(motion)
        dialect = self._dialect
        self.cycles = frozenset(DRILLING) | (
            {FINE_BORING} if dialect.cycles.fine_boring else frozenset()
        )
        self._rules = dialect.cycles
        self._turns = dialect.cycles.turns and not dialect.turning.lathe
        self._performer = performer
        self._dwells = dwells
        self.series: Series | None = None

    def make(self, words: LineWords, code: Code | None) -> None:
        """Execute a line of the cycle in effect; ``code`` is that of the line, if it has one."""
        motion, state = self._motion, self._state
        cycle = state.motion
        assert cycle is not None
        name = cycle.written
        at = code.word if code else words.first()
        refuse_modes(motion, state, name, at)
        if not words.has_axis() and not (self._rules.words_stay and "R" in words.rest):
            raise fault(
                "axis-words-missing",
                f"{name} needs axis words",
                at,
                "give the place of the hole, such as X10 Y20",
            )
        refuse_axes(words, name, "XYZABC" if self._turns else "XYZ")
        plane = CyclePlane(motion, state)
        plane.needs("XYZ" if cycle == FINE_BORING else plane.across, name, at)
        _check_transform(motion, plane, cycle, at)
        motion.take_length_change(at, absolute=state.absolute, moves=False)
        series = self._series_of(cycle)
        depth = self._word(words, series, plane.across, name, at)
        retract = self._retract(words, series, plane, name, at)
        settings = self._settings(words, series, cycle, name, at)
        repeats = self._repeats(words, name)
        polar = motion.polar_steps(words, name)
        given = motion.axis_values(words, name)
        self._check_distance(series, (depth, retract), name, at)
        heights = self._heights(plane, series, depth, retract, at)
        top, bottom, _ = heights
        if top < bottom:
            message = f"R is at {top:g} mm, below the bottom of the hole at {bottom:g} mm"
            raise fault(
                "cycle-retract-below-bottom",
                message,
                _of_line(words, "R", at),
                _downwards(name, plane.across, at),
            )
        smallest = settings.least or settings.peck
        if settings.peck and repeats * (top - bottom) > MOST_PECKS * smallest:
            message = f"this line makes more than {MOST_PECKS} pecks"
            raise fault("cycle-too-long", message, _of_line(words, "Q", at), "give a larger Q")
        if polar is not None:
            holes = holes_on_circle(plane, polar, heights, repeats)
        elif motion.in_polar_mode(given) and not state.absolute:
            holes = holes_in_polar_mode(plane, motion.polar, given, heights, repeats)
        else:
            holes = holes_on_line(plane, given, heights, repeats, absolute=state.absolute)
        end = plane.place((*plane.start[:2], bottom))
        settings = settings._replace(feed=motion.feed(words, end, 0.0, at))
        self.series = series
        if not repeats:
            self._refuse_place(plane, given, name, at)
            return
        turned = {column: given[column] for column in motion.rotary_columns if column in given}
        turning = state.turning
        if not turned:
            self._performer.perform(steps(cycle, plane.start, holes, settings, turning), plane)
            return
        for hole in holes:
            self._turn(turned, hole)
            plane = CyclePlane(motion, state)
            self._performer.perform(steps(cycle, plane.start, [hole], settings, turning), plane)

    def _refuse_place(
        self, plane: CyclePlane, given: dict[int, float], name: str, at: Word
    ) -> None:
        """Refuse another place in a line without a hole: controllers differ on the move to it."""
        for here, value in zip(plane.start[:2], plane.in_plane(given), strict=True):
            if value is not None and abs(value - (here if self._state.absolute else 0.0)) > _NEAR:
                message = (
                    f"{name} with 0 repeats has another place than the position: controllers "
                    "differ on whether the tool goes there"
                )
                hint = "leave out the place, or go there before with G0"
                raise fault("axis-words-unused", message, at, hint)

    def _turn(self, values: dict[int, float], hole: Hole) -> None:
        """Go to the place of a hole, and turn the rotary axes, at R or at a greater height.

        The values are degrees by column.
        """
        motion = self._motion
        turned = motion.reached(values, motion.position)
        plane = CyclePlane(motion, self._state)
        height = max(plane.start[2], hole.retract)
        if height > plane.start[2]:
            motion.traverse(plane.place((*plane.start[:2], height)))
        end = plane.place((hole.first, hole.second, height))
        for column in values:
            end[column] = turned[column]
        motion.traverse(end)

    def _series_of(self, cycle: G) -> Series:
        """The series that this line continues, or a new one."""
        state, series, before = self._state, self.series, self._motion.motion_before
        kind = kernel.NEW
        if series is not None:
            kind = _series_at(
                before in self.cycles, series.plane == state.plane, cycle == series.cycle,
                self._rules.words_stay,
            )  # fmt: skip
        if series is None or kind == kernel.NEW:
            return Series(cycle, state.plane, self._motion.position)
        if kind == kernel.BEGUN_AGAIN:
            return Series(cycle, series.plane, series.start)
        words, absolute = series.words.copy(), series.absolute.copy()
        return Series(cycle, series.plane, series.start, words, absolute)

    def _word(self, words: LineWords, series: Series, letter: str, name: str, at: Word) -> Word:
        """A word that the cycle needs, of this line or of one before."""
        word = self._staying(words, series, letter, name)
        if word is None:
            hint = f"give {letter} in the first line of {name}"
            if letter == "R":
                hint += "; a Haas control begins at the position: --dialect haas"
            raise fault("cycle-word-missing", f"{name} needs {letter}", at, hint)
        return word

    def _retract(
        self, words: LineWords, series: Series, plane: CyclePlane, name: str, at: Word
    ) -> Word:
        """Return the R word. Without one, where R is optional, it is the level, with a warning."""
        missing = "R" not in words.rest and "R" not in series.words
        if missing and self._rules.retract_optional:
            level = plane.seen(self._motion.coordinates.to_program(series.start))[2]
            message = (
                f"{name} without R: the hole begins at the level of the position, {level:g} mm"
            )
            self._here.report_warning("cycle-level-assumed", message, at, "give R")
            height = level / self._motion.scales[self._motion.column[plane.across]]
            series.words["R"] = Word("R", height, "R", at.column, at.length)
            series.absolute["R"] = True
        return self._word(words, series, "R", name, at)

    def _staying(self, words: LineWords, series: Series, letter: str, name: str) -> Word | None:
        if word := words.take(letter, name):
            series.words[letter], series.absolute[letter] = word, self._state.absolute
        return series.words.get(letter)

    def _settings(
        self, words: LineWords, series: Series, cycle: G, name: str, at: Word
    ) -> HoleSettings:
        """The settings from Q, P and the spindle, without the feed."""
        state, rules = self._state, self._rules
        dwell = peck = less = least = 0.0
        if cycle in PECKING and self._shrinking(words, series):
            peck, less, least = self._shrinking_pecks(words, series, name, at)
        elif cycle in PECKING or cycle == FINE_BORING:
            word = self._word(words, series, "Q", name, at)
            what = "the shift" if cycle == FINE_BORING else "a peck"
            peck = positive(word, what) * state.scale
        pauses = (cycle in PECKING and rules.peck_dwell) or (
            rules.plane_and_depth and cycle != G.G85
        )
        if cycle in DWELLING or cycle == FINE_BORING or pauses:
            optional = not rules.dwell_needed or cycle in TAPS
            letters = (
                self._staying(words, series, "P", name)
                if optional
                else self._word(words, series, "P", name, at)
            )
            dwell = self._dwells.seconds(letters) if letters else 0.0
        elif rules.idle_dwell and "P" in words.rest:
            self._keep_dwell(words, series, name)
        if cycle in NEEDS_SPINDLE:
            self._check_spindle(cycle, name, at)
        return HoleSettings(
            feed=0.0,
            dwell=dwell,
            peck=peck if cycle in PECKING else 0.0,
            less=less,
            least=least,
            clearance=rules.clearance,
            shift=peck,
            out_to_retract=rules.feed_out_to == "retract",
            dwells_twice=rules.tap_dwell == "before-each",
        )

    def _keep_dwell(self, words: LineWords, series: Series, name: str) -> None:
        """Keep a P for later cycles of the series, in a cycle that has no dwell."""
        word = words.rest["P"]
        self._staying(words, series, "P", name)
        message = f"{word.written} has no effect in {name}; it stays for later cycles"
        self._here.report_warning("word-idle", message, word, "remove it, or give G82")

    def _shrinking(self, words: LineWords, series: Series) -> bool:
        """Whether pecks have I, J and K (Haas), and not Q. The later of both is in effect."""
        if not self._rules.pecks_shrink:
            return False
        if "I" in words.rest:
            series.words.pop("Q", None)
        elif "Q" in words.rest:
            for letter in "IJK":
                series.words.pop(letter, None)
        return "I" in words.rest or "I" in series.words

    def _shrinking_pecks(
        self, words: LineWords, series: Series, name: str, at: Word
    ) -> tuple[float, float, float]:
        """Take I, J and K: the first peck, the decrease, and the smallest one, mm."""
        pecks = [self._word(words, series, letter, name, at) for letter in "IJK"]
        first, less, least = (word.number * self._state.scale for word in pecks)
        if first <= 0.0 or less < 0.0 or not 0.0 < least <= first:
            message = f"{name}: I and K must be more than 0, K not more than I, and J not negative"
            raise fault("value-out-of-range", message, pecks[0])
        return first, less, least

    def _check_spindle(self, cycle: G, name: str, at: Word) -> None:
        state = self._state
        needed = TAPS.get(cycle)
        if needed and state.spindle == "off" and state.speed and self._rules.starts_spindle:
            if self._rules.starts_spindle == "unclear":
                message = f"{name} starts the spindle itself, which only rigid tapping does"
                hint = f"give M{3 if needed == 'cw' else 4} before if the control needs it"
                self._here.report_warning("spindle-started", message, at, hint)
            state.spindle = needed
            self._performer.start_spindle()
        start = "S and M4" if needed == "ccw" else "S and M3"
        self.context.spindle_speed(name, at, start=start)
        if needed and state.spindle != needed:
            direction = "anticlockwise" if needed == "ccw" else "clockwise"
            hand = "left" if needed == "ccw" else "right"
            message = f"{name} cuts a {hand}-hand thread: the spindle must turn {direction}"
            hint = f"give {start} before, or {'G84' if needed == 'ccw' else 'G74'}"
            raise fault("spindle-direction", message, at, hint)

    def _repeats(self, words: LineWords, name: str) -> int:
        given = [word for letter in self._rules.repeats if (word := words.take(letter, name))]
        if len(given) > 1:
            later = max(given, key=lambda word: word.column)
            raise fault(
                "word-wanted-twice",
                f"{name} takes {' or '.join(self._rules.repeats)}, not both",
                later,
            )
        least = 0 if self._rules.no_hole else 1
        return whole(given[0], "the repeats", least, MOST_REPEATS) if given else 1

    def _check_distance(
        self, series: Series, heights: tuple[Word, Word], name: str, at: Word
    ) -> None:
        """Refuse heights of a line with another distance mode, where controllers differ."""
        if self._rules.heights != "unclear":
            return
        for word in heights:
            if series.absolute[word.letter] != self._state.absolute:
                before, now = ("G90", "G91") if series.absolute[word.letter] else ("G91", "G90")
                message = (
                    f"{name} under {now} with {word.written} of a line under {before}: FANUC and "
                    "Haas keep that height, LinuxCNC counts it again"
                )
                hint = "give R and the depth in this line, or name the --dialect"
                raise fault("cycle-distance-mode", message, at, hint)

    def _check_level(self, top: float, clear: float, at: Word) -> None:
        """Warn once of a level between the holes that the dialects read differently, mm."""
        if self._state.initial_level != "unclear" or clear == top:
            return
        self._state.initial_level = True
        message = (
            f"without G98 and G99 the tool goes up to {clear:g} mm between the holes, as on FANUC "
            f"and Haas; LinuxCNC and Mach3 go to R, {top:g} mm"
        )
        self._here.report_warning("cycle-level-unclear", message, at, "give G98 or G99")

    def _heights(
        self, plane: CyclePlane, series: Series, depth: Word, retract: Word, at: Word
    ) -> tuple[float, float, float]:
        """Heights of R, of the bottom, and of the end of the cycle, mm; ``at`` is for a warning."""
        state, motion = self._state, self._motion
        scale = motion.scales[motion.column[plane.across]]
        level = plane.seen(motion.coordinates.to_program(series.start))[2]
        kept = self._rules.heights == "kept"
        r, z = series.absolute["R"], series.absolute[plane.across]
        top, bottom, clear = _heights_of(
            retract.number * scale, depth.number * scale, level, r if kept else state.absolute,
            z if kept else state.absolute, bool(state.initial_level),
        )  # fmt: skip
        self._check_level(top, clear, at)
        return top, bottom, clear


def _check_transform(motion: Motion, plane: CyclePlane, cycle: G, at: Word) -> None:
    """Refuse what controllers do not apply to heights, or to the side of fine boring."""
    transform, across = motion.coordinates.transform, plane.columns[2]
    if across is not None and transform.factors[across] != 1.0:
        message = f"{cycle.written} under G51 with another factor than 1 along {plane.across}"
        raise fault("scaling-cycle", message, at, "give G50 before, or I1. J1. K1.")
    turns = transform.plane is not None and transform.angle % 360.0 != 0.0
    if cycle == FINE_BORING and (turns or any(factor != 1.0 for factor in transform.factors)):
        message = (
            f"{cycle.written} under a rotation, scaling or mirror, which the tool does not follow"
        )
        raise fault("scaling-cycle", message, at, "give G69, G50 or G50.1 before, or G86")


def _downwards(name: str, across: str, at: Word) -> str:
    """Return the hint for R below the bottom; a cycle of an earlier line is not ``at`` itself."""
    hint = f"{name} goes from R down to {across}"
    return hint if at.letter == "G" else f"{hint}; it is still in effect, and G80 ends it"


def _of_line(words: LineWords, letter: str, at: Word) -> Word:
    """A word of this line; ``at`` if it is in effect from a line before."""
    return words.users[letter][1] if letter in words.users else at


# Patterns of holes for the canned cycle in effect: G70 and G71 of Haas mills.
#
# The position is the centre of the circle: I radius, J first angle, K angle between holes (G71), L
# holes. Angles count from X, anticlockwise. Source: Haas, "Mill Operator's Manual", G70 and G71.

_LETTERS = {G.G70: "IJL", G.G71: "IJKL"}


def register_patterns(motion: Motion, cycles: DrillingCycles) -> None:
    """Register the handlers of G70 and G71."""
    made = HolePatterns(motion, cycles)
    motion.handlers |= dict.fromkeys(_LETTERS, made.make)


class HolePatterns(MotionCodes):
    """Execution of patterns of holes."""

    def __init__(self, motion: Motion, cycles: DrillingCycles) -> None:
        super().__init__(motion)
        self._cycles = cycles

    def make(self, words: LineWords, code: Code | None) -> None:
        """Drill the holes of a line with G70 or G71.

        Raises:
            GcodeError: ``cycle-not-active``, ``cycle-word-missing``, ``polar-active``,
                ``value-out-of-range``.
        """
        assert code is not None
        motion, state, name = self._motion, self._state, code.word.written
        # The code is not modal: the cycle before it stays.
        state.motion = motion.motion_before
        if state.motion not in self._cycles.cycles:
            message = f"{name} drills with the canned cycle in effect, and there is none"
            hint = "give the cycle before, such as G81 Z-5. R1. F100. L0"
            raise fault("cycle-not-active", message, code.word, hint)
        if state.plane != "XY":
            raise fault("cycle-not-active", f"{name} in another plane than G17", code.word)
        if motion.polar.plane is not None:
            message = f"{name} under G16: its holes have no radius and angle"
            raise fault("polar-active", message, code.word, "give G15 before")
        own: dict[str, Word] = {}
        for letter in _LETTERS[code.g]:
            word = words.take(letter, name)
            if word is None:
                message = f"{name} needs {letter}"
                raise fault("cycle-word-missing", message, code.word, f"give {letter}")
            own[letter] = word
        count = whole(own["L"], "the holes", 1, MOST_REPEATS)
        positive(own["I"], "the radius")
        numbers = {letter: word.number for letter, word in own.items()}
        here = motion.coordinates.to_program(motion.position)
        x, y = motion.column["X"], motion.column["Y"]
        centre = complex(here[x], here[y]) / state.scale
        before = centre
        for offset in _offsets(code.g, numbers, count):
            place = centre + offset
            shown = place if state.absolute else place - before
            self._cycles.make(_words_of(shown, code.word), None)
            before = place


def _offsets(code: G, numbers: dict[str, float], count: int) -> list[complex]:
    """Return the holes of a pattern from the position, in units of the program."""
    size, first = numbers["I"], math.radians(numbers["J"])
    step = math.tau / count if code is G.G70 else math.radians(numbers["K"])
    return [cmath.rect(size, first + step * index) for index in range(count)]


def _words_of(place: complex, at: Word) -> LineWords:
    """Return the words X and Y of a place."""
    words = LineWords()
    for letter, number in (("X", place.real), ("Y", place.imag)):
        words.rest[letter] = Word(letter, number, at.written, at.column, at.length)
    return words
