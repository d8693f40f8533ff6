"""Axis words and feeds of a line as machine positions and feeds in mm/s.

The position is kept in machine coordinates: offsets and units change the meaning of words, never
the position.
"""

from __future__ import annotations

import math

from cnc.gcode.codes import polar
from cnc.gcode.dialects import Dialect
from cnc.gcode.state.coordinates import Coordinates
from cnc.gcode.state.modal_groups import Feed, ModalState
from cnc.gcode.state.unused_words import UnusedWords
from cnc.gcode.syntax.words import AXES, POLAR, LineWords, Word, fault
from cnc.model.blocks import ROTARY_LETTERS
from cnc.model.units import per_second

MIN_FEED = 1e-6
"""mm/s. What is slower is a slip: a millimetre would take eleven days."""

_CYCLES = frozenset(
    ("G73", "G74", "G76", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89")
)
_POLAR_USERS = _CYCLES | {"G0", "G1", "G2", "G3", "G38.2", "G38.3", "G38.4", "G38.5"}
"""Codes whose point may be given by @ and ^; a cycle under G91 would have to count anew for each of
its repeats.
"""


class AxisWords:
    """Conversion of axis words and F.

    Attributes:
        position: Programmed machine position, mm or degrees.
        axes: Letters of the machine's axes.
        column: Index of each axis, by upper-case letter.
        scales: mm or degrees of a unit of each axis word.
        coordinates: The coordinate systems.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        dialect: Dialect,
        state: ModalState,
        position: list[float],
        coordinates: Coordinates,
        unused_words: UnusedWords,
    ) -> None:
        self.position = position
        self.axes = axes
        self.column = {letter.upper(): index for index, letter in enumerate(axes)}
        self.coordinates = coordinates
        self.scales: list[float] = []
        self._linear = [letter not in ROTARY_LETTERS for letter in axes]
        self._has_rotary = not all(self._linear)
        self._dialect = dialect
        self._state = state
        self._unused_words = unused_words
        self._machine_words = False
        self.units_changed()

    def units_changed(self) -> None:
        """Millimetres (or degrees) a unit of each axis word, after G20, G21, G7 or G8."""
        state = self._state
        self.scales = [state.scale if linear else 1.0 for linear in self._linear]
        if state.diameter and "X" in self.column:
            self.scales[self.column["X"]] *= 0.5

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
            end = [
                here + step for here, step in zip(start, coordinates.rotated(delta), strict=True)
            ]
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
        self._unused_words.mark_used("F")
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


def surface_rpm(speed: float, most_rpm: float, radius: float) -> float:
    """Turns a minute at a surface speed (mm/s) and a radius (mm): at most ``most_rpm`` where that
    is not 0; infinite on the axis.
    """
    rpm = speed * 60.0 / (math.tau * radius) if radius > 0.0 else math.inf
    return min(rpm, most_rpm) if most_rpm else rpm
