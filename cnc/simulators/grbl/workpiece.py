"""A workpiece for the probe of the simulated board: planes, and boxes with holes.

The probe is a vertical pin of a radius, whose position is the centre of its lower end. Each solid
knows a lower bound of the distance between pin and solid, negative where the pin is inside. So a
move is followed in steps of that distance, which never miss a contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

from cnc.simulators.grbl.planner import Move, Point

NEAR = 1e-9
"""Distance that counts as contact, mm."""
LEAST_STEP = 1e-7
"""Shortest step along a move, mm."""


class Solid(Protocol):
    """A solid of the workpiece."""

    def distance(self, position: Point, radius: float) -> float:
        """Return a lower bound of the distance of the pin, mm; negative inside."""


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """The material below a plane: where normal . position <= level. The pin is a point.

    Attributes:
        normal: Unit normal.
        level: Distance of the plane from machine zero along the normal, mm.
    """

    normal: Point
    level: float

    def distance(self, position: Point, radius: float) -> float:
        """Return the distance of the centre of the pin's end, mm."""
        return sum(n * p for n, p in zip(self.normal, position, strict=False)) - self.level


@dataclass(frozen=True, slots=True)
class Hole:
    """A vertical hole through a box.

    Attributes:
        x: Centre, mm.
        y: Centre, mm.
        radius: mm.
    """

    x: float
    y: float
    radius: float


@dataclass(frozen=True, slots=True)
class Box:
    """A box with vertical sides that reaches down without end, with holes.

    Attributes:
        x: Lowest and highest X, mm.
        y: Lowest and highest Y, mm.
        top: Z of its top, mm.
        holes: Its holes.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    top: float
    holes: tuple[Hole, ...] = ()

    def distance(self, position: Point, radius: float) -> float:
        """Return the distance of the pin, see :class:`Solid`."""
        px, py, pz = position[:3]
        beside_x = max(self.x[0] - px, px - self.x[1])
        beside_y = max(self.y[0] - py, py - self.y[1])
        beside = math.hypot(max(beside_x, 0.0), max(beside_y, 0.0))
        if beside == 0.0:
            beside = max(beside_x, beside_y)
        distance = max(beside - radius, pz - self.top)
        for hole in self.holes:
            room = hole.radius - radius - math.hypot(px - hole.x, py - hole.y)
            distance = max(distance, room)
        return distance


@dataclass(slots=True)
class Workpiece:
    """Solids, and the pin that touches them.

    Attributes:
        solids: The solids.
        radius: Radius of the pin, mm.
    """

    solids: tuple[Solid, ...]
    radius: float = 0.0

    def distance(self, position: Point) -> float:
        """Return a lower bound of the distance of the pin from the workpiece, mm."""
        return min(solid.distance(position, self.radius) for solid in self.solids)

    def contact(self, move: Move, towards: bool) -> float | None:
        """Return the path length at which the pin touches (or lets go); None without."""
        along = 0.0
        while along < move.length:
            place = tuple(s + along * u for s, u in zip(move.start, move.unit, strict=False))
            gap = self.distance(place)
            if gap <= NEAR if towards else gap > NEAR:
                return along
            along += max(abs(gap), LEAST_STEP)
        return None


# The surroundings of the simulated board: limit switches, a workpiece for the probe, a door.
#
# The board counts its steps from where it was switched on. The environment knows that position:
# ``offset`` is true position minus machine position. The switches are ``travel`` apart; homing
# finds them at ``high`` (or ``low``, by ``$23``).

AXES = "XYZ"


@dataclass(slots=True)
class Environment:
    """Switches, workpiece and door.

    Attributes:
        low: True position of the lower switches, mm.
        high: True position of the upper switches, mm.
        offset: True position minus machine position, mm.
        broken: Axes whose switch never trips.
        stuck: Axes whose switch never lets go.
        workpiece: What the probe touches, in machine positions; None without one.
        door_open: Whether the safety door is open.
        stop_pressed: Whether the emergency stop of grblHAL is pressed.
    """

    low: Point = (-200.0, -200.0, -200.0)
    high: Point = (0.0, 0.0, 0.0)
    offset: Point = (-100.0, -100.0, -100.0)
    broken: set[str] = field(default_factory=set)
    stuck: set[str] = field(default_factory=set)
    workpiece: Workpiece | None = None
    door_open: bool = False
    stop_pressed: bool = False

    @classmethod
    def of_travels(cls, x: float, y: float, z: float) -> Environment:
        """Return switches as far apart as the board's travels, with the machine in the middle."""
        return cls(low=(-x, -y, -z), offset=(-x / 2.0, -y / 2.0, -z / 2.0))

    def touches(self, position: Point) -> bool:
        """Return whether the probe touches at a machine position."""
        return self.workpiece is not None and self.workpiece.distance(position) <= NEAR

    def contact(self, move: Move, towards: bool) -> float | None:
        """Return the path length of a block at which the probe touches or lets go."""
        return None if self.workpiece is None else self.workpiece.contact(move, towards)

    def switch(self, move: Move) -> float | None:
        """Return the path length of a block at which the first switch trips; None without.

        A move that ends at a switch presses it.
        """
        distances = []
        for index, axis in enumerate(AXES):  # further axes have no switches
            unit, start = move.unit[index], move.start[index] + self.offset[index]
            if unit and axis not in self.broken:
                along = ((self.high if unit > 0.0 else self.low)[index] - start) / unit
                if along <= move.length:
                    distances.append(max(along, 0.0))
        return min(distances, default=None)

    def tripped(self, position: Point) -> str:
        """Return the axes whose switch is pressed at a machine position."""
        pressed = []
        for index, axis in enumerate(AXES):
            at = position[index] + self.offset[index]
            if axis in self.stuck or (
                axis not in self.broken
                and not self.low[index] + 1e-9 < at < self.high[index] - 1e-9
            ):
                pressed.append(axis)
        return "".join(pressed)
