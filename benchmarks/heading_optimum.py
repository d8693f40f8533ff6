"""The time-optimal motion inside the tolerance tube of a planar polygon, where the path is limited.

Limits along the path are simple where the motion is given by its heading: with the speed v, the
tangential acceleration a, the curvature k and the heading h,

    x' = v cos h,  y' = v sin h,  h' = k v,  v' = a,

the normal acceleration is k v^2 and the tangential jerk is a'. The jerk in the axes has the
components a' - k^2 v^3 along the path and 3 k v a + k' v^2 across it. All are smooth for v > 0. In
x, y and their derivatives (:mod:`benchmarks.tube_optimum`) they are not, so a solver seldom finds
a legal motion there.

a' and k' are constant in each step. IPOPT (through casadi) lowers the sum of the durations. The
result is integrated in finer steps: it counts only where it keeps to the polygon there, and its
clock is slowed until every limit holds. It is a local optimum, so it bounds the true one from
above.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from benchmarks.tube_optimum import Tube

Floats = NDArray[np.float64]

COARSE, STEPS = (8, 6, 8), (18, 8, 18)
"""Steps of each leg: behind a corner, in the middle, before the next corner."""

GROUPS = 3

PARTS = 2
"""Parts of a step that are integrated one after the other. The tube is observed at the middle and
the end of each.
"""

TURN = 0.6
"""Largest change of the heading in a step."""

SHORTEST = 1e-3
"""Least duration of a group, as a part of the mean of the guess."""

TRIES = 3
"""Solutions on the finer steps, each in a narrower tube."""

SIDE, NEAR = 0.3, 4.0
"""Part of a leg's time that the outer groups take at first; but no more than the ramp to the feed,
and so many times the time by which the largest jerk moves by the tolerance.
"""

SLOWED = 1.05
"""The solver begins with the guess slowed by this."""

INSIDE = 0.995
"""Part of the tolerance that the solver uses."""

OFF = 1.01
"""Deviation in tolerances that counts as within it."""

MISSED = 0.02
"""Largest difference between the solver's integration and the finer one, in tolerances."""

FINE = 8
"""Parts of a step of the finer integration."""

SLOWEST = 1e-3
"""Least speed between the ends, as a part of the feed."""

ITERATIONS, LONGEST = 600, 60.0
"""Bounds on the iterations of a solution, and on its CPU time, s."""
CLOSE = 0.03
"""The heading is not read where the guess is slower than this part of its largest speed."""


class Steps(NamedTuple):
    """The steps.

    Attributes:
        leg: (m,): the leg of each.
        group: (m,): its group. Their durations are equal.
        t: (m + 1,): times of the guess, s.
    """

    leg: NDArray[np.int64]
    group: NDArray[np.int64]
    t: Floats


class Units(NamedTuple):
    """Units of the variables: length, mm, and time, s."""

    length: float
    time: float


class Solution(NamedTuple):
    """A motion on given steps, in units of :class:`Units`.

    Attributes:
        state: (6, m + 1): x, y, heading, speed, acceleration along the path and curvature.
        rate: (2, m): the changes of the last two.
        span: (groups,): durations of the groups.
    """

    state: Floats
    rate: Floats
    span: Floats


def time_beside_corner(tube: Tube) -> float:
    """Return the time in which a motion turns at a corner and comes to its feed, about, s."""
    limits = tube.limits
    jerk = min(limits.tangential_jerk, float(limits.axis_jerk.min()))
    pull = min(limits.tangential_acceleration, float(limits.axis_acceleration.min()))
    ramp = tube.feed / pull + pull / jerk
    return float(NEAR * (6.0 * tube.tolerance / jerk) ** (1.0 / 3.0) + ramp)


def steps_of(passed: Floats, counts: tuple[int, ...], near: float) -> Steps:
    """Return the steps for a guess that passes start, corners and end at these times.

    ``counts``: steps of each group of a leg. ``near``: bound on the time of the outer groups, s.
    """
    leg: list[int] = []
    group: list[int] = []
    t = [0.0]
    for k, (begin, end) in enumerate(pairwise(passed)):
        side = min(SIDE * (end - begin), near)
        shares = (side, end - begin - 2.0 * side, side)
        for g, (count, duration) in enumerate(zip(counts, shares, strict=True)):
            leg += [k] * count
            group += [GROUPS * k + g] * count
            t += (t[-1] + duration * np.arange(1, count + 1) / count).tolist()
    return Steps(np.array(leg), np.array(group), np.array(t))


def change(x: casadi.MX, u: casadi.MX) -> casadi.MX:
    """Return the derivative of a state (x, y, heading, v, a, k) for u = (a', k')."""
    v, a, k = x[3], x[4], x[5]
    return casadi.vertcat(v * casadi.cos(x[2]), v * casadi.sin(x[2]), v * k, a, u[0], u[1])


def advanced(x: casadi.MX, u: casadi.MX, h: casadi.MX) -> tuple[casadi.MX, casadi.MX]:
    """Return the states in the middle and at the end of a step, by Runge and Kutta's method."""
    first = change(x, u)
    second = change(x + h / 2 * first, u)
    third = change(x + h / 2 * second, u)
    fourth = change(x + h * third, u)
    return x + h / 2 * second, x + h / 6 * (first + 2 * second + 2 * third + fourth)


def used(tube: Tube, unit: Units, x: casadi.MX, u: casadi.MX) -> list[tuple[casadi.MX, float, int]]:
    """Return what is limited at a state: the value, its bound in these units, and its order."""
    limits = tube.limits
    v, a, k = x[3], x[4], x[5]
    across = k * v * v
    along_jerk, across_jerk = u[0] - k * k * v**3, 3.0 * v * a * k + v * v * u[1]
    cosine, sine = casadi.cos(x[2]), casadi.sin(x[2])
    found = [
        (v, tube.feed, 1),
        (a, limits.tangential_acceleration, 2),
        (across, tube.normal, 2),
        (u[0], limits.tangential_jerk, 3),
    ]
    for i, (first, second) in enumerate(((cosine, -sine), (sine, cosine))):
        found += [
            (v * first, limits.axis_velocity[i], 1),
            (a * first + across * second, limits.axis_acceleration[i], 2),
            (along_jerk * first + across_jerk * second, limits.axis_jerk[i], 3),
        ]
    return [
        (value, float(bound) * unit.time**order / unit.length, order)
        for value, bound, order in found
        if math.isfinite(bound)
    ]


def optimum(tube: Tube, t: Floats, r: Floats, passed: Floats) -> float:
    """Return the least duration that is found, s; infinity where no result counts.

    The first solution has few steps. It is the guess for one with more. Where that leaves the tube
    between its places, the next one is sought in a narrower tube.

    Args:
        tube: the constraints, of two axes.
        t: (n,): times of a guess, s.
        r: (n, 2): its positions, mm.
        passed: times at which it passes start, corners and end, s.
    """
    near = time_beside_corner(tube)
    time = min(near, float(passed[-1]) / (GROUPS * (len(passed) - 1)))
    unit = Units(max(0.3 * tube.feed * time, 3.0 * tube.tolerance), time)
    steps = steps_of(passed, COARSE, near)
    spans = SLOWED * np.bincount(steps.group, np.diff(steps.t)) / time
    state = _guess(steps, t, r, unit)
    rate = np.diff(state[4:], axis=1) / (SLOWED * np.diff(steps.t) / time)
    guess = Solution(state, rate, spans.astype(np.float64))
    narrow, best = INSIDE * tube.tolerance, math.inf
    for fine in (False, *[True] * TRIES):
        if fine:
            guess, steps = _refined(guess, steps, steps_of(passed, STEPS, near))
        guess = solved(tube._replace(tolerance=narrow), unit, steps, guess)
        off, duration = checked(tube, unit, steps, guess)
        if off <= OFF and duration < best:
            best = duration
        if fine and (off <= OFF or not off < math.inf):
            break
        if fine:
            narrow *= INSIDE / min(off, 1.2)
    return best


def solved(tube: Tube, unit: Units, steps: Steps, guess: Solution) -> Solution:
    """Return the solution of IPOPT, or its last iterate."""
    m, groups = len(steps.leg), int(steps.group[-1]) + 1
    counts = np.bincount(steps.group)
    points, eps = tube.points / unit.length, tube.tolerance / unit.length
    opti = casadi.Opti()
    state, rate = opti.variable(6, m + 1), opti.variable(2, m)
    span = opti.variable(groups)
    opti.minimize(casadi.sum1(span))
    opti.subject_to(span >= SHORTEST)
    for k in range(m):
        g, leg = int(steps.group[k]), int(steps.leg[k])
        h, x, u = span[g] / counts[g] / PARTS, state[:, k], rate[:, k]
        for part in range(PARTS):
            middle, end = advanced(x, u, h)
            for place in (middle, end) if part or k else (x, middle, end):
                for value, bound, _ in used(tube, unit, place, u):
                    opti.subject_to(opti.bounded(-bound, value, bound))
                _hold_to_leg(opti, place, points[leg : leg + 2], eps, g % GROUPS == 1)
            x = end
        opti.subject_to(state[:, k + 1] == x)
        opti.subject_to(opti.bounded(-TURN, state[2, k + 1] - state[2, k], TURN))
        if k:
            opti.subject_to(state[3, k] >= SLOWEST * tube.feed * unit.time / unit.length)
        if k + 1 < m and steps.leg[k + 1] > leg:
            opti.subject_to(casadi.sumsqr(state[:2, k + 1] - points[leg + 1]) <= eps**2)
    for at, end in ((0, points[0]), (m, points[-1])):
        opti.subject_to(state[:2, at] == end)
        opti.subject_to(state[3:5, at] == 0.0)
    opti.set_initial(state, guess.state)
    opti.set_initial(rate, guess.rate)
    opti.set_initial(span, guess.span)
    settings: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": ITERATIONS,
        "max_cpu_time": LONGEST,
        "tol": 1e-5,
        "mu_init": 1e-2,
    }
    settings |= {"constr_viol_tol": 1e-6, "mu_strategy": "adaptive"}
    opti.solver("ipopt", {"print_time": False, "expand": True}, settings)
    with suppress(RuntimeError):
        opti.solve()
    found = [np.array(opti.debug.value(each), np.float64) for each in (state, rate, span)]
    return Solution(*found)


def _refined(guess: Solution, coarse: Steps, fine: Steps) -> tuple[Solution, Steps]:
    """Return a solution on other steps of the same groups."""
    begin, end = _places(coarse), _places(fine)
    state = np.array([np.interp(end, begin, row) for row in guess.state])
    middle = 0.5 * (end[1:] + end[:-1])
    at = np.clip(np.searchsorted(begin, middle) - 1, 0, len(coarse.leg) - 1)
    return Solution(state, guess.rate[:, at], guess.span), fine


def _places(steps: Steps) -> Floats:
    """Return the ends of the steps, counted in groups (m + 1,)."""
    counts = np.bincount(steps.group)
    return np.concatenate(([0.0], np.cumsum(1.0 / counts[steps.group])))


def _hold_to_leg(
    opti: casadi.Opti, place: casadi.MX, ends: Floats, eps: float, middle: bool
) -> None:
    """Hold a place to the tolerance of a leg; in its middle, between its ends."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    along = (ends[1] - ends[0]) / length
    off = place[:2] - ends[0]
    on = off[0] * along[0] + off[1] * along[1]
    across = off[0] * along[1] - off[1] * along[0]
    if middle:
        opti.subject_to(opti.bounded(-eps, across, eps))
        opti.subject_to(opti.bounded(0.0, on, length))
        return
    beyond = opti.variable()
    opti.subject_to(beyond >= 0.0)
    opti.subject_to(beyond >= on - length)
    opti.subject_to(beyond >= -on)
    opti.subject_to(across**2 + beyond**2 <= eps**2)


def _guess(steps: Steps, t: Floats, r: Floats, unit: Units) -> Floats:
    """Return the states (6, m + 1) of the guess."""
    velocity = np.gradient(r, t[1] - t[0], axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    fast = speed > CLOSE * speed.max()
    heading = np.unwrap(np.arctan2(velocity[fast, 1], velocity[fast, 0]))
    heading = np.interp(t, t[fast], heading)
    wide = max(3, len(t) // 100)
    heading = np.convolve(np.pad(heading, wide, mode="edge"), np.ones(2 * wide + 1), "valid")
    heading /= 2 * wide + 1

    def at(values: Floats) -> Floats:
        return np.interp(steps.t, t, values)

    v = np.maximum(at(speed), 0.02 * speed.max())
    v[0] = v[-1] = 0.0
    turned = at(heading)
    bend = np.gradient(turned, steps.t) / np.maximum(v, 0.05 * speed.max())
    return np.array(
        [
            at(r[:, 0]) / unit.length,
            at(r[:, 1]) / unit.length,
            turned,
            v * unit.time / unit.length / SLOWED,
            np.gradient(v, steps.t) * unit.time**2 / unit.length / SLOWED**2,
            bend * unit.length,
        ]
    )


def checked(tube: Tube, unit: Units, steps: Steps, found: Solution) -> tuple[float, float]:
    """Return the largest deviation, in tolerances, and the duration at which all limits hold, s.

    The deviation is infinite where the integration of the solver is not accurate.
    """
    counts = np.bincount(steps.group)
    h = found.span[steps.group] / counts[steps.group]
    x, u = casadi.MX.sym("x", 6), casadi.MX.sym("u", 2)
    size = casadi.MX.sym("h")
    parts = used(tube, unit, x, u)
    go = casadi.Function("go", [x, u, size], [advanced(x, u, size)[1]])
    look = casadi.Function("look", [x, u], [casadi.vertcat(*(v / bound for v, bound, _ in parts))])
    power = 1.0 / np.array([order for *_, order in parts])
    clock, points, most = 1.0, tube.points / unit.length, 0.0
    for k in range(len(h)):
        place, rate = found.state[:, k], found.rate[:, k]
        start, end = points[steps.leg[k]], points[steps.leg[k] + 1]
        along = end - start
        for part in range(FINE + 1):
            taken = np.abs(np.asarray(look(place, rate)).ravel()) ** power
            clock = max(clock, float(taken.max()))
            on = min(max(float((place[:2] - start) @ along / (along @ along)), 0.0), 1.0)
            most = max(most, float(np.linalg.norm(place[:2] - start - on * along)))
            if part < FINE:
                place = np.asarray(go(place, rate, h[k] / FINE)).ravel()
        missed = float(np.abs(place[:2] - found.state[:2, k + 1]).max()) * unit.length
        if not missed <= MISSED * tube.tolerance:
            return math.inf, math.inf
    return most * unit.length / tube.tolerance, float(h.sum()) * unit.time * clock
