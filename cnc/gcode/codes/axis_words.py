"""Axis words of a line as machine positions.

The position is kept in machine coordinates: offsets and units change the meaning of words, never
the position.
"""

from __future__ import annotations

from collections.abc import Iterable

from cnc.gcode.codes import polar
from cnc.gcode.codes.polar_mode import PolarMode
from cnc.gcode.state.context import Context, Executor
from cnc.gcode.state.coordinates import Coordinates
from cnc.gcode.state.rotary_axes import RotaryAxes
from cnc.gcode.syntax.words import AXES, POLAR, LineWords, Word, fault
from cnc.kernels.gcode.rules import end_of_word
from cnc.kernels.jit import interpreted
from cnc.model.blocks import ROTARY_LETTERS

_end_of_word = interpreted(end_of_word)
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
        axes: tuple[str, ...],
        position: list[float],
        coordinates: Coordinates,
    ) -> None:
        super().__init__(context)
        self.position = position
        self._idle: set[str] = set()
        self.polar = PolarMode()
        self._polar_end: tuple[float, float] | None = None
        self.rotary = RotaryAxes(axes, {}, context.dialect.wrap)
        self.axes = axes
        self.column = {letter.upper(): index for index, letter in enumerate(axes)}
        self.coordinates = coordinates
        self.scales: list[float] = []
        self.turns_linearly = False
        self.length_change: tuple[float, int] | None = None
        self._linear = [letter not in ROTARY_LETTERS for letter in axes]
        self._has_rotary = not all(self._linear)
        self._machine_words = False
        self.units_changed()

    def units_changed(self) -> None:
        """Compute the scales again after G20, G21, G7, G8, or G90 and G91 under DIAM90."""
        state = self._state
        self.scales = [state.scale if linear else 1.0 for linear in self._linear]
        if "X" in self.column:
            self.scales[self.column["X"]] *= state.x_factor(absolute=state.absolute)

    @property
    def has_direction_words(self) -> bool:
        """Whether A3=, B3= and C3= are the direction of the tool."""
        return self._dialect.flavour == "siemens"

    @property
    def rotary_columns(self) -> list[int]:
        """Columns of the rotary axes."""
        return [column for column, linear in enumerate(self._linear) if not linear]

    # Words to coordinates

    def needs_interpreter(self, index: int) -> bool:
        """Return whether compiled code does not know the moves of an axis."""
        all_axes = self._dialect.feed_of_all_axes and not self._linear[index]
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
        found: dict[int, float] = {}
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
            found[index] = word.number * self.scales[index]
            if self.rotary.wrapped and self._state.absolute and user in _MOVES:
                self.rotary.check(index, word.number, word)
            if word.letter != letter and self._state.absolute:
                found[index] += self.coordinates.to_program(self.position)[index]
        if not POLAR.isdisjoint(words.rest):
            self._polar(words, user, found)
        if user in _POLAR_USERS and found and not self._machine_words:
            if self.coordinates.figure_is_new:
                self._check_first_point(words, found)
            if self.polar.plane is not None:
                self._polar_mode(found, self.polar.plane)
        return found

    def _check_first_point(self, words: LineWords, found: dict[int, float]) -> None:
        """Refuse one axis of a new rotation: controllers differ on the other one's coordinate."""
        plane = self.coordinates.figure.plane
        given = [index for index in plane or () if index in found]
        if len(given) == 1 and self._state.absolute:
            letter = self.axes[given[0]].upper()
            raise fault(
                "rotation-first-point",
                f"{letter} alone in the first move after G68",
                words.users[letter][1],
                "give both axes of the plane",
            )
        if given and self._state.absolute:
            self.coordinates.figure_is_new = False

    def in_polar_mode(self, values: dict[int, float]) -> bool:
        """Return whether values by column have a radius or an angle of G16."""
        return self.polar.plane is not None and not values.keys().isdisjoint(self.polar.plane)

    def _polar_mode(self, found: dict[int, float], plane: tuple[int, int]) -> None:
        """Replace radius and angle of G16 by the two axis values."""
        i, j = plane
        if not self.in_polar_mode(found):
            return
        absolute, scale = self._state.absolute, self.scales[j]
        angle = found[j] / scale if j in found else None
        program = self.coordinates.to_program(self.position)
        here = program[i], program[j]
        x, y = self.polar.place(found.get(i), angle, here, absolute=absolute)
        found[i], found[j] = (x, y) if absolute else (x - here[0], y - here[1])

    def _take_idle(self, words: LineWords, letter: str, user: str) -> None:
        """Take a word of 0 for an axis that the machine lacks, and report it once."""
        word = words.take(letter, user)
        assert word is not None
        if letter not in self._idle:
            self._idle.add(letter)
            message = f"{word.written}: the machine has no {letter} axis; its words of 0 do nothing"
            self._here.report_warning("axis-idle", message, word)

    def _polar(self, words: LineWords, user: str, found: dict[int, float]) -> None:
        """Take @ and ^ and add X and Y to the values found."""
        at = polar.first_polar(words)
        x, y = self._polar_columns(at, user)
        if {x, y} & found.keys():
            raise fault("polar-and-axis", "X and Y can't stand beside polar coordinates", at)
        program = self.coordinates.to_program(self.position)
        here, absolute = (program[x], program[y]), self._state.absolute
        siemens = self._dialect.flavour == "siemens"
        if siemens:
            polar.refuse_other_start(words, here, self._polar_end)
        point = polar.point(words, user, here, self._state.scale, absolute=absolute)
        found[x], found[y] = point
        if siemens:
            self._polar_end = point if absolute else (here[0] + point[0], here[1] + point[1])

    def polar_steps(self, words: LineWords, user: str) -> tuple[float, float] | None:
        """Take @ and ^ under G91 as steps of the radius (mm) and the angle (degrees).

        None under G90, and without such a word.

        Raises:
            GcodeError: ``polar-at-origin``, and those of a place for polar coordinates.
        """
        at = polar.first_polar(words)
        if at is None or self._state.absolute:
            return None
        x, y = self._polar_columns(at, user)
        program = self.coordinates.to_program(self.position)
        return polar.steps(words, user, (program[x], program[y]), self._state.scale)

    def _polar_columns(self, at: Word | None, user: str) -> tuple[int, int]:
        """Return the columns of X and Y, after checks that polar coordinates may stand here."""
        x, y = self.column.get("X"), self.column.get("Y")
        if self._dialect.flavour not in ("ngc", "siemens"):
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
        if same_line and self._dialect.length_in_increments == "added":
            return change
        message = (
            f"{at.written} under G91 is the first move along Z after a new tool length: FANUC adds "
            f"its change of {change:g} mm, others do not"
        )
        hint = "give Z under G90 first"
        if self._dialect.length_in_increments == "unclear":
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
