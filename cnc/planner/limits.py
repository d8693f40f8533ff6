"""The limits of a machine as the planner uses them.

Limits are along the path (tangential acceleration and jerk, normal acceleration), for each axis
(acceleration, jerk), or both. A limit that the machine file leaves out is infinite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.path.chunk import PathChunk
from cnc.planner.kernels.arrays import LimitArrays

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits in mm and s (degrees for rotary axes).

    Attributes:
        max_feed: mm/s.
        tangential_acceleration: and the following: see
            :class:`cnc.planner.kernels.arrays.LimitArrays`.
        travel: (2, columns): lowest and highest position, for motion beside the programmed path;
            infinite for an axis that repeats after a turn.
        tip_columns: number of columns of the tool tip in front of those of the joints, which have
            no limits of their own; 0 where the axes are the joints.
        feed_factor: the operator's override of programmed feeds; 0 while the motion is held.
        slowing_from: motion that slows may have this speed where its feed is lower, mm/s.
        spread: longest time by which shaping mixes the motion at a place with that before and
            behind, s; see :class:`cnc.planner.shaping.Shaping`.
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
    travel: Floats
    tip_columns: int = 0
    feed_factor: float = 1.0
    slowing_from: float = 0.0
    spread: float = 0.0

    @classmethod
    def of(cls, machine: Machine) -> Limits:
        """Return the limits in a machine's configuration."""

        def unless_none(value: float | None) -> float:
            return inf if value is None else value

        joints = machine.joint_tables.values()
        tip_columns = machine.tip_columns

        def of_columns(name: str) -> Floats:
            own = [unless_none(getattr(joint, name)) for joint in joints]
            return np.array([inf] * tip_columns + own)

        # With tool-tip control the travel is that of the joints, which have the tables of the axes.
        tip: list[tuple[float, float] | None] = [None] * tip_columns
        if not machine.kinematics.with_tip_control:
            tip = [axis.travel for axis in machine.axes.values()][:tip_columns]
        # The travel of compensated axes is that of the tip: true places.
        own = [None if joint.wrap or machine.is_compensated else joint.travel for joint in joints]
        travel = [span or (-inf, inf) for span in (*tip, *own)]
        path = machine.path
        return cls(
            max_feed=path.max_feed,
            tangential_acceleration=unless_none(path.max_tangential_acceleration),
            tangential_jerk=unless_none(path.max_jerk),
            normal_acceleration=unless_none(path.max_normal_acceleration),
            chord_error=path.chord_error,
            period=path.period,
            step_deviation=unless_none(path.step_deviation),
            axis_velocity=of_columns("max_velocity"),
            axis_acceleration=of_columns("max_acceleration"),
            axis_jerk=of_columns("max_jerk"),
            travel=np.array(travel).T,
            tip_columns=tip_columns,
        )

    @classmethod
    def of_tip(cls, machine: Machine) -> Limits:
        """Return limits of the columns of the tip alone, as strict as the strictest joint's.

        They are for estimates: the limits of the joints hold for the joints.
        """
        limits = cls.of(machine)
        columns, own = limits.tip_columns, slice(limits.tip_columns, None)
        return replace(
            limits,
            tip_columns=0,
            travel=limits.travel[:, :columns],
            axis_velocity=np.full(columns, limits.axis_velocity[own].min()),
            axis_acceleration=np.full(columns, limits.axis_acceleration[own].min()),
            axis_jerk=np.full(columns, limits.axis_jerk[own].min()),
        )

    @property
    def arrays(self) -> LimitArrays:
        """The machine's limits as kernels take them."""
        return LimitArrays(
            self.tangential_acceleration,
            self.tangential_jerk,
            self.normal_acceleration,
            self.chord_error,
            self.period,
            self.step_deviation,
            self.axis_velocity,
            self.axis_acceleration,
            self.axis_jerk,
        )

    @property
    def per_axis(self) -> bool:
        """Whether an axis has a limit of its own for acceleration or jerk."""
        return bool(np.isfinite(self.axis_acceleration).any() or np.isfinite(self.axis_jerk).any())

    def feeds(self, path: PathChunk) -> Floats:
        """Return the largest feed of each piece, mm/s.

        It is the programmed feed times the override, at most the machine's. A traverse is limited
        by the axes alone: its feed is infinite, except for motion that slows to rest.
        """
        feeds = np.minimum(
            np.maximum(path.feed * self.feed_factor, self.slowing_from), self.max_feed
        )
        return np.where(
            np.isnan(path.feed), inf if self.feed_factor > 0.0 else self.slowing_from, feeds
        )

    def slower(self, part: float) -> Limits:
        """Return the limits with which a motion has at most ``part`` of the speed.

        The motion that these limits allow is one within the limits themselves, with a slower clock.
        """
        squared, cubed = part**2, part**3
        return replace(
            self,
            max_feed=self.max_feed * part,
            feed_factor=self.feed_factor * part,
            tangential_acceleration=self.tangential_acceleration * squared,
            tangential_jerk=self.tangential_jerk * cubed,
            normal_acceleration=self.normal_acceleration * squared,
            chord_error=self.chord_error * squared,
            step_deviation=self.step_deviation * squared,
            axis_velocity=self.axis_velocity * part,
            axis_acceleration=self.axis_acceleration * squared,
            axis_jerk=self.axis_jerk * cubed,
        )

    def stopping_distance(self, v: float, *, any_direction: bool = False) -> float:
        """Return the least length, mm, in which motion stops from ``v`` on a straight path.

        It is that in the best direction, or that which is enough in any.
        """
        size, own = np.min if any_direction else np.linalg.norm, slice(self.tip_columns, None)
        a = min(self.tangential_acceleration, float(size(self.axis_acceleration[own])))
        j = min(self.tangential_jerk, float(size(self.axis_jerk[own])))
        return 0.5 * v * (v / a + a / j) if v * j >= a * a else v * sqrt(v / j)
