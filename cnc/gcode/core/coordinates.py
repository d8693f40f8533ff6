"""Coordinate systems: conversion between program and machine coordinates.

    machine = tool + origin + R(rotation) (program + shift + local)

``origin`` and ``rotation`` (of X and Y about Z) belong to the coordinate system in use. ``shift``
is G92's and stays when another system is selected. ``tool`` is the length offset. ``local`` is G52
in dialects where it is an offset of its own; elsewhere G52 sets the shift. FANUC adds an external
offset to every origin.

The values are stored in the parameters 5161 to 5390. They take effect as in LinuxCNC: a coordinate
system when another one is selected or when G10 sets the one in use, the shift with G92.3.

Source: LinuxCNC, "Coordinate Systems", G10, G52, G54-G59.3, G92, and "Numbered Parameters". For
``local`` and the external offset: FANUC, "Local coordinate system" and "Workpiece coordinate
system".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.words import G, Word, fault
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, ROTARY_LETTERS
from cnc.model.choices import WrapRule
from cnc.model.parameter_numbers import POSITION

# Scaling, mirroring and rotation of the programmed shape (G51, G51.1, G68).
#
#     point -> shift + centre_r + R (centre_s + f (point - centre_s) - centre_r)
#
# A point is first scaled and mirrored by a factor for each axis, then rotated in one plane, then
# shifted (G68.2 without a tilt). Source:
# FANUC Series 0i operator's manual, "Scaling", "Programmable mirror image" and "Coordinate system
# rotation"; the order is that of "Scaling and coordinate system rotation".


@dataclass(frozen=True, slots=True)
class Transform:
    """A similarity of the program's coordinates, in mm or degrees by column of the axis.

    Attributes:
        factors: (axes,) factor of each axis; a negative one mirrors.
        fixed: (axes,) coordinate that scaling leaves in its place.
        plane: Columns of the axes that the rotation turns, or None.
        centre: Centre of the rotation in these two axes.
        angle: Degrees, from the first axis of the plane to the second.
        shift: (axes,) distance by which the transform moves after the rotation; empty for none.
    """

    factors: tuple[float, ...]
    fixed: tuple[float, ...]
    plane: tuple[int, int] | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    shift: tuple[float, ...] = ()

    @classmethod
    def none(cls, axes: int) -> Transform:
        """Return the transform that leaves the shape as it is."""
        return cls((1.0,) * axes, (0.0,) * axes)

    @property
    def changes(self) -> bool:
        """Whether a point may move."""
        return self.plane is not None or any(factor != 1.0 for factor in self.factors)

    def point(self, at: list[float]) -> list[float]:
        """Return the image of a point."""
        image = [
            fixed + factor * (value - fixed)
            for value, factor, fixed in zip(at, self.factors, self.fixed, strict=True)
        ]
        turned = self._turned(image, 1.0, self.centre)
        if not self.shift:
            return turned
        return [value + step for value, step in zip(turned, self.shift, strict=True)]

    def original(self, at: list[float]) -> list[float]:
        """Return the point that a point is the image of."""
        if self.shift:
            at = [value - step for value, step in zip(at, self.shift, strict=True)]
        point = self._turned(at, -1.0, self.centre)
        return [
            fixed + (value - fixed) / factor
            for value, factor, fixed in zip(point, self.factors, self.fixed, strict=True)
        ]

    def vector(self, delta: list[float]) -> list[float]:
        """Return the image of a difference of two points."""
        image = [value * factor for value, factor in zip(delta, self.factors, strict=True)]
        return self._turned(image, 1.0, (0.0, 0.0))

    def mirrors(self, plane: tuple[int, int]) -> bool:
        """Return whether the direction of turns in a plane (two columns) is reversed."""
        return self.factors[plane[0]] * self.factors[plane[1]] < 0.0

    def scale(self, plane: tuple[int, int]) -> float | None:
        """Return the factor of lengths in a plane; None if its axes have different ones."""
        first, second = abs(self.factors[plane[0]]), abs(self.factors[plane[1]])
        return first if first == second else None

    def coupled(self, columns: set[int]) -> set[int]:
        """Return the columns that move with given ones."""
        plane = set(self.plane or ())
        return columns | plane if plane & columns else columns

    def _turned(self, at: list[float], sign: float, centre: tuple[float, float]) -> list[float]:
        if self.plane is None:
            return at
        i, j = self.plane
        cosine, sine = cosine_sine(sign * self.angle)
        x, y = at[i] - centre[0], at[j] - centre[1]
        turned = at.copy()
        turned[i] = centre[0] + cosine * x - sine * y
        turned[j] = centre[1] + sine * x + cosine * y
        return turned


def cosine_sine(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle in degrees; exact at multiples of 90."""
    quarters = angle / 90.0
    if quarters.is_integer():
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarters) % 4]
    radians = math.radians(math.fmod(angle, 360.0))
    return math.cos(radians), math.sin(radians)


EXTERNAL = -1
"""Index of FANUC's offset of all systems (P0)."""
SYSTEM_CODES = (G.G54, G.G55, G.G56, G.G57, G.G58, G.G59, G.G59_1, G.G59_2, G.G59_3)
"""The code of each system, as #<_coord_system> reads it. All other systems are G54.1's."""
_HOMES: dict[G, int] = {G.G28: numbers.G28_POSITION, G.G30: numbers.G30_POSITION}


class Coordinates:
    """Coordinate systems of a program during execution.

    Values are in mm or degrees, one for each axis of the machine, in the machine's order.

    Attributes:
        zero: Machine position of the program's zero point; valid while ``rotation`` is 0.
        rotation: Degrees, counter-clockwise.
        system: Index of the system in use, 0 for G54.
        systems: Number of systems without G54.1's.
        axes: Letters of the machine's axes.
        transform_is_new: Whether no point was given since G68.
        on_tool_offset: Called with each new tool offset, if not None.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        parameters: Parameters,
        *,
        systems: int = 9,
        fanuc: bool = False,
        shift_stays: bool = True,
    ) -> None:
        """Read the state from the parameters.

        Args:
            axes: Letters of the machine's axes.
            parameters: The parameters that hold the stored values.
            systems: Number of coordinate systems without G54.1's.
            fanuc: G52 is an offset of its own, and the external offset counts.
            shift_stays: The shift of an earlier program stays in effect.
        """
        self.parameters = parameters
        self.systems = systems
        self.system = 0
        self.rotation = 0.0
        self.zero: list[float] = []
        self.axes = axes
        self.transform = Transform.none(len(axes))
        self.transform_is_new = False
        self.on_tool_offset: Callable[[tuple[float, ...]], None] | None = None
        self._fanuc = fanuc
        self._values = parameters.values
        self._places = [AXIS_LETTERS.index(axis) for axis in axes]
        self._xy = (axes.index("x"), axes.index("y")) if {"x", "y"} <= set(axes) else None
        self._turn = (1.0, 0.0)
        self._origin, self._tool = [0.0] * len(axes), [0.0] * len(axes)
        self._local, self._external = [0.0] * len(axes), [0.0] * len(axes)
        if not shift_stays:
            self._values[numbers.SHIFT_IN_EFFECT] = 0.0
        self._shift = (
            self._stored(numbers.SHIFT)
            if self._values.get(numbers.SHIFT_IN_EFFECT, 0.0)
            else [0.0] * len(axes)
        )
        number = self._values.get(numbers.CURRENT_SYSTEM, 1.0)
        self._use(int(number) - 1 if number in range(1, systems + 1) else 0)

    # Conversion

    @property
    def can_rotate(self) -> bool:
        """Whether the machine has the two axes that a rotation needs."""
        return self._xy is not None

    @property
    def transform(self) -> Transform:
        """Scaling, mirroring and rotation."""
        return self._transform

    @transform.setter
    def transform(self, transform: Transform) -> None:
        self._transform, self._transform_changes = transform, transform.changes
        self.transform_is_new = False

    @property
    def turned(self) -> bool:
        """Whether a machine position is more than a sum."""
        return self.rotation != 0.0 or self._transform_changes

    def coupled(self, columns: set[int]) -> set[int]:
        """Return the columns of axes that move with those of a program's words."""
        return self._transform.coupled(self._changed_axes(dict.fromkeys(columns, 0.0), self._turn))

    def to_machine(self, program: list[float]) -> list[float]:
        """Return the machine position of a point in program coordinates."""
        program = self._transform.point(program) if self._transform_changes else program
        if not self.rotation:
            return [value + zero for value, zero in zip(program, self.zero, strict=True)]
        added = [
            value + a + b for value, a, b in zip(program, self._shift, self._local, strict=True)
        ]
        return [
            value + base
            for value, base in zip(
                self._rotated(added, self._turn), self._base(self._origin), strict=True
            )
        ]

    def to_program(self, machine: list[float]) -> list[float]:
        """Return the program coordinates of a machine position."""
        program = self._unshifted(machine)
        return self._transform.original(program) if self._transform_changes else program

    def _unshifted(self, machine: list[float]) -> list[float]:
        if not self.rotation:
            return [value - zero for value, zero in zip(machine, self.zero, strict=True)]
        terms = zip(self._from_origin(machine), self._shift, self._local, strict=True)
        return [value - a - b for value, a, b in terms]

    def rotated(self, delta: list[float]) -> list[float]:
        """Return a vector in program directions as one in machine directions."""
        delta = self._transform.vector(delta) if self._transform_changes else delta
        return self._rotated(delta, self._turn) if self.rotation else delta

    def _rotated(self, vector: list[float], turn: tuple[float, float]) -> list[float]:
        cosine, sine = turn
        turned = vector.copy()
        if self._xy and turn != (1.0, 0.0):
            x, y = self._xy
            turned[x] = cosine * vector[x] - sine * vector[y]
            turned[y] = sine * vector[x] + cosine * vector[y]
        return turned

    def _changed_axes(self, values: Mapping[int, float], turn: tuple[float, float]) -> set[int]:
        """Columns of the axes that change with the values: under a rotation X and Y both do."""
        touched = set(values)
        if self._xy and turn != (1.0, 0.0) and not touched.isdisjoint(self._xy):
            touched.update(self._xy)
        return touched

    def _unrotated(self, vector: list[float], turn: tuple[float, float]) -> list[float]:
        return self._rotated(vector, (turn[0], -turn[1]))

    def _base(self, origin: list[float]) -> list[float]:
        """Sum of the origin, the tool offset and the external offset."""
        return [a + b + c for a, b, c in zip(origin, self._tool, self._external, strict=True)]

    def _from_origin(self, machine: list[float]) -> list[float]:
        """Program coordinates of a machine position before shift and local offset."""
        return self._unrotated(
            [value - base for value, base in zip(machine, self._base(self._origin), strict=True)],
            self._turn,
        )

    # Coordinate systems

    def select(self, system: int) -> None:
        """Select G54 (0) to G59.3 (8).

        Selecting the system in use does not read its parameters again.
        """
        self._values[numbers.CURRENT_SYSTEM] = system + 1.0
        if system != self.system:
            self._use(system)

    def refresh(self) -> None:
        """Read the parameters of the system in use again."""
        self._use(self.system)

    def end(self) -> None:
        """Select the first system without a local offset at the program end (M2, M30)."""
        self._local = [0.0] * len(self.axes)
        self.transform = Transform.none(len(self.axes))
        self._values[numbers.CURRENT_SYSTEM] = 1.0
        self._use(0)

    def set_origin(
        self,
        system: int,
        values: Mapping[int, float],
        *,
        rotation: float | None = None,
        add: bool = False,
    ) -> None:
        """Set the origin of a system (G10 L2).

        Args:
            system: Index of the system, or EXTERNAL.
            values: Origin by column of the axis.
            rotation: Degrees; None leaves the stored one.
            add: Add the values to the stored ones.
        """
        first = self._first(system)
        for index, value in values.items():
            number = first + self._places[index]
            self._values[number] = value + (self._values.get(number, 0.0) if add else 0.0)
        if rotation is not None:
            self._values[first + numbers.ROTATION] = rotation
        if system in (self.system, EXTERNAL):
            self.refresh()

    def set_origin_here(
        self, system: int, values: Mapping[int, float], position: list[float]
    ) -> None:
        """Set the origin of a system so that a machine position has the ``values`` in it (G10 L20).

        The shift and the tool offset stay.
        """
        first = self._first(system)
        origin, turn = self._stored(first), cosine_sine(self._rotation_of(system))
        from_offsets = [
            value - base
            for value, base in zip(position, self._base([0.0] * len(position)), strict=True)
        ]
        program = self._unrotated(
            [value - base for value, base in zip(from_offsets, origin, strict=True)], turn
        )
        for index, value in values.items():
            program[index] = value + self._shift[index] + self._local[index]
        turned = self._rotated(program, turn)
        self.set_origin(
            system,
            {
                index: from_offsets[index] - turned[index]
                for index in self._changed_axes(values, turn)
            },
        )

    def _use(self, system: int) -> None:
        self.system = system
        self._origin = self._stored(self._first(system))
        self._external = self._stored(numbers.EXTERNAL_OFFSET) if self._fanuc else self._external
        self.rotation = self._rotation_of(system)
        self._turn = cosine_sine(self.rotation)
        self._update_zero()

    def _first(self, system: int) -> int:
        """First parameter of a system. G54.1's systems follow the others, from ``systems`` on."""
        if system == EXTERNAL:
            return numbers.EXTERNAL_OFFSET
        if system < self.systems:
            return numbers.origin(system)
        return numbers.G54_1_ORIGIN + numbers.SYSTEM_STEP * (system - self.systems)

    def _rotation_of(self, system: int) -> float:
        return self._values.get(self._first(system) + numbers.ROTATION, 0.0) if self._xy else 0.0

    def _stored(self, first: int) -> list[float]:
        return [self._values.get(first + place, 0.0) for place in self._places]

    def _update_zero(self) -> None:
        """Compute the zero point after a change."""
        self.zero = [
            base + a + b
            for base, a, b in zip(self._base(self._origin), self._shift, self._local, strict=True)
        ]

    # G92 and G52

    def set_shift_here(self, values: Mapping[int, float], position: list[float]) -> None:
        """Set the shift so that the machine ``position`` has the ``values`` (G92).

        Axes without a value keep theirs. A local offset ends on the given axes.
        """
        program, shift = self._from_origin(position), self._shift.copy()
        for index, value in values.items():
            self._local[index] = 0.0
            shift[index] = program[index] - value
        self._set_shift(shift, 1.0)

    def set_local(self, values: Mapping[int, float]) -> None:
        """Set the offset of G52 by column; axes without a value keep theirs."""
        offset = self._local.copy() if self._fanuc else self._shift.copy()
        for index, value in values.items():
            offset[index] = value
        if self._fanuc:
            self._local = offset
            self._update_zero()
        else:
            self._set_shift(offset, 1.0)

    def clear_shift(self) -> None:
        """Delete the shift in effect and the stored one (G92.1)."""
        self._set_shift([0.0] * len(self.axes), 0.0)

    def suspend_shift(self) -> None:
        """Suspend the shift; the stored one stays for G92.3 (G92.2)."""
        self._values[numbers.SHIFT_IN_EFFECT], self._shift = 0.0, [0.0] * len(self.axes)
        self._update_zero()

    def restore_shift(self) -> None:
        """Put the stored shift into effect (G92.3)."""
        self._set_shift(self._stored(numbers.SHIFT), 1.0)

    def _set_shift(self, shift: list[float], in_effect: float) -> None:
        self._shift = shift
        self._values[numbers.SHIFT_IN_EFFECT] = in_effect
        for place, value in zip(self._places, shift, strict=True):
            self._values[numbers.SHIFT + place] = value
        self._update_zero()

    # Tool

    @property
    def tool_offset(self) -> list[float]:
        """Length offset in effect (G43, G43.1, G43.2), in machine directions."""
        return self._tool

    @tool_offset.setter
    def tool_offset(self, offset: list[float]) -> None:
        self._tool = offset
        self._update_zero()
        if self.on_tool_offset is not None:
            self.on_tool_offset(tuple(offset))

    def tool_for(
        self,
        old: list[float],
        values: Mapping[int, float],
        position: list[float],
        *,
        fixture: bool = False,
    ) -> dict[int, float]:
        """Return the tool offset that gives the machine ``position`` the ``values`` (G10 L10, L11).

        Args:
            old: Present offset of the tool. Program directions without a value keep it.
            values: Program coordinates by column.
            position: Machine position.
            fixture: Use the last coordinate system (G59.3) without the shift, not the one in use
                with it.

        Returns:
            The offset by column, for the axes that change.
        """
        if fixture:
            last = self.systems - 1
            origin, turn = self._stored(self._first(last)), cosine_sine(self._rotation_of(last))
            moved = [0.0] * len(old)
        else:
            origin, turn = self._origin, self._turn
            moved = [a + b for a, b in zip(self._shift, self._local, strict=True)]
        from_offsets = self._unrotated(
            [a - b - c for a, b, c in zip(position, origin, self._external, strict=True)], turn
        )
        tool = self._unrotated(old, turn)
        for index, value in values.items():
            tool[index] = from_offsets[index] - moved[index] - value
        turned = self._rotated(tool, turn)
        return {index: turned[index] for index in self._changed_axes(values, turn)}

    def parts(self) -> tuple[list[float], list[float], list[float], list[float]]:
        """Return origin, external offset, shift and local offset, of which ``zero`` is the sum."""
        return self._origin, self._external, self._shift, self._local

    # Saved by M70

    def save(self) -> tuple[int, list[float]]:
        """Return the system in use and the tool offset, for :meth:`restore` (M70)."""
        return self.system, self._tool

    def restore(self, saved: tuple[int, list[float]]) -> None:
        """Put a saved state into effect (M72)."""
        self.select(saved[0])
        self.tool_offset = saved[1]

    # Reference positions

    def home(self, code: G) -> list[float]:
        """Return the machine position that G28 or G30 goes to."""
        return self._stored(_HOMES[code])

    def set_home(self, code: G, position: list[float]) -> None:
        """Store the machine position that G28 or G30 goes to."""
        for place, value in zip(self._places, position, strict=True):
            self._values[_HOMES[code] + place] = value


# Parameters that show the position to a program.


def bind_position(
    coordinates: Coordinates, here: Callable[[], list[float]], scale: Callable[[], float]
) -> None:
    """Show the position as parameters: 5420 to 5428 and their names.

    Args:
        coordinates: The coordinate systems, with the parameters.
        here: Returns the programmed machine position.
        scale: Returns the mm of a program unit.
    """
    axes, bind = coordinates.axes, coordinates.parameters.bind
    for place, letter in enumerate(AXIS_LETTERS):
        index = axes.index(letter) if letter in axes else None
        relative = _reading(index, letter, lambda: coordinates.to_program(here()), scale)
        bind(POSITION + place, relative)
        bind(f"_{letter}", relative)
        bind(f"_abs_{letter}", _reading(index, letter, here, scale))

    def code() -> float:
        system = coordinates.system
        return float(SYSTEM_CODES[system] if system < len(SYSTEM_CODES) else G.G54_1)

    bind("_coord_system", code)


def bind_numbers(
    coordinates: Coordinates,
    first: int,
    position: Callable[[], list[float]],
    scale: Callable[[], float],
) -> None:
    """Show a position in mm as one parameter for each axis of the machine."""
    for index, letter in enumerate(coordinates.axes):
        coordinates.parameters.bind(first + index, _reading(index, letter, position, scale))


def _reading(
    index: int | None,
    letter: str,
    position: Callable[[], list[float]],
    scale: Callable[[], float],
) -> Callable[[], float]:
    if index is None:
        return lambda: 0.0
    if letter in ROTARY_LETTERS:
        return lambda: position()[index]
    return lambda: position()[index] / scale()


# Rotary axes that repeat after 360 degrees: the end of a move, and its direction.
#
# A wrapped axis has the same place at 10, 370 and -350 degrees. Its position counts on over whole
# turns, so the end of a move is one of these. The rule of the controller selects it:
#
#     shortest  the nearest one; half a turn is positive. FANUC, parameter 1008 ROA = 1, RAB = 0
#     sign      in the direction of the sign of the word. LinuxCNC, WRAPPED_ROTARY; FANUC, RAB = 1
#     in-turn   within the present turn of 0 to 360 degrees. SINUMERIK, MD30310 ROT_IS_MODULO, AC
#
# SINUMERIK also writes the direction beside the value: DC (shortest), ACP (positive) and ACN
# (negative). Source: LinuxCNC, "INI configuration", WRAPPED_ROTARY; Siemens, "Programming Manual,
# Fundamentals", DC, ACP, ACN.

Direction = Literal["shortest", "positive", "negative", "counted"]
"""Direction of DC, ACP and ACN; with IC whole turns count."""

_DIRECTIONS: dict[str, Direction] = {name: name for name in get_args(Direction)}
TURN = 360.0
SAME = 1e-7
"""Degrees. An axis that is this near to its end does not make a turn."""


class RotaryAxes:
    """Ends of absolute moves of wrapped axes.

    Args:
        axes: letters of the machine's axes.
        rules: rule of each wrapped axis by its letter.
        of_dialect: rule of the dialect.

    Attributes:
        wrapped: whether an axis is wrapped, or has a direction in the present line.
    """

    def __init__(
        self, axes: tuple[str, ...], rules: Mapping[str, WrapRule], of_dialect: WrapRule
    ) -> None:
        self._rules = {
            column: of_dialect if rules[axis] == "dialect" else rules[axis]
            for column, axis in enumerate(axes)
            if axis in rules
        }
        self._directions: dict[int, Direction] = {}
        self.wrapped = bool(self._rules)

    def turn(self, column: int, direction: str) -> None:
        """Set the direction of an axis for the next word of it."""
        self._directions[column] = _DIRECTIONS[direction]
        self.wrapped = True

    def has(self, column: int) -> bool:
        """Return whether whole turns of an axis do not count."""
        return column in self._rules or column in self._directions

    def is_directed(self, column: int) -> bool:
        """Return whether an axis has a direction in the present line."""
        return column in self._directions

    def check(self, column: int, value: float, word: Word | None = None) -> None:
        """Check the value of an absolute move, degrees.

        Raises:
            GcodeError: ``wrapped-axis-range``, at the word.
        """
        rule = self._directions.get(column) or self._rules.get(column)
        if rule in (None, "shortest", "counted"):
            return
        lowest = -TURN if rule == "sign" else 0.0
        if not (lowest < value < TURN or value == 0.0):
            raise fault(
                "wrapped-axis-range",
                f"{value:g} degrees on an axis that repeats after 360 degrees",
                word,
                "write an angle from 0 to less than 360, or count the turns under G91",
            )

    def end(self, column: int, value: float, here: float) -> float:
        """Return the end of an absolute move in the coordinates of the word.

        Args:
            column: column of the axis.
            value: number of the word, degrees.
            here: present position, degrees.

        Raises:
            GcodeError: ``wrapped-axis-range``, without a place.
        """
        self.check(column, value)
        direction = self._directions.pop(column, None)
        self.wrapped = bool(self._rules or self._directions)
        rule = direction or self._rules[column]
        if rule == "counted":
            return value
        if rule == "shortest":
            return value + TURN * math.floor((here - value) / TURN + 0.5)
        negative = rule == "negative" or (rule == "sign" and math.copysign(1.0, value) < 0.0)
        angle = abs(value)
        if rule == "in-turn":
            return angle + TURN * math.floor((here + SAME) / TURN)
        ahead = (here - angle) / TURN
        nearest = angle + TURN * round(ahead)
        if abs(nearest - here) <= SAME:
            return nearest
        return angle + TURN * (math.floor(ahead) if negative else math.ceil(ahead))


# SINUMERIK's programmable frame: shift, rotation, scaling and mirroring of program coordinates.
#
#     point of the work piece = shift + R(angle) F point
#
# F holds a factor for each axis; a negative one mirrors. TRANS, ROT, SCALE and MIRROR replace the
# frame; ATRANS, AROT, ASCALE and AMIRROR add to it, in the frame's own axes: the new frame is
# applied to a point first. Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual,
# Fundamentals", "Coordinate transformations (frames)".

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ProgramFrame:
    """A frame, in mm along X, Y and Z.

    Attributes:
        shift: Shift of the origin by TRANS and G58.
        added: Further shift by ATRANS and G59.
        factors: Factor of each axis.
        plane: Axes that the rotation turns, by number, from the first to the second.
        angle: Angle of the rotation, degrees.
        is_axial: Whether G59 has set a part of it.
    """

    shift: Triple = (0.0, 0.0, 0.0)
    added: Triple = (0.0, 0.0, 0.0)
    factors: Triple = (1.0, 1.0, 1.0)
    plane: tuple[int, int] = (0, 1)
    angle: float = 0.0
    is_axial: bool = False

    @property
    def origin(self) -> Triple:
        """Place of the origin."""
        x, y, z = (a + b for a, b in zip(self.shift, self.added, strict=True))
        return x, y, z

    def moved(self, delta: Triple) -> ProgramFrame:
        """Return the frame with an additional shift."""
        part = [factor * value for factor, value in zip(self.factors, delta, strict=True)]
        first, second = self.plane
        cosine, sine = cosine_sine(self.angle)
        x, y = part[first], part[second]
        part[first], part[second] = cosine * x - sine * y, sine * x + cosine * y
        x, y, z = (a + b for a, b in zip(self.added, part, strict=True))
        return replace(self, added=(x, y, z))

    def turned(self, plane: tuple[int, int], angle: float) -> ProgramFrame | None:
        """Return the frame with an additional rotation.

        None if the result is no rotation of one plane, or would distort angles.
        """
        if self.angle and plane != self.plane:
            return None
        first, second = (self.factors[axis] for axis in plane)
        if abs(first) != abs(second):
            return None
        # A mirror image turns in the other direction.
        sign = -1.0 if first * second < 0.0 else 1.0
        return replace(self, plane=plane, angle=self.angle + sign * angle)

    def scaled(self, factors: Triple) -> ProgramFrame:
        """Return the frame with additional factors."""
        x, y, z = (a * b for a, b in zip(self.factors, factors, strict=True))
        return replace(self, factors=(x, y, z))
