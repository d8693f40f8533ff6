"""What is around the board: switches at the ends of the axes, a workpiece for the probe, a door.

The board counts its steps from wherever it was switched on; the environment knows where that was.
``offset`` is environment position minus machine position. The switches are ``travel`` apart; homing finds
them at ``high`` (or ``low``, where ``$23`` says so).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc.boards.grbl.simulator.planner import Move, Point

AXES = "XYZ"


@dataclass(slots=True)
class Environment:
    """low, high: environment positions of the switches, mm. broken: axes whose switch never trips. stuck:
    axes whose switch never lets go.

    surface: (normal, distance): the probe touches where normal . machine position <= distance;
    None: nothing to touch.
    """

    low: Point = (-200.0, -200.0, -200.0)
    high: Point = (0.0, 0.0, 0.0)
    offset: Point = (-100.0, -100.0, -100.0)
    broken: set[str] = field(default_factory=set)
    stuck: set[str] = field(default_factory=set)
    surface: tuple[Point, float] | None = None
    door_open: bool = False

    @classmethod
    def of_travels(cls, x: float, y: float, z: float) -> Environment:
        """Switches as far apart as the board thinks, the machine between them."""
        return cls(low=(-x, -y, -z), offset=(-x / 2.0, -y / 2.0, -z / 2.0))

    def touches(self, position: Point) -> bool:
        """Whether the probe touches at a machine position."""
        if self.surface is None:
            return False
        normal, distance = self.surface
        return sum(n * p for n, p in zip(normal, position, strict=True)) <= distance + 1e-9

    def contact(self, move: Move, towards: bool) -> float | None:
        """Way along a block at which the probe begins to touch (``towards``) or lets go."""
        if self.surface is None:
            return None
        normal, distance = self.surface
        rate = sum(n * u for n, u in zip(normal, move.unit, strict=True))
        if rate == 0.0 or (rate < 0.0) != towards:
            return None
        way = (distance - sum(n * p for n, p in zip(normal, move.start, strict=True))) / rate
        return way if 0.0 <= way < move.length else None

    def switch(self, move: Move) -> float | None:
        """Way along a block at which the first switch trips."""
        ways = []
        for index, axis in enumerate(AXES):
            unit, start = move.unit[index], move.start[index] + self.offset[index]
            if unit and axis not in self.broken:
                way = ((self.high if unit > 0.0 else self.low)[index] - start) / unit
                if way < move.length:
                    ways.append(max(way, 0.0))
        return min(ways, default=None)

    def tripped(self, position: Point) -> str:
        """Axes whose switch is pressed at a machine position."""
        pressed = []
        for index, axis in enumerate(AXES):
            at = position[index] + self.offset[index]
            if axis in self.stuck or (
                axis not in self.broken
                and not self.low[index] + 1e-9 < at < self.high[index] - 1e-9
            ):
                pressed.append(axis)
        return "".join(pressed)
