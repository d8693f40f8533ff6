"""Drilling cycles of lathes: G83 to G85 along Z, G87 to G89 along X, and Haas' G81, G82, G86.

FANUC's R is the distance from the initial level, and its cycles end at the initial level in system
A. Haas' R is a position, without which the cycle begins at the initial level. The words stay in
effect until G80. Source: FANUC, "Operator's Manual for Lathe System", "Canned cycle for drilling";
Haas, "Lathe Operator's Manual", drilling cycles.
"""

from __future__ import annotations

from cnc.gcode.codes.dwells import Dwells
from cnc.gcode.cycles.cycle_runner import CyclePlane, CycleRunner, refuse_axes, refuse_modes
from cnc.gcode.cycles.drilling import MOST_PECKS
from cnc.gcode.cycles.drilling_steps import steps
from cnc.gcode.cycles.steps import Point, Turning
from cnc.gcode.cycles.turning_moves import TurningMoves
from cnc.gcode.state.modal_groups import Code
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.kernels.gcode.holes import Hole, HoleSettings, peck_count
from cnc.kernels.jit import interpreted

_CODES = (G.G81, G.G82, G.G83, G.G84, G.G85, G.G86, G.G87, G.G88, G.G89)
_ALONG_X = {G.G87: G.G83, G.G88: G.G84, G.G89: G.G85}
"""FANUC's cycles along X, and the cycle along Z that does the same."""
_NEEDS_SPINDLE = (G.G84, G.G86)
_peck_count = interpreted(peck_count)


def register(moves: TurningMoves) -> None:
    """Register the handlers of the drilling cycles of the dialect."""
    holes = TurningHoles(moves)
    known = [code for code in _CODES if code in moves.dialect.g]
    moves.motion.handlers |= dict.fromkeys(known, holes.make)


class TurningHoles:
    """Execution of the drilling cycles."""

    def __init__(self, moves: TurningMoves) -> None:
        self._dialect = moves.dialect
        self._moves = moves
        self._state = moves.state
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
        along_x = cycle.code in self._dialect.tap_side
        refuse_modes(motion, state, name, at)
        refuse_axes(words, name, "XZ")
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
        end = plane.seen(motion.coordinates.to_program(motion.reached(values, motion.position)))
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
        turning: Turning = "ccw" if state.spindle == "ccw" else "cw"
        made = steps(base, plane.start, [hole] * count, settings, turning)
        self._runner.perform(made, plane)

    def _hole(self, end: Point, scale: float, at: Word) -> Hole:
        """The hole at a point, from R and the level before the first cycle."""
        retract = self._words.get("R")
        top = self._level
        if retract is not None and self._dialect.retract_is_distance:
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
        state, found = self._state, self._words
        peck = self._depth(found["Q"]) if cycle == G.G83 and "Q" in found else 0.0
        if peck and _peck_count(hole.retract, hole.bottom, peck) > MOST_PECKS:
            message = f"this line makes more than {MOST_PECKS} pecks"
            raise fault("cycle-too-long", message, at, "give a larger Q")
        if cycle in _NEEDS_SPINDLE and (state.spindle == "off" or not state.speed):
            message = f"{at.written} needs the spindle, which does not turn"
            raise fault("spindle-stopped", message, at, "give S and M3 before")
        rules = self._dialect.cycles
        return HoleSettings(
            feed=0.0,
            dwell=self._dwells.seconds(found["P"]) if "P" in found else 0.0,
            peck=peck,
            clearance=rules.clearance,
            out_to_retract=rules.feed_out_to == "retract",
            dwells_twice=rules.tap_dwell == "before-each",
        )

    def _depth(self, word: Word) -> float:
        """Q in mm; FANUC counts thousandths without a decimal point."""
        return self._moves.length(word, self._dialect.integer_unit)
