"""A plan s(t) as kernels take it: phases of constant jerk over the pieces of a path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
