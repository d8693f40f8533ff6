"""The largest speeds and accelerations of the motion of a GRBL board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(slots=True)
class Largest:
    """Largest values of the motion at 100 %.

    Attributes:
        speed: Along the path, mm/s.
        acceleration: Along the path, mm/s^2.
        velocities: Of each axis (n,), mm/s.
        accelerations: Of each axis (n,), mm/s^2, along the path.
    """

    velocities: list[float]
    accelerations: list[float]
    speed: float = 0.0
    acceleration: float = 0.0

    @classmethod
    def of_axes(cls, axes: int) -> Largest:
        """Return zeros."""
        return cls([0.0] * axes, [0.0] * axes)

    def add(self, units: Floats, speeds: Floats, accelerations: Floats) -> None:
        """Add moves: directions (k, n), highest speeds (k,), accelerations (k,), 0 without one."""
        self.speed = max(self.speed, float(speeds.max()))
        self.acceleration = max(self.acceleration, float(accelerations.max()))
        sizes = np.abs(units)
        for mine, new in (
            (self.velocities, (sizes * speeds[:, None]).max(axis=0)),
            (self.accelerations, (sizes * accelerations[:, None]).max(axis=0)),
        ):
            mine[:] = np.maximum(mine, new).tolist()
