"""A published five-axis path: the flank of a part, as two cubic B-splines.

Source: H.-Y. Ma and others, "Optimal feedrate planning on a five-axis parametric tool path",
Journal of Computational Design and Engineering, 2022, appendix 1 (control points of the tip P and
of a second point H on the axis of the tool) and table 4 (limits of the axes), as in the data sets
of github.com/Theigrams/cnc-five-axis-interpolation (MIT licence).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from cnc.kinematics.five_axis import FiveAxis
from cnc.machine.models import Axis, Board, Machine, PathLimits
from cnc.model.blocks import Block, PathMode, Polyline, TipControl

KNOTS = np.array([0, 0, 0, 0, 0.2, 0.4, 0.6, 0.8, 1, 1, 1, 1], float)
TIP = np.array(
    [[5, 0, 0], [-10, 20, 0], [10, 20, 0], [20, 30, 0], [30, 30, 0], [40, 30, 0], [50, 20, 0],
     [55, 0, 0]],
    float,
)  # fmt: skip
SECOND = np.array(
    [[0, 0, 15], [-15, 20, 15], [5, 25, 15], [15, 35, 15], [30, 35, 15], [45, 35, 15],
     [55, 25, 15], [60, 0, 15]],
    float,
)  # fmt: skip
VELOCITY = (100.0, 100.0, 100.0, np.degrees(0.4), np.degrees(0.8))
ACCELERATION = (500.0, 500.0, 500.0, np.degrees(0.5), np.degrees(0.5))
JERK = (3000.0, 3000.0, 3000.0, np.degrees(1.5), np.degrees(1.5))
LENGTH = 150.0
"""Length of the tool, mm."""


def poses(count: int) -> np.ndarray:
    """Return X, Y, Z, A and C (count, 5) along the path; C counts its turns."""
    u = np.linspace(0.0, 1.0, count)
    tip, second = (BSpline(KNOTS, points, 3)(u) for points in (TIP, SECOND))
    axis = second - tip
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    tilt = np.degrees(np.arccos(axis[:, 2]))
    turn = np.degrees(np.unwrap(np.arctan2(axis[:, 0], -axis[:, 1])))
    return np.column_stack((tip, tilt, turn))


def flank_machine(period: float = 1e-3) -> Machine:
    """Return a trunnion with the published limits."""
    axes = {
        letter: Axis(
            steps_per_mm=1000.0, max_velocity=v, max_acceleration=float(a), max_jerk=float(j)
        )
        for letter, v, a, j in zip("xyzac", VELOCITY, ACCELERATION, JERK, strict=True)
    }
    return Machine(
        name="flank",
        kinematics=FiveAxis(type="xyzac", tilt_point=(0.0, 0.0, -70.0)),
        axes=axes,
        path=PathLimits(max_feed=100.0, period=period),
        board=Board(max_step_rate=1e9),
    )


def flank_blocks(count: int, feed: float, tolerance: float) -> tuple[np.ndarray, list[Block]]:
    """Return the start of the path (5,), and blocks of ``count`` - 1 moves at a feed, mm/s."""
    places = poses(count)
    moves = Polyline(
        "", 2, places[1:], np.full(count - 1, feed), np.arange(2, count + 1, dtype=np.int32)
    )
    control = TipControl("", 1, (0.0, 0.0, LENGTH), places[0])
    return places[0], [control, PathMode("", 1, "blend", tolerance), moves]
