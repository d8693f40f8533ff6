"""Tolerances of a motion on a Klipper board."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Tolerances of a motion.

    Attributes:
        tolerance_s: Largest deviation of a step from its time, s.
        spacing_s: Least time between two steps of an axis, s.
        ramp_s: Length of an emergency ramp, s.
    """

    tolerance_s: float
    spacing_s: float
    ramp_s: float
