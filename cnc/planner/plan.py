"""A plan: constant-jerk phases over the arc length of a stretch of path: the one timing model,
which estimates, samples and pulses read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.path.chunk import PathChunk


@dataclass(frozen=True, slots=True)
class PlanChunk:
    """Motion over ``path`` from local arc length ``phase_s[0]`` to ``phase_s[-1]``.

    path: the pieces that the motion touches; a chunk may begin and end inside a piece. piece_s (m +
    1,): local arc length at the pieces' ends, 0 at the start of the first. t0: time in s since the
    program's start at which the motion begins. s0: path length that lies before local arc length 0.
    phase_t (p + 1,): times from t0, starting with 0. phase_s, phase_v, phase_a (p + 1,): arc
    length, speed and tangential acceleration there. phase_j (p,): jerk inside each phase. Within
    phase k, with dt = t - phase_t[k], s = phase_s[k] + dt (v + dt (a / 2 + dt j / 6)).
    """

    path: PathChunk
    piece_s: NDArray[np.float64]
    t0: float
    s0: float
    phase_t: NDArray[np.float64]
    phase_s: NDArray[np.float64]
    phase_v: NDArray[np.float64]
    phase_a: NDArray[np.float64]
    phase_j: NDArray[np.float64]

    @property
    def duration(self) -> float:
        """Seconds from the first to the last phase boundary."""
        return float(self.phase_t[-1])
