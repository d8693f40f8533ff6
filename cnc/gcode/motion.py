"""Axis words to moves: straight lines, arcs, the start of a NURBS, and the codes that move the coordinate systems.

The position is kept in machine coordinates, so offsets and units change what words mean and never where the machine stands.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.canon import PLANE_AXES, ROTARY_LETTERS, ArcFeed
from cnc.gcode import arcs
from cnc.gcode.dialects import Dialect
from cnc.gcode.modal import CANCEL, NURBS, Code, Modal
from cnc.gcode.nurbs import Collector, Place, form_of
from cnc.gcode.offsets import Offsets
from cnc.gcode.output import Output
from cnc.gcode.words import AXES, LineWords, Word, fault, whole
from cnc.units import per_second

MIN_FEED = 1e-6
"""mm/s. What is slower is a slip: a millimetre would take eleven days."""

_MOTION_NAMES = {0: "G0", 10: "G1", 20: "G2", 30: "G3"}
_CENTER_WORDS = {"x": "I", "y": "J", "z": "K"}
_ARC_WORDS = frozenset("IJKR")
_MOVES_ORIGIN = (100, 920)
MAX_TURNS = 1_000_000


class Motion:
    """Where the machine stands and how it moves. ``nurbs`` is the curve that is being collected, if any."""

    def __init__(self, file: str, axes: tuple[str, ...], dialect: Dialect, state: Modal, position: list[float], out: Output) -> None:
        self.position = position
        self.nurbs: Collector | None = None
        self._file = file
        self._axes = axes
        self._column = {letter.upper(): index for index, letter in enumerate(axes)}
        self._linear = [letter not in ROTARY_LETTERS for letter in axes]
        self._dialect = dialect
        self._state = state
        self._out = out
        self._machine_words = False
        self._offsets = Offsets.none(len(axes))
        self._zero = self._offsets.zero

    # Which move a line asks for

    def check(self, words: LineWords, codes: dict[str, Code]) -> int | None:
        """The motion code that this line's words belong to, before anything is executed; None for a line without a move."""
        code, special = codes.get("motion"), codes.get("non-modal")
        self._machine_words = special is not None and special.number == 530
        has_axis = words.has_axis()
        if special and special.number == 40 and has_axis:
            has_axis = self._axis_beside_dwell(words, code)
        if special and special.number in _MOVES_ORIGIN:
            if code and code.number != CANCEL:
                raise fault("axis-words-wanted-twice", f"both {special.word.written} and {code.word.written} take axis words", code.word)
            self._state.motion = None if code else self._state.motion
            return None
        if code:
            return self._explicit(words, code, special, has_axis)
        if not has_axis:
            if self._machine_words and special:
                raise fault("axis-words-missing", f"{special.word.written} needs axis words", special.word)
            arc_again = self._state.motion in (20, 30) and not _ARC_WORDS.isdisjoint(words.rest)
            return self._state.motion if arc_again and special is None else None
        return self._modal_move(words, special)

    def _axis_beside_dwell(self, words: LineWords, code: Code | None) -> bool:
        """Whether a line with G4 has axis words for a move; where the dwell itself takes an axis letter, no move may stand beside it."""
        timed = [letter for letter in self._dialect.dwell if letter in AXES and letter in words.rest]
        if timed and code:
            raise fault("word-wanted-twice", f"both G4 and {code.word.written} take a {timed[0]} word in this line", words.rest[timed[0]])
        return any(letter in AXES and letter not in timed for letter in words.rest)

    def _explicit(self, words: LineWords, code: Code, special: Code | None, has_axis: bool) -> int | None:
        """A line with a motion code of its own."""
        if self._machine_words and special:
            if code.number not in (0, 10):
                raise fault("machine-coordinates-motion", f"{special.word.written} goes with G0 and G1 only", special.word)
            if not has_axis:
                raise fault("axis-words-missing", f"{special.word.written} needs axis words", special.word)
        self._state.motion = None if code.number == CANCEL else code.number
        if code.number == CANCEL:
            if has_axis:
                word = words.first_axis()
                raise fault("motion-missing", f"{word.written} with {code.word.written}: there is no motion to make", word, "give G0 or G1")
            return None
        if code.number in (0, 10) and not has_axis:
            return None
        return code.number

    def _modal_move(self, words: LineWords, special: Code | None) -> int:
        """Axis words without a motion code: the one in effect."""
        word, motion = words.first_axis(), self._state.motion
        if special and not self._machine_words:
            message = f"{word.written} with {special.word.written}, but no motion code in this line"
            raise fault("axis-words-unused", message, word, "write the move on a line of its own")
        if motion is None:
            raise fault("motion-missing", f"{word.written} without a motion code in effect", word, "begin with G0 or G1")
        if motion == NURBS:
            message = f"G6.2 is still in effect: {word.written} needs a new motion code"
            raise fault("nurbs-still-active", message, word, "give G0, G1, G2, G3 or another G6.2")
        if special and motion not in (0, 10):
            raise fault("machine-coordinates-motion", f"{special.word.written} goes with G0 and G1 only", special.word)
        return motion

    def move(self, words: LineWords, motion: int | None, line: int, text: str, explicit: Code | None = None) -> None:
        """Make the move that :meth:`check` found; ``explicit`` is the line's own motion code, if it has one."""
        if motion is None:
            return
        code = explicit.word if explicit else None
        if motion == 0:
            end = self.target(words, "G0", self.position, machine=self._machine_words)
            self._out.move(end, math.nan, line)
        elif motion == 10:
            at = code or words.first_axis()
            end = self.target(words, "G1", self.position, machine=self._machine_words)
            self._out.move(end, self._feed(words, end, self._distance(end), at), line)
        elif motion == NURBS:
            self._begin_nurbs(words, line, text)
            return
        else:
            end = self._arc(words, motion, line, code)
        self.position = end

    # Words to coordinates

    def _scale(self, index: int) -> float:
        return self._state.scale if self._linear[index] else 1.0

    def axis_values(self, words: LineWords, user: str) -> dict[int, float]:
        """Takes the axis words of a line: mm or degrees by axis index, no offset applied."""
        found: dict[int, float] = {}
        for letter in [letter for letter in words.rest if letter in AXES]:
            index = self._column.get(letter)
            if letter not in self._dialect.axes:
                raise fault("axis-not-in-dialect", f"{letter} is no axis in the {self._dialect.name} dialect", words.rest[letter])
            if index is None:
                raise fault(
                    "axis-missing", f"the machine has no {letter} axis", words.rest[letter], f"its axes are {' '.join(self._axes).upper()}"
                )
            word = words.take(letter, user)
            assert word is not None
            found[index] = word.number * self._scale(index)
        return found

    def target(self, words: LineWords, user: str, start: list[float], *, machine: bool = False) -> list[float]:
        """The machine position that a line's axis words mean, seen from ``start``; axes without a word stay there."""
        end = start.copy()
        absolute, zero = self._state.absolute, self._zero
        for index, value in self.axis_values(words, user).items():
            if machine:
                end[index] = value
            elif absolute:
                end[index] = value + zero[index]
            else:
                end[index] += value
        return end

    # Feed

    def _distance(self, end: list[float]) -> float:
        """Length of a straight move as feeds count it: over x y z if one of them moves, else over u v w, else over a b c."""
        for group in ("xyz", "uvw", "abc"):
            length = math.hypot(*(end[i] - self.position[i] for i, letter in enumerate(self._axes) if letter in group))
            if length > 0:
                return length
        return 0.0

    def _feed(self, words: LineWords, end: list[float], length: float, at: Word) -> float:
        """The feed of a move in mm/s, or deg/s if only rotary axes move. ``at`` is the word that an error points at."""
        if self._state.inverse_time:
            word = words.take("F", "G93")
            if word is None:
                raise fault("feed-missing", "under G93 every move needs an F word", at, "give F, one over the minutes of the move")
            if word.number <= 0:
                raise fault("feed-not-positive", f"{word.written}: the feed must be more than 0", word)
            # A move of no length takes no time whatever the rate is; any positive feed says so.
            rate = per_second(word.number * (length or 1.0))
            if length and rate < MIN_FEED:
                raise fault("feed-too-slow", f"{word.written}: the feed is next to nothing", word)
            return rate
        feed = self._state.feed
        if feed is None:
            raise fault("feed-missing", "a feed move, but no feed was ever given", at, "give F")
        rotary = any(end[i] != self.position[i] for i, linear in enumerate(self._linear) if not linear)
        if rotary and all(end[i] == self.position[i] for i, linear in enumerate(self._linear) if linear):
            return feed.rotary
        return feed.linear

    # Arcs

    def _arc(self, words: LineWords, motion: int, line: int, code: Word | None) -> list[float]:
        user, clockwise, state = _MOTION_NAMES[motion], motion == 20, self._state
        at = code or min(words.rest.values(), key=lambda word: word.column)
        first, second = PLANE_AXES[state.plane]
        for axis in (first, second):
            if axis not in self._axes:
                raise fault("axis-missing", f"an arc in the {state.plane} plane, but the machine has no {axis.upper()} axis", at)
        i, j = self._axes.index(first), self._axes.index(second)
        end = self.target(words, user, self.position)
        tolerance = self._dialect.arc_mm if state.scale == 1.0 else self._dialect.arc_inch
        radius = words.take("R", user)
        centers = [words.take(_CENTER_WORDS[axis], user) for axis in (first, second)]
        turns = self._turns(words, user)
        here, there = (self.position[i], self.position[j]), (end[i], end[j])
        if radius:
            if clash := next(filter(None, centers), None):
                later = max(radius, clash, key=lambda word: word.column)
                raise fault("arc-radius-and-center", f"{user} takes R or a centre, not both", later)
            arc = arcs.from_radius(
                here, there, radius.number * state.scale, clockwise=clockwise, turns=turns, tolerance=tolerance, word=radius
            )
        else:
            center = self._center(centers, (i, j), user, at)
            word = next(filter(None, centers), at)
            arc = arcs.from_center(here, there, center, clockwise=clockwise, turns=turns, tolerance=tolerance, word=word)
        third = next((n for n, axis in enumerate(self._axes) if axis in "xyz" and n not in (i, j)), None)
        rise = 0.0 if third is None else end[third] - self.position[third]
        feed = self._feed(words, end, arc.length(rise), at)
        self._out.add(ArcFeed(self._file, line, state.plane, arc.center, np.array(end), arc.radius, arc.turns, feed))
        return end

    def _center(self, words: list[Word | None], axes: tuple[int, int], user: str, at: Word) -> tuple[float, float]:
        """The centre in machine coordinates from I, J, K."""
        state, letters = self._state, [_CENTER_WORDS[axis] for axis in PLANE_AXES[self._state.plane]]
        if words[0] is None and words[1] is None:
            raise fault("arc-center-missing", f"{user} needs {letters[0]}, {letters[1]} or R", at)
        if state.arc_absolute:
            for letter, word in zip(letters, words, strict=True):
                if word is None:
                    message = f"under G90.1 {user} needs both {letters[0]} and {letters[1]}; {letter} is missing"
                    raise fault("arc-center-missing", message, at)
            base = [self._zero[axis] for axis in axes]
        else:
            base = [self.position[axis] for axis in axes]
        offsets = [word.number * state.scale if word else 0.0 for word in words]
        return base[0] + offsets[0], base[1] + offsets[1]

    def _turns(self, words: LineWords, user: str) -> int:
        if "P" in words.rest and not self._dialect.arc_turns:
            raise fault("word-not-in-dialect", f"P turns of an arc are not in the {self._dialect.name} dialect", words.rest["P"])
        word = words.take("P", user)
        return whole(word, "the turns", 1, MAX_TURNS) if word else 1

    # NURBS

    def _begin_nurbs(self, words: LineWords, line: int, text: str) -> None:
        state = self._state
        word = next(word for word in words.g if word.tenths == NURBS)
        form = form_of(words, self._dialect.nurbs)
        if state.inverse_time or state.compensation:
            mode = "G93" if state.inverse_time else "cutter compensation"
            raise fault(form.wrong_mode, f"{word.written} under {mode}", word, "give G94 and G40 before")
        feed = self._feed(words, self.position, 0.0, word)
        curve = Collector(form, Place(word, line, text), file=self._file, position=self.position, feed=feed, target=self.target)
        curve.first(words)
        self.nurbs = curve

    def nurbs_line(self, words: LineWords, line: int, text: str) -> None:
        """A line while a NURBS is being collected."""
        assert self.nurbs is not None
        if block := self.nurbs.line(words, line, text):
            self._out.add(block)
            self.position = self.nurbs.position
            self.nurbs = None

    # Coordinate systems

    def use_system(self, system: int) -> None:
        """G54 to G59.3."""
        self._set(self._offsets.use(system))

    def offsets_code(self, words: LineWords, code: Code) -> None:
        """G10, G92, G92.1, G92.2, G92.3; G53 has said what it wants to the move already."""
        if code.number == 100:
            self._g10(words, code.word)
        elif code.number == 920:
            values = self.axis_values(words, "G92")
            if not values:
                raise fault("axis-words-missing", f"{code.word.written} needs axis words", code.word)
            self._set(self._offsets.shift_here(values, self.position))
        elif code.number == 921:
            self._set(self._offsets.clear_shift())
        elif code.number == 922:
            self._set(self._offsets.suspend_shift())
        elif code.number == 923:
            self._set(self._offsets.restore_shift())

    def _g10(self, words: LineWords, at: Word) -> None:
        dialect = self._dialect
        kind = words.take("L", "G10")
        if kind is None:
            raise fault("offset-kind-missing", f"{at.written} needs an L word", at, "L2 sets an origin, L20 the present position")
        if kind.whole not in dialect.offsets:
            raise fault("code-not-supported", f"{at.written} {kind.written} is not supported", kind)
        if "R" in words.rest:
            raise fault("word-not-supported", "R of G10, rotation of the coordinate system, is not supported", words.rest["R"])
        system = words.take("P", "G10")
        if system is None:
            raise fault("offset-system-missing", f"{at.written} needs a P word", at, "P1 is G54, P2 is G55, and so on")
        number = whole(system, "the coordinate system", 0 if dialect.offsets_current else 1, dialect.systems)
        index = number - 1 if number else self._offsets.current
        values = self.axis_values(words, "G10")
        if not values:
            raise fault("axis-words-missing", f"{at.written} needs axis words", at)
        if kind.whole == 2:
            self._set(self._offsets.set_origin(index, values, add=dialect.offsets_add and not self._state.absolute))
        else:
            self._set(self._offsets.set_origin_here(index, values, self.position))

    def _set(self, offsets: Offsets) -> None:
        self._offsets, self._zero = offsets, offsets.zero
