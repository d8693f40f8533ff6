"""What cycles are made of: steps with every number known, before they become canonical blocks.

A cycle stands on the plane in effect. Its points are (first, second, height): the plane's two axes
in the order of :data:`cnc.model.blocks.PLANE_AXES` and the height along the axis across it, all in
mm of the coordinate system in use. Whoever carries the steps out turns points into machine
positions, so that offsets, rotation and tool length are no concern of a cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

ROUNDING = 1e-9
"""Part of a peck or of a pass that is rounding, and does not make one more."""

Point = tuple[float, float, float]
Turning = Literal["cw", "ccw"]


@dataclass(frozen=True, slots=True)
class Rapid:
    """A traverse, mm."""

    to: Point


@dataclass(frozen=True, slots=True)
class Cut:
    """A straight move (mm) at ``feed`` mm/s."""

    to: Point
    feed: float


@dataclass(frozen=True, slots=True)
class Pause:
    """A dwell, s."""

    seconds: float


@dataclass(frozen=True, slots=True)
class TurnSpindle:
    """The spindle turns so at ``times`` the speed programmed, or stands."""

    state: Turning | Literal["off"]
    times: float = 1.0


@dataclass(frozen=True, slots=True)
class OrientSpindle:
    """The spindle is held at its angle of orientation."""


@dataclass(frozen=True, slots=True)
class OperatorStop:
    """The program waits for the operator."""


@dataclass(frozen=True, slots=True)
class SetOverrides:
    """Whether the operator may override feed and spindle speed; ``spindle`` False leaves that of
    the spindle alone.
    """

    overrides: bool
    spindle: bool = True


@dataclass(frozen=True, slots=True)
class Synchronise:
    """From here on moves follow the spindle, ``pitch`` mm a turn; 0 ends that."""

    pitch: float


Step = Rapid | Cut | Pause | TurnSpindle | OrientSpindle | OperatorStop | SetOverrides | Synchronise


def opposite(turning: Turning) -> Turning:
    """The other way round."""
    return "ccw" if turning == "cw" else "cw"


def without_standing(position: Point, steps: Iterable[Step]) -> Iterator[Step]:
    """The steps without moves to where the machine is and dwells of no time; ``position`` is where
    they begin.
    """
    for step in steps:
        if isinstance(step, Rapid | Cut):
            if step.to == position:
                continue
            position = step.to
        elif isinstance(step, Pause) and step.seconds <= 0:
            continue
        yield step
