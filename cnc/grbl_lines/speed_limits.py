r"""The highest speeds along a path for a board that makes its own ramps.

Such a board keeps the limits of each axis and slows down at corners. It does not know the curve
that its lines and arcs replace. At a point of a curve with the unit tangent t, and the derivatives
q'' and q''' of the position by arc length, the speed is at most

    v_i / |t_i|    sqrt(a_i / |q_i''|)    sqrt(a_n / |q''|)    cbrt(j_i / |q_i'''|)

for each axis i: at a constant speed v the axis has the speed q_i' v, the acceleration q_i'' v^2 and
the jerk q_i''' v^3. The derivatives are differences between the samples of the curve.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.moves import PlaneArc
from cnc.grbl_lines.number_format import LETTERS, PLANE_COLUMNS, board_axes
from cnc.machine.models import Machine

Floats = NDArray[np.float64]

NOTHING = 1e-12
"""In place of 0 where a limit is divided by it."""


class SpeedLimits(NamedTuple):
    """Limits of a machine; infinite where there is none.

    Attributes:
        feed: Highest feed, mm/s.
        rates: Highest speed of each axis of the board (n,), mm/s.
        accelerations: Of each axis (n,), mm/s^2.
        jerks: Of each axis (n,), mm/s^3.
        normal: Highest acceleration across the path, mm/s^2.
    """

    feed: float
    rates: Floats
    accelerations: Floats
    jerks: Floats
    normal: float

    @classmethod
    def of(cls, machine: Machine) -> SpeedLimits:
        """Return the limits of a machine file."""
        axes = [machine.axes.get(letter) for letter in board_axes(machine.axes)]

        def each(name: str) -> Floats:
            return np.array([getattr(axis, name, None) or math.inf for axis in axes])

        return cls(
            machine.path.max_feed or math.inf,
            each("max_velocity"),
            each("max_acceleration"),
            each("max_jerk"),
            machine.path.max_normal_acceleration or math.inf,
        )

    def straight(self, steps: Floats) -> Floats:
        """Return the highest speed along each of the steps (k, n), (k,) in mm/s."""
        lengths = np.linalg.norm(steps, axis=1)
        parts = np.abs(steps) / np.maximum(lengths, NOTHING)[:, None]
        speeds: Floats = (self.rates / np.maximum(parts, NOTHING)).min(axis=1)
        return speeds

    def curve(self, points: Floats) -> Floats:
        """Return the highest speed in each interval between the samples of a curve.

        Args:
            points: Samples from the start of the curve to its end (k + 1, n), mm, k >= 2.

        Returns:
            The larger one of the limits at both ends of each interval (k,), mm/s.
        """
        steps = np.diff(points, axis=0)
        lengths = np.maximum(np.linalg.norm(steps, axis=1), NOTHING)
        directions = steps / lengths[:, None]
        between = 0.5 * (lengths[1:] + lengths[:-1])
        bends = np.diff(directions, axis=0) / between[:, None]
        bends = np.concatenate((bends[:1], bends, bends[-1:]))
        sizes = np.abs(bends)
        by_axis = (self.accelerations / np.maximum(sizes, NOTHING)).min(axis=1)
        across = np.linalg.norm(bends[:, : len(LETTERS)], axis=1)
        by_path = self.normal / np.maximum(across, NOTHING)
        at_samples = np.sqrt(np.minimum(by_axis, by_path))
        changes = np.abs(np.diff(bends, axis=0)) / lengths[:, None]
        by_jerk = np.cbrt((self.jerks / np.maximum(changes, NOTHING)).min(axis=1))
        by_bend = np.maximum(at_samples[1:], at_samples[:-1])
        speeds: Floats = np.minimum(np.minimum(by_bend, by_jerk), self.straight(steps))
        return speeds

    def arc(self, arc: PlaneArc, radius: float, climb: float) -> tuple[float, float]:
        """Return the highest speed along an arc or helix, mm/s, and its length, mm.

        Args:
            arc: The arc.
            radius: mm.
            climb: Length along the axis across its plane, mm.
        """
        i, j, across = PLANE_COLUMNS[arc.plane]
        level = max(radius * abs(arc.sweep), NOTHING)
        acceleration = min(self.normal, float(min(self.accelerations[i], self.accelerations[j])))
        jerk = float(min(self.jerks[i], self.jerks[j]))
        speed = min(
            math.sqrt(acceleration * radius),
            math.cbrt(jerk * radius * radius),
            float(min(self.rates[i], self.rates[j])),
        )
        length = math.hypot(level, climb)
        if climb:
            speed = min(speed, float(self.rates[across]) * level / abs(climb))
        return speed * length / level, length


def corner_speeds(points: Floats, accelerations: Floats, deviation: float) -> Floats:
    """Return the speed at which the board passes each inner point (k - 1,), mm/s.

    Args:
        points: Ends of straight moves (k + 1, n), mm.
        accelerations: Of each axis (n,), mm/s^2.
        deviation: The board's $11, mm; see :mod:`cnc.grbl_lines.grbl_timing`.
    """
    steps = np.diff(points, axis=0)
    units = steps / np.maximum(np.linalg.norm(steps, axis=1), NOTHING)[:, None]
    turns = np.diff(units, axis=0)
    sizes = np.linalg.norm(turns, axis=1)
    # The size of the difference of two unit vectors is 2 cos(theta / 2), theta between the legs.
    half = np.sqrt(np.maximum(1.0 - 0.25 * sizes * sizes, 0.0))
    aims = np.abs(turns) / np.maximum(sizes, NOTHING)[:, None]
    acceleration = (accelerations / np.maximum(aims, NOTHING)).min(axis=1)
    squares: Floats = acceleration * deviation * half / np.maximum(1.0 - half, NOTHING)
    return np.sqrt(squares)
