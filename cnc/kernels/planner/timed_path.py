r"""The path of a motion past corners, measured by its arc length.

A motion that stops inside of such a motion (:mod:`cnc.kernels.planner.timed`) is planned along its
path, like any other. So its timed pieces become spans with a table of the arc length.
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import measure
from cnc.kernels.path.curve import LENGTH, SPAN, SPAN_BODY, START, U1, Floats, curve_eval
from cnc.kernels.path.joint_records import LARGEST_TABLE
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.kernels.planner.timed import timed_length, timed_motion, write_turns

MOST_PLACES = 64
"""Largest number of parts of a phase."""


@njit
def measured_size(pieces: Pieces) -> int:
    """Return the largest size of the records of :func:`measured_path`, in numbers."""
    data, at = pieces.data, pieces.at
    size = 0
    for k in range(len(at)):
        n = int(data[at[k]])
        size += START + 2 * n + SPAN_BODY + 4 * (n + 1) + LARGEST_TABLE + 3 * n
    return size


@njit
def measured_path(pieces: Pieces, accuracy: float, out: Pieces, length: Floats) -> int:
    """Write timed pieces as spans with a table of their arc length.

    Args:
        pieces: the timed pieces.
        accuracy: largest error of the inverse arc length, mm.
        out: receives the pieces; see :func:`measured_size`.
        length: (pieces,): receives their lengths, mm.

    Returns:
        The size of the records, in numbers.
    """
    data = pieces.data
    q = np.empty((4, int(data[pieces.at[0]])))
    used = 0
    for k in range(len(length)):
        at = pieces.at[k]
        size = int(data[at + START + 2 * q.shape[1] + 1])
        for i in range(size):
            out.data[used + i] = data[at + i]
        behind = measure(pieces.kind[k], out.data, used, used + size, accuracy, q)
        out.kind[k] = SPAN
        out.at[k] = used
        length[k] = out.data[used + LENGTH]
        used = write_turns(out.data, used, behind)
    return used


@njit
def timed_states(pieces: Pieces, plan: PlanArrays, change: float, states: Floats) -> int:
    """Write the motion along the path at places of phases over timed pieces, one on each.

    The places divide a phase evenly, so that the jerk along the path changes by no more than about
    ``change`` between two of them.

    Args:
        pieces: the timed pieces.
        plan: the phases; the first may begin, and the last end inside its piece.
        change: of the jerk, mm/s^3.
        states: (MOST_PLACES phases + 1, 4): receives the time, s, the path length since the start
            of the first piece, mm, the speed along the path and the tangential acceleration.

    Returns:
        The number of places.
    """
    data = pieces.data
    q = np.empty((4, int(data[pieces.at[0]])))
    count = 0
    before = 0.0
    for k in range(len(plan.j)):
        kind, at, rate = pieces.kind[k], pieces.at[k], plan.v[k]
        begin = max(plan.s[k] - plan.piece_s[k], 0.0)
        extent = min(plan.s[k + 1], plan.piece_s[k + 1]) - plan.piece_s[k] - begin
        varied, jerk = 0.0, 0.0
        for m in range(MOST_PLACES + 1):
            curve_eval(kind, data, at, begin + extent * m / MOST_PLACES, q)
            _, _, here, _ = timed_motion(data, at, q, rate)
            if m > 0:
                varied += abs(here - jerk)
            jerk = here
        parts = int(min(max(math.ceil(varied / change), 1.0), MOST_PLACES))
        last = 1 if k + 1 == len(plan.j) else 0
        for m in range(parts + last):
            u = begin + extent * m / parts
            states[count, 0] = plan.t[k] + (plan.t[k + 1] - plan.t[k]) * m / parts
            states[count, 1] = before + timed_length(kind, data, at, u, q)
            curve_eval(kind, data, at, u, q)
            states[count, 2], states[count, 3], _, _ = timed_motion(data, at, q, rate)
            count += 1
        before += timed_length(kind, data, at, data[at + U1], q)
    return count
