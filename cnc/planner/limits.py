"""The limits of a machine as the planner's kernels take them, and the bounds that they put on a stretch of path.

Two modes, either or both: along the path (tangential acceleration and jerk, normal acceleration) and for each axis (acceleration, jerk).
A limit that the machine file leaves out is infinite.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.limits import LEVELS, chunk_intervals, joint
from cnc.machine.models import Machine
from cnc.path.chunk import PathChunk

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits in mm, s (degrees for rotary axes); axis arrays have one entry an axis of the machine."""

    max_feed: float
    tangential_acceleration: float
    tangential_jerk: float
    normal_acceleration: float
    chord_error: float
    period: float
    step_deviation: float
    axis_velocity: Floats
    axis_acceleration: Floats
    axis_jerk: Floats

    @classmethod
    def of(cls, machine: Machine) -> Limits:
        """The limits in a machine's configuration."""

        def each(name: str) -> Floats:
            return np.array([inf if getattr(axis, name) is None else getattr(axis, name) for axis in machine.axes.values()])

        path = machine.path
        return cls(
            max_feed=path.max_feed,
            tangential_acceleration=inf if path.max_tangential_acceleration is None else path.max_tangential_acceleration,
            tangential_jerk=inf if path.max_jerk is None else path.max_jerk,
            normal_acceleration=inf if path.max_normal_acceleration is None else path.max_normal_acceleration,
            chord_error=path.chord_error,
            period=path.period,
            step_deviation=path.step_deviation,
            axis_velocity=each("max_velocity"),
            axis_acceleration=each("max_acceleration"),
            axis_jerk=each("max_jerk"),
        )

    @property
    def rules(self) -> Floats:
        """The path's limits in the order in which the kernels read them."""
        return np.array(
            [
                self.tangential_acceleration,
                self.tangential_jerk,
                self.normal_acceleration,
                self.chord_error,
                self.period,
                self.step_deviation,
            ]
        )

    def feeds(self, path: PathChunk) -> Floats:
        """The largest feed that each piece may have: programmed and within the machine's; infinite for a traverse, which the axes limit."""
        return np.where(np.isnan(path.feed), inf, np.minimum(path.feed, self.max_feed))


@dataclass(frozen=True, slots=True)
class Junction:
    """How the path goes on from one chunk to the next: the speed to cross at, and whether it must be constant about the junction."""

    speed: float
    flat: bool


STANDSTILL = Junction(0.0, True)


@dataclass(frozen=True, slots=True)
class Intervals:
    """A stretch of path as intervals with constant bounds.

    end (n,): arc length where each ends, from the start of the chunk. speed (n,). accel, jerk (n, LEVELS): bounds at falling levels of
    speed. flat (n,): crossed at constant speed; a stop is a flat interval of no length at speed 0.
    """

    end: Floats
    speed: Floats
    accel: Floats
    jerk: Floats
    flat: NDArray[np.bool_]


def junction_between(before: PathChunk, after: PathChunk, limits: Limits) -> Junction:
    """The junction of two chunks that follow each other."""
    if before.stop_after[-1]:
        return STANDSTILL
    speed, flat = joint(
        before.kind[-1], before.data, before.at[-1], before.length[-1], limits.feeds(before)[-1],
        after.kind[0], after.data, after.at[0], after.length[0], limits.feeds(after)[0],
        limits.rules, limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk, np.zeros((2, 4, len(before.axes))),
    )  # fmt: skip
    return Junction(speed, flat)


def intervals(path: PathChunk, limits: Limits, before: Junction, after: Junction) -> Intervals:
    """Cut a chunk into intervals with constant bounds."""
    room = 4 * len(path) + 1024
    while True:
        end, speed, flat = np.empty(room), np.empty(room), np.empty(room, np.bool_)
        accel, jerk = np.empty((room, LEVELS)), np.empty((room, LEVELS))
        count = chunk_intervals(
            path.kind, path.at, path.data, path.length, limits.feeds(path), path.stop_after,
            before.speed, before.flat, after.speed, after.flat,
            limits.rules, limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk,
            end, speed, accel, jerk, flat,
        )  # fmt: skip
        if count >= 0:
            return Intervals(end[:count], speed[:count], accel[:count], jerk[:count], flat[:count])
        room *= 2
