"""The limits of a machine as the planner's kernels take them, and the bounds that they put on a
stretch of path.

Two modes, either or both: along the path (tangential acceleration and jerk, normal acceleration)
and for each axis (acceleration, jerk). A limit that the machine file leaves out is infinite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.planner.limits import LEVELS, SAMPLES, chunk_intervals, joint
from cnc.machine.models import Machine
from cnc.path.chunk import PathChunk

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits in mm, s (degrees for rotary axes); axis arrays have one entry an axis of the machine.

    feed_factor: the operator's override of programmed feeds; 0 while the motion is held.
    slowing_from: mm/s; motion that is being slowed may be this fast where its feed is lower.
    """

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
    feed_factor: float = 1.0
    slowing_from: float = 0.0

    @classmethod
    def of(cls, machine: Machine) -> Limits:
        """The limits in a machine's configuration."""

        def each(name: str) -> Floats:
            return np.array(
                [
                    inf if getattr(axis, name) is None else getattr(axis, name)
                    for axis in machine.axes.values()
                ]
            )

        path = machine.path
        return cls(
            max_feed=path.max_feed,
            tangential_acceleration=inf
            if path.max_tangential_acceleration is None
            else path.max_tangential_acceleration,
            tangential_jerk=inf if path.max_jerk is None else path.max_jerk,
            normal_acceleration=inf
            if path.max_normal_acceleration is None
            else path.max_normal_acceleration,
            chord_error=path.chord_error,
            period=path.period,
            step_deviation=inf if path.step_deviation is None else path.step_deviation,
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

    @property
    def per_axis(self) -> bool:
        """Whether some axis has limits of its own for acceleration or jerk."""
        return bool(np.isfinite(self.axis_acceleration).any() or np.isfinite(self.axis_jerk).any())

    def feeds(self, path: PathChunk) -> Floats:
        """The largest feed that each piece may have: programmed, times the override, and within the
        machine's.

        A traverse is limited by the axes alone: infinite, but for motion that is coming to rest.
        """
        feeds = np.minimum(
            np.maximum(path.feed * self.feed_factor, self.slowing_from), self.max_feed
        )
        return np.where(
            np.isnan(path.feed), inf if self.feed_factor > 0.0 else self.slowing_from, feeds
        )

    def stopping_distance(self, v: float, *, any_direction: bool = False) -> float:
        """The least length within which motion comes to rest from ``v`` on a straight path: in the
        best direction, or in any.
        """
        size = np.min if any_direction else np.linalg.norm
        a = min(self.tangential_acceleration, float(size(self.axis_acceleration)))
        j = min(self.tangential_jerk, float(size(self.axis_jerk)))
        return 0.5 * v * (v / a + a / j) if v * j >= a * a else v * sqrt(v / j)


@dataclass(frozen=True, slots=True)
class Junction:
    """How the path goes on from one chunk to the next: the speed to cross at, and whether it must
    be constant about the junction.
    """

    speed: float
    flat: bool


STANDSTILL = Junction(0.0, True)


@dataclass(frozen=True, slots=True)
class Intervals:
    """A stretch of path as intervals with constant bounds.

    end (n,): arc length where each ends, from the start of the chunk. speed (n,): leaves room to
    change speed in any direction; top (n,): no motion is faster. accel, jerk (n, LEVELS): bounds at
    falling levels of speed. flat (n,): crossed at constant speed; a stop is a flat interval of no
    length at speed 0. sampled (n, 2): arc lengths between which ``samples`` (n, SAMPLES, 3, axes)
    holds the path's first three derivatives, evenly spaced.
    """

    end: Floats
    speed: Floats
    top: Floats
    accel: Floats
    jerk: Floats
    flat: NDArray[np.bool_]
    sampled: Floats
    samples: Floats

    def __len__(self) -> int:
        return len(self.end)

    def between(self, start: float, stop: float) -> Intervals:
        """The intervals from ``start`` to ``stop``, the last one cut there; a stop at ``stop`` is
        one of them, one at ``start`` isn't.
        """
        first = int(np.searchsorted(self.end, start, side="right"))
        last = int(np.searchsorted(self.end, stop, side="right"))
        cut = last < len(self) and (last == 0 or self.end[last - 1] < stop) and last >= first
        part = Intervals(*(getattr(self, field.name)[first : last + cut] for field in fields(self)))
        return replace(part, end=np.minimum(part.end, stop)) if cut else part

    @staticmethod
    def joined(parts: Sequence[Intervals], bases: Sequence[float]) -> Intervals:
        """Intervals of stretches that follow each other and begin at ``bases``."""
        places = {"end", "sampled"}
        return Intervals(
            *(
                np.concatenate(
                    [
                        getattr(part, field.name) + base
                        if field.name in places
                        else getattr(part, field.name)
                        for part, base in zip(parts, bases, strict=True)
                    ]
                )
                for field in fields(Intervals)
            )
        )


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
        found = Intervals(
            end=np.empty(room), speed=np.empty(room), top=np.empty(room),
            accel=np.empty((room, LEVELS)), jerk=np.empty((room, LEVELS)), flat=np.empty(room, np.bool_),
            sampled=np.empty((room, 2)), samples=np.empty((room, SAMPLES, 3, len(path.axes))),
        )  # fmt: skip
        count = chunk_intervals(
            path.kind, path.at, path.data, path.length, limits.feeds(path), path.stop_after,
            before.speed, before.flat, after.speed, after.flat,
            limits.rules, limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk,
            found.end, found.speed, found.top, found.accel, found.jerk, found.flat, found.sampled, found.samples,
        )  # fmt: skip
        if count >= 0:
            return Intervals(*(getattr(found, field.name)[:count] for field in fields(Intervals)))
        room *= 2
