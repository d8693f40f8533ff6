"""Codes of coordinate systems, shifts and reference positions: G10 L2 and L20, G28 to G92.3.

G53 is only checked here; its effect on the axis words is in the move. Source: LinuxCNC, "G-codes";
FANUC, "Programmable data input", "Reference position return" and "Local coordinate system".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cnc.gcode.core.coordinates import EXTERNAL, SYSTEM_CODES, Transform
from cnc.gcode.core.modal_groups import PLAIN_MOTIONS, Code, Codes
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tip_control import refuse_under_tip_control
from cnc.gcode.core.tool_codes import ToolCodes
from cnc.gcode.core.tool_table import ToolEntry
from cnc.gcode.reader.parameters import KEPT_MACRO, MORE_MACRO
from cnc.gcode.reader.words import AXES, G, LineWords, Word, fault, under_compensation, whole
from cnc.gcode.turning.codes import set_turret_offset
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, PLANE_AXES

# Codes that transform the shape: G50, G51, G50.1, G51.1, G68, G68.2, G69; and G15, G16.
#
# Sources: FANUC Series 0i operator's manual, "Scaling (G50, G51)", "Programmable mirror image",
# "Coordinate system rotation (G68, G69)", "Tilted working plane indexing (G68.2)" and "Polar
# coordinate command (G15, G16)"; Haas, "Mill Operator's Manual", G51 (P is the factor itself);
# "Using Mach3Mill", G15, G50, G51, G68.

SMALLEST_FACTOR = 1e-6
_FACTORS = {"I": "X", "J": "Y", "K": "Z"}
_GROUPS = ("figure-polar", "figure-scaling", "figure-mirror", "figure-rotation")


def check_rotary_axes_at_zero(motion: Motion, at: Word) -> None:
    """Refuse a code of the tilted plane while a rotary axis is turned, as it may turn it back."""
    if any(motion.position[column] for column in motion.rotary_columns):
        message = f"{at.written} while a rotary axis is not at 0"
        raise fault("code-not-supported", message, at, "turn the rotary axes to 0 before")


class TransformCodes(MotionCodes):
    """Execution of these codes."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)

    def execute(self, words: LineWords, codes: Codes) -> None:
        """Execute the codes of a line, before its move."""
        for group in _GROUPS:
            if code := codes.get(group):
                self._execute(words, code)
        polar, plane = self._motion.polar.plane, codes.get("plane")
        if polar is not None and plane and self._plane(plane.word) != polar:
            message = f"{plane.word.written} under G16 of another plane"
            raise fault("polar-active", message, plane.word, "give G15 before")

    def _execute(self, words: LineWords, code: Code) -> None:
        at, transform = code.word, self._coordinates.transform
        if self._motion.compensated:
            raise under_compensation(at)
        match code.number:
            case G.G15:
                self._motion.polar.end()
            case G.G16:
                program = self._coordinates.to_program(self._motion.position)
                self._motion.polar.begin(
                    self._plane(at),
                    program,
                    at,
                    from_here=self._dialect.offsets.transforms == "mach3",
                )
            case G.G50:
                if self._state.scaled:
                    self._set(Transform.none(len(transform.factors)))
                self._state.scaled = False
            case G.G51:
                self._scale(words, at)
            case G.G50_1 | G.G51_1:
                self._mirror(words, code)
            case G.G68:
                self._rotate(words, at)
            case G.G68_2:
                self._place(words, at)
            case _:
                if transform.plane is not None:
                    self._set(Transform.none(len(transform.factors)))

    def _set(self, transform: Transform) -> None:
        self._coordinates.transform = transform

    def _plane(self, at: Word) -> tuple[int, int]:
        return self._motion.arcs.plane_columns(at, at.written)

    def _check_alone(self, at: Word) -> None:
        """Refuse a change inside another one: the controllers apply them in different orders."""
        transform = self._coordinates.transform
        if not transform.changes and not self._coordinates.rotation:
            return
        if self._coordinates.rotation:
            message = f"{at.written} in a rotated coordinate system (R of G10 L2)"
            hint = "use a coordinate system without R"
        else:
            now, end = (
                ("G68", "G69")
                if transform.plane is not None
                else ("G51", "G50")
                if self._state.scaled
                else ("G51.1", "G50.1")
            )
            message, hint = f"{at.written} under {now}", f"give {end} before"
        raise fault("figure-active", message, at, hint)

    # Scaling and mirroring

    def _scale(self, words: LineWords, at: Word) -> None:
        """G51 X Y Z P, or I J K for each axis. X Y Z is the centre, the position by default."""
        motion = self._motion
        if self._dialect.offsets.transforms == "mach3":
            self._scale_axes(words, at)
            return
        self._check_alone(at)
        here = self._coordinates.to_program(motion.position)
        centre = motion.axis_values(words, "G51")
        factors = [1.0] * len(here)
        common = words.take("P", "G51")
        each = {letter: word for letter in _FACTORS if (word := words.take(letter, "G51"))}
        if (common is None) == (not each):
            message = f"{at.written} needs P, or I, J and K: the factor"
            raise fault("scaling-factor", message, at, "such as G51 X0 Y0 Z0 P0.5")
        for letter, axis in _FACTORS.items():
            column = motion.column.get(axis)
            word = common or each.get(letter)
            if column is not None and word is not None:
                factors[column] = self._factor(word)
        fixed = tuple(centre.get(index, value) for index, value in enumerate(here))
        self._set(Transform(tuple(factors), fixed))
        self._state.scaled = True

    def _scale_axes(self, words: LineWords, at: Word) -> None:
        """G51 of Mach3: axis words are factors about the zero; other axes keep theirs."""
        motion, transform = self._motion, self._coordinates.transform
        if not self._state.scaled:
            self._check_alone(at)
        factors = list(transform.factors)
        given = [
            (column, word)
            for letter, column in motion.column.items()
            if (word := words.take(letter, "G51")) is not None
        ]
        if not given:
            message = f"{at.written} needs axis words: the factors"
            raise fault("scaling-factor", message, at, "such as G51 X2 Y2")
        for column, word in given:
            if abs(word.number) < SMALLEST_FACTOR:
                raise fault("scaling-factor", f"{word.written}: the factor must not be 0", word)
            factors[column] = word.number
        self._set(Transform(tuple(factors), Transform.none(len(factors)).fixed))
        self._state.scaled = True

    def _factor(self, word: Word) -> float:
        """Return a factor. Without a decimal point controllers count in different units."""
        unit = 1.0 if "." in word.written else self._dialect.offsets.scale_unit
        if unit == 0.0:
            message = f"{word.written} without a decimal point is {word.number / 1000:g} for FANUC"
            hint = f"write {word.written}. or name a --dialect"
            raise fault("scaling-factor", message, word, hint)
        factor = word.number * unit
        if abs(factor) < SMALLEST_FACTOR:
            raise fault("scaling-factor", f"{word.written}: the factor must not be 0", word)
        return factor

    def _mirror(self, words: LineWords, code: Code) -> None:
        """G51.1 X: mirror about the line at X. G50.1 X ends it; without words all of them."""
        motion, transform, at = self._motion, self._coordinates.transform, code.word
        on = code.number == G.G51_1
        if transform.plane is not None or self._state.scaled or self._coordinates.rotation:
            self._check_alone(at)
        values = motion.axis_values(words, at.written)
        if on and not values:
            message = f"{at.written} needs axis words"
            raise fault("axis-words-missing", message, at, "such as G51.1 X0")
        if on and "51" not in at.written and any(values.values()):
            message = f"{at.written} mirrors about the work zero, so its numbers are 0"
            raise fault("code-not-supported", message, at, "use G51.1 for another line")
        factors, fixed = list(transform.factors), list(transform.fixed)
        for index in values or range(len(factors)):
            factors[index] = -1.0 if on else 1.0
            fixed[index] = values.get(index, 0.0) if on else 0.0
        self._set(Transform(tuple(factors), tuple(fixed)))

    # Rotation

    def _rotate(self, words: LineWords, at: Word) -> None:
        """G68: the centre by the two axes of the plane, R degrees."""
        motion, state, coordinates = self._motion, self._state, self._coordinates
        self._check_alone(at)
        if not state.absolute:
            hint = "give G90: the angle and the centre are absolute"
            raise fault("rotation-incremental", f"{at.written} under G91", at, hint)
        word = words.take("R", "G68")
        if word is None:
            if empty := next((each for each in words.vacant if each.letter == "R"), None):
                message = f"{empty.written} gives no angle: the variable is empty"
                raise fault("rotation-angle", message, empty, "set the variable before")
            raise fault("rotation-angle", f"{at.written} needs R, the angle", at, "such as R45.")
        names = PLANE_AXES[state.plane]
        plane = self._plane(at)
        here = coordinates.to_program(motion.position)
        # Mach4 names the centre by X and Y.
        if self._dialect.offsets.transforms == "mach3" and words.rest.keys().isdisjoint("XY"):
            centre = self._centre_of_mach3(words, plane, at)
        else:
            centre = motion.axis_values(words, "G68")
        if outside := next((index for index in centre if index not in plane), None):
            message = f"{motion.axes[outside].upper()} is across the plane of the rotation"
            hint = f"its axes are {' '.join(names).upper()}"
            raise fault("axis-not-allowed", message, at, hint)
        none = Transform.none(len(here))
        turned = replace(
            none,
            plane=plane,
            centre=(centre.get(plane[0], here[plane[0]]), centre.get(plane[1], here[plane[1]])),
            angle=word.number,
        )
        self._set(turned)
        coordinates.transform_is_new = True

    def _place(self, words: LineWords, at: Word) -> None:
        """G68.2 without a tilt: X Y Z is the new zero; I and K turn the plane X Y about it.

        I, J and K are Euler angles about Z, X and Z; with J0 both others are about the same Z.
        """
        motion, coordinates = self._motion, self._coordinates
        self._check_alone(at)
        if not self._state.absolute:
            raise fault("rotation-incremental", f"{at.written} under G91", at, "give G90 before")
        first, tilt, last = (words.take(letter, "G68.2") for letter in "IJK")
        if tilt is not None and tilt.number % 360.0:
            message = f"{at.written} with {tilt.written} (a tilted plane) is not supported"
            hint = "let the CAM system write positions without a tilted plane, or G43.4"
            raise fault("code-not-supported", message, at, hint)
        check_rotary_axes_at_zero(motion, at)
        zero = motion.axis_values(words, "G68.2")
        x, y, z = (motion.column.get(axis) for axis in "XYZ")
        if x is None or y is None or not zero.keys() <= {x, y, z}:
            raise fault("axis-not-allowed", f"{at.written} has the words X Y Z I J K", at)
        none = Transform.none(len(motion.axes))
        angle = sum(word.number for word in (first, last) if word is not None)
        shift = tuple(zero.get(column, 0.0) for column in range(len(motion.axes)))
        self._set(replace(none, plane=(x, y), angle=angle, shift=shift))
        coordinates.transform_is_new = True

    def _centre_of_mach3(
        self, words: LineWords, plane: tuple[int, int], at: Word
    ) -> dict[int, float]:
        """A and B: the centre of the rotation in X and Y."""
        centre = words.take("A", "G68"), words.take("B", "G68")
        if centre[0] is None or centre[1] is None or self._state.plane != "XY":
            hint = "such as G17 G68 A0 B0 R45"
            message = f"{at.written} needs A and B, the centre in X and Y, and the plane G17"
            raise fault("axis-words-missing", message, at, hint)
        scale = self._state.scale
        return {plane[0]: centre[0].number * scale, plane[1]: centre[1].number * scale}


_HOME = {G.G28: G.G28, G.G28_1: G.G28, G.G30: G.G30, G.G30_1: G.G30}
"""The code that goes to the position of each code."""
_ORIGINS = (2, 20)
_BASIC_SYSTEMS = 6
_NO_CYCLE = (None, G.G80, *PLAIN_MOTIONS)
"""Modes of motion in which no cycle uses a P word."""
_WITHOUT_P = frozenset(
    (0, 1, 2, 3, 17, 18, 19, 20, 21, 40, 41, 42, 43, 49, 54, 69, 80, 90, 91, 94, 98, 99)
)
"""Codes that may stand beside G54 P: they have no P word."""


class OffsetCodes(MotionCodes):
    """Execution of the codes of offsets. Most are an error under cutter compensation."""

    def __init__(self, motion: Motion, tools: ToolCodes) -> None:
        super().__init__(motion)
        self._tools = tools

    def system(self, words: LineWords, code: Code) -> None:
        """Execute G54 to G59.3, or FANUC's G54.1 P, which is G54 P, too."""
        self._check_compensation(code.word)
        self._check_transform(code.word)
        further = code.number == G.G54 and self._dialect.offsets.system_word and "P" in words.rest
        if further:
            self._check_system_word(words, code.word)
        if further or code.number == G.G54_1:
            word = words.take("P", code.word.written)
            if word is None:
                hint = f"give P from 1 to {self._dialect.offsets.more_systems}"
                raise fault(
                    "offset-system-missing", f"{code.word.written} needs a P word", code.word, hint
                )
            basic = self._dialect.offsets.basic_system and word.number == 0
            index = EXTERNAL if basic else self._more(word)
        else:
            index = SYSTEM_CODES.index(code.g)
        self._coordinates.select(index)

    def _check_system_word(self, words: LineWords, at: Word) -> None:
        """Refuse P beside G54 if a cycle, a dwell or another code of the line may use it."""
        if self._state.motion in _NO_CYCLE and all(word.number in _WITHOUT_P for word in words.g):
            return
        message = f"P of this line may belong to {at.written} or to another code"
        raise fault("word-wanted-twice", message, words.rest["P"], f"write {at.written} P alone")

    def _more(self, word: Word) -> int:
        """Index of the coordinate system that P of G54.1 names."""
        return (
            self._coordinates.systems
            + whole(word, "the coordinate system", 1, self._dialect.offsets.more_systems)
            - 1
        )

    def non_modal(self, words: LineWords, code: Code) -> None:
        """Execute G10, G28, G28.1, G30, G30.1, G52, G53 or G92 to G92.3."""
        number, coordinates = code.g, self._coordinates
        if number == G.G53_1:
            self._turn_tool(code.word)
            return
        if number not in (G.G28, G.G30, G.G53):
            self._check_transform(code.word)
        if number == G.G10:
            self._g10(words, code.word)
            return
        self._check_compensation(code.word)
        if number in (G.G28, G.G28_1, G.G30, G.G30_1, G.G53):
            refuse_under_tip_control(self._motion, code.word)
        if number in (G.G28, G.G30):
            self._go_home(words, code)
        elif number in (G.G28_1, G.G30_1):
            coordinates.set_home(_HOME[number], self._motion.position)
        elif number == G.G52:
            coordinates.set_local(self._values(words, "G52", code.word))
        elif number == G.G53:
            self._check_machine_move(code.word)
        elif number == G.G92 and self._dialect.turning.lathe and "S" in words.users:
            if words.has_axis():
                message = f"{code.word.written} with S limits the speed, and sets no coordinates"
                raise fault("axis-words-unused", message, words.first_axis(), "write two lines")
        elif number == G.G92:
            coordinates.set_shift_here(self._values(words, "G92", code.word), self._motion.position)
        elif number == G.G92_1:
            coordinates.clear_shift()
        elif number == G.G92_2:
            coordinates.suspend_shift()
        else:
            coordinates.restore_shift()

    def _values(self, words: LineWords, user: str, at: Word) -> dict[int, float]:
        """Take the axis words, at least one. Those of axes that the machine lacks do nothing."""
        given = words.has_axis()
        values = self._motion.axis_values(words, user)
        if not given:
            raise fault("axis-words-missing", f"{at.written} needs axis words", at, "such as X0 Y0")
        return values

    def _turn_tool(self, at: Word) -> None:
        """G53.1: the tool is along Z of the plane of G68.2 already, which has no tilt here."""
        if not self._coordinates.transform.shift:
            message = f"{at.written} without G68.2 before it"
            raise fault("figure-missing", message, at, "give G68.2 before")
        check_rotary_axes_at_zero(self._motion, at)

    def _check_transform(self, at: Word) -> None:
        """Refuse an offset under G51, G51.1 or G68, in whose coordinates it would be unclear."""
        if self._coordinates.transform.changes:
            message = f"{at.written} under a transform that G51, G51.1, G68 or G101 changed"
            raise fault("figure-active", message, at, "give G50, G50.1, G69 or G100 before")

    def _check_compensation(self, at: Word) -> None:
        if self._motion.compensated:
            raise under_compensation(at)

    def _check_machine_move(self, at: Word) -> None:
        """Refuse G53 under G91 if the dialect does.

        Some controllers read its axis words as absolute. FANUC's ignore G53 there.
        """
        if self._state.absolute:
            return
        if not self._dialect.home.machine_in_incremental:
            raise fault(
                "machine-coordinates-incremental", f"{at.written} under G91", at, "give G90"
            )
        if self._dialect.home.machine_in_incremental == "unclear":
            message = f"{at.written} under G91: its axis words are read as machine coordinates"
            hint = "FANUC controls ignore G53 there: give G90"
            self._here.report_warning("machine-coordinates-absolute", message, at, hint)

    # Reference positions

    def _go_home(self, words: LineWords, code: Code) -> None:
        """Move through the point of the axis words to the stored position.

        Only the given axes go on from the point, or all if none is given. Words of axes that the
        machine lacks are no reason to move the others.
        """
        motion, stored = self._motion, self._home(words, code)
        given = [letter for letter in words.rest if letter in AXES]
        columns = [motion.column[letter] for letter in given if letter in motion.column]
        if words.has_axis():
            through = motion.target(words, code.word.written, motion.position)
            if not self._dialect.home.directly:
                motion.traverse(through)
        elif self._dialect.home.needs_axes and not self._dialect.lenient:
            raise fault(
                "axis-words-missing",
                f"{code.word.written} needs axis words",
                code.word,
                "give the axes that must move, such as Z0",
            )
        if given and not columns:
            return
        if not columns:
            motion.length_change = None
        motion.traverse(self._partly_home(columns, stored))

    def _partly_home(self, columns: list[int], stored: list[float]) -> list[float]:
        """The stored position for the axes of ``columns``, or for all if there are none.

        The axes are those of the coordinate system.
        """
        if not columns:
            return stored
        coordinates, here = self._coordinates, self._motion.position
        if not coordinates.rotation:
            return [
                stored[index] if index in columns else value for index, value in enumerate(here)
            ]
        end, there = coordinates.to_program(here), coordinates.to_program(stored)
        for index in columns:
            end[index] = there[index]
        return coordinates.to_machine(end)

    def _home(self, words: LineWords, code: Code) -> list[float]:
        """The stored position; FANUC's P2 to P4 of G30 select one."""
        home = _HOME[code.g]
        if (
            self._dialect.tools.memory
            and home == G.G30
            and (place := words.take("P", "G30"))
            and whole(place, "the reference position", 2, 4) > 2
        ):
            message = f"{place.written}: reference positions 3 and 4 are not stored on this machine"
            raise fault(
                "reference-position-missing",
                message,
                place,
                "the second one (P2) is parameters 5181 to 5189",
            )
        return self._coordinates.home(home)

    # G10

    def _g10(self, words: LineWords, at: Word) -> None:
        dialect = self._dialect
        kind = words.take("L", "G10")
        if dialect.turning.turret_offsets and (kind is None or kind.whole not in _ORIGINS):
            self._check_compensation(at)
            set_turret_offset(self._tools, words, kind, at, dialect)
            return
        if kind is None:
            raise fault(
                "offset-kind-missing",
                f"{at.written} needs an L word",
                at,
                "L2 sets an origin, L20 sets it by the present position",
            )
        if kind.whole not in dialect.offsets.written:
            raise fault(
                "code-not-supported",
                f"{at.written} {kind.written} is not in the {dialect.name} dialect",
                kind,
                _kinds(dialect.offsets.written),
            )
        if kind.whole not in _ORIGINS:
            self._check_compensation(at)
            self._tools.g10(words, kind.whole, at)
            return
        system = words.take("P", "G10")
        if system is None:
            raise fault(
                "offset-system-missing",
                f"{at.written} needs a P word",
                at,
                "P1 is G54, P2 is G55, and so on",
            )
        here = kind.whole == 20
        if here and dialect.offsets.more_systems:
            index, here = self._more(system), False
        elif number := whole(system, "the coordinate system", 0, self._most_systems):
            index = number - 1
        else:
            index = self._coordinates.system if dialect.offsets.current else EXTERNAL
        if index in (self._coordinates.system, EXTERNAL):
            self._check_compensation(at)
        rotation = None if here else self._rotation(words)
        values = self._motion.axis_values(words, "G10")
        if not values and rotation is None and (here or not dialect.offsets.rotation):
            raise fault("axis-words-missing", f"{at.written} needs axis words", at, "such as X0 Y0")
        if here:
            self._coordinates.set_origin_here(index, values, self._motion.position)
        else:
            if values and not self._state.absolute and dialect.offsets.add == "unclear":
                message = f"{at.written} L2 under G91: FANUC adds to the offset, others set it"
                hint = "give G10 L2 under G90, or name the --dialect"
                raise fault("offset-incremental", message, at, hint)
            add = dialect.offsets.add == "yes" and not self._state.absolute
            self._coordinates.set_origin(index, values, rotation=rotation, add=add)

    @property
    def _most_systems(self) -> int:
        """Highest P of G10 L2. A control with G54.1 has G54 to G59 besides, and no G59.1."""
        return _BASIC_SYSTEMS if self._dialect.offsets.more_systems else self._coordinates.systems

    def _rotation(self, words: LineWords) -> float | None:
        """R of G10 L2, degrees."""
        word = words.take("R", "G10")
        if word is None:
            return None
        if not self._dialect.offsets.rotation:
            message = (
                "R of G10 (rotation of the coordinate system) is not in the "
                f"{self._dialect.name} dialect"
            )
            raise fault("word-not-in-dialect", message, word)
        if not self._coordinates.can_rotate:
            raise fault(
                "axis-missing",
                f"{word.written} rotates X and Y, and the machine does not have both",
                word,
            )
        return word.number


def _kinds(kinds: list[int]) -> str:
    """A list of the L words that G10 has."""
    *most, last = (f"L{kind}" for kind in kinds)
    return f"the dialect has {', '.join(most)} and {last}"


# Macro variables of the offset memory, of coordinate systems by axis, and of Haas' numbers.
#
# Lengths are in the units of the program. Which number shows what is data of the dialect:
# :class:`cnc.gcode.dialects.rules.VariableNumbers`.

_AXIS_STEP = 100
"""From #2500, the external offset of the first axis, to #2600, that of the next one."""
_BY_AXIS = 7
"""The external offset and G54 to G59."""
_COMMON = (range(100, 200), range(500, 1000))


_Value = Callable[[ToolEntry], float]
_Change = Callable[[ToolEntry, float], ToolEntry]


class OffsetVariables(MotionCodes):
    """Binds the variables of a dialect to the parameters of a program.

    Args:
        dialect: The dialect.
        here: Place of the current line.
        tools: The codes of tools, with the offset memory.
        coordinates: The coordinate systems, with the parameters.
    """

    def __init__(self, tools: ToolCodes) -> None:
        super().__init__(tools.motion)
        self._tools, dialect = tools, self._dialect
        self._wear_reported = False
        variables = dialect.variables
        unsure = [range(first, last + 1) for first, last in variables.wear_is_length]
        size = 2.0 if dialect.tools.diameters else 1.0
        rows: tuple[tuple[list[list[int]], _Value, _Change], ...] = (
            (variables.length, lambda entry: entry.offsets.get("Z", 0.0),
             lambda entry, value: replace(entry, offsets=entry.offsets | {"Z": value})),
            (variables.wear, lambda entry: entry.wear.get("Z", 0.0),
             lambda entry, value: replace(entry, wear=entry.wear | {"Z": value})),
            (variables.radius, lambda entry: size * entry.diameter / 2.0,
             lambda entry, value: replace(entry, diameter=2.0 * value / size)),
            (variables.radius_wear, lambda entry: size * entry.radius_wear,
             lambda entry, value: replace(entry, radius_wear=value / size)),
        )  # fmt: skip
        for places, value, change in rows:
            for first, count in places:
                is_unsure = any(first in each for each in unsure)
                self._bind(range(first, first + count), value, change, is_unsure=is_unsure)
        if variables.origins:
            self._bind_origins(variables.origins)
        if variables.more_origins:
            last = numbers.MOST_G54_1_SYSTEMS * numbers.SYSTEM_STEP
            self._alias(
                range(variables.more_origins, variables.more_origins + last), numbers.G54_1_ORIGIN
            )
        if variables.common:
            self._bind_common()

    def _bind(self, row: range, value: _Value, change: _Change, *, is_unsure: bool) -> None:
        """Bind the variables of one kind of offset."""
        table, state = self._tools.table, self._state

        def place_of(place: int) -> Word:
            number = row[place]
            at = Word("#", float(number), f"#{number}", 1, len(self._here.text))
            if is_unsure:
                self._report_wear(number, at)
            return at

        def read(place: int) -> float:
            entry = self._tools.entry(place + 1, place_of(place))
            return value(entry) / state.scale

        def write(place: int, number: float) -> None:
            place_of(place)
            length = 0.0 if number != number else number * state.scale
            table.put(change(table.tool(place + 1) or ToolEntry(place + 1), length))

        self._parameters.bind_row(row, read, write)

    def _report_wear(self, number: int, at: Word) -> None:
        """Report once that a variable is read as a wear, and is a whole length elsewhere."""
        if self._wear_reported:
            return
        self._wear_reported = True
        message = f"#{number} is the wear of a length; controls with memory A keep the length there"
        hint = f"the geometry is #{number % 1000 + 11000}"
        self._here.report_warning("offset-variable-wear", message, at, hint)

    def _bind_origins(self, first: int) -> None:
        """Bind the offsets of the coordinate systems by axis: #2500, #2501 for G54, #2600, .."""
        for axis in (AXIS_LETTERS.index(letter) for letter in "xyz"):
            for system in range(_BY_AXIS):
                origin = numbers.origin(system - 1) if system else numbers.EXTERNAL_OFFSET
                number = first + _AXIS_STEP * axis + system
                self._alias(range(number, number + 1), origin + axis)

    def _alias(self, row: range, first: int) -> None:
        """Give the variables from ``first`` on second numbers; such as those of origins."""

        def write(place: int, value: float) -> None:
            self._parameters.set_number(first + place, value, 1)
            self._coordinates.refresh()

        self._parameters.bind_row(
            row, lambda place: self._parameters.number(first + place, 1), write
        )

    def _bind_common(self) -> None:
        """Bind the second numbers of common variables: #10100 is #100. Those between are more."""
        self._parameters.kept = KEPT_MACRO.union(MORE_MACRO)
        for span in _COMMON:
            row = range(MORE_MACRO.start + span.start, MORE_MACRO.start + span.stop)
            self._alias(row, span.start)
