"""Cycles of lathes in FANUC's language: single cycles, pecking, and the settings of G71 to G76.

The numbers are those of G-code system B: G77 to G79 are G90, G92 and G94 of system A. A cycle
starts at the position and returns to it. The cycles that have a profile are in
:mod:`cnc.gcode.turning.profiles`. Source: FANUC, "Operator's Manual for Lathe System", "Canned
cycle" and "Multiple repetitive cycle"; Haas, "Lathe Operator's Manual", canned cycles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field

from cnc.compiled.jit import interpreted
from cnc.gcode.core.compensation_codes import CompensationCodes
from cnc.gcode.core.context import Executor
from cnc.gcode.core.cycle_runner import (
    CyclePlane,
    CycleRunner,
    Point,
    refuse_axes,
    refuse_modes,
    steps,
)
from cnc.gcode.core.drilling import MOST_PECKS
from cnc.gcode.core.machine_codes import Dwells
from cnc.gcode.core.modal_groups import Code
from cnc.gcode.core.motion import Handler, Motion
from cnc.gcode.kernels.cycles import ROUNDING, Hole, HoleSettings, peck_count
from cnc.gcode.reader.words import G, LineWords, Word, fault, not_negative, positive, whole
from cnc.gcode.turning import threads
from cnc.gcode.turning.codes import FOLLOWING, MOST_PASSES
from cnc.gcode.turning.moves import TurningMoves

# Drilling cycles of lathes: G83 to G85 along Z, G87 to G89 along X, and Haas' G81, G82, G86.
#
# FANUC's R is the distance from the initial level, and its cycles end at the initial level in
# system A. Haas' R is a position, without which the cycle begins at the initial level. The words
# stay in effect until G80. Source: FANUC, "Operator's Manual for Lathe System", "Canned cycle for
# drilling"; Haas, "Lathe Operator's Manual", drilling cycles.

_CODES = (G.G81, G.G82, G.G83, G.G84, G.G85, G.G86, G.G87, G.G88, G.G89)
_ALONG_X = {G.G87: G.G83, G.G88: G.G84, G.G89: G.G85}
"""FANUC's cycles along X, and the cycle along Z that does the same."""
_NEEDS_SPINDLE = (G.G84, G.G86)
_peck_count = interpreted(peck_count)


def register_holes(moves: TurningMoves) -> None:
    """Register the handlers of the drilling cycles of the dialect."""
    holes = TurningHoles(moves)
    codes = [code for code in _CODES if code in moves.dialect.g]
    moves.motion.handlers |= dict.fromkeys(codes, holes.make)


class TurningHoles(Executor):
    """Execution of the drilling cycles."""

    def __init__(self, moves: TurningMoves) -> None:
        super().__init__(moves.context)
        self._moves = moves
        self._dwells = Dwells(moves.motion.context)
        self._runner = CycleRunner(moves.motion)
        self._words: dict[str, Word] = {}
        self._bottom = 0.0
        self._level = 0.0

    def make(self, words: LineWords, code: Code | None) -> None:
        """Execute a line of the cycle in effect."""
        state, motion = self._state, self._moves.motion
        cycle = state.motion
        assert cycle is not None
        at = code.word if code else words.first()
        name = at.written
        along_x = cycle.code in self._dialect.turning.tap_side
        refuse_modes(motion, state, name, at)
        refuse_axes(words, name, "XZC" if "C" in motion.column else "XZ")
        plane = CyclePlane(motion, state, "YZ" if along_x else "XY")
        plane.needs(plane.across, name, at)
        if code:
            self._words.clear()
            self._level = plane.start[2]
            if plane.across not in words.rest:
                hint = f"give {plane.across} and the bottom of the hole"
                raise fault("cycle-word-missing", f"{name} needs {plane.across}", at, hint)
        for letter in "RQP":
            if word := words.take(letter, name):
                self._words[letter] = word
        repeats = words.take("K", name) or words.take("L", name)
        values = motion.axis_values(words, name)
        reached = motion.reached(values, motion.position)
        end = plane.seen(motion.coordinates.to_program(reached))
        if motion.column[plane.across] in values:
            self._bottom = end[2]
        hole = self._hole(end, motion.scales[motion.column[plane.across]], at)
        base = _ALONG_X.get(cycle, cycle) if along_x else cycle
        settings = self._settings(base, hole, at)
        if base == G.G83 and settings.peck == 0.0:
            base = G.G82
        place = plane.place((end[0], end[1], hole.bottom))
        settings = settings._replace(feed=motion.feed(words, place, 0.0, at))
        count = whole(repeats, "the repeats", 1, MOST_PECKS) if repeats else 1
        if (turned := motion.column.get("C")) in values:
            # The main spindle turns to the place of the hole together with the other axis.
            over = plane.place((end[0], end[1], plane.start[2]))
            over[turned] = reached[turned]
            motion.traverse(over)
            plane = CyclePlane(motion, state, "YZ" if along_x else "XY")
        made = steps(base, plane.start, [hole] * count, settings, state.turning)
        self._runner.perform(made, plane)

    def _hole(self, end: Point, scale: float, at: Word) -> Hole:
        """The hole at a point, from R and the level before the first cycle."""
        retract = self._words.get("R")
        top = self._level
        if retract is not None and self._dialect.turning.retract_is_distance:
            # The distance is a radius along X, and its sign says nothing.
            top -= abs(retract.number) * self._state.scale
        elif retract is not None:
            top = retract.number * scale
        if top < self._bottom:
            message = f"the cycle begins at {top:g} mm, below its end at {self._bottom:g} mm"
            hint = "cycles go towards smaller coordinates; give R nearer to the start"
            raise fault("cycle-retract-below-bottom", message, at, hint)
        state = self._state
        clear = max(self._level, top) if state.initial_level else top
        return Hole(end[0], end[1], self._bottom, top, clear)

    def _settings(self, cycle: G, hole: Hole, at: Word) -> HoleSettings:
        """The settings from Q, P and the spindle, without the feed."""
        settings = self._words
        peck = self._depth(settings["Q"]) if cycle == G.G83 and "Q" in settings else 0.0
        if peck and _peck_count(hole.retract, hole.bottom, peck) > MOST_PECKS:
            message = f"this line makes more than {MOST_PECKS} pecks"
            raise fault("cycle-too-long", message, at, "give a larger Q")
        if cycle in _NEEDS_SPINDLE:
            self.context.spindle_speed(at.written, at)
        rules = self._dialect.cycles
        return HoleSettings(
            feed=0.0,
            dwell=self._dwells.seconds(settings["P"]) if "P" in settings else 0.0,
            peck=peck,
            clearance=rules.clearance,
            out_to_retract=rules.feed_out_to == "retract",
            dwells_twice=rules.tap_dwell == "before-each",
        )

    def _depth(self, word: Word) -> float:
        """Q in mm; FANUC counts thousandths without a decimal point."""
        return self._moves.length(word, self._dialect.turning.integer_unit)


RETRACT = 0.5
"""Retract of cycles without a line of settings, mm."""


@dataclass(slots=True)
class CycleSettings:
    """Settings of cycles, which stay in effect.

    Attributes:
        depth: Depth of the passes of G71 and G72, mm; None if it was not given.
        retract: Retract of G71, G72, G74 and G75, mm.
        relief: Shift of the first pass of G73 in X (radius) and Z, mm; None if it was not given.
        passes: Number of passes of G73.
        doubtful: The word of the depth if it has no decimal point, which controls read differently.
    """

    depth: float | None = None
    retract: float = RETRACT
    relief: tuple[float, float] | None = None
    passes: int = 1
    doubtful: Word | None = None


@dataclass(slots=True)
class _Staying:
    """Words of a modal single cycle that stay in effect."""

    words: dict[str, float] = field(default_factory=dict)


def register(motion: Motion, compensation: CompensationCodes) -> TurningCycles:
    """Register the handlers of the cycles of a lathe, and return their settings."""
    moves = TurningMoves(motion)
    moves.compensation = compensation
    cycles = TurningCycles(moves)
    motion.handlers |= {
        G.G70: cycles.finishing,
        G.G71: cycles.once(cycles.roughing_settings),
        G.G72: cycles.once(cycles.roughing_settings),
        G.G73: cycles.once(cycles.pattern_settings),
        G.G74: cycles.once(cycles.peck),
        G.G75: cycles.once(cycles.peck),
        G.G77: cycles.turn_once,
        G.G79: cycles.turn_once,
    }
    threads.register(moves, cycles.once)
    register_holes(moves)
    return cycles


def register_thread(motion: Motion) -> TurningCycles:
    """Register SINUMERIK's G33 to G35, and return the cycles, which have its moves."""
    cycles = TurningCycles(TurningMoves(motion))
    move = threads.TurningThreads(cycles.moves).move
    motion.handlers |= dict.fromkeys(FOLLOWING, move)
    return cycles


class TurningCycles(Executor):
    """Execution of single cycles and pecking; ``settings`` are those of the other cycles."""

    def __init__(self, moves: TurningMoves) -> None:
        self.settings = CycleSettings()
        self.moves = moves
        super().__init__(moves.context)
        self._motion = moves.motion
        self._staying = _Staying()

    def once(self, handler: Handler) -> Handler:
        """Return a handler after which the motion code before the line is in effect again."""

        def run(words: LineWords, code: Code | None) -> None:
            handler(words, code)
            self._state.motion = self._motion.motion_before

        return run

    # Settings

    def finishing(self, words: LineWords, code: Code | None) -> None:
        """Refuse G70 without P and Q: it has no settings."""
        at = "G70" if code is None else code.word.written
        hint = "give the first and the last line of the profile: G70 P10 Q20"
        message = f"{at} needs P and Q"
        raise fault("cycle-word-missing", message, code.word if code else words.first(), hint)

    def roughing_settings(self, words: LineWords, code: Code | None) -> None:
        """Execute G71 or G72 without P and Q: depth (U or W) and retract (R)."""
        assert code is not None
        at, letter = code.word, "U" if code.number == G.G71 else "W"
        self._check_form(at)
        depth, retract = words.take(letter, at.written), words.take("R", at.written)
        if depth is None:
            hint = f"give the lines from which the profile is read, or {letter} and the depth"
            raise fault("cycle-word-missing", f"{at.written} needs P and Q", at, hint)
        self.settings.depth = self.positive(depth, "the depth")
        pointed = "." in depth.written or self._dialect.turning.least_increments
        self.settings.doubtful = None if pointed else depth
        if retract:
            self.settings.retract = not_negative(retract, "the retract") * self._state.scale

    def pattern_settings(self, words: LineWords, code: Code | None) -> None:
        """Execute G73 without P and Q: relief (U in radius, W) and number of passes (R)."""
        assert code is not None
        at = code.word
        self._check_form(at)
        x, z, count = (words.take(letter, at.written) for letter in "UWR")
        if count is None or (x is None and z is None):
            hint = "give U, W and R, or P and Q"
            raise fault("cycle-word-missing", f"{at.written} needs P and Q", at, hint)
        scale = self._state.scale
        self.settings.relief = (x.number * scale if x else 0.0, z.number * scale if z else 0.0)
        self.settings.passes = whole(count, "the number of passes", 1, MOST_PASSES)

    def _check_form(self, at: Word) -> None:
        if not self._dialect.turning.two_line_cycles:
            hint = "give P, Q, D and the allowances U and W in one line"
            message = f"{at.written} without P and Q is not in the {self._dialect.name} dialect"
            raise fault("cycle-word-missing", message, at, hint)

    def positive(self, word: Word, what: str) -> float:
        """Return the length of a word in mm, which must be more than 0."""
        return positive(word, what) * self._state.scale

    # Single cycles

    def turn_once(self, words: LineWords, code: Code | None) -> None:
        """Execute G77 (along Z) or G79 (along X): in, cut, out, back.

        R (or I of G77, K of G79) is the difference between the start and the end of the cut: of X
        as a radius, or of Z. Without it the cut is along an axis, where nose compensation changes
        nothing.
        """
        at = code.word if code else words.first()
        alone = code is not None and not words.has_axis() and "R" not in words.rest
        if alone and self._state.motion == G.G77:
            # Only the mode: G90 stands in the safe lines of many programs. G94 may mean system B.
            self._staying = _Staying()
            message = f"{at.written} is a turning cycle here; without X or Z it makes no move"
            self._here.report_warning("code-without-effect", message, at, "remove it")
            return
        self.moves.take_taper(words, "K" if self._state.motion == G.G79 else "I")
        tapered = "R" in words.rest or (code is None and "R" in self._staying.words)
        with nullcontext() if tapered else self.moves.uncompensated(at):
            self._turn_once(words, code, at)

    def _turn_once(self, words: LineWords, code: Code | None, at: Word) -> None:
        moves, state = self.moves, self._state
        assert state.motion is not None
        facing = state.motion == G.G79
        moves.check(at)
        if code:
            self._staying = _Staying()
        taper = words.take("R", at.written)
        if taper:
            self._staying.words["R"] = taper.number * state.scale
        z0, x0 = moves.place
        z, x = self._end(words, at)
        rest = self._staying.words.get("R", 0.0)
        first = (z + rest, x0) if facing else (z0, x + rest)
        back = (z0, x) if facing else (z, x0)
        with moves.context.exact_path():
            moves.rapid(*first)
            moves.cut(z, x, at)
            moves.cut(*back, at)
            moves.rapid(z0, x0)

    def _end(self, words: LineWords, at: Word) -> tuple[float, float]:
        """The end of the cut; X and Z of the line before stay in effect."""
        moves, staying = self.moves, self._staying.words
        given = moves.given(words, at.written)
        staying |= given
        missing = [letter for letter in "XZ" if letter not in staying]
        if missing:
            hint = "give X and Z (or U and W) in the first line of the cycle"
            if not given:
                hint = f"{at.written} is a turning cycle here: remove it, or {hint}"
            raise fault("cycle-word-missing", f"{at.written} needs {missing[0]}", at, hint)
        return staying["Z"], staying["X"]

    # Pecking

    def peck(self, words: LineWords, code: Code | None) -> None:
        """Execute G74 (pecks along Z) or G75 (pecks along X), or their settings (R)."""
        assert code is not None
        at, moves, settings = code.word, self.moves, self.settings
        along_z = code.number == G.G74
        if not words.has_axis():
            retract = words.take("R", at.written)
            if retract is None:
                message = f"{at.written} needs {'Z' if along_z else 'X'}"
                raise fault("axis-words-missing", message, at, "give the end of the cycle")
            settings.retract = not_negative(retract, "the retract") * self._state.scale
            return
        moves.check(at)
        z0, x0 = moves.place
        increments = self._taken_increments(words, at)
        relief = words.take("R", at.written)
        given = moves.given(words, at.written)
        z, x = given.get("Z", z0), given.get("X", x0)
        steps = self._lengths(increments, {"X": x - x0, "Z": z - z0})
        step, side_step = (steps["Z"], steps["X"]) if along_z else (steps["X"], steps["Z"])
        line = (z0, z) if along_z else (x0, x)
        side = (x0, x) if along_z else (z0, z)
        away = math.copysign(1.0, side[0] - side[1]) if side[0] != side[1] else 0.0
        shift = away * relief.number * self._state.scale if relief else 0.0
        places = list(_stations(*side, side_step, at))
        depths = list(_stations(*line, step, at))[1:] or [line[1]]
        if len(places) * len(depths) > MOST_PASSES:
            raise fault("cycle-too-long", f"{at.written} makes more than {MOST_PASSES} pecks", at)
        with moves.context.exact_path():
            for place in places:
                self._peck_at(place, (line[0], depths), (shift, place != side[0]), along_z, at)
            moves.rapid(z0, x0)

    def _peck_at(
        self,
        place: float,
        line: tuple[float, list[float]],
        relief: tuple[float, bool],
        along_z: bool,
        at: Word,
    ) -> None:
        """Pecks at one place: cut, retract a little, and at the end the relief and out."""
        moves, start, depths = self.moves, line[0], line[1]

        def point(depth: float, side: float) -> tuple[float, float]:
            return (depth, side) if along_z else (side, depth)

        moves.rapid(*point(start, place))
        back = math.copysign(self.settings.retract, start - depths[-1])
        for depth in depths:
            moves.cut(*point(depth, place), at)
            if depth != depths[-1]:
                limited = depth + back if abs(back) < abs(depth - start) else start
                moves.rapid(*point(limited, place))
        shift, has_free_side = relief
        if shift and has_free_side:
            moves.cut(*point(depths[-1], place + shift), at)
            place += shift
        moves.rapid(*point(start, place))

    def _taken_increments(self, words: LineWords, at: Word) -> dict[str, Word | None]:
        """Increments in X (radius) and Z: P and Q; I and K of Haas and of Series 10/11."""
        with_p = self._dialect.turning.two_line_cycles and words.rest.keys().isdisjoint("IK")
        letters = {"X": "P", "Z": "Q"} if with_p else {"X": "I", "Z": "K"}
        return {axis: words.take(letter, at.written) for axis, letter in letters.items()}

    def _lengths(
        self, increments: dict[str, Word | None], ways: dict[str, float]
    ) -> dict[str, float | None]:
        """Return the increments in mm; 0 is none along an axis without a way.

        Source: FANUC, alarm PS0062: an increment of 0 is illegal where the axis has a way.
        """
        lengths: dict[str, float | None] = {}
        for axis, word in increments.items():
            lengths[axis] = None
            if word and (word.number or ways[axis]):
                unit = self._dialect.turning.integer_unit if word.letter in "PQ" else 1.0
                lengths[axis] = self.moves.length(word, unit)
        return lengths


def _stations(start: float, end: float, step: float | None, at: Word) -> Iterator[float]:
    """Yield places from start to end, at most ``step`` apart; both ends are exact."""
    yield start
    length = abs(end - start)
    if length == 0.0:
        return
    count = 1 if step is None else max(1, math.ceil(length / step - ROUNDING))
    if count > MOST_PASSES:
        raise fault("cycle-too-long", f"{at.written} makes more than {MOST_PASSES} pecks", at)
    for number in range(1, count):
        yield start + math.copysign(number * (step or 0.0), end - start)
    yield end
