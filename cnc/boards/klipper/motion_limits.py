"""Tolerances of a motion on a Klipper board, and how far ahead it is sent."""

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


@dataclass(frozen=True, slots=True)
class Pace:
    """How far ahead of the board a motion is sent.

    Attributes:
        horizon_s: Longest motion sent ahead of the motion that the board plays, s.
        prefill_s: Motion beyond the reserve that is there before the motion starts, s.
        start_s: Time from the start of a motion to its first move, s.
        dry_s: Motion left on the board at which the reserve becomes a ramp, s.
    """

    horizon_s: float
    prefill_s: float
    start_s: float
    dry_s: float


RUN = Pace(horizon_s=0.25, prefill_s=0.1, start_s=0.2, dry_s=0.08)
JOG = Pace(horizon_s=0.1, prefill_s=0.04, start_s=0.06, dry_s=0.03)
"""A jog ends soon after its release, so little is sent ahead."""
DENSE_DRY_S = 0.025
"""The same as ``dry_s`` at most, while the motion left uses half of the queue or more: dense motion
fills the queue of a small board before ``dry_s`` is reached.
"""
