r"""The ramps at a stop on a corner, overlapped in time.

The ramp from rest begins while the ramp to rest still runs. A stop takes the two one after the
other. Where the first ends and the second begins with constant jerk (J1, J2), the second may begin
tau early: then the motion cuts the corner.

        v |``\                  ,--
          |   \  before        /
          |    `.           ,-'
          |______`-.____,-'______ t
          |``\     ,--
          |   \   /    after
          |    `./
          |____,'`._____________ t

The deviation from the corner C is, with the directions u1 and u2 and x = t / tau,

    e(x) = | -d1 (1-x)^3 u1 + d2 x^3 u2 |,   d = J tau^3 / 6.

At the x where both distances are the same, J1 J2 / (c1 + c2)^3 tau^3 / 6 with c = J^(1/3), e is
2 sin(theta/2) times that (theta: the turn). That is at least the distance of the motion from the
corner, and more than its distance from the legs. With e = eps and equal jerks

    tau = (24 eps / (J sin(theta/2)))^(1/3).

During the overlap every axis has the constant jerk J1 u1 + J2 u2, so that the overlap is a timed
piece (:mod:`cnc.kernels.planner.timed`). Speeds and accelerations of an axis are means of those of
the two ramps, with weights whose sum is at most 1. Its jerk is a sum and must be checked. So must
be, where the machine limits them, the accelerations along the path and the tangential jerk: about
J (4 sin^2(theta/2) / cos(theta/2) + 2 cos(theta/2)) in the middle, never less than 2 J.

Before that each ramp may be changed so that it overshoots the corner
(:mod:`cnc.kernels.planner.overshoot`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats
from cnc.kernels.planner.legs import REVERSED, Turn
from cnc.kernels.planner.limit_arrays import LimitArrays
from cnc.kernels.planner.overshoot import PHASE_SHARE

SHORTEST = 1e-6
"""mm; where less than this of a leg would be cut, the corner is a stop."""

POINTS = 33
"""Points at which an overlap is compared with the limits along the path."""

REPEATS = 4
"""Number of times that the search for a maximum is repeated with as many points between the
neighbours of the highest: the jerk at a sharp corner has a sharp peak.
"""


class Leg(NamedTuple):
    """The ramp on one side of a corner.

    Attributes:
        j: its jerk beside the corner, mm/s^3.
        t: the duration of that jerk, s.
        length: the length of the leg that may be used, mm.
    """

    j: float
    t: float
    length: float


@njit
def overlap_time(
    u: Floats, turn: Turn, before: Leg, after: Leg, eps: float, limits: LimitArrays
) -> float:
    """Return the longest overlap of the ramps of two lines, s.

    It is 0 where an overlap breaks a limit or saves nothing.

    Args:
        u: (2, axes): the directions of the lines.
        turn: the turn between them.
        before: the ramp to rest.
        after: the ramp from rest.
        eps: largest distance of the motion from the corner, mm.
        limits: of the machine.
    """
    sine = turn.sine
    j1, j2 = before.j, after.j
    if sine > REVERSED or sine == 0.0:
        return 0.0
    for i in range(u.shape[1]):
        if abs(j1 * u[0, i] + j2 * u[1, i]) > limits.axis_jerk[i]:
            return 0.0
    roots = j1 ** (1.0 / 3.0) + j2 ** (1.0 / 3.0)
    tau = (3.0 * eps / (j1 * j2 * turn.widest)) ** (1.0 / 3.0) * roots
    tau = min(
        tau,
        PHASE_SHARE * before.t,
        PHASE_SHARE * after.t,
        (6.0 * before.length / j1) ** (1.0 / 3.0),
        (6.0 * after.length / j2) ** (1.0 / 3.0),
    )
    least = min(limits.tangential_acceleration, limits.tangential_jerk, limits.normal_acceleration)
    period, chord_error = limits.period, limits.chord_error
    if least < math.inf or chord_error < period * period / 8.0 * max(j1, j2) * tau:
        most, pull, bend = largest_along(j1, j2, 1.0 - 2.0 * sine * sine)
        if most > limits.tangential_jerk:
            return 0.0
        tau = min(
            tau,
            limits.tangential_acceleration / pull,
            limits.normal_acceleration / bend,
            8.0 * chord_error / (period * period * bend),
        )
    return tau if min(j1, j2) * tau**3 / 6.0 > SHORTEST else 0.0


@njit
def largest_along(j1: float, j2: float, cos: float) -> tuple[float, float, float]:
    """Return the largest values along the path of two ramps that overlap for a time of 1.

    The jerk is the same for any time; the accelerations are proportional to it. The motion is that
    of :func:`cnc.kernels.planner.timed.timed_motion` there.

    Args:
        j1: jerk of the ramp to rest.
        j2: jerk of the ramp from rest.
        cos: of the turn.

    Returns:
        The tangential jerk, the tangential and the normal acceleration.
    """
    most = np.zeros(3)
    values = np.zeros(3)
    for m in range(3):
        low = 0.0
        high = 1.0
        for _ in range(REPEATS):
            best = 0
            for k in range(POINTS):
                x = low + (high - low) * k / (POINTS - 1.0)
                a1 = -j1 * (1.0 - x)
                a2 = j2 * x
                v1 = 0.5 * j1 * (1.0 - x) ** 2
                v2 = 0.5 * j2 * x * x
                speed = math.sqrt(v1 * v1 + v2 * v2 + 2.0 * v1 * v2 * cos)
                squared = a1 * a1 + a2 * a2 + 2.0 * a1 * a2 * cos
                along = (v1 * a1 + v2 * a2 + (v1 * a2 + v2 * a1) * cos) / speed
                values[0] = abs(
                    (squared + v1 * j1 + v2 * j2 + (v1 * j2 + v2 * j1) * cos - along * along)
                    / speed
                )
                values[1] = abs(along)
                values[2] = math.sqrt(max(squared - along * along, 0.0))
                if values[m] > most[m]:
                    most[m] = values[m]
                    best = k
            width = (high - low) / (POINTS - 1.0)
            low, high = max(low + (best - 1) * width, 0.0), min(low + (best + 1) * width, 1.0)
    return most[0], most[1], most[2]
