"""Axis words of a line as machine positions.

The position is kept in machine coordinates: offsets and units change the meaning of words, never
the position.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import interpreted
from cnc.gcode.core.context import Context, Executor
from cnc.gcode.core.coordinates import RotaryAxes
from cnc.gcode.core.modal_groups import Feed, check_feed, feed_of
from cnc.gcode.kernels import arithmetic
from cnc.gcode.kernels.rules import (
    MIN_FEED,
    end_of_word,
    feed_of_move,
    feed_of_time,
    length_of_move,
)
from cnc.gcode.reader.words import AXES, POLAR, LineWords, Word, fault
from cnc.model.blocks import ROTARY_LETTERS
from cnc.model.diagnostics import GcodeError

_end_of_word = interpreted(end_of_word)
_cosine, _sine = interpreted(arithmetic.cosine), interpreted(arithmetic.sine)

# Polar coordinates: ``@`` is the distance and ``^`` the angle of a point in X and Y.
#
# They count from the zero of the coordinate system, and under G91 from those of the present
# position. A missing word leaves its value as it is. SINUMERIK keeps the words of the last polar
# point (AP, RP) instead, so both are needed where the position is another one. Sources: LinuxCNC,
# "G-code overview", polar coordinates; Siemens, "SINUMERIK 840D sl/828D Programming Manual,
# Fundamentals", AP and RP.

_SAME = 1e-6
"""Distance of two equal places, mm."""
_NO_ANGLE = 1e-9
"""Distance from the zero within which the angle of a place is rounding, mm."""


def first_polar(words: LineWords) -> Word | None:
    """The leftmost remaining polar word."""
    return min(
        (word for letter, word in words.rest.items() if letter in POLAR),
        key=lambda word: word.column,
        default=None,
    )


def polar_point(
    words: LineWords, user: str, here: tuple[float, float], scale: float, *, absolute: bool
) -> tuple[float, float]:
    """Take the polar words of a line and return X and Y in mm, incremental if the line is.

    Args:
        words: The words of the line.
        user: Code that takes them, for messages.
        here: Present X and Y in the coordinate system, mm.
        scale: mm of a program unit.
        absolute: Whether G90 is in effect.

    Raises:
        GcodeError: ``polar-at-origin``.
    """
    if not absolute:
        x, y = stepped(here, *steps(words, user, here, scale))
        return x - here[0], y - here[1]
    if math.hypot(*here) < _NO_ANGLE and "^" not in words.rest:
        hint = "give ^ too, or X and Y"
        raise fault("polar-at-origin", "the zero point has no angle", first_polar(words), hint)
    radius, angle = math.hypot(*here), math.degrees(math.atan2(here[1], here[0]))
    if word := words.take("@", user):
        radius = word.number * scale
    if word := words.take("^", user):
        angle = word.number
    return radius * _cosine(angle), radius * _sine(angle)


def steps(
    words: LineWords, user: str, here: tuple[float, float], scale: float
) -> tuple[float, float]:
    """Take the polar words of a line under G91: increments of the radius (mm) and of the angle.

    Raises:
        GcodeError: ``polar-at-origin``.
    """
    if math.hypot(*here) < _NO_ANGLE:
        raise fault(
            "polar-at-origin",
            "at the zero point a polar increment has no direction",
            first_polar(words),
            "give G90, or X and Y",
        )
    distance, angle = words.take("@", user), words.take("^", user)
    return (distance.number * scale if distance else 0.0), (angle.number if angle else 0.0)


def stepped(
    here: tuple[float, float], radius: float, angle: float, count: int = 1
) -> tuple[float, float]:
    """Return the point after a number of equal polar steps from a point, mm and degrees."""
    reached = math.hypot(*here) + count * radius
    turned = math.degrees(math.atan2(here[1], here[0])) + count * angle
    return reached * _cosine(turned), reached * _sine(turned)


def refuse_other_start(
    words: LineWords, here: tuple[float, float], last: tuple[float, float] | None
) -> None:
    """Refuse a radius or an angle alone where the position is not the last polar point.

    Raises:
        GcodeError: ``polar-word-missing``.
    """
    if words.rest.keys() >= set(POLAR):
        return
    if last is None or math.dist(here, last) > _SAME:
        message = "AP or RP alone, and the position is not the last polar point"
        hint = "give AP and RP: the control keeps the last values of both"
        raise fault("polar-word-missing", message, first_polar(words), hint)


# Polar coordinates by axis words (G15, G16).
#
# Under G16 the word of the plane's first axis is a radius and that of the second an angle in
# degrees. Under G90 they count from the zero of the coordinate system; in Mach3 from the position
# at G16. Under G91 a radius counts from the present position, and an angle from the last one.
# Sources: FANUC Series 0i operator's manual, "Polar coordinate command (G15, G16)"; "Using
# Mach3Mill", G15 and G16.

Point = tuple[float, float]


class PolarMode:
    """The mode and the last radius and angle.

    Attributes:
        plane: Columns of the plane's axes while the mode is on, or None.
    """

    def __init__(self) -> None:
        self.plane: tuple[int, int] | None = None
        self._origin: Point = (0.0, 0.0)
        self._centre: Point = (0.0, 0.0)
        self._radius = self._angle = 0.0
        self._words: tuple[float | None, float | None] = (None, None)

    def begin(
        self, plane: tuple[int, int], program: list[float], at: Word, *, from_here: bool
    ) -> None:
        """Begin the mode (G16).

        Args:
            plane: Columns of the plane's axes.
            program: (axes,) present position in program coordinates, mm.
            at: Word at which errors are reported.
            from_here: Count from the present position, not from the zero.

        Raises:
            GcodeError: ``polar-active``.
        """
        if self.plane is not None and self.plane != plane:
            raise fault("polar-active", f"{at.written} in another plane", at, "give G15 before")
        x, y = program[plane[0]], program[plane[1]]
        self._origin = (x, y) if from_here else (0.0, 0.0)
        self.plane, self._centre = plane, self._origin
        x, y = x - self._origin[0], y - self._origin[1]
        self._radius, self._angle = math.hypot(x, y), math.degrees(math.atan2(y, x))

    def end(self) -> None:
        """End the mode (G15)."""
        self.plane = None

    def place(
        self, radius: float | None, angle: float | None, here: Point, *, absolute: bool
    ) -> Point:
        """Return the point of a radius (mm) and an angle (degrees), and keep them.

        Args:
            radius: None if the line has none.
            angle: None if the line has none.
            here: Present position in the plane, in program coordinates, mm.
            absolute: Whether G90 is in effect.
        """
        self._words = radius, angle
        if absolute:
            self._centre = self._origin
            self._angle = self._angle if angle is None else angle
        else:
            self._angle += angle or 0.0
            if radius is not None:
                self._centre = here
        self._radius = self._radius if radius is None else radius
        return (
            self._centre[0] + self._radius * _cosine(self._angle),
            self._centre[1] + self._radius * _sine(self._angle),
        )

    def again(self, here: Point) -> Point:
        """Return the point of the last words once more, counted from ``here`` under G91."""
        return self.place(*self._words, here, absolute=False)


_CYCLES = frozenset(
    ("G73", "G74", "G76", "G81", "G82", "G83", "G84", "G85", "G86", "G87", "G88", "G89")
)
_MOVES = frozenset(("G0", "G1", "G2", "G3"))
_HOMES = frozenset(("G28", "G30"))
_POLAR_USERS = _CYCLES | _MOVES | {"G38.2", "G38.3", "G38.4", "G38.5"}
"""Codes whose point may be given by @ and ^.

A cycle under G91 would need a new increment for each repeat.
"""


class AxisWords(Executor):
    """Conversion of axis words.

    Attributes:
        position: Programmed machine position, mm or degrees.
        axes: Letters of the machine's axes.
        column: Index of each axis, by upper-case letter.
        in_plane: Index of the axis that stands for each axis of a plane, by upper-case letter.
        scales: mm or degrees of a unit of each axis word.
        coordinates: The coordinate systems.
        polar: The mode of polar coordinates (G16).
        rotary: The rotary axes that repeat after 360 degrees.
        turns_linearly: Whether a direction of the tool turns the rotary axes linearly.
        length_change: Change of the tool offset along Z that no move along Z followed yet, mm, and
            its line; None in dialects where increments leave it out.
    """

    def __init__(
        self,
        context: Context,
        position: list[float],
    ) -> None:
        super().__init__(context)
        self.coordinates = context.coordinates
        self.axes = axes = self.coordinates.axes
        self.position = position
        self._idle: set[str] = set()
        self.polar = PolarMode()
        self._polar_end: tuple[float, float] | None = None
        self.rotary = RotaryAxes(axes, context.policy.wraps, context.dialect.motion.wrap)
        self.column = {letter.upper(): index for index, letter in enumerate(axes)}
        self.in_plane = self.column
        self.scales: list[float] = []
        self.turns_linearly = False
        self.length_change: tuple[float, int] | None = None
        self._linear = [letter not in ROTARY_LETTERS for letter in axes]
        self._has_rotary = not all(self._linear)
        self.groups = ["xyzuvwabc".index(letter) // 3 for letter in axes]
        """Groups of the axes, as of :func:`length_of_move`."""
        self._machine_words = False
        self._real = self.column, self.rotary, 0, 0
        self._virtual_unit: tuple[int, float] | None = None
        self.units_changed()

    def units_changed(self) -> None:
        """Compute the scales again after G20, G21, G7, G8, or G90 and G91 under DIAM90."""
        state = self._state
        self.scales = [state.scale if linear else 1.0 for linear in self._linear]
        if "X" in self.column:
            self.scales[self.column["X"]] *= state.x_factor(absolute=state.absolute)
        if self._virtual_unit is not None:
            column, unit = self._virtual_unit
            self.scales[column] = unit

    def begin_virtual(
        self, column: int, letter: str, *, unit: float | None = None, in_plane: str = ""
    ) -> None:
        """Let a rotary axis be a linear one.

        Args:
            column: Column of the axis.
            letter: Letter of its words, beside its own.
            unit: mm of a unit of its words; None for the units of the program.
            in_plane: Letters of the planes' axes for which it stands, besides ``letter``.
        """
        self._real = self.column, self.rotary, self.groups[column], column
        self.column = self.column | {letter: column}
        self.in_plane = self.column | dict.fromkeys(in_plane, column)
        self.rotary = RotaryAxes(self.axes, {}, self._dialect.motion.wrap)
        self._linear[column], self.groups[column] = True, 0
        self._virtual_unit = None if unit is None else (column, unit)
        self.units_changed()

    def end_virtual(self) -> None:
        """End :meth:`begin_virtual`."""
        self.column, self.rotary, group, column = self._real
        self.in_plane, self.groups[column] = self.column, group
        self._linear[column], self._virtual_unit = False, None
        self.units_changed()

    @property
    def has_direction_words(self) -> bool:
        """Whether A3=, B3= and C3= are the direction of the tool."""
        return self._dialect.motion.direction_words

    @property
    def rotary_columns(self) -> list[int]:
        """Columns of the rotary axes."""
        return [column for column, linear in enumerate(self._linear) if not linear]

    # Words to coordinates

    def needs_interpreter(self, index: int) -> bool:
        """Return whether compiled code does not know the moves of an axis."""
        all_axes = self._dialect.feed.of_all_axes and not self._linear[index]
        return all_axes or self.rotary.has(index)

    def turn_directions(self, text: str) -> None:
        """Set the direction of an axis for its word in this line: its letter and the direction.

        TOOL and ``linear`` or ``circle`` say how the tool turns to a direction from here on.
        """
        letter, direction = text.split()
        if letter == "TOOL":
            self.turns_linearly = direction == "linear"
        elif letter in self.column:
            self.rotary.turn(self.column[letter], direction)

    def axis_values(self, words: LineWords, user: str) -> dict[int, float]:
        """Take the axis words of a line.

        Args:
            words: The words of the line.
            user: Code that takes them, for messages.

        Returns:
            mm or degrees by column, without offsets.

        Raises:
            GcodeError: ``axis-not-in-dialect``, ``axis-missing``, and the errors of polar
                coordinates.
        """
        values: dict[int, float] = {}
        for letter in [letter for letter in words.rest if letter in AXES]:
            index = self.column.get(letter)
            if letter not in self._dialect.axes:
                raise fault(
                    "axis-not-in-dialect",
                    f"{letter} is not an axis in the {self._dialect.name} dialect",
                    words.rest[letter],
                )
            if index is None and self._dialect.lenient and words.rest[letter].number == 0.0:
                self._take_idle(words, letter, user)
                continue
            if index is None:
                hint = f"its axes are {' '.join(self.axes).upper()}"
                raise fault(
                    "axis-missing", f"the machine has no {letter} axis", words.rest[letter], hint
                )
            word = words.take(letter, user)
            assert word is not None
            values[index] = word.number * self.scales[index]
            if self.rotary.wrapped and self._state.absolute and user in _MOVES:
                self.rotary.check(index, word.number, word)
            if word.letter != letter and self._state.absolute:
                values[index] += self.coordinates.to_program(self.position)[index]
        if not POLAR.isdisjoint(words.rest):
            self._polar(words, user, values)
        if user in _POLAR_USERS and values and not self._machine_words:
            if self.coordinates.transform_is_new:
                self._check_first_point(words, values)
            if self.polar.plane is not None:
                self._polar_mode(values, self.polar.plane)
        return values

    def _check_first_point(self, words: LineWords, values: dict[int, float]) -> None:
        """Refuse one axis of a new rotation: controllers differ on the other one's coordinate."""
        plane = self.coordinates.transform.plane
        given = [index for index in plane or () if index in values]
        if len(given) == 1 and self._state.absolute:
            letter = self.axes[given[0]].upper()
            raise fault(
                "rotation-first-point",
                f"{letter} alone in the first move after G68",
                words.users[letter][1],
                "give both axes of the plane",
            )
        if given and self._state.absolute:
            self.coordinates.transform_is_new = False

    def in_polar_mode(self, values: dict[int, float]) -> bool:
        """Return whether values by column have a radius or an angle of G16."""
        return self.polar.plane is not None and not values.keys().isdisjoint(self.polar.plane)

    def _polar_mode(self, values: dict[int, float], plane: tuple[int, int]) -> None:
        """Replace radius and angle of G16 by the two axis values."""
        i, j = plane
        if not self.in_polar_mode(values):
            return
        absolute, scale = self._state.absolute, self.scales[j]
        angle = values[j] / scale if j in values else None
        program = self.coordinates.to_program(self.position)
        here = program[i], program[j]
        x, y = self.polar.place(values.get(i), angle, here, absolute=absolute)
        values[i], values[j] = (x, y) if absolute else (x - here[0], y - here[1])

    def _take_idle(self, words: LineWords, letter: str, user: str) -> None:
        """Take a word of 0 for an axis that the machine lacks, and report it once."""
        word = words.take(letter, user)
        assert word is not None
        if letter not in self._idle:
            self._idle.add(letter)
            message = f"{word.written}: the machine has no {letter} axis; its words of 0 do nothing"
            self._here.report_warning("axis-idle", message, word)

    def _polar(self, words: LineWords, user: str, values: dict[int, float]) -> None:
        """Take @ and ^ and add X and Y to the values found."""
        at = first_polar(words)
        x, y = self._polar_columns(at, user)
        if {x, y} & values.keys():
            raise fault("polar-and-axis", "X and Y can't stand beside polar coordinates", at)
        program = self.coordinates.to_program(self.position)
        here, absolute = (program[x], program[y]), self._state.absolute
        siemens = self._dialect.motion.polar == "siemens"
        if siemens:
            refuse_other_start(words, here, self._polar_end)
        point = polar_point(words, user, here, self._state.scale, absolute=absolute)
        values[x], values[y] = point
        if siemens:
            self._polar_end = point if absolute else (here[0] + point[0], here[1] + point[1])

    def polar_steps(self, words: LineWords, user: str) -> tuple[float, float] | None:
        """Take @ and ^ under G91 as steps of the radius (mm) and the angle (degrees).

        None under G90, and without such a word.

        Raises:
            GcodeError: ``polar-at-origin``, and those of a place for polar coordinates.
        """
        at = first_polar(words)
        if at is None or self._state.absolute:
            return None
        x, y = self._polar_columns(at, user)
        program = self.coordinates.to_program(self.position)
        return steps(words, user, (program[x], program[y]), self._state.scale)

    def _polar_columns(self, at: Word | None, user: str) -> tuple[int, int]:
        """Return the columns of X and Y, after checks that polar coordinates may stand here."""
        x, y = self.column.get("X"), self.column.get("Y")
        if not self._dialect.motion.polar:
            raise fault(
                "syntax-not-in-dialect",
                f"polar coordinates are not in the {self._dialect.name} dialect",
                at,
            )
        if user not in _POLAR_USERS or self._machine_words:
            taker = "G53" if self._machine_words else user
            raise fault(
                "polar-not-here", f"{taker} does not take polar coordinates", at, "give X and Y"
            )
        if self._state.plane != "XY":
            raise fault(
                "polar-plane",
                f"polar coordinates in the {self._state.plane} plane",
                at,
                "give G17: polar coordinates are X and Y",
            )
        if x is None or y is None:
            raise fault("axis-missing", "polar coordinates need the axes X and Y", at)
        return x, y

    def target(
        self, words: LineWords, user: str, start: list[float], *, machine: bool = False
    ) -> list[float]:
        """Take the axis words of a line and return the machine position of its end.

        Args:
            words: The words of the line.
            user: Code that takes them, for messages.
            start: (axes,) position that increments count from. Axes without a word stay there.
            machine: The words are machine coordinates (G53).
        """
        values = self.axis_values(words, user)
        if self.length_change is not None and "Z" in words.users:
            absolute = machine or user in _HOMES or self._state.absolute
            change = self.take_length_change(words.users["Z"][1], absolute=absolute)
            values[self.column["Z"]] += change
        return self.reached(values, start, machine=machine)

    def take_length_change(self, at: Word, *, absolute: bool, moves: bool = True) -> float:
        """Return the distance that a new tool length adds to the first move along Z after it.

        Args:
            at: The word of the move.
            absolute: Whether it gives a position, which the change adds nothing to.
            moves: Whether it is a plain move, and not a cycle.

        Raises:
            GcodeError: ``tool-length-incremental``, where controllers differ.
        """
        change, line = self.length_change or (0.0, 0)
        self.length_change = None
        if change != change:
            message = (
                f"{at.written} moves under the G43 of the tool before the change in line {line}"
            )
            hint = "give G43 in the first line with Z after the tool change, or G44 before it"
            raise fault("tool-length-open", message, at, hint)
        if absolute or change == 0.0:
            return 0.0
        same_line = moves and line == self._here.line
        if same_line and self._dialect.tools.length_in_increments == "added":
            return change
        message = (
            f"{at.written} under G91 is the first move along Z after a new tool length: FANUC adds "
            f"its change of {change:g} mm, others do not"
        )
        hint = "give Z under G90 first"
        if self._dialect.tools.length_in_increments == "unclear":
            hint += ", or name the --dialect"
        raise fault("tool-length-incremental", message, at, hint)

    def reached(
        self, values: dict[int, float], start: list[float], *, machine: bool = False
    ) -> list[float]:
        """Return the machine position of axis values; arguments as of :meth:`target`."""
        coordinates = self.coordinates
        if not machine and not coordinates.turned:
            return self.shifted(values.items(), start)
        end = start.copy()
        if machine:
            for index, value in values.items():
                end[index] = value
                if self.rotary.wrapped and self.rotary.has(index):
                    end[index] = self.rotary.end(index, value, start[index])
        elif self._state.absolute:
            program = coordinates.to_program(start)
            for index, value in values.items():
                if self.rotary.wrapped and self.rotary.has(index):
                    value = self.rotary.end(index, value, program[index])
                program[index] = value
            turned = coordinates.to_machine(program)
            # Rounding must not move an axis without a value.
            for index in coordinates.coupled(set(values)):
                end[index] = turned[index]
        else:
            delta = [values.get(index, 0.0) for index in range(len(end))]
            end = [
                here + step for here, step in zip(start, coordinates.rotated(delta), strict=True)
            ]
        return end

    def shifted(self, values: Iterable[tuple[int, float]], start: list[float]) -> list[float]:
        """Return the machine position of axis values, if the coordinates are shifted only."""
        end, zero, absolute = start.copy(), self.coordinates.zero, self._state.absolute
        rotary = self.rotary
        for index, value in values:
            if rotary.wrapped and absolute and rotary.has(index):
                value = rotary.end(index, value, start[index] - zero[index])
            elif rotary.wrapped and not absolute and rotary.is_directed(index):
                here = start[index] - zero[index]
                value = rotary.end(index, here + value, here) - here
            end[index] = _end_of_word(value, start[index], zero[index], absolute)
        return end


# Feeds of moves in mm/s, or degrees/s where only rotary axes move.

_feed_of_move, _feed_of_time = interpreted(feed_of_move), interpreted(feed_of_time)
_length_of_move = interpreted(length_of_move)
_FEED_HINT = "write F and the feed in this line or before it, or use --default-feed"


class MoveFeeds(AxisWords):
    """Feeds of moves, from F and the mode of the feed."""

    _surface_radius = 0.0
    """Radius of the last move under G96 that was not on the axis, mm."""

    def distance(self, end: list[float]) -> float:
        """Length of a straight move for its feed, mm or degrees.

        It counts x y z if one of them moves, else u v w, else a b c.
        """
        return _length_of_move(self.position, end, self.groups)

    def feed(self, words: LineWords, end: list[float], length: float | None, at: Word) -> float:
        """Return the feed of a move in mm/s, or in deg/s if only rotary axes move.

        Args:
            words: The words of the line; an F under G93 is taken.
            end: (axes,) machine position of the end.
            length: mm, used under G93; None for that of a straight move.
            at: Word at which errors are reported.

        Raises:
            GcodeError: No feed is in effect, it is too slow, or the spindle does not turn.
        """
        state = self._state
        if state.feed_mode == "inverse-time":
            length = self.distance(end) if length is None else length
            return self._inverse_time(words, length, at)
        feed = state.feed
        if feed is None:
            feed = self._first_feed(words, at)
        self._unused_words.mark_used("F")
        rate = self.straight_feed(end, feed, length or 0.0)
        if state.feed_mode == "per-revolution":
            rate *= self.spindle_rpm(end, at) / 60.0
            if rate < MIN_FEED:
                raise fault("feed-too-slow", f"the feed is less than {MIN_FEED:g} mm/s", at)
        return rate

    def _first_feed(self, words: LineWords, at: Word) -> Feed:
        """Put the feed with which the controller begins into effect, with a warning."""
        first = self._dialect.feed.at_start
        if not first:
            raise _missing(words, at)
        message = f"no F before this move: the firmware begins with {first:g} mm/min"
        self._here.report_warning("feed-assumed", message, at, _FEED_HINT)
        self._state.feed = feed_of(first, 1.0)
        return self._state.feed

    def straight_feed(self, end: list[float], feed: Feed, length: float = 0.0) -> float:
        """Return the feed of linear axes, or of rotary axes if only they move.

        Args:
            end: (axes,) machine position of the end.
            feed: the feed in effect.
            length: length along the linear axes, mm; 0 for a straight move.
        """
        if self._has_rotary:
            steps = [there - here for there, here in zip(end, self.position, strict=True)]
            turned = [step for step, linear in zip(steps, self._linear, strict=True) if not linear]
            shifts, turns = any(compress(steps, self._linear)), any(turned)
            if self._dialect.feed.of_all_axes and shifts and turns:
                length = length or self.distance(end)
                return feed.linear * length / math.hypot(length, *turned)
            return _feed_of_move(feed.linear, feed.rotary, shifts, turns)
        return feed.linear

    def feed_of_rotary_curve(self, points: NDArray[np.float64]) -> float:
        """Return the ratio of the feed of a curve to that of linear axes.

        Args:
            points: (n, axes), control points.
        """
        moved = (points != points[0]).any(axis=0)
        feed = self._state.feed
        if feed is None or not moved.any() or moved[self._linear].any():
            return 1.0
        return feed.rotary / feed.linear

    def _inverse_time(self, words: LineWords, length: float, at: Word) -> float:
        word = words.take("F", "G93")
        if word is None:
            raise fault(
                "feed-missing",
                "under G93 every move needs an F word",
                at,
                "give F, one over the minutes of the move",
            )
        rate = _feed_of_time(word.number, length)
        # A move of length 0 takes no time at any feed.
        check_feed(word, rate if length else math.inf)
        return rate

    def spindle_rpm(self, end: list[float], at: Word) -> float:
        """Return the revolutions per minute of a move; under G96 at the largest radius."""
        state = self._state
        speed = self.context.spindle_speed(at.written, at)
        if not state.constant_surface:
            return speed
        radius = max(self._radius(self.position), self._radius(end))
        if radius > 0.0:
            self._surface_radius = radius
        elif self._surface_radius and not state.surface_limit:
            radius = self._surface_radius
            rpm = surface_rpm(speed, 0.0, radius)
            message = (
                f"{at.written} on the axis under G96 without a limit: the spindle has its highest "
                f"speed, which is not known; the feed is that of {rpm:.0f} rpm, as at X before"
            )
            hint = "limit the speed, such as G50 S2000"
            self._here.report_warning("spindle-speed-assumed", message, at, hint)
        rpm = max(surface_rpm(speed, state.surface_limit, radius), state.rpm_range[0])
        if math.isinf(rpm):
            raise fault(
                "spindle-speed-unlimited",
                "G96 gives an infinite spindle speed on the axis",
                at,
                "limit the speed: G50 S2000 on FANUC's and Haas' lathes, D in the line of G96 in "
                "LinuxCNC",
            )
        return rpm

    def _radius(self, place: list[float]) -> float:
        """Return the distance of a machine position from the axis of a lathe's spindle, mm."""
        x = self.column.get("X")
        return 0.0 if x is None else abs(self.coordinates.to_program(place)[x])

    def keep_surface_radius(self, end: list[float]) -> None:
        """Keep the radius of a traverse under G96, for a feed on the axis without a limit."""
        self._surface_radius = (
            self._radius(end) or self._radius(self.position) or self._surface_radius
        )


def _missing(words: LineWords, at: Word) -> GcodeError:
    """Return the error of a feed move without a feed."""
    for word in words.vacant:
        if word.letter == "F":
            message = f"{word.written} gives no feed: the variable is empty, and no F is before it"
            return fault("feed-missing", message, word, "set the variable, or use --default-feed")
    return fault("feed-missing", "a feed move without a feed in effect", at, _FEED_HINT)


def surface_rpm(speed: float, most_rpm: float, radius: float) -> float:
    """Return the revolutions per minute at a surface speed.

    Args:
        speed: Surface speed, mm/s.
        most_rpm: Limit; 0 for none.
        radius: mm. Without a limit the result for 0 is infinite.
    """
    rpm = speed * 60.0 / (math.tau * radius) if radius > 0.0 else math.inf
    return min(rpm, most_rpm) if most_rpm else rpm
