"""Axis words to moves.

The position is kept in machine coordinates, so offsets and units change what words mean and never
where the machine stands. Straight moves and arcs are here; other motion codes register a handler.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from cnc.gcode.codes import polar
from cnc.gcode.codes.arc_words import ArcMoves
from cnc.gcode.codes.machine_codes import surface_rpm
from cnc.gcode.codes.prepared_lines import QuickMove
from cnc.gcode.dialects import Dialect
from cnc.gcode.geometry.compensation import Compensation
from cnc.gcode.state.block_buffer import Output
from cnc.gcode.state.coordinates import Coordinates
from cnc.gcode.state.modal_groups import QUICK_MOTIONS, Code, Codes, Feed, Modal, feed_of
from cnc.gcode.state.source_location import Here
from cnc.gcode.state.unused_words import Waiting
from cnc.gcode.syntax.code_numbers import G, M
from cnc.gcode.syntax.words import AXES, MAX_NUMBER, POLAR, LineWords, Word, fault
from cnc.model.blocks import ROTARY_LETTERS, ArcFeed, NurbsFeed
from cnc.model.diagnostics import GcodeError
from cnc.model.units import per_second

MIN_FEED = 1e-6
"""mm/s. What is slower is a slip: a millimetre would take eleven days."""

_ARC_WORDS = frozenset("IJKR")
_CURVES = (G.G5, G.G5_1, G.G5_2, G.G6_2, G.BSPLINE)
_CYCLES = frozenset(
    ("G73", "G74", "G76", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89")
)
_POLAR_USERS = _CYCLES | {"G0", "G1", "G2", "G3", "G38.2", "G38.3", "G38.4", "G38.5"}
"""Codes whose point may be given by @ and ^; a cycle under G91 would have to count anew for each of
its repeats.
"""
_TAKES_AXES = (G.G10, G.G28, G.G30, G.G52, G.G92)
"""Non-modal codes that take the axis words of their line."""
_TRAVERSE = G.G0
_STRAIGHT = (G.G0, G.G1)
_ARCS = (G.G2, G.G3)

Handler = Callable[[LineWords, Code | None], None]
"""Makes the move of a motion code: takes the words of the line and sets the position. The code is
None where it was in effect already.
"""


class Collector(Protocol):
    """A curve that is written over many lines."""

    def line(self, words: LineWords, codes: Codes) -> bool:
        """Take a line; whether it is used up. The collector ends itself by ``motion.collector =
        None``.
        """

    def end(self, what: str) -> None:
        """The program ends: completes the curve, or raises the error of one that ends before it is
        complete.
        """


class Motion:
    """Where the machine stands and how it moves.

    ``position`` is the programmed one in machine coordinates; ``column`` tells the column of an
    axis letter; ``handlers`` makes the moves of motion codes other than G0 to G3; ``collector`` is
    the curve that is being collected, if any; ``compensation`` turns moves into those of the tool's
    centre; ``before`` is the motion code that was in effect before the line; ``again`` tells the
    letters that repeat the move of a motion code in effect without an axis word.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        dialect: Dialect,
        here: Here,
        state: Modal,
        position: list[float],
        coordinates: Coordinates,
        out: Output,
        waiting: Waiting,
    ) -> None:
        self.position = position
        self._waiting = waiting
        self.axes = axes
        self.column = {letter.upper(): index for index, letter in enumerate(axes)}
        self.coordinates = coordinates
        self.collector: Collector | None = None
        self.compensation = Compensation(out, here)
        self.handlers: dict[G, Handler] = {}
        self.scales: list[float] = []
        self.before: G | None = None
        self.again: dict[G, frozenset[str]] = dict.fromkeys(_ARCS, _ARC_WORDS)
        self._linear = [letter not in ROTARY_LETTERS for letter in axes]
        self._has_rotary = not all(self._linear)
        self._dialect = dialect
        self._here = here
        self._state = state
        self._out = out
        self._machine_words = False
        self.arcs = ArcMoves(self, dialect, here, state)
        self.units_changed()

    @property
    def compensated(self) -> bool:
        """Whether cutter compensation is on."""
        return self.compensation.on

    def units_changed(self) -> None:
        """Millimetres (or degrees) a unit of each axis word, after G20, G21, G7 or G8."""
        state = self._state
        self.scales = [state.scale if linear else 1.0 for linear in self._linear]
        if state.diameter and "X" in self.column:
            self.scales[self.column["X"]] *= 0.5

    # Which move a line asks for

    def check(self, words: LineWords, codes: Codes) -> G | None:
        """The motion code that this line's words belong to, before anything is executed; None for a
        line without a move.
        """
        code, special, state = codes.get("motion"), codes.get("non-modal"), self._state
        self._machine_words = special is not None and special.number == G.G53
        self.before = state.motion
        has_axis = words.has_axis()
        if special and special.number == G.G4 and has_axis:
            has_axis = self._axis_beside_dwell(words, code)
        taker = special if special and special.number in _TAKES_AXES else None
        if (length := codes.get("tool-length")) and (
            length.number == G.G43_1 or (length.number == G.G43_2 and "H" not in words.rest)
        ):
            if special and (taker or self._machine_words):
                raise fault(
                    "axis-words-wanted-twice",
                    f"both {special.word.written} and {length.word.written} take axis words",
                    length.word,
                )
            taker = length
        if taker:
            if code:
                beside = (
                    code.number in _STRAIGHT
                    and taker.number in (G.G28, G.G30)
                    and self._dialect.home_beside_motion
                )
                if code.number != G.G80 and not beside:
                    raise fault(
                        "axis-words-wanted-twice",
                        f"both {taker.word.written} and {code.word.written} take axis words",
                        code.word,
                    )
                state.motion = code.g if beside else None
            return None
        if code:
            return self._explicit(words, code, special, has_axis)
        if not has_axis:
            if self._machine_words and special:
                raise fault(
                    "axis-words-missing",
                    f"{special.word.written} needs axis words",
                    special.word,
                    "such as G53 G0 Z0",
                )
            orient = codes.get("spindle")
            letters = self.again.get(state.motion or _TRAVERSE, frozenset())
            again = not letters.isdisjoint(words.rest) and not (orient and orient.number == M.M19)
            return state.motion if again and special is None else None
        return self._modal_move(words, special)

    def _axis_beside_dwell(self, words: LineWords, code: Code | None) -> bool:
        """Whether a line with G4 has axis words for a move; where the dwell itself takes an axis
        letter, no move may stand beside it.
        """
        timed = [
            letter for letter in self._dialect.dwell if letter in AXES and letter in words.rest
        ]
        if timed and code:
            raise fault(
                "word-wanted-twice",
                f"both G4 and {code.word.written} take a {timed[0]} word in this line",
                words.rest[timed[0]],
            )
        return any(letter in AXES and letter not in timed for letter in words.rest)

    def _explicit(
        self, words: LineWords, code: Code, special: Code | None, has_axis: bool
    ) -> G | None:
        """A line with a motion code of its own."""
        if self._machine_words and special:
            if code.number not in _STRAIGHT:
                raise fault(
                    "machine-coordinates-motion",
                    f"{special.word.written} goes with G0 and G1 only",
                    special.word,
                )
            if not has_axis:
                raise fault(
                    "axis-words-missing",
                    f"{special.word.written} needs axis words",
                    special.word,
                    "such as G53 G0 Z0",
                )
        self._state.motion = None if code.number == G.G80 else code.g
        if code.number == G.G80:
            if has_axis:
                word = words.first_axis()
                raise fault(
                    "motion-missing",
                    f"{word.written} with {code.word.written}: there is no motion to make",
                    word,
                    "give G0 or G1",
                )
            return None
        if code.number in _STRAIGHT and not has_axis:
            return None
        return code.g

    def _modal_move(self, words: LineWords, special: Code | None) -> G:
        """Axis words without a motion code: the one in effect."""
        word, motion = words.first_axis(), self._state.motion
        if special and not self._machine_words:
            message = f"{word.written} with {special.word.written}, but no motion code in this line"
            raise fault("axis-words-unused", message, word, "write the move on a line of its own")
        if motion is None:
            raise fault(
                "motion-missing",
                f"{word.written} without a motion code in effect",
                word,
                "begin with G0 or G1",
            )
        if motion == G.G6_2:
            message = f"G6.2 is still in effect: {word.written} needs a new motion code"
            raise fault("nurbs-still-active", message, word, "give G0, G1, G2, G3 or another G6.2")
        if special and motion not in _STRAIGHT:
            raise fault(
                "machine-coordinates-motion",
                f"{special.word.written} goes with G0 and G1 only",
                special.word,
            )
        return motion

    def move(self, words: LineWords, motion: G | None, explicit: Code | None = None) -> None:
        """Make the move that :meth:`check` found; ``explicit`` is the line's own motion code, if it
        has one.
        """
        if motion is None:
            return
        code = explicit.word if explicit else None
        if motion == G.G0:
            self.traverse(self.target(words, "G0", self.position, machine=self._machine_words))
        elif motion == G.G1:
            at = code or words.first_axis()
            end = self.target(words, "G1", self.position, machine=self._machine_words)
            self.feed_to(end, self.feed(words, end, self.distance(end), at))
        elif motion in _ARCS:
            self.arcs.move(words, motion, code)
        else:
            if motion in _CURVES:
                self.compensation.refuse_curve(code)
            self.handlers[motion](words, explicit)

    def traverse(self, end: list[float]) -> None:
        """A straight move as fast as the axes allow, to a machine position."""
        self.feed_to(end, math.nan)

    def feed_to(self, end: list[float], feed: float) -> None:
        """A straight move at ``feed`` mm/s, to a machine position."""
        if self.compensation.active:
            self.compensation.move(end, feed, self._here.line)
        else:
            self._out.move(end, feed, self._here.line)
        self.position = end

    def arc(self, block: ArcFeed) -> None:
        """An arc from the position."""
        if self.compensation.active:
            self.compensation.arc(block)
        else:
            self._out.add(block)
        self.position = block.end.tolist()

    def spline(self, block: NurbsFeed) -> None:
        """A spline from the position."""
        self._out.add(block)
        self.position = block.control_points[-1].tolist()

    # Words to coordinates

    def axis_values(self, words: LineWords, user: str) -> dict[int, float]:
        """Takes the axis words of a line: mm or degrees by axis index, no offset applied."""
        found: dict[int, float] = {}
        for letter in [letter for letter in words.rest if letter in AXES]:
            index = self.column.get(letter)
            if letter not in self._dialect.axes:
                raise fault(
                    "axis-not-in-dialect",
                    f"{letter} is no axis in the {self._dialect.name} dialect",
                    words.rest[letter],
                )
            if index is None:
                hint = f"its axes are {' '.join(self.axes).upper()}"
                raise fault(
                    "axis-missing", f"the machine has no {letter} axis", words.rest[letter], hint
                )
            word = words.take(letter, user)
            assert word is not None
            found[index] = word.number * self.scales[index]
        if not POLAR.isdisjoint(words.rest):
            self._polar(words, user, found)
        return found

    def _polar(self, words: LineWords, user: str, found: dict[int, float]) -> None:
        """Takes @ and ^: X and Y of what was ``found``."""
        at, x, y = polar.first_polar(words), self.column.get("X"), self.column.get("Y")
        if self._dialect.flavour != "ngc":
            raise fault(
                "syntax-not-in-dialect",
                f"polar coordinates are not in the {self._dialect.name} dialect",
                at,
            )
        if (
            user not in _POLAR_USERS
            or self._machine_words
            or (user in _CYCLES and not self._state.absolute)
        ):
            taker = (
                "G53" if self._machine_words else f"{user} under G91" if user in _CYCLES else user
            )
            raise fault("polar-not-here", f"{taker} takes no polar coordinates", at, "give X and Y")
        if self._state.plane != "XY":
            raise fault(
                "polar-plane",
                f"polar coordinates in the {self._state.plane} plane",
                at,
                "give G17: they are of X and Y",
            )
        if x is None or y is None:
            raise fault("axis-missing", "polar coordinates need the axes X and Y", at)
        if {x, y} & found.keys():
            raise fault("polar-and-axis", "X and Y can't stand beside polar coordinates", at)
        program = self.coordinates.to_program(self.position)
        found[x], found[y] = polar.point(
            words, user, (program[x], program[y]), self._state.scale, absolute=self._state.absolute
        )

    def target(
        self, words: LineWords, user: str, start: list[float], *, machine: bool = False
    ) -> list[float]:
        """The machine position that a line's axis words mean, seen from ``start``; axes without a
        word stay there.
        """
        return self.reached(self.axis_values(words, user), start, machine=machine)

    def reached(
        self, values: dict[int, float], start: list[float], *, machine: bool = False
    ) -> list[float]:
        """The machine position that axis values mean, seen from ``start``."""
        end = start.copy()
        coordinates = self.coordinates
        if machine:
            for index, value in values.items():
                end[index] = value
        elif not coordinates.rotation:
            absolute, zero = self._state.absolute, coordinates.zero
            for index, value in values.items():
                if absolute:
                    end[index] = value + zero[index]
                else:
                    end[index] += value
        elif self._state.absolute:
            program = coordinates.to_program(start)
            for index, value in values.items():
                program[index] = value
            turned = coordinates.to_machine(program)
            # An axis that nothing moves stays where it is to the bit.
            plane = {self.column.get("X"), self.column.get("Y")}
            for index in {*values, *(plane if plane & values.keys() else ())} - {None}:
                end[index] = turned[index]
        else:
            delta = [values.get(index, 0.0) for index in range(len(end))]
            end = [here + step for here, step in zip(start, coordinates.turned(delta), strict=True)]
        return end

    # Feed

    def distance(self, end: list[float]) -> float:
        """Length of a straight move as feeds count it: over x y z if one of them moves, else over u
        v w, else over a b c.
        """
        for group in ("xyz", "uvw", "abc"):
            length = math.hypot(
                *(
                    end[i] - self.position[i]
                    for i, letter in enumerate(self.axes)
                    if letter in group
                )
            )
            if length > 0:
                return length
        return 0.0

    def feed(self, words: LineWords, end: list[float], length: float, at: Word) -> float:
        """The feed of a move in mm/s, or deg/s if only rotary axes move. ``at`` is the word that an
        error points at.
        """
        state = self._state
        if state.feed_mode == "inverse-time":
            return self._inverse_time(words, length, at)
        feed = state.feed
        if feed is None:
            raise fault("feed-missing", "a feed move without a feed in effect", at, "give F")
        self._waiting.used("F")
        rate = self.straight_feed(end, feed)
        if state.feed_mode == "per-revolution":
            rate *= self.spindle_rpm(end, at) / 60.0
            if rate < MIN_FEED:
                raise fault("feed-too-slow", "the feed is next to nothing", at)
        return rate

    def straight_feed(self, end: list[float], feed: Feed) -> float:
        """The feed of linear axes, or that of rotary axes if they move alone."""
        if self._has_rotary:
            moved = [there != here for there, here in zip(end, self.position, strict=True)]
            if any(moved) and not any(
                moves for moves, linear in zip(moved, self._linear, strict=True) if linear
            ):
                return feed.rotary
        return feed.linear

    def _inverse_time(self, words: LineWords, length: float, at: Word) -> float:
        word = words.take("F", "G93")
        if word is None:
            raise fault(
                "feed-missing",
                "under G93 every move needs an F word",
                at,
                "give F, one over the minutes of the move",
            )
        if word.number <= 0:
            raise fault("feed-not-positive", f"{word.written}: the feed must be more than 0", word)
        # A move of no length takes no time whatever the rate is; any positive feed says so.
        rate = per_second(word.number * (length or 1.0))
        if length and rate < MIN_FEED:
            raise fault("feed-too-slow", f"{word.written}: the feed is next to nothing", word)
        return rate

    def spindle_rpm(self, end: list[float], at: Word) -> float:
        """Turns a minute on the way to ``end``: under G96 the fewest, those at the largest
        radius.
        """
        state = self._state
        if state.spindle == "off" or not state.speed:
            raise fault(
                "spindle-stopped",
                f"{at.written} counts turns of the spindle, which does not turn",
                at,
                "give S and M3 before",
            )
        if not state.constant_surface:
            return state.speed
        x = self.column.get("X")
        radius = (
            0.0
            if x is None
            else max(abs(self.coordinates.to_program(place)[x]) for place in (self.position, end))
        )
        rpm = surface_rpm(state.speed, state.most_rpm, radius)
        if math.isinf(rpm):
            raise fault(
                "spindle-speed-unlimited",
                "on the axis G96 asks for any speed",
                at,
                "limit it with D in the line of G96",
            )
        return rpm

    # The quick way

    def quick(self, move: QuickMove) -> bool:
        """Make a move of the plainest kind, under G94 and with no rotation; False, and nothing
        done, where it needs a closer look.
        """
        state, parameters, scales = self._state, self.coordinates.parameters, self.scales
        motion = state.motion if move.motion is None else move.motion
        feed = state.feed
        is_arc = motion in _ARCS
        if (
            motion is None
            or motion not in QUICK_MOTIONS
            or bool(move.arc) != is_arc
            or (is_arc and state.arc_absolute)
        ):
            return False
        waiting = self._waiting
        if (
            move.feed is not None
            and waiting.watching
            and (motion == _TRAVERSE or "F" in waiting.words)
        ):
            return False
        try:
            if move.feed is not None:
                value = move.feed if move.feed.__class__ is float else move.feed(parameters)  # type: ignore[operator]
                if not 0.0 < value <= MAX_NUMBER:
                    return False
                feed = feed_of(value, state.scale)
                if feed.rotary < MIN_FEED:
                    return False
            position = self.position
            end = position.copy()
            zero = self.coordinates.zero
            absolute = state.absolute
            for index, number in move.axes:
                value = number if number.__class__ is float else number(parameters)  # type: ignore[operator]
                if not -MAX_NUMBER <= value <= MAX_NUMBER:
                    return False
                end[index] = (
                    value * scales[index] + zero[index]
                    if absolute
                    else end[index] + value * scales[index]
                )
            if motion == _TRAVERSE:
                rate = math.nan
            elif feed is None:
                return False
            elif not is_arc:
                rate = self.straight_feed(end, feed)
            else:
                arc = self.arcs.quick(move, motion, end, self.straight_feed(end, feed))
        except GcodeError:
            return False
        if not is_arc:
            self.feed_to(end, rate)
        elif arc is None:
            return False
        else:
            self.arc(arc)
        if motion != _TRAVERSE and waiting.words:
            waiting.used("F")
        state.feed = feed
        state.motion = motion
        return True
