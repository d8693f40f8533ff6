"""The limits of a machine as kernels take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
