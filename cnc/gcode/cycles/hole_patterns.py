"""Patterns of holes for the canned cycle in effect: G70 and G71 of Haas mills.

The position is the centre of the circle: I radius, J first angle, K angle between holes (G71), L
holes. Angles count from X, anticlockwise. Source: Haas, "Mill Operator's Manual", G70 and G71.
"""

from __future__ import annotations

import cmath
import math

from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.cycles.drilling import MOST_REPEATS, DrillingCycles
from cnc.gcode.state.modal_groups import Code
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, positive, whole

_LETTERS = {G.G70: "IJL", G.G71: "IJKL"}


def register(motion: Motion, cycles: DrillingCycles) -> None:
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
        found: dict[str, Word] = {}
        for letter in _LETTERS[code.g]:
            word = words.take(letter, name)
            if word is None:
                message = f"{name} needs {letter}"
                raise fault("cycle-word-missing", message, code.word, f"give {letter}")
            found[letter] = word
        count = whole(found["L"], "the holes", 1, MOST_REPEATS)
        positive(found["I"], "the radius")
        numbers = {letter: word.number for letter, word in found.items()}
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
