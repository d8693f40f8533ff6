r"""A chain of corners within its tolerance, and the spline in time past it.

The motion is a cubic B-spline in time, so each axis has a constant jerk in each of its steps. A
step belongs to one leg of the path, and its duration is a part of that of its group of steps. The
motion passes a corner between the steps of its two legs.

            group 0    group 1   group 2
          o---o---o---o-o-o-o.             e2
                             o             |
                leg 0        o  leg 1      |____ e1
                             o
                             o             step k lasts from t_k to t_k+1

Control point c_k has the parameters (t_k-2, t_k-1, t_k) of the polar form f (the blossom), so the
position at t_k is f(t_k, t_k, t_k), and step k has the control points c_k .. c_k+3. From the polar
form follow the Bezier points of a step, the control points of the velocity, the acceleration at its
start and its jerk.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints

FIXED = 3
"""The first and the last three control points follow from the motion beside."""

JERK, ACCELERATION, VELOCITY, LAST_VELOCITY, EARLY, LATE, FIRST_POINT, CORNER, POINT = range(9)
"""Places: the jerk of a step, the acceleration at its start, a control
point of the velocity, the next one; the second, third and first Bezier point of the step; the first
one where it lies between two legs; a control point.
"""


EDGE = 2e-4
"""Relative: where the motion beside takes all of the bound of its velocity or acceleration, the
first and the last step may take so much more. They need some room.
"""


class Tube(NamedTuple):
    """A chain of legs with their tolerance, the limits, and the motion beside.

    Attributes:
        axes: (n, d): components in each axis of the d directions in which the motion is sought.
        velocity: (n,): limits of each axis, mm/s; infinite where there are none.
        acceleration: (n,): mm/s^2.
        jerk: (n,): mm/s^3.
        travel: (2, n): lowest and highest position, from the origin of the legs, mm.
        feed: (legs,): mm/s.
        along_pull: largest acceleration along the path, mm/s^2.
        across_pull: largest acceleration across the path, mm/s^2.
        along_jerk: largest jerk along the path, mm/s^3.
        tolerance: mm.
        start: (legs, d): a point of each leg, mm.
        along: (legs, d): direction of each leg.
        reach: (legs, 2): first and last place of each leg on its line, from ``start``, mm.
        leg: (steps,): leg of each step.
        group: (steps,): group of each step.
        part: (steps,): duration of each step, as a part of that of its group.
        ends: (2, 3, d): position, velocity and acceleration at the start and at the end.
        unit: mm; 0 where the end is given. Else the motion ends at rest on the last leg, at a place
            that is sought: behind its start by this times the last of the unknowns ``spans``.
    """

    axes: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    travel: Floats
    feed: Floats
    along_pull: float
    across_pull: float
    along_jerk: float
    tolerance: float
    start: Floats
    along: Floats
    reach: Floats
    leg: Ints
    group: Ints
    part: Floats
    ends: Floats
    unit: float


@njit
def durations_of(tube: Tube, spans: Floats) -> int:
    """Return how many of the unknowns are logarithms of durations."""
    return len(spans) - (1 if tube.unit > 0.0 else 0)


@njit
def steps_of(tube: Tube, group: int, begin: int) -> tuple[int, int]:
    """Return the first step of a group, and the one behind its last; ``begin`` is its first.

    A place of the end that is sought counts as a group of the last step. Other values depend on the
    two steps before and behind a group.
    """
    steps = len(tube.leg)
    if begin == steps:
        return steps - 1, steps
    end = begin + 1
    while end < steps and tube.group[end] == group:
        end += 1
    return begin, end


@njit
def set_knots(tube: Tube, spans: Floats, t: Floats) -> None:
    """Write t (steps + 5,) for logarithms ``spans`` (groups,) of the durations.

    Beside the ends, steps repeat. An end whose place is sought is written, too.
    """
    steps = len(tube.leg)
    if tube.unit > 0.0:
        last = len(tube.feed) - 1
        for q in range(tube.start.shape[1]):
            place = tube.unit * spans[-1] * tube.along[last, q]
            tube.ends[1, 0, q] = tube.start[last, q] + place
    t[2] = 0.0
    for k in range(steps):
        t[k + 3] = t[k + 2] + math.exp(spans[tube.group[k]]) * tube.part[k]
    begin, end = t[3] - t[2], t[steps + 2] - t[steps + 1]
    t[1], t[0] = -begin, -2.0 * begin
    t[steps + 3], t[steps + 4] = t[steps + 2] + end, t[steps + 2] + 2.0 * end


@njit
def place_ends(tube: Tube, t: Floats, c: Floats) -> None:
    """Write the control points (steps + 3, d) that give the motion its states at both ends.

    They have t_0 or t_steps among their parameters, so the jerk does not count.
    """
    steps = len(tube.leg)
    for end in range(2):
        first = steps * end
        origin = t[first + 2]
        for k in range(first, first + FIXED):
            x, y, z = t[k] - origin, t[k + 1] - origin, t[k + 2] - origin
            by_v, by_a = (x + y + z) / 3.0, (x * y + y * z + z * x) / 6.0
            for q in range(c.shape[1]):
                state = tube.ends[end]
                c[k, q] = state[0, q] + by_v * state[1, q] + by_a * state[2, q]


@njit
def write_stencil(kind: int, k: int, t: Floats, out: Floats) -> None:
    """Write the weights (4,) of control points k .. k + 3 in what a place bounds."""
    tm2, tm1, t0, t1, t2 = t[k], t[k + 1], t[k + 2], t[k + 3], t[k + 4]
    out[:] = 0.0
    if kind == VELOCITY:
        out[1] = 3.0 / (t1 - tm2)
        out[0] = -out[1]
    elif kind == LAST_VELOCITY:
        out[2] = 3.0 / (t2 - tm1)
        out[1] = -out[2]
    elif kind <= ACCELERATION:
        rate = 2.0 / (t1 - tm1)
        first, second = rate * 3.0 / (t1 - tm2), rate * 3.0 / (t2 - tm1)
        if kind == ACCELERATION:
            out[0], out[1], out[2] = first, -first - second, second
        else:
            t3 = t[k + 5]
            rate = 2.0 / (t2 - t0)
            third, fourth = rate * 3.0 / (t2 - tm1), rate * 3.0 / (t3 - t0)
            step = 1.0 / (t1 - t0)
            out[0] = -step * first
            out[1] = step * (third + first + second)
            out[2] = -step * (third + fourth + second)
            out[3] = step * fourth
    elif kind == POINT:
        out[0] = 1.0
    elif kind == LATE:
        out[2] = (t1 - tm1) / (t2 - tm1)
        out[1] = 1.0 - out[2]
    else:
        early = (t0 - tm1) / (t2 - tm1)
        if kind == EARLY:
            out[1], out[2] = 1.0 - early, early
        else:
            before, part = (t0 - tm2) / (t1 - tm2), (t0 - tm1) / (t1 - tm1)
            out[0] = (1.0 - part) * (1.0 - before)
            out[1] = (1.0 - part) * before + part * (1.0 - early)
            out[2] = part * early
