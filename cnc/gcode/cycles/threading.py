"""Moves that follow the spindle (G33, G33.1, G76): words of a line to steps.

The steps are in :mod:`cnc.gcode.cycles.threading_steps`. The feed is the pitch times the speed of
the spindle; F has no effect. Source: LinuxCNC 2.9, "G-codes", G33, G33.1, G76.
"""

from __future__ import annotations

from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.cycles.cycle_runner import CyclePlane, CycleRunner, refuse_axes, refuse_modes
from cnc.gcode.cycles.steps import Turning
from cnc.gcode.cycles.threading_steps import MOST_PASSES, Thread, cut, follow, passes, tap_rigidly
from cnc.gcode.state.modal_groups import Code
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, not_negative, positive, whole

FOLLOW, TAP, THREAD = G.G33, G.G33_1, G.G76
LARGEST_SLIDE = 80.0
"""Largest angle of the compound slide in G76, degrees: the tangent of a right angle is infinite."""
MOST_SPRINGS = 1000
FASTEST = 100.0
"""Highest speed of the return of G33.1, as a multiple."""


def register(motion: Motion, performer: CycleRunner) -> None:
    """Register the handlers of G33, G33.1 and, where the dialect has it as a thread, G76."""
    cycles = ThreadingCycles(motion, performer)
    motion.handlers[FOLLOW] = motion.handlers[TAP] = cycles.move
    if not motion.context.dialect.cycles.fine_boring:
        motion.handlers[THREAD] = cycles.thread


class ThreadingCycles(MotionCodes):
    """Execution of G33, G33.1 and G76."""

    def __init__(self, motion: Motion, performer: CycleRunner) -> None:
        super().__init__(motion)
        self._performer = performer

    def move(self, words: LineWords, code: Code | None) -> None:
        """Execute G33 or G33.1."""
        motion, state = self._motion, self._state
        rigid = state.motion == TAP
        name = "G33.1" if rigid else "G33"
        at = code.word if code else words.first()
        refuse_modes(motion, state, name, at, inverse_time=False)
        if not words.has_axis():
            raise fault(
                "axis-words-missing",
                f"{name} needs axis words",
                at,
                "give the end of the thread, such as Z-10",
            )
        refuse_axes(words, name, "XYZ")
        pitch = self._pitch(words, "K", name, at)
        faster = self._faster(words) if rigid else 1.0
        plane = CyclePlane(motion, state)
        turns, turning = self._turns_per_second(name, at)
        end = plane.seen(motion.coordinates.to_program(motion.target(words, name, motion.position)))
        steps = (
            tap_rigidly(plane.start, end, pitch, turns, turning, faster)
            if rigid
            else follow(plane.start, end, pitch, turns)
        )
        self._performer.perform(steps, plane)

    def _pitch(self, words: LineWords, letter: str, name: str, at: Word) -> float:
        """The pitch, mm a revolution."""
        word = words.take(letter, name)
        if word is None:
            raise fault(
                "pitch-missing",
                f"{name} needs {letter}",
                at,
                f"give {letter} and the length of the move in one revolution",
            )
        return positive(word, "the pitch") * self._state.scale

    def _faster(self, words: LineWords) -> float:
        word = words.take("I", "G33.1")
        if word and not 0.0 < word.number <= FASTEST:
            message = (
                f"{word.written}: the speed of the return must be more than 0 and at most "
                f"{FASTEST:g} times the speed"
            )
            raise fault("value-out-of-range", message, word)
        return word.number if word else 1.0

    def _turns_per_second(self, name: str, at: Word) -> tuple[float, Turning]:
        state = self._state
        if state.spindle == "off" or not state.speed:
            raise fault(
                "spindle-stopped",
                f"{name} follows the spindle, which does not turn",
                at,
                "give S and M3 before",
            )
        if state.constant_surface:
            message = f"{name} under G96: the pitch needs a constant speed of the spindle"
            raise fault("surface-speed-active", message, at, "give G97 and S before")
        return state.speed / 60.0, state.spindle

    def thread(self, words: LineWords, code: Code | None) -> None:
        """Execute G76."""
        motion, state = self._motion, self._state
        at = code.word if code else words.first()
        refuse_modes(motion, state, "G76", at, inverse_time=False)
        if state.plane != "ZX":
            raise fault("thread-plane", f"G76 in the {state.plane} plane", at, "give G18 before")
        refuse_axes(words, "G76", "Z")
        if "Z" not in words.rest:
            raise fault("axis-words-missing", "G76 needs Z", at, "give Z and the end of the thread")
        plane = CyclePlane(motion, state)
        plane.needs("XZ", "G76", at)
        turns, _ = self._turns_per_second("G76", at)
        end_word = words.rest["Z"]
        start, drive, height = plane.start
        end, _, _ = plane.seen(
            motion.coordinates.to_program(motion.target(words, "G76", motion.position))
        )
        if end == start:
            raise fault(
                "thread-length", "the thread has no length: Z is where the tool is", end_word
            )
        thread = self._thread(words, at, (start, end, drive, height))
        if passes(thread) > MOST_PASSES:
            raise fault(
                "cycle-too-long",
                f"G76 makes more than {MOST_PASSES} passes",
                at,
                "give a larger J or a smaller R",
            )
        self._performer.perform(cut(thread, turns), plane)

    def _thread(
        self, words: LineWords, at: Word, line: tuple[float, float, float, float]
    ) -> Thread:
        """The thread of G76's words; ``line`` is start, end, x and y of the drive line."""
        start, end, drive, height = line
        # I, J and K lie along X: under G7 they are diameters.
        across, along = self._motion.scales[self._motion.column["X"]], self._state.scale
        pitch = self._pitch(words, "P", "G76", at)
        peak, first, full = self._cuts(words, at)
        degression, angle, springs, taper, ends = (words.take(letter, "G76") for letter in "RQHEL")
        if degression and degression.number < 1.0:
            raise fault(
                "value-out-of-range",
                f"{degression.written}: the degression must be at least 1",
                degression,
            )
        if angle and not abs(angle.number) <= LARGEST_SLIDE:
            message = (
                f"{angle.written}: the angle of the slide must be from {-LARGEST_SLIDE:g} to "
                f"{LARGEST_SLIDE:g} degrees"
            )
            raise fault("value-out-of-range", message, angle)
        tapered = whole(ends, "the tapered ends", 0, 3) if ends else 0
        length = not_negative(taper, "the taper") * along if taper else 0.0
        if ends and tapered and not length:
            raise fault(
                "thread-taper",
                f"{ends.written}: the taper has no length",
                ends,
                "give E and the length of the taper",
            )
        thread = Thread(
            start=start,
            end=end,
            drive=drive,
            height=height,
            pitch=pitch,
            peak=peak.number * across,
            first=first.number * across,
            full=full.number * across,
            degression=degression.number if degression else 1.0,
            angle=angle.number if angle else 0.0,
            springs=whole(springs, "the spring passes", 0, MOST_SPRINGS) if springs else 0,
            taper=length if tapered else 0.0,
            entry=tapered in (1, 3),
            exit=tapered in (2, 3),
        )
        length_of_line = abs(end - start)
        if taper and length > length_of_line / 2:
            half = length_of_line / 2
            message = f"{taper.written}: a taper can be at most half the drive line, {half:g} mm"
            raise fault("thread-taper", message, taper)
        if angle and length_of_line - thread.slide < thread.taper * (thread.entry + thread.exit):
            message = f"{angle.written}: the slide and the tapers are longer than the thread"
            raise fault("thread-slide", message, angle, "give a smaller Q or a longer thread")
        return thread

    def _cuts(self, words: LineWords, at: Word) -> tuple[Word, Word, Word]:
        """I, J and K of G76: the peak, the first cut and the full depth."""
        peak, first, full = (self._needed(words, letter, at) for letter in "IJK")
        if peak.number == 0.0:
            message = f"{peak.written}: the peak must not be on the drive line"
            raise fault(
                "value-out-of-range",
                message,
                peak,
                "negative for an external thread, positive for an internal one",
            )
        positive(first, "the first cut")
        if full.number < first.number:
            raise fault(
                "value-out-of-range",
                f"{full.written}: the full depth must be no less than J, the first cut",
                full,
            )
        return peak, first, full

    @staticmethod
    def _needed(words: LineWords, letter: str, at: Word) -> Word:
        word = words.take(letter, "G76")
        if word is None:
            raise fault(
                "cycle-word-missing", f"G76 needs {letter}", at, "it needs P, Z, I, J and K"
            )
        return word
