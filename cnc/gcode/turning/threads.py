"""Threads of lathes in FANUC's language: G32 (G33), G34, G92 (G78) and G76.

F is the lead, measured along the axis that moves farther. The spindle must turn at a constant speed
(G97). Threads have no chamfer at their end unless G76 gives one. In pass n of G76 the tool is
``first * sqrt(n)`` deep, by at least ``least`` deeper than before, and moves along the flank: the
area of the chip is constant. The last passes take the finishing allowance, which is part of the
height. G34 changes the lead by K each turn. Source: FANUC, "Operator's Manual for Lathe System",
"Thread cutting" and "Multiple threading cycle"; Haas, "Lathe Operator's Manual", G76.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil, copysign, hypot, log, radians, tan

from cnc.gcode.core.context import Context, Executor
from cnc.gcode.core.cycle_runner import (
    Cut,
    CyclePlane,
    CycleRunner,
    Point,
    Rapid,
    SetOverrides,
    Step,
    Synchronise,
    TurnSpindle,
    opposite,
    refuse_axes,
    refuse_modes,
    without_standing,
)
from cnc.gcode.core.modal_groups import Code, Feed, Turning
from cnc.gcode.core.motion import Handler, Motion, MotionCodes
from cnc.gcode.kernels.cycles import ROUNDING
from cnc.gcode.reader.words import G, LineWords, Word, fault, not_negative, positive, whole
from cnc.gcode.turning.codes import MOST_PASSES, VARIABLE
from cnc.gcode.turning.moves import PIECES, Helix, TurningMoves

SAME_WAY = 1e-3
"""Largest difference of the ways along X and Z on a cone of 45 degrees, mm."""
WIDEST = 120.0
"""Largest angle of a thread, degrees."""


def turns_per_second(context: Context, name: str, at: Word, length: str = "lead") -> float:
    """Return the speed of the spindle that a thread follows, which must be constant.

    Args:
        context: The modal state.
        name: The code, for messages.
        at: Word at which errors are reported.
        length: The length that belongs to a turn: lead or pitch.

    Raises:
        GcodeError: ``spindle-stopped``, ``surface-speed-active``.
    """
    speed = context.spindle_speed(name, at, use="follows")
    if context.state.constant_surface:
        message = f"{name} under G96: the {length} needs a constant speed of the spindle"
        raise fault("surface-speed-active", message, at, "give G97 and S before")
    return speed / 60.0


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
        G.G34: threads.move,
        G.G76: once(threads.cycle),
        G.G78: threads.single,
    }


class TurningThreads(Executor):
    """Execution of the threads."""

    def __init__(self, moves: TurningMoves) -> None:
        super().__init__(moves.context)
        self._moves = moves
        self._lead: float | None = None
        self._staying: dict[str, float] = {}
        # m, r and a of G76's first line, with the least depth and the allowance, mm.
        self._finishing = 1
        self._chamfer = 0.0
        self._angle = 0.0
        self._least = 0.0
        self._allowance = 0.0
        self._doubtful: Word | None = None

    # One move, one pass

    def move(self, words: LineWords, code: Code | None) -> None:
        """Execute G33 (G32 of system A), G34 or G35: one move that follows the spindle.

        The next line with such a move goes on without a stop; any other line ends the thread.
        """
        moves = self._moves
        at = code.word if code else words.first()
        moves.check(at)
        if not words.has_axis():
            raise fault("axis-words-missing", f"{at.written} needs X or Z", at)
        siemens, here = self._dialect.flavour == "siemens", moves.place
        turns = turns_per_second(self.context, at.written, at)
        angle = self._offset_angle(words) if siemens else self._take_angle(words, at)
        lead = None if siemens else self._lead_of(words, at)
        change = self._change(words, "F" if siemens else "K", at)
        given = moves.given(words, at.written)
        end = given.get("Z", here[0]), given.get("X", here[1])
        ways = abs(end[0] - here[0]), abs(end[1] - here[1])
        if lead is None:
            lead = self._lead_along(words, ways, at)
        helix = Helix(lead, turns, angle, change)
        farther = max(ways)
        if math.isnan(number := helix.number(farther)) or number * PIECES > MOST_PASSES:
            message = f"{at.written}: the lead falls to 0 before the end of the thread"
            if number == number:
                message = f"{at.written} has more than {MOST_PASSES // PIECES} turns"
            raise fault("thread-lead", message, at, "change the lead less from turn to turn")
        self.follow(here, end, helix)

    def single(self, words: LineWords, code: Code | None) -> None:
        """Execute G78 (G92 of system A): in, one pass, out and back. R is the taper."""
        moves, staying = self._moves, self._staying
        at = code.word if code else words.first()
        moves.check(at)
        if code:
            staying.clear()
        moves.take_taper(words, "I")
        angle = self._take_angle(words, at)
        lead, turns = self._lead_of(words, at), turns_per_second(self.context, at.written, at)
        if taper := words.take("R", at.written):
            staying["R"] = taper.number * self._state.scale
        staying |= moves.given(words, at.written)
        for letter in "XZ":
            if letter not in staying:
                raise fault("cycle-word-missing", f"{at.written} needs {letter}", at)
        z0, x0 = moves.place
        z, x = staying["Z"], staying["X"]
        first = z0, x + staying.get("R", 0.0)
        with self.context.exact_path():
            moves.rapid(*first)
            self.follow(first, (z, x), Helix(lead, turns, angle))
            self.context.end_follow()
            moves.rapid(z, x0)
            moves.rapid(z0, x0)

    def _take_angle(self, words: LineWords, at: Word) -> float:
        """Take Q, the start angle in thousandths of a degree; it counts in its own line only.

        Source: FANUC, "Operator's Manual for Lathe System", "Multiple thread cutting".

        Raises:
            GcodeError: ``value-out-of-range``, ``number-not-whole``.
        """
        word = words.take("Q", at.written)
        if word is None:
            return 0.0
        if "." in word.written:
            message = f"{word.written}: a start angle has no decimal point"
            hint = f"it counts thousandths of a degree: Q{1000.0 * word.number:.0f}"
            raise fault("value-out-of-range", message, word, hint)
        return self._new_start(word, whole(word, "the start angle", 0, 360_000) / 1000.0)

    def _offset_angle(self, words: LineWords) -> float:
        """Take SF, the start angle in degrees; it counts in its own line only.

        Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", "Thread cutting
        with constant lead (G33)".
        """
        word = words.take("SF", "G33")
        if word is None:
            return 0.0
        if not 0.0 <= word.number < 360.0:
            message = f"SF={word.number:g}: a start angle is from 0 to 359.999 degrees"
            raise fault("value-out-of-range", message, word)
        return self._new_start(word, word.number)

    def _new_start(self, word: Word, angle: float) -> float:
        """Return the angle; a warning tells that it has no effect where a thread goes on."""
        if angle and self.context.follows:
            message = f"{word.written} has no effect: the thread goes on from the line before"
            self._here.report_warning("word-idle", message, word, "remove it")
        return angle

    def _change(self, words: LineWords, letter: str, at: Word) -> float:
        """Take the change of the lead from turn to turn, mm: K of G34, F of SINUMERIK's."""
        if self._state.motion not in VARIABLE:
            return 0.0
        word = words.take(letter, at.written)
        if word is None:
            hint = f"give {letter} and the change of the lead from turn to turn"
            raise fault("pitch-missing", f"{at.written} needs {letter}", at, hint)
        change = (
            positive(word, "the change") if letter == "F" else word.number
        ) * self._state.scale
        return -change if self._state.motion == G.G35 else change

    def follow(self, here: tuple[float, float], to: tuple[float, float], helix: Helix) -> None:
        """Cut to a point; the lead counts along the axis that moves farther."""
        z, x = abs(to[0] - here[0]), abs(to[1] - here[1])
        if longer := max(z, x):
            self._moves.follow(*to, helix.scaled(math.hypot(z, x) / longer))

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

    def _lead_along(self, words: LineWords, ways: tuple[float, float], at: Word) -> float:
        """SINUMERIK's lead, mm a turn: K along Z, or I along X, of the axis that moves farther.

        Either of them may be given on a cone of 45 degrees. ``ways`` are those of Z and X, mm.
        Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", "Thread cutting
        with constant lead (G33)".
        """
        z, x = ways
        letter, axis = ("K", "Z") if z >= x else ("I", "X")
        if abs(z - x) < SAME_WAY and letter not in words.rest:
            letter = "I" if letter == "K" else "K"
        word = words.take(letter, at.written)
        if word is None:
            hint = f"give {letter} and the lead along {axis}, which moves farther"
            raise fault("pitch-missing", f"{at.written} needs {letter}", at, hint)
        return positive(word, "the lead") * self._state.scale

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
        lead, turns = self._lead_of(words, at), turns_per_second(self.context, at.written, at)
        helix = Helix(lead, turns, self._cycle_angle(words, at))
        thread = self._thread(words, at, lead)
        for count, _ in enumerate(thread.depths()):
            if count > MOST_PASSES:
                message = f"{at.written} makes more than {MOST_PASSES} passes"
                raise fault("cycle-too-long", message, at, "give a larger first depth")
        with self.context.exact_path():
            self.context.add_overrides(feed=False, spindle=False)
            for depth in thread.depths():
                self._pass(thread, depth, helix)
            self.context.add_overrides()

    def _cycle_angle(self, words: LineWords, at: Word) -> float:
        """The start angle of the cycle in one line; in two lines Q is the first depth."""
        two_lines = self._dialect.turning.two_line_cycles and "K" not in words.rest
        return 0.0 if two_lines else self._take_angle(words, at)

    def _pass(self, thread: Thread, depth: float, helix: Helix) -> None:
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
            self.follow(begin, corner, helix)
            end = z, corner[1] - inward * out
            self.follow(corner, end, helix)
        else:
            self.follow(begin, end, helix)
        self.context.end_follow()
        moves.rapid(z, x0)
        moves.rapid(z0, x0)

    def _settings(self, words: LineWords, at: Word) -> None:
        """P (two digits each: finishing passes, chamfer, angle), Q and R of the first line."""
        form, least, allowance = (words.take(letter, at.written) for letter in "PQR")
        if not self._dialect.turning.two_line_cycles or form is None:
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
            pointed = "." in allowance.written or self._dialect.turning.least_increments
            self._doubtful = None if pointed else allowance

    def _thread(self, words: LineWords, at: Word, lead: float) -> Thread:
        """The thread of the words of G76 with X and Z."""
        moves, scale = self._moves, self._state.scale
        # P is the height and R the taper; K and I on a Haas and in FANUC's Series 10/11 format.
        two_lines = self._dialect.turning.two_line_cycles and "K" not in words.rest
        letters = "PQR" if two_lines else "KDI"
        tip = None if two_lines else words.take("A", at.written)
        height, first, taper = (words.take(letter, at.written) for letter in letters)
        if height and self._doubtful and self._allowance >= self._length(height):
            self._read_in_thousandths(self._doubtful, at)
        given = moves.given(words, at.written)
        start = moves.place
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
            # The method of the infeed; P1 cuts one flank with a constant area of the chip.
            way = words.take("P", at.written)
            if way is not None and way.whole != 1:
                message = f"{way.written} of {at.written}: only the infeed P1 is made"
                raise fault("code-not-supported", message, way, "remove it, or write P1")
            angle, finishing, chamfer = tip.number if tip else 0.0, 1, 0.0
            if tip:
                self._check_angle(tip, angle)
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

    def _read_in_thousandths(self, allowance: Word, at: Word) -> None:
        """Read the allowance as P and Q of G76: in mm it would be no less than the thread's height.

        FANUC's own example of G76 has R200 beside coordinates with a decimal point.
        """
        self._allowance, self._doubtful = self._length(allowance), None
        message = f"{allowance.written} of G76 counts thousandths here, as P and Q do: in mm it is "
        message += "more than the thread"
        hint = f"write the decimal point: R{self._allowance / self._state.scale:g}"
        self._here.report_warning("decimal-point-missing", message, at, hint)

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
        return self._moves.length(word, self._dialect.turning.integer_unit)


# Steps of threads: the passes of G76, rigid tapping (G33.1) and one synchronised move (G33).
#
#     x            one pass of G76, external (peak negative), with both tapers
#
#     drive line   ┌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌┐    ╌ traverse
#                  ┊                      ┊    ─ synchronised
#     thread peak  ┘                      │
#                   \                    /
#     bottom         \__________________/
#                  E                    E
#                z end              z start
#
# The whole pass is shifted away from the workpiece by the remaining depth. So the stroke from its
# start to the bottom is the same in every pass.
#
# In pass n the tool is ``first * n ** (1 / degression)`` beyond the peak, up to the full depth.
# With degression 1 every pass has the same depth, with 2 the same area. Source: LinuxCNC 2.9,
# "G-codes", G76.


@dataclass(frozen=True, slots=True)
class ThreadSteps:
    """A thread in the ZX plane, mm; x is a radius.

    Attributes:
        start: z of the start of the drive line.
        end: z of its end.
        drive: x of the drive line.
        height: y.
        pitch: mm a revolution.
        peak: From the drive line to the peak; negative for an external thread.
        first: Depth of the first pass beyond the peak.
        full: Depth of the last pass beyond the peak.
        degression: At least 1.
        angle: Angle of the compound slide, degrees.
        springs: Additional passes at full depth.
        taper: Length of the tapers along z.
        entry: Whether the start has a taper.
        exit: Whether the end has a taper.
    """

    start: float
    end: float
    drive: float
    height: float
    pitch: float
    peak: float
    first: float
    full: float
    degression: float = 1.0
    angle: float = 0.0
    springs: int = 0
    taper: float = 0.0
    entry: bool = False
    exit: bool = False

    @property
    def slide(self) -> float:
        """Shift of a pass at full depth along z, mm."""
        return self.full * tan(radians(self.angle))


def passes(thread: ThreadSteps) -> int:
    """Return the number of passes to full depth without spring passes.

    The largest result is :data:`MOST_PASSES` + 1.
    """
    exponent = thread.degression * log(thread.full / thread.first)
    if exponent > log(MOST_PASSES):
        return MOST_PASSES + 1
    return max(1, ceil(float((thread.full / thread.first) ** thread.degression) - ROUNDING))


def depths(thread: ThreadSteps) -> Iterator[float]:
    """Return the depth of each pass beyond the peak, mm; the last are exactly the full depth."""
    count = passes(thread)
    for number in range(1, count):
        yield min(thread.first * number ** (1.0 / thread.degression), thread.full)
    for _ in range(1 + thread.springs):
        yield thread.full


def cut(thread: ThreadSteps, turns_per_second: float) -> Iterator[Step]:
    """Return the steps of G76 from the start of the drive line to its end."""
    direction = copysign(1.0, thread.end - thread.start)
    inward = copysign(1.0, thread.peak)
    # On the taper the tool also moves in x, so the pitch along the move is longer.
    on_taper = (
        thread.pitch * hypot(thread.taper, thread.full) / thread.taper
        if thread.taper
        else thread.pitch
    )

    def at(z: float, x: float) -> Point:
        return z, x, thread.height

    def passing(depth: float) -> Iterator[Step]:
        start = thread.start + direction * depth / thread.full * thread.slide
        end = thread.end - direction * (1.0 - depth / thread.full) * thread.slide
        bottom = thread.drive + thread.peak + inward * depth
        crest = bottom - inward * thread.full
        away = thread.drive - inward * (thread.full - depth)
        yield Rapid(at(start, away))
        if thread.entry:
            yield Synchronise(on_taper)
            yield Cut(at(start, crest), on_taper * turns_per_second)
            yield Cut(at(start + direction * thread.taper, bottom), on_taper * turns_per_second)
        else:
            yield Rapid(at(start, bottom))
        yield Synchronise(thread.pitch)
        straight_end = end - direction * thread.taper if thread.exit else end
        yield Cut(at(straight_end, bottom), thread.pitch * turns_per_second)
        if thread.exit:
            yield Synchronise(on_taper)
            yield Cut(at(end, crest), on_taper * turns_per_second)
        yield Synchronise(0.0)
        yield Rapid(at(end, away))

    def whole() -> Iterator[Step]:
        yield SetOverrides(overrides=False, spindle=False)
        for depth in depths(thread):
            yield from passing(depth)
        yield SetOverrides(overrides=True, spindle=False)
        yield Rapid(at(thread.end, thread.drive))

    yield from without_standing(at(thread.start, thread.drive), whole())


def tap_rigidly(
    start: Point, end: Point, pitch: float, turns_per_second: float, turning: Turning, faster: float
) -> Iterator[Step]:
    """G33.1: in and out at ``pitch`` mm a revolution.

    The spindle reverses for the retract, where it turns ``faster`` times as fast.
    """
    if end != start:
        yield Synchronise(pitch)
        yield Cut(end, pitch * turns_per_second)
        yield TurnSpindle(opposite(turning), faster)
        yield Cut(start, pitch * turns_per_second * faster)
        yield TurnSpindle(turning)
        yield Synchronise(0.0)


# Moves that follow the spindle (G33, G33.1, G76): words of a line to steps.
#
# The steps are in :mod:`cnc.gcode.turning.threads`. The feed is the pitch times the speed of
# the spindle; F has no effect. Source: LinuxCNC 2.9, "G-codes", G33, G33.1, G76.

FOLLOW, TAP, THREAD = G.G33, G.G33_1, G.G76
LARGEST_SLIDE = 80.0
"""Largest angle of the compound slide in G76, degrees: the tangent of a right angle is infinite."""
MOST_SPRINGS = 1000
FASTEST = 100.0
"""Highest speed of the return of G33.1, as a multiple."""


def register_threading(motion: Motion, performer: CycleRunner) -> None:
    """Register the handlers of G33, G33.1 and, where the dialect has it as a thread, G76."""
    cycles = ThreadingCycles(motion, performer)
    motion.handlers |= dict.fromkeys((FOLLOW, TAP, *VARIABLE), cycles.move)
    if not motion.context.dialect.cycles.fine_boring:
        motion.handlers[THREAD] = cycles.thread


class ThreadingCycles(MotionCodes):
    """Execution of G33, G33.1 and G76."""

    def __init__(self, motion: Motion, performer: CycleRunner) -> None:
        super().__init__(motion)
        self._performer = performer

    def move(self, words: LineWords, code: Code | None) -> None:
        """Execute G33 or G33.1. K is the pitch along the move.

        The next line with G33 goes on without a stop. Source: LinuxCNC 2.9, ``tp.c``: only a move
        that does not follow the spindle, or none, ends the synchronisation.
        """
        motion, state = self._motion, self._state
        rigid = state.motion == TAP
        name = "G33.1" if rigid else "G33"
        at = code.word if code else words.first()
        if self._dialect.flavour == "siemens":
            hint = 'set kind = "lathe" under [machine] of the machine file'
            raise fault("code-not-supported", f"{at.written} (thread) is not supported", at, hint)
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
        turns = turns_per_second(self.context, name, at, "pitch")
        end = plane.seen(motion.coordinates.to_program(motion.target(words, name, motion.position)))
        if rigid:
            steps = tap_rigidly(plane.start, end, pitch, turns, state.turning, faster)
            self._performer.perform(steps, plane)
        elif end != plane.start:
            self.context.follow_spindle(pitch)
            motion.feed_to(plane.place(end), pitch * turns)

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
        turns = turns_per_second(self.context, "G76", at, "pitch")
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
    ) -> ThreadSteps:
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
        thread = ThreadSteps(
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
