"""The fastest motion to rest on a helix, by a nonlinear programme over time (casadi, IPOPT).

It shares nothing with the planner: its unknowns are the jerks of phases of equal duration.
"""

import math
from typing import NamedTuple

import casadi

from cnc.planner.limits import Limits

PHASES = 40


class Helix(NamedTuple):
    """A helix about an axis parallel to z; a circle where ``rise`` is 0.

    Attributes:
        radius: mm.
        rise: part of the path length that z gains.
        angle: of the point at which the motion to rest begins, seen from the centre, rad.
    """

    radius: float
    rise: float
    angle: float


def shortest_time_to_rest(helix: Helix, v: float, a: float, limits: Limits) -> float:
    """Return the time in s from speed ``v`` and acceleration ``a``; NaN where none is found."""
    scale = max(v / min(limits.axis_acceleration.min(), limits.tangential_acceleration), 1e-3)
    problem = casadi.Opti()
    h, s = problem.variable(), problem.variable(PHASES + 1)
    speed, accel, jerk = (problem.variable(PHASES + n) for n in (1, 1, 0))
    problem.minimize(PHASES * h / scale)
    problem.subject_to(h >= 0)
    ends = [s[0] == 0, speed[0] == v, accel[0] == a, speed[PHASES] == 0, accel[PHASES] == 0]
    problem.subject_to(ends)
    problem.subject_to(speed >= 0)
    for k in range(PHASES):
        here = (s[k], speed[k], accel[k])
        behind, middle = (_after(t, *here, jerk[k]) for t in (h, h / 2))
        units = (v * scale, v, v / scale)
        for value, unit, wanted in zip(behind, units, (s, speed, accel), strict=True):
            problem.subject_to((wanted[k + 1] - value) / unit == 0)
        taken = [shares(helix, limits, *middle, jerk[k])[1]]
        if k:
            taken.append(shares(helix, limits, *here, 0)[0])
        for share in (share for each in taken for share in each):
            problem.subject_to(problem.bounded(-1, share, 1))
    start = [k / PHASES for k in range(PHASES + 1)]
    problem.set_initial(h, 3 * scale / PHASES)
    problem.set_initial(speed, [v * (1 - 3 * x**2 + 2 * x**3) for x in start])
    problem.set_initial(accel, [v * (6 * x**2 - 6 * x) / (3 * scale) for x in start])
    problem.set_initial(s, [3 * v * scale * (x - x**3 + x**4 / 2) for x in start])
    quiet = {"print_level": 0, "max_iter": 400, "sb": "yes"}
    problem.solver("ipopt", {"print_time": 0, "expand": True}, quiet)
    try:
        return float(PHASES * problem.solve().value(h))
    except RuntimeError:
        return math.nan


def _after(t, s, v, a, j):
    """Return arc length, speed and acceleration after time ``t`` at constant jerk."""
    return s + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j


def shares(helix: Helix, limits: Limits, s, v, a, j):
    """Return the shares of the limits of acceleration, and those of jerk, that a state uses."""
    flat = math.sqrt(1 - helix.rise**2)
    turn = flat / helix.radius
    angle = helix.angle + turn * s
    cos, sin = casadi.cos(angle), casadi.sin(angle)
    first = (-flat * sin, flat * cos, helix.rise)
    second = (-flat * turn * cos, -flat * turn * sin, 0.0)
    third = (flat * turn**2 * sin, -flat * turn**2 * cos, 0.0)
    accelerations = [(a, limits.tangential_acceleration)]
    jerks = [(j, limits.tangential_jerk)]
    rows = list(zip(first, second, third, limits.axis_acceleration, limits.axis_jerk, strict=True))
    for q1, q2, q3, a_max, j_max in rows if helix.rise else rows[:2]:
        accelerations.append((q1 * a + q2 * v**2, a_max))
        jerks.append((q1 * j + 3 * q2 * v * a + q3 * v**3, j_max))
    return tuple(
        [value / limit for value, limit in values if math.isfinite(limit)]
        for values in (accelerations, jerks)
    )
