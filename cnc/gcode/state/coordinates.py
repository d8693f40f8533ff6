"""Coordinate systems: from program coordinates to machine coordinates and back.

    machine = tool + origin + R(rotation) (program + shift + local)

``origin`` and ``rotation`` (about Z, of X and Y alone) belong to the coordinate system in use;
``shift`` is G92's and stays when another one is chosen; ``tool`` is the length offset. ``local`` is
G52 where that is an offset of its own; elsewhere G52 sets the shift. FANUC adds an external offset
to every origin. What is stored lives in the parameters (5161 to 5390) and nowhere else, and takes
effect as in LinuxCNC: a coordinate system when another one is chosen or when G10 sets the one in
use, the shift with G92.3.

Source: LinuxCNC, "Coordinate Systems", G10, G52, G54-G59.3, G92, and "Numbered Parameters"; for
``local`` and the external offset FANUC's "Local coordinate system" and "Workpiece coordinate
system".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, ROTARY_LETTERS

EXTERNAL = -1
"""The number of the offset that counts in every system (FANUC's P0)."""
SYSTEM_CODES = (G.G54, G.G55, G.G56, G.G57, G.G58, G.G59, G.G59_1, G.G59_2, G.G59_3)
"""The code of each system, as #<_coord_system> reads it. All others are G54.1's."""
_HOMES: dict[G, int] = {G.G28: numbers.G28_POSITION, G.G30: numbers.G30_POSITION}


class Coordinates:
    """The coordinate systems of a program that is being read.

    Everything is in mm or degrees, one number an axis of the machine, in the machine's order.
    ``zero`` is the machine position of the program's zero point as long as ``rotation`` (degrees,
    counter-clockwise) is 0; ``system`` is the index of the system in use, 0 for G54. ``systems`` is
    how many there are; with ``fanuc`` G52 is an offset of its own and an external offset counts.
    Unless ``shift_stays``, the shift that an earlier program left behind is not in effect.
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
        self.parameters = parameters
        self.systems = systems
        self.system = 0
        self.rotation = 0.0
        self.zero: list[float] = []
        self._axes = axes
        self._fanuc = fanuc
        self._values = parameters.values
        self._places = [AXIS_LETTERS.index(axis) for axis in axes]
        self._xy = (axes.index("x"), axes.index("y")) if {"x", "y"} <= set(axes) else None
        self._turn = (1.0, 0.0)
        self._origin = [0.0] * len(axes)
        self._tool = [0.0] * len(axes)
        self._local = [0.0] * len(axes)
        self._external = [0.0] * len(axes)
        if not shift_stays:
            self._values[numbers.SHIFT_IN_EFFECT] = 0.0
        self._shift = (
            self._stored(numbers.SHIFT)
            if self._values.get(numbers.SHIFT_IN_EFFECT, 0.0)
            else [0.0] * len(axes)
        )
        number = self._values.get(numbers.CURRENT_SYSTEM, 1.0)
        self._use(int(number) - 1 if number in range(1, systems + 1) else 0)

    def bind(self, here: Callable[[], list[float]], scale: Callable[[], float]) -> None:
        """Show the state as parameters: 5420 to 5428 and their names.

        ``here`` tells the machine position (of the programmed point), ``scale`` mm a program unit.
        """
        bind = self.parameters.bind
        for place, letter in enumerate(AXIS_LETTERS):
            index = self._axes.index(letter) if letter in self._axes else None
            relative = self._reading(index, letter, lambda: self.to_program(here()), scale)
            bind(numbers.POSITION + place, relative)
            bind(f"_{letter}", relative)
            bind(f"_abs_{letter}", self._reading(index, letter, here, scale))
        bind(
            "_coord_system",
            lambda: float(
                SYSTEM_CODES[self.system] if self.system < len(SYSTEM_CODES) else G.G54_1
            ),
        )

    def bind_numbers(
        self, first: int, position: Callable[[], list[float]], scale: Callable[[], float]
    ) -> None:
        """Show a position, in mm, as a number for each of the machine's axes, in their order."""
        for index, letter in enumerate(self._axes):
            self.parameters.bind(first + index, self._reading(index, letter, position, scale))

    @staticmethod
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

    # From one to the other

    @property
    def turns(self) -> bool:
        """Whether the machine has the axes that a rotation needs."""
        return self._xy is not None

    def to_machine(self, program: list[float]) -> list[float]:
        """The machine position of a point in program coordinates."""
        if not self.rotation:
            return [value + zero for value, zero in zip(program, self.zero, strict=True)]
        added = [
            value + a + b for value, a, b in zip(program, self._shift, self._local, strict=True)
        ]
        return [
            value + base
            for value, base in zip(
                self._turned(added, self._turn), self._base(self._origin), strict=True
            )
        ]

    def to_program(self, machine: list[float]) -> list[float]:
        """The program coordinates of a machine position."""
        if not self.rotation:
            return [value - zero for value, zero in zip(machine, self.zero, strict=True)]
        return [
            value - a - b
            for value, a, b in zip(self._felt(machine), self._shift, self._local, strict=True)
        ]

    def turned(self, delta: list[float]) -> list[float]:
        """A way in program directions as a way of the machine."""
        return self._turned(delta, self._turn) if self.rotation else delta

    def _turned(self, vector: list[float], turn: tuple[float, float]) -> list[float]:
        cosine, sine = turn
        turned = vector.copy()
        if self._xy and turn != (1.0, 0.0):
            x, y = self._xy
            turned[x] = cosine * vector[x] - sine * vector[y]
            turned[y] = sine * vector[x] + cosine * vector[y]
        return turned

    def _touched(self, values: Mapping[int, float], turn: tuple[float, float]) -> set[int]:
        """The axes of the machine that change with program coordinates: under a rotation X and Y do
        together.
        """
        touched = set(values)
        if self._xy and turn != (1.0, 0.0) and not touched.isdisjoint(self._xy):
            touched.update(self._xy)
        return touched

    def _back(self, vector: list[float], turn: tuple[float, float]) -> list[float]:
        return self._turned(vector, (turn[0], -turn[1]))

    def _base(self, origin: list[float]) -> list[float]:
        """Origin, tool and what counts in every system."""
        return [a + b + c for a, b, c in zip(origin, self._tool, self._external, strict=True)]

    def _felt(self, machine: list[float]) -> list[float]:
        """A machine position from the origin in use, turned back: program coordinates before shift
        and local offset.
        """
        return self._back(
            [value - base for value, base in zip(machine, self._base(self._origin), strict=True)],
            self._turn,
        )

    # Coordinate systems

    def select(self, system: int) -> None:
        """G54 (0) to G59.3 (8). To choose the one in use again changes nothing: stored numbers are
        not read anew.
        """
        self._values[numbers.CURRENT_SYSTEM] = system + 1.0
        if system != self.system:
            self._use(system)

    def refresh(self) -> None:
        """Take the stored numbers of the system in use into effect."""
        self._use(self.system)

    def end(self) -> None:
        """The program is over (M2, M30): the first system, and no local offset."""
        self._local = [0.0] * len(self._axes)
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
        """G10 L2: the origin of a system (or EXTERNAL) by axis index, and its rotation in degrees;
        ``add`` to what is stored.
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
        """G10 L20: the origin of a system such that the machine ``position`` has the ``values``
        there under shift and tool as they are.
        """
        first = self._first(system)
        origin, turn = self._stored(first), _turn(self._rotation_of(system))
        way = [
            value - base
            for value, base in zip(position, self._base([0.0] * len(position)), strict=True)
        ]
        felt = self._back([value - base for value, base in zip(way, origin, strict=True)], turn)
        for index, value in values.items():
            felt[index] = value + self._shift[index] + self._local[index]
        turned = self._turned(felt, turn)
        self.set_origin(
            system, {index: way[index] - turned[index] for index in self._touched(values, turn)}
        )

    def _use(self, system: int) -> None:
        self.system = system
        self._origin = self._stored(self._first(system))
        self._external = self._stored(numbers.EXTERNAL_OFFSET) if self._fanuc else self._external
        self.rotation = self._rotation_of(system)
        self._turn = _turn(self.rotation)
        self._settle()

    def _first(self, system: int) -> int:
        """The first parameter of a system; those of FANUC's G54.1 come after the others, from
        ``systems`` on.
        """
        if system == EXTERNAL:
            return numbers.EXTERNAL_OFFSET
        if system < self.systems:
            return numbers.origin(system)
        return numbers.G54_1_ORIGIN + numbers.SYSTEM_STEP * (system - self.systems)

    def _rotation_of(self, system: int) -> float:
        return self._values.get(self._first(system) + numbers.ROTATION, 0.0) if self._xy else 0.0

    def _stored(self, first: int) -> list[float]:
        return [self._values.get(first + place, 0.0) for place in self._places]

    def _settle(self) -> None:
        """The zero point after any change."""
        self.zero = [
            base + a + b
            for base, a, b in zip(self._base(self._origin), self._shift, self._local, strict=True)
        ]

    # G92 and G52

    def shift_here(self, values: Mapping[int, float], position: list[float]) -> None:
        """G92: the shift such that the machine ``position`` gets the ``values``; axes without a
        value keep theirs.

        A local offset of its own ends on the axes given.
        """
        felt, shift = self._felt(position), self._shift.copy()
        for index, value in values.items():
            self._local[index] = 0.0
            shift[index] = felt[index] - value
        self._set_shift(shift, 1.0)

    def local(self, values: Mapping[int, float]) -> None:
        """G52: the offset itself, by axis index; axes without a value keep theirs."""
        offset = self._local.copy() if self._fanuc else self._shift.copy()
        for index, value in values.items():
            offset[index] = value
        if self._fanuc:
            self._local = offset
            self._settle()
        else:
            self._set_shift(offset, 1.0)

    def clear_shift(self) -> None:
        """G92.1: no shift, and none stored."""
        self._set_shift([0.0] * len(self._axes), 0.0)

    def suspend_shift(self) -> None:
        """G92.2: no shift; the stored one waits for G92.3."""
        self._values[numbers.SHIFT_IN_EFFECT] = 0.0
        self._shift = [0.0] * len(self._axes)
        self._settle()

    def restore_shift(self) -> None:
        """G92.3: the shift that is stored."""
        self._set_shift(self._stored(numbers.SHIFT), 1.0)

    def _set_shift(self, shift: list[float], in_effect: float) -> None:
        self._shift = shift
        self._values[numbers.SHIFT_IN_EFFECT] = in_effect
        for place, value in zip(self._places, shift, strict=True):
            self._values[numbers.SHIFT + place] = value
        self._settle()

    # Tool

    @property
    def tool_offset(self) -> list[float]:
        """The length offset in effect (G43, G43.1, G43.2), in machine directions."""
        return self._tool

    @tool_offset.setter
    def tool_offset(self, offset: list[float]) -> None:
        self._tool = offset
        self._settle()

    def tool_for(
        self,
        old: list[float],
        values: Mapping[int, float],
        position: list[float],
        *,
        fixture: bool = False,
    ) -> dict[int, float]:
        """G10 L10 and L11: the tool offset, by axis index, with which the machine ``position``
        would have the ``values``.

        Where that is open, in the other program directions, it is ``old``'s. With ``fixture`` as
        seen from the last coordinate system (G59.3) without shift, else from the one in use with
        it.
        """
        if fixture:
            last = self.systems - 1
            origin, turn = self._stored(self._first(last)), _turn(self._rotation_of(last))
            moved = [0.0] * len(old)
        else:
            origin, turn = self._origin, self._turn
            moved = [a + b for a, b in zip(self._shift, self._local, strict=True)]
        way = self._back(
            [a - b - c for a, b, c in zip(position, origin, self._external, strict=True)], turn
        )
        tool = self._back(old, turn)
        for index, value in values.items():
            tool[index] = way[index] - moved[index] - value
        turned = self._turned(tool, turn)
        return {index: turned[index] for index in self._touched(values, turn)}

    # What M70 saves

    def save(self) -> tuple[int, list[float]]:
        """The system in use and the tool offset, for :meth:`restore`."""
        return self.system, self._tool

    def restore(self, saved: tuple[int, list[float]]) -> None:
        """Back to what was saved (M72)."""
        self.select(saved[0])
        self.tool_offset = saved[1]

    # Reference positions

    def home(self, code: G) -> list[float]:
        """The machine position that G28 or G30 goes to."""
        return self._stored(_HOMES[code])

    def set_home(self, code: G, position: list[float]) -> None:
        """Store the machine position that G28 or G30 goes to."""
        for place, value in zip(self._places, position, strict=True):
            self._values[_HOMES[code] + place] = value


def _turn(rotation: float) -> tuple[float, float]:
    """Cosine and sine; exact where the axes change places."""
    quarters = rotation / 90.0
    if quarters.is_integer():
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarters) % 4]
    angle = math.radians(math.fmod(rotation, 360.0))
    return math.cos(angle), math.sin(angle)
