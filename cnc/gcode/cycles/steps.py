"""Steps of cycles, before they become canonical blocks.

A cycle works in the plane in effect. Its points are (first, second, height): the plane's two axes
in the order of :data:`cnc.model.blocks.PLANE_AXES` and the height along the axis across it, in mm
of the coordinate system in use. The cycle runner converts points into machine positions, so cycles
do not depend on offsets, rotation and tool length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

Point = tuple[float, float, float]
Turning = Literal["cw", "ccw"]


@dataclass(frozen=True, slots=True)
class Rapid:
    """A traverse to a point, mm."""

    to: Point


@dataclass(frozen=True, slots=True)
class Cut:
    """A straight move to a point, mm, at ``feed`` mm/s."""

    to: Point
    feed: float


@dataclass(frozen=True, slots=True)
class Pause:
    """A dwell, s."""

    seconds: float


@dataclass(frozen=True, slots=True)
class TurnSpindle:
    """A direction of the spindle at ``times`` the programmed speed, or off."""

    state: Turning | Literal["off"]
    times: float = 1.0


@dataclass(frozen=True, slots=True)
class OrientSpindle:
    """The spindle stops at its angle of orientation."""


@dataclass(frozen=True, slots=True)
class OperatorStop:
    """The program waits for the operator."""


@dataclass(frozen=True, slots=True)
class SetOverrides:
    """Whether the overrides are enabled. ``spindle`` False leaves that of the spindle unchanged."""

    overrides: bool
    spindle: bool = True


@dataclass(frozen=True, slots=True)
class Synchronise:
    """From here on moves follow the spindle at ``pitch`` mm a revolution; 0 ends this."""

    pitch: float


Step = Rapid | Cut | Pause | TurnSpindle | OrientSpindle | OperatorStop | SetOverrides | Synchronise


def opposite(turning: Turning) -> Turning:
    """Return the opposite direction."""
    return "ccw" if turning == "cw" else "cw"


def without_standing(position: Point, steps: Iterable[Step]) -> Iterator[Step]:
    """Return the steps without moves of length 0 and dwells of 0 s; ``position`` is their start."""
    for step in steps:
        if isinstance(step, Rapid | Cut):
            if step.to == position:
                continue
            position = step.to
        elif isinstance(step, Pause) and step.seconds <= 0:
            continue
        yield step
