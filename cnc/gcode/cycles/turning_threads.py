"""Threads of lathes in FANUC's language: G32 (G33), G92 (G78) and G76.

F is the lead, measured along the axis that moves farther. The spindle must turn at a constant speed
(G97). Threads have no chamfer at their end unless G76 gives one. In pass n of G76 the tool is
``first * sqrt(n)`` deep, by at least ``least`` deeper than before, and moves along the flank: the
area of the chip is constant. The last passes take the finishing allowance, which is part of the
height. Source: FANUC, "Operator's Manual for Lathe System", "Thread cutting" and "Multiple
threading cycle"; Haas, "Lathe Operator's Manual", G76.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cnc.gcode.codes.motion import Handler
from cnc.gcode.cycles.roughing import MOST_PASSES
from cnc.gcode.cycles.turning_moves import TurningMoves
from cnc.gcode.state.modal_groups import Code, Feed
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, not_negative, positive, whole
from cnc.model.blocks import Overrides

WIDEST = 120.0
"""Largest angle of a thread, degrees."""


@dataclass(frozen=True, slots=True)
class Thread:
    """A thread of G76, mm; x is a radius.

    Attributes:
        start: z and x of the start of the cycle.
        end: z and x of the root at the end.
        taper: Difference of the root's x between start and end.
        height: From crest to root.
        first: Depth of the first pass.
        least: Least increase of the depth from pass to pass.
        allowance: Depth that the finishing passes take.
        finishing: Number of passes at full depth.
        angle: Angle of the tip, degrees; the tool moves in along half of it.
        chamfer: Length of the chamfer at the end.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    taper: float
    height: float
    first: float
    least: float = 0.0
    allowance: float = 0.0
    finishing: int = 1
    angle: float = 0.0
    chamfer: float = 0.0

    def depths(self) -> Iterator[float]:
        """Yield the depth of each pass below the crest; the last ones are the height."""
        rough, depth, number = self.height - self.allowance, 0.0, 0
        while depth < rough - 1e-9:
            number += 1
            depth = min(max(self.first * math.sqrt(number), depth + self.least), rough)
            yield depth
        finishing = self.finishing if self.allowance or not number else self.finishing - 1
        for _ in range(finishing):
            yield self.height

    @property
    def inward(self) -> float:
        """Direction of x into the material."""
        return math.copysign(1.0, self.end[1] - self.start[1])


def register(moves: TurningMoves, once: Callable[[Handler], Handler]) -> None:
    """Register the handlers of the threads."""
    threads = TurningThreads(moves)
    moves.motion.handlers |= {
        G.G33: threads.move,
        G.G76: once(threads.cycle),
        G.G78: threads.single,
    }


class TurningThreads:
    """Execution of the threads."""

    def __init__(self, moves: TurningMoves) -> None:
        self._dialect = moves.dialect
        self._moves = moves
        self._state = moves.state
        self._lead: float | None = None
        self._staying: dict[str, float] = {}
        # m, r and a of G76's first line, with the least depth and the allowance, mm.
        self._finishing = 1
        self._chamfer = 0.0
        self._angle = 0.0
        self._least = 0.0
        self._allowance = 0.0

    # One move, one pass

    def move(self, words: LineWords, code: Code | None) -> None:
        """Execute G33 (G32 of system A): one move that follows the spindle.

        The next line with such a move goes on without a stop; any other line ends the thread.
        """
        moves = self._moves
        at = code.word if code else words.first()
        moves.check(at)
        if not words.has_axis():
            raise fault("axis-words-missing", f"{at.written} needs X or Z", at)
        lead, turns = self._lead_of(words, at), self._turns_per_second(at)
        here, given = moves.place, moves.given(words, at.written)
        self._follow(here, (given.get("Z", here[0]), given.get("X", here[1])), lead, turns)

    def single(self, words: LineWords, code: Code | None) -> None:
        """Execute G78 (G92 of system A): in, one pass, out and back. R is the taper."""
        moves, staying = self._moves, self._staying
        at = code.word if code else words.first()
        moves.check(at)
        if code:
            staying.clear()
        lead, turns = self._lead_of(words, at), self._turns_per_second(at)
        if taper := words.take("R", at.written):
            staying["R"] = taper.number * self._state.scale
        staying |= moves.given(words, at.written)
        for letter in "XZ":
            if letter not in staying:
                raise fault("cycle-word-missing", f"{at.written} needs {letter}", at)
        z0, x0 = moves.place
        z, x = staying["Z"], staying["X"]
        first = z0, x + staying.get("R", 0.0)
        with moves.exact_path():
            moves.rapid(*first)
            self._follow(first, (z, x), lead, turns)
            moves.end_follow()
            moves.rapid(z, x0)
            moves.rapid(z0, x0)

    def _follow(
        self, here: tuple[float, float], to: tuple[float, float], lead: float, turns: float
    ) -> None:
        """Cut to a point; the lead counts along the axis that moves farther."""
        z, x = abs(to[0] - here[0]), abs(to[1] - here[1])
        if longer := max(z, x):
            self._moves.follow(*to, lead * math.hypot(z, x) / longer, turns)

    def _lead_of(self, words: LineWords, at: Word) -> float:
        """F or E, or the last lead, mm a turn. Under G99 F stays in effect as the feed."""
        state = self._state
        word = words.take("F", at.written) or words.take("E", at.written)
        if word is None:
            if state.feed_mode == "per-revolution" and state.feed is not None:
                return state.feed.linear
            if self._lead is None:
                raise fault("pitch-missing", f"{at.written} needs F", at, "give F and the lead")
            return self._lead
        self._lead = positive(word, "the lead") * state.scale
        if state.feed_mode == "per-revolution":
            state.feed = Feed(self._lead, word.number)
        return self._lead

    def _turns_per_second(self, at: Word) -> float:
        state = self._state
        if state.spindle == "off" or not state.speed:
            message = f"{at.written} follows the spindle, which does not turn"
            raise fault("spindle-stopped", message, at, "give S and M3 before")
        if state.constant_surface:
            message = f"{at.written} under G96: the lead needs a constant speed of the spindle"
            raise fault("surface-speed-active", message, at, "give G97 and S before")
        return state.speed / 60.0

    # G76

    def cycle(self, words: LineWords, code: Code | None) -> None:
        """Execute a line of G76."""
        assert code is not None
        at = code.word
        if not words.has_axis():
            self._settings(words, at)
            return
        moves = self._moves
        moves.check(at)
        lead, turns = self._lead_of(words, at), self._turns_per_second(at)
        thread = self._thread(words, at, lead)
        for count, _ in enumerate(thread.depths()):
            if count > MOST_PASSES:
                message = f"{at.written} makes more than {MOST_PASSES} passes"
                raise fault("cycle-too-long", message, at, "give a larger first depth")
        with moves.exact_path():
            self._overrides(on=False)
            for depth in thread.depths():
                self._pass(thread, depth, lead, turns)
            self._overrides(on=True)

    def _overrides(self, *, on: bool) -> None:
        """Disable the feed override during the threads, and enable it where it was before."""
        state, here = self._state, self._moves.here
        self._moves.out.add(
            Overrides(
                here.file,
                here.line,
                state.feed_override and on,
                state.speed_override and on,
                state.adaptive_feed,
                state.feed_stop,
            )
        )

    def _pass(self, thread: Thread, depth: float, lead: float, turns: float) -> None:
        moves, inward = self._moves, thread.inward
        (z0, x0), (z, x) = thread.start, thread.end
        ahead = math.copysign(1.0, z - z0)
        above = -inward * (thread.height - depth)
        # The deeper the pass, the farther ahead it starts, so that one flank is cut.
        shift = ahead * depth * math.tan(math.radians(thread.angle / 2.0))
        share = 1.0 - shift / (z - z0)
        begin = z0 + shift, x + thread.taper * share + above
        end = z, x + above
        moves.rapid(begin[0], x0)
        moves.rapid(*begin)
        if thread.chamfer > 0.0:
            part = 1.0 - thread.chamfer / abs(z - begin[0])
            corner = (
                begin[0] + part * (z - begin[0]),
                begin[1] + part * (end[1] - begin[1]),
            )
            out = min(thread.chamfer, abs(corner[1] - x0))
            self._follow(begin, corner, lead, turns)
            end = z, corner[1] - inward * out
            self._follow(corner, end, lead, turns)
        else:
            self._follow(begin, end, lead, turns)
        moves.end_follow()
        moves.rapid(z, x0)
        moves.rapid(z0, x0)

    def _settings(self, words: LineWords, at: Word) -> None:
        """P (two digits each: finishing passes, chamfer, angle), Q and R of the first line."""
        form, least, allowance = (words.take(letter, at.written) for letter in "PQR")
        if not self._dialect.two_line_cycles or form is None:
            raise fault("axis-words-missing", f"{at.written} needs X and Z", at)
        number = whole(form, "the form of the thread", 0, 999_999)
        self._finishing = max(1, number // 10_000)
        self._chamfer = number // 100 % 100 / 10.0
        self._angle = float(number % 100)
        self._check_angle(form, self._angle)
        if least:
            self._least = self._length(least)
        if allowance:
            self._allowance = not_negative(allowance, "the allowance") * self._state.scale

    def _thread(self, words: LineWords, at: Word, lead: float) -> Thread:
        """The thread of the words of G76 with X and Z."""
        moves, scale = self._moves, self._state.scale
        given = moves.given(words, at.written)
        start = moves.place
        two_lines = self._dialect.two_line_cycles
        # FANUC's P is the height and R the taper; on a Haas they are K and I.
        letters = "PQR" if two_lines else "KDI"
        height, first, taper = (words.take(letter, at.written) for letter in letters)
        for letter, word in zip(
            (*"XZ", *letters[:2]), (*map(given.get, "XZ"), height, first), strict=True
        ):
            if word is None:
                message = f"{at.written} needs {letter}"
                raise fault("cycle-word-missing", message, at, "it needs X, Z, height and depth")
        assert height is not None
        assert first is not None
        angle, finishing, chamfer = self._angle, self._finishing, self._chamfer * lead
        if not two_lines:
            word = words.take("A", at.written)
            angle, finishing, chamfer = word.number if word else 0.0, 1, 0.0
            if word:
                self._check_angle(word, angle)
        thread = Thread(
            start=start,
            end=(given["Z"], given["X"]),
            taper=taper.number * scale if taper else 0.0,
            height=self._length(height),
            first=self._length(first),
            least=self._least if two_lines else 0.0,
            allowance=self._allowance if two_lines else 0.0,
            finishing=finishing,
            angle=angle,
            chamfer=chamfer,
        )
        self._check(thread, at, (height, first))
        return thread

    def _check(self, thread: Thread, at: Word, words: tuple[Word, Word]) -> None:
        (z0, x0), (z, x) = thread.start, thread.end
        if z == z0:
            raise fault("thread-length", "the thread has no length: Z is where the tool is", at)
        crest = [place - thread.inward * thread.height for place in (x, x + thread.taper)]
        if any((place - x0) * thread.inward < 0.0 for place in crest):
            message = (
                f"the tool starts at X {2 * x0:g} mm (diameter), inside the crest of the thread at "
                f"{2 * crest[0]:g} mm"
            )
            raise fault("thread-start", message, at, "start the cycle clear of the thread")
        if thread.first > thread.height:
            message = f"{words[1].written}: the first pass is deeper than the thread"
            raise fault("value-out-of-range", message, words[1])
        if thread.allowance >= thread.height:
            raise fault("value-out-of-range", "the allowance is not less than the height", words[0])
        slide = thread.height * math.tan(math.radians(thread.angle / 2.0))
        if thread.chamfer + slide >= abs(z - z0):
            message = "the chamfer and the slide along the flank are longer than the thread"
            raise fault("thread-taper", message, at, "give a longer thread")

    @staticmethod
    def _check_angle(word: Word, angle: float) -> None:
        if not 0.0 <= angle <= WIDEST:
            message = f"{word.written}: the angle must be from 0 to {WIDEST:g} degrees"
            raise fault("value-out-of-range", message, word)

    def _length(self, word: Word) -> float:
        """A depth in mm: a word without a decimal point is in thousandths."""
        return self._moves.length(word, self._dialect.integer_unit)
