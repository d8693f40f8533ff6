"""The surroundings of the simulated board: limit switches, a workpiece for the probe, a door.

The board counts its steps from where it was switched on. The environment knows that position:
``offset`` is true position minus machine position. The switches are ``travel`` apart; homing finds
them at ``high`` (or ``low``, by ``$23``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc.boards.grbl.simulator.planner import Move, Point
from cnc.boards.grbl.simulator.workpiece import NEAR, Workpiece

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
