"""Phases of constant jerk as rows of an array, as the planner makes and changes them.

A finished plan has the same data as arrays of its own (:mod:`cnc.kernels.planner.plan_arrays`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

PHASE = np.dtype(
    [
        ("duration", np.float64),
        ("s", np.float64),
        ("v", np.float64),
        ("a", np.float64),
        ("j", np.float64),
    ]
)
"""A phase: its duration in s, the arc length, speed and acceleration at its start, its jerk."""

Phases = NDArray[np.void]
"""(n,) of PHASE."""


@njit
def phase_at(dt: float, s: float, v: float, a: float, j: float) -> tuple[float, float, float]:
    """Return arc length, speed and acceleration after ``dt`` seconds of a phase."""
    return s + dt * (v + dt * (0.5 * a + dt * j / 6.0)), v + dt * (a + 0.5 * dt * j), a + dt * j


@njit
def write_phase(
    phases: Phases, k: int, duration: float, s: float, v: float, a: float, j: float
) -> None:
    """Write row ``k`` of ``phases``."""
    row = phases[k]
    row["duration"] = duration
    row["s"] = s
    row["v"] = v
    row["a"] = a
    row["j"] = j
