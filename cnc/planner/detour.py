r"""The rest of a motion past corners as a path of its own, on which the motion may stop.

Such a motion is given by time (:mod:`cnc.kernels.planner.timed`). For a hold, its rest becomes a
curve in front of the path behind it, and the same motion becomes phases along that curve, from
which the search for a stop begins:

          here
     C - - o.            curve: from the start of the piece that is under way
             `\
               \
                |        the path behind
                |
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.phases import PHASE, Phases
from cnc.kernels.planner.timed_path import (
    MOST_PLACES,
    measured_path,
    measured_size,
    timed_states,
)
from cnc.path.chunk import PathChunk
from cnc.planner.corners import ACCURACY
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

CHANGE = 0.005
"""Part of the smallest limit of jerk by which the jerk along the path changes between places."""

THIRDS = np.linalg.inv(np.array([[1.0, 1.0, 1.0], [2.5, 1.5, 0.5], [19.0 / 6.0, 7.0 / 6.0, 1 / 6]]))
"""Gives the jerks in three equal parts of a phase for a change of acceleration, and for the rest of
the changes of speed and place.
"""


def detour(motion: PlanChunk, limits: Limits) -> tuple[PathChunk, Phases]:
    """Return the path of a motion past corners as a curve, and its phases along that curve.

    Args:
        motion: phases over timed pieces, one on each.
        limits: of the machine.

    Returns:
        The curve, and phases whose arc lengths are measured from its start. They meet place, speed
        and acceleration at the ends of each phase of ``motion``, and come near to them in between.
    """
    path = motion.path
    count, pieces = len(path), Pieces(path.kind, path.at, path.data)
    out = Pieces(
        np.empty(count, np.int64), np.empty(count, np.int64), np.empty(measured_size(pieces))
    )
    length = np.empty(count)
    size = measured_path(pieces, ACCURACY, out, length)
    curve = replace(path, kind=out.kind, at=out.at, data=out.data[:size].copy(), length=length)
    states = np.empty((MOST_PLACES * count + 1, 4))
    change = CHANGE * min(limits.tangential_jerk, float(limits.axis_jerk.min()))
    return curve, _phases(states[: timed_states(pieces, motion.arrays, change, states)])


def _phases(states: Floats) -> Phases:
    """Return phases that meet states: rows (n, 4) of time, place, speed and acceleration."""
    phases = np.empty(3 * len(states) - 3, PHASE)
    t, s, v, a = states[:-1].T
    t_end, s_end, v_end, a_end = states[1:].T
    whole = t_end - t
    third = whole / 3.0
    miss = np.stack(
        (
            (a_end - a) / third,
            (v_end - v - whole * a) / third**2,
            (s_end - s - whole * (v + 0.5 * whole * a)) / third**3,
        )
    )
    for k, j in enumerate(THIRDS @ miss):
        row = phases[k::3]
        row["duration"], row["s"], row["v"], row["a"], row["j"] = third, s, v, a, j
        s = s + third * (v + third * (0.5 * a + third * j / 6.0))
        v, a = v + third * (a + 0.5 * third * j), a + third * j
    return phases
