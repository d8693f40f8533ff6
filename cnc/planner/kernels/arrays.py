"""Limits, paths, plans and phases as kernels take them: arrays with names."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Pieces


class LimitArrays(NamedTuple):
    """Limits along the path and of each axis; infinite where the machine has none.

    Attributes:
        tangential_acceleration: mm/s^2.
        tangential_jerk: mm/s^3.
        normal_acceleration: mm/s^2.
        chord_error: distance of the path from the chord of one period, mm.
        period: sampling period, s.
        step_deviation: relative difference of the arc and the chord of one period.
        axis_velocity: (axes,): mm/s.
        axis_acceleration: (axes,): mm/s^2.
        axis_jerk: (axes,): mm/s^3.
    """

    tangential_acceleration: float
    tangential_jerk: float
    normal_acceleration: float
    chord_error: float
    period: float
    step_deviation: float
    axis_velocity: NDArray[np.float64]
    axis_acceleration: NDArray[np.float64]
    axis_jerk: NDArray[np.float64]


class PathArrays(NamedTuple):
    """Consecutive pieces of a path: the arrays of a :class:`cnc.path.chunk.PathChunk`.

    Kernels that make a path write into one that has space for more.

    Attributes:
        pieces: the curves.
        length: (n,): arc length of each piece, mm.
        feed: (n,): programmed feed, mm/s; NaN for a traverse.
        line: (n,) int32: source line.
        stop_after: (n,) bool: the motion rests at the end of the piece.
        tolerance: (n,): largest distance of the motion from the corner behind the piece, mm.
    """

    pieces: Pieces
    length: NDArray[np.float64]
    feed: NDArray[np.float64]
    line: NDArray[np.int32]
    stop_after: NDArray[np.bool_]
    tolerance: NDArray[np.float64]


class PlanArrays(NamedTuple):
    """Phases of constant jerk, and the arc lengths at which the pieces of the path begin.

    Attributes:
        piece_s: (n + 1,): arc length at the start of each piece and at the end of the last, mm.
        t: (m + 1,): time at the start of each phase and at the end of the last, s.
        s: (m + 1,): arc length there, mm.
        v: (m + 1,): speed there, mm/s.
        a: (m + 1,): tangential acceleration there, mm/s^2.
        j: (m,): tangential jerk of each phase, mm/s^3.
    """

    piece_s: NDArray[np.float64]
    t: NDArray[np.float64]
    s: NDArray[np.float64]
    v: NDArray[np.float64]
    a: NDArray[np.float64]
    j: NDArray[np.float64]


# Phases of constant jerk as rows of an array, as the planner makes and changes them.
#
# A finished plan has the same data as PlanArrays.

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
