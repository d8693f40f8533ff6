"""The time-optimal motion inside the tolerance tube of a polygon, where the path is limited.

The motion is given by its heading, because limits along the path are simple there
(:mod:`benchmarks.heading_frame`). a' and u are constant in each step, and a step is integrated by
Simpson's rule. IPOPT (through casadi) lowers the sum of the durations. The result is integrated in
finer steps: it counts only where it keeps to the polygon there, and its clock is slowed until every
limit holds. It is a local optimum, so it bounds the true one from above.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from benchmarks.heading_frame import Frame, Units, frame_of
from benchmarks.tube_optimum import Tube

Floats = NDArray[np.float64]

COARSE, STEPS = (14, 4, 14), (32, 8, 32)
"""Steps of each leg: behind a corner, in the middle, before the next corner."""

GROUPS = 3

TURN = 0.35
"""Largest change of an angle in a step, rad."""

SHORTEST = 1e-3
"""Least duration of a group, as a part of the mean of the guess."""

TRIES = 3
"""Solutions on the finer steps, each in a narrower tube."""

SIDE, NEAR = 0.3, 4.0
"""Part of a leg's time that the outer groups take at first; but no more than the ramp to the feed,
and so many times the time by which the largest jerk moves by the tolerance.
"""

EVEN, BLUR = 0.4, 0.01
"""Part of a group's steps that is spread evenly; the others lie where the guess turns, which is
averaged over this part of a group to both sides.
"""

SLOWED = 1.05
"""The solver begins with the guess slowed by this."""

INSIDE = 0.995
"""Part of the tolerance that the solver uses."""

OFF = 1.01
"""Deviation in tolerances that counts as within it."""

MISSED = 0.03
"""Largest difference between the solver's integration and the finer one, in tolerances."""

FINE = 8
"""Parts of a step of the finer integration."""

ITERATIONS, LONGEST = 600, 60.0
"""Bounds on the iterations of a solution, and on its CPU time, s."""

CLOSE = 0.01
"""The direction is not read where the guess is slower than this part of its largest speed."""


class Steps(NamedTuple):
    """The steps.

    Attributes:
        leg: (m,): the leg of each.
        group: (m,): its group.
        share: (m,): its part of the group's duration.
        t: (m + 1,): times of the guess, s.
    """

    leg: NDArray[np.int64]
    group: NDArray[np.int64]
    share: Floats
    t: Floats


class Solution(NamedTuple):
    """A motion on given steps, in units of :class:`Units`.

    Attributes:
        state: (3 n, m + 1), in a frame of n axes: r, q, w, v and a.
        rate: (n, m): u and a'.
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


def steps_of(tube: Tube, counts: tuple[int, ...], t: Floats, r: Floats, passed: Floats) -> Steps:
    """Return the steps of a solution: more of them where the guess turns.

    Args:
        tube: the constraints.
        counts: steps of each group of a leg.
        t: (m,): times of a guess, s.
        r: (m, axes): its positions, mm.
        passed: times at which it passes start, corners and end, s.
    """
    near = time_beside_corner(tube)
    turned = np.linalg.norm(np.diff(directions_of(t, r), axis=0), axis=1)
    turned = np.concatenate(([0.0], np.cumsum(turned)))
    leg: list[int] = []
    group: list[int] = []
    found, shares = [0.0], []
    for k, (begin, end) in enumerate(pairwise(passed)):
        side = min(SIDE * (end - begin), near)
        bounds = (begin, begin + side, end - side, end)
        for g, (count, (first, last)) in enumerate(zip(counts, pairwise(bounds), strict=True)):
            fine = np.linspace(first, last, 1001)
            blur = np.linspace(-BLUR, BLUR, 21) * (last - first)
            bent = np.mean([np.interp(np.clip(fine + b, first, last), t, turned) for b in blur], 0)
            weight = EVEN * (fine - first) / (last - first)
            weight += (1.0 - EVEN) * (bent - bent[0]) / max(bent[-1] - bent[0], TURN)
            places = np.interp(np.linspace(0.0, weight[-1], count + 1), weight, fine)
            leg += [k] * count
            group += [GROUPS * k + g] * count
            found += places[1:].tolist()
            shares += (np.diff(places) / (last - first)).tolist()
    return Steps(np.array(leg), np.array(group), np.array(shares), np.array(found))


def optimum(tube: Tube, t: Floats, r: Floats, passed: Floats) -> float:
    """Return the least duration that is found, s; infinity where no result counts.

    The first solution has few steps. It is the guess for one with more. Where that leaves the tube
    between its places, the next one is sought in a narrower tube.

    Args:
        tube: the constraints.
        t: (m,): times of a guess, s.
        r: (m, axes): its positions, mm.
        passed: times at which it passes start, corners and end, s.
    """
    time = min(time_beside_corner(tube), float(passed[-1]) / (GROUPS * (len(passed) - 1)))
    unit = Units(max(0.3 * tube.feed * time, 3.0 * tube.tolerance), time)
    frame = frame_of(tube, unit)
    inside = tube._replace(points=tube.points @ frame.basis)
    r = r @ frame.basis
    steps = steps_of(inside, COARSE, t, r, passed)
    guess = _guess(steps, t, r, unit)
    narrow, best = INSIDE * tube.tolerance, math.inf
    for fine in (False, *[True] * TRIES):
        if fine:
            guess, steps = _refined(guess, steps, steps_of(inside, STEPS, t, r, passed))
        guess = solved(inside._replace(tolerance=narrow), unit, frame, steps, guess)
        off, duration = checked(inside, unit, frame, steps, guess)
        if off <= OFF and duration < best:
            best = duration
        if fine and (off <= OFF or not off < math.inf):
            break
        if fine:
            narrow *= INSIDE / min(off, 1.2)
    return best


def solved(tube: Tube, unit: Units, frame: Frame, steps: Steps, guess: Solution) -> Solution:
    """Return the solution of IPOPT, or its last iterate."""
    m, n, groups = len(steps.leg), tube.points.shape[1], int(steps.group[-1]) + 1
    points, eps = tube.points / unit.length, tube.tolerance / unit.length
    opti = casadi.Opti()
    state, rate = opti.variable(3 * n, m + 1), opti.variable(n, m)
    span = opti.variable(groups)
    opti.minimize(casadi.sum1(span))
    opti.subject_to(span >= SHORTEST)
    for k in range(m):
        g, leg = int(steps.group[k]), int(steps.leg[k])
        h, x, end, u = span[g] * steps.share[k], state[:, k], state[:, k + 1], rate[:, k]
        middle, missed = frame.joined(x, end, u, h)
        opti.subject_to(missed == 0.0)
        for place in (x, middle, end):
            opti.subject_to(opti.bounded(-1.0, frame.used(place, u), 1.0))
        for place in (middle, end):
            _hold_to_leg(opti, place[:n], points[leg : leg + 2], eps, g % GROUPS == GROUPS // 2)
        turned = end[n : 2 * n - 1] - x[n : 2 * n - 1]
        opti.subject_to(opti.bounded(-TURN, turned, TURN))
        opti.subject_to(end[-2] >= 0.0)
        if k + 1 < m and steps.leg[k + 1] > leg:
            opti.subject_to(casadi.sumsqr(end[:n] - points[leg + 1]) / eps**2 <= 1.0)
    for at, place in ((0, points[0]), (m, points[-1])):
        opti.subject_to(state[:n, at] == place)
        opti.subject_to(state[-2:, at] == 0.0)
    opti.set_initial(state, guess.state)
    opti.set_initial(rate, guess.rate)
    opti.set_initial(span, guess.span)
    settings: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": ITERATIONS,
        "max_cpu_time": LONGEST,
        "tol": 1e-5,
        "constr_viol_tol": 1e-6,
        "mu_init": 1e-2,
        "mu_strategy": "adaptive",
    }
    opti.solver("ipopt", {"print_time": False, "expand": True}, settings)
    with suppress(RuntimeError):
        opti.solve()
    found = [np.array(opti.debug.value(each), np.float64) for each in (state, rate, span)]
    return Solution(found[0], np.atleast_2d(found[1]), np.atleast_1d(found[2]))


def _refined(guess: Solution, coarse: Steps, fine: Steps) -> tuple[Solution, Steps]:
    """Return a solution on other steps of the same groups."""
    begin, end = _places(coarse), _places(fine)
    state = np.array([np.interp(end, begin, row) for row in guess.state])
    middle = 0.5 * (end[1:] + end[:-1])
    at = np.clip(np.searchsorted(begin, middle) - 1, 0, len(coarse.leg) - 1)
    return Solution(state, guess.rate[:, at], guess.span), fine


def _places(steps: Steps) -> Floats:
    """Return the ends of the steps, counted in groups (m + 1,)."""
    return np.concatenate(([0.0], np.cumsum(steps.share)))


def _hold_to_leg(opti: casadi.Opti, r: casadi.MX, ends: Floats, eps: float, middle: bool) -> None:
    """Hold a position to the tolerance of a leg; in its middle, between its ends."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    along = (ends[1] - ends[0]) / length
    off = r - ends[0]
    on = casadi.dot(off, along)
    across = casadi.sumsqr(off - on * along) / eps**2
    if middle:
        opti.subject_to(across <= 1.0)
        opti.subject_to(opti.bounded(0.0, on, length))
        return
    beyond = opti.variable()
    opti.subject_to(beyond >= 0.0)
    opti.subject_to(beyond * eps >= on - length)
    opti.subject_to(beyond * eps >= -on)
    opti.subject_to(across + beyond**2 <= 1.0)


def _guess(steps: Steps, t: Floats, r: Floats, unit: Units) -> Solution:
    """Return the guess, slowed, on given steps."""
    dt = t[1] - t[0]
    speed = np.linalg.norm(np.gradient(r, dt, axis=0), axis=1)
    direction = directions_of(t, r)
    angles = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))[:, None]
    if r.shape[1] == 3:
        angles = np.column_stack((angles, np.arcsin(np.clip(direction[:, 2], -1.0, 1.0))))

    def at(values: Floats) -> Floats:
        return np.array([np.interp(steps.t, t, column) for column in values.T])

    v = np.interp(steps.t, t, speed)
    v[0] = v[-1] = 0.0
    state = np.vstack(
        (
            at(r) / unit.length,
            at(angles),
            at(np.gradient(angles, dt, axis=0)) * unit.time / SLOWED,
            v * unit.time / unit.length / SLOWED,
            np.gradient(v, steps.t) * unit.time**2 / unit.length / SLOWED**2,
        )
    )
    n = r.shape[1]
    changing = state[[*range(2 * n - 1, 3 * n - 2), 3 * n - 1]]
    rate = np.diff(changing, axis=1) / (SLOWED * np.diff(steps.t) / unit.time)
    spans = SLOWED * np.bincount(steps.group, np.diff(steps.t)) / unit.time
    return Solution(state, rate, spans.astype(np.float64))


def directions_of(t: Floats, r: Floats) -> Floats:
    """Return the direction at each place of a guess (m, axes).

    Where the motion is not fast, the direction turns evenly in the plane of those before and
    behind.
    """
    velocity = np.gradient(r, t[1] - t[0], axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    known = np.flatnonzero(speed > CLOSE * speed.max())
    unit = velocity[known] / speed[known][:, None]
    place = np.interp(np.arange(len(t)), known, np.arange(len(known)))
    before = np.minimum(place.astype(np.int64), len(known) - 2)
    share = (place - before)[:, None]
    start, end = unit[before], unit[before + 1]
    turn = np.arccos(np.clip((start * end).sum(axis=1), -1.0, 1.0))[:, None]
    found = (1.0 - share) * start + share * end
    bent = turn[:, 0] > 1e-3
    size = np.sin(turn[bent])
    found[bent] = np.sin((1.0 - share[bent]) * turn[bent]) / size * start[bent]
    found[bent] += np.sin(share[bent] * turn[bent]) / size * end[bent]
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


def checked(
    tube: Tube, unit: Units, frame: Frame, steps: Steps, found: Solution
) -> tuple[float, float]:
    """Return the largest deviation, in tolerances, and the duration at which all limits hold, s.

    The deviation is infinite where the integration of the solver is not accurate.
    """
    h = found.span[steps.group] * steps.share
    n = tube.points.shape[1]
    clock, points, most = 1.0, tube.points / unit.length, 0.0
    for k in range(len(h)):
        place, rate = found.state[:, k], found.rate[:, k]
        start, end = points[steps.leg[k]], points[steps.leg[k] + 1]
        along = end - start
        for part in range(FINE + 1):
            taken = np.abs(np.asarray(frame.used(place, rate)).ravel()) ** (1.0 / frame.order)
            clock = max(clock, float(taken.max()))
            on = min(max(float((place[:n] - start) @ along / (along @ along)), 0.0), 1.0)
            most = max(most, float(np.linalg.norm(place[:n] - start - on * along)))
            if part < FINE:
                place = frame.advanced(place, rate, float(h[k]) / FINE)
        missed = float(np.abs(place[:n] - found.state[:n, k + 1]).max()) * unit.length
        if not missed <= MISSED * tube.tolerance:
            return math.inf, math.inf
    return most * unit.length / tube.tolerance, float(h.sum()) * unit.time * clock
