"""A plan: phases of constant jerk over the arc length of a stretch of path.

It is the one timing model: estimates, samples and pulses are computed from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.path.chunk import PathChunk


@dataclass(frozen=True, slots=True)
class PlanChunk:
    """Motion over ``path`` from local arc length ``phase_s[0]`` to ``phase_s[-1]``.

    Within phase k, with dt = t - phase_t[k], s = phase_s[k] + dt (v + dt (a / 2 + dt j / 6)).

    Attributes:
        path: the n pieces that the motion touches; a chunk may begin and end inside a piece.
        piece_s: (n + 1,): local arc length at the ends of the pieces, 0 at the start of the first.
        t0: time since the start of the program at which the motion begins, s.
        s0: path length before local arc length 0, mm.
        phase_t: (m + 1,): times from t0, starting with 0.
        phase_s: (m + 1,): arc length at these times, mm.
        phase_v: (m + 1,): speed there, mm/s.
        phase_a: (m + 1,): tangential acceleration there, mm/s^2.
        phase_j: (m,): jerk inside each phase, mm/s^3.
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
        """Time from the first to the last end of a phase, s."""
        return float(self.phase_t[-1])

    @property
    def arrays(self) -> PlanArrays:
        """The phases as kernels take them."""
        return PlanArrays(
            self.piece_s, self.phase_t, self.phase_s, self.phase_v, self.phase_a, self.phase_j
        )
