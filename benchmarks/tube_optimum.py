"""The time-optimal motion inside the tolerance tube of a polygon, by a nonlinear solver.

The motion is a sequence of short steps, each with a constant jerk of every axis. Steps of one group
have the same duration: one group behind each corner, one before it, one between. IPOPT (through
casadi) lowers the sum of the durations. Constraints:

- In the steps of leg k the motion lies within the tolerance of that leg, ends included.
- The motion is within the tolerance of a corner where it goes from one leg to the next, so that no
  part of the polygon is left out.
- Speed, acceleration and jerk keep to the limits of each axis and to those along the path. With
  r(t) and v = |r'|: v' = r'.r''/v, v'' = (r''.r'' + r'.r''' - v'^2) / v, and the normal
  acceleration is sqrt(r''.r'' - v'^2).

Constraints hold at the start and the middle of each step. Between them they may be exceeded a
little. So the result is evaluated at many points, and its clock is slowed until every limit holds:
by a factor l, speeds become l times as large, accelerations l^2 and jerks l^3. The duration is then
that of a motion that is legal. It is a local optimum, so it bounds the true one from above.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from cnc.planner.limits import Limits

Floats = NDArray[np.float64]

SHARE = (0.0, 0.5)
"""Places in a step at which constraints hold."""

FINE = 16
"""Points of a step at which the result is evaluated."""

INSIDE = 0.994
"""Part of the tolerance that the motion may use at the places where the constraint holds."""

OFF = 1.002
"""Deviation in tolerances that counts as within it."""

TRIES = 4
"""Solutions, each in a narrower tube, until the deviation between those places is within it."""

SLOWEST = 1e-2
"""Speeds below this part of the largest are too slow for a direction."""


class Tube(NamedTuple):
    """What the motion must keep to.

    Attributes:
        points: (n + 1, axes): the corners of the polygon, start and end included, mm.
        tolerance: mm.
        feed: mm/s.
        limits: of the machine.
    """

    points: Floats
    tolerance: float
    feed: float
    limits: Limits

    @property
    def normal(self) -> float:
        """Largest normal acceleration; the chord of a period T leaves the path by a T^2 / 8."""
        limits = self.limits
        return min(limits.normal_acceleration, 8.0 * limits.chord_error / limits.period**2)

    def of_axes(self, used: NDArray[np.int64]) -> Tube:
        """Return the same tube with the axes that move."""
        limits = self.limits
        limits = replace(
            limits,
            axis_velocity=limits.axis_velocity[used],
            axis_acceleration=limits.axis_acceleration[used],
            axis_jerk=limits.axis_jerk[used],
        )
        return self._replace(points=self.points[:, used], limits=limits)


class Motion(NamedTuple):
    """Steps of constant jerk from rest at the first point.

    Attributes:
        h: (m,): durations, s.
        jerk: (m, axes): mm/s^3.
        leg: (m,): the leg that each step belongs to.
    """

    h: Floats
    jerk: Floats
    leg: NDArray[np.int64]


class Guess(NamedTuple):
    """A motion near which the solver begins, sampled at the ends of the steps to use.

    Attributes:
        t: (m + 1,): times, s.
        r: (m + 1, axes): positions, mm.
        v: (m + 1, axes): velocities, mm/s.
        a: (m + 1, axes): accelerations, mm/s^2.
        leg: (m,): the leg that each step belongs to.
        group: (m,): its group, counted from 0. Their durations are equal.
    """

    t: Floats
    r: Floats
    v: Floats
    a: Floats
    leg: NDArray[np.int64]
    group: NDArray[np.int64]


def states(motion: Motion, start: Floats, share: Floats) -> tuple[Floats, Floats, Floats]:
    """Return position, velocity and acceleration at parts of each step (m, len(share), axes)."""
    r, v, a = start.copy(), np.zeros_like(start), np.zeros_like(start)
    rows = []
    for h, jerk in zip(motion.h, motion.jerk, strict=True):
        t = (share * h)[:, None]
        rows.append(
            (r + t * (v + t * (a / 2 + t * jerk / 6)), v + t * (a + t * jerk / 2), a + t * jerk)
        )
        r = r + h * (v + h * (a / 2 + h * jerk / 6))
        v = v + h * (a + h * jerk / 2)
        a = a + h * jerk
    return (
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]),
    )


def slowest_clock(tube: Tube, motion: Motion) -> float:
    """Return the largest factor <= 1 on the clock's speed at which every limit holds."""
    limits = tube.limits
    _, v, a = states(motion, tube.points[0], np.linspace(0.0, 1.0, FINE))
    j = np.broadcast_to(motion.jerk[:, None, :], a.shape)
    speed = np.linalg.norm(v, axis=2)
    seen = motion.h[:, None] * np.ones(FINE) > 1e-7
    fast = (speed > SLOWEST * speed.max()) & seen
    safe = np.where(fast, speed, 1.0)
    along = (v * a).sum(axis=2) / safe
    change = ((a * a + v * j).sum(axis=2) - along**2) / safe
    normal = np.sqrt(np.maximum((a * a).sum(axis=2) - along**2, 0.0))

    def most(values: Floats, where: NDArray[np.bool_]) -> float:
        return float(np.abs(values[where]).max(initial=0.0))

    first = [speed.max() / tube.feed]
    second = [most(along, fast) / limits.tangential_acceleration, most(normal, fast) / tube.normal]
    third = [most(change, fast) / limits.tangential_jerk]
    for i in range(v.shape[2]):
        first.append(most(v[..., i], seen) / limits.axis_velocity[i])
        second.append(most(a[..., i], seen) / limits.axis_acceleration[i])
        third.append(most(j[..., i], seen) / limits.axis_jerk[i])
    return float(min(1.0, 1.0 / max(first), max(second) ** -0.5, max(third) ** (-1.0 / 3.0)))


def deviation(tube: Tube, motion: Motion) -> float:
    """Return the largest distance of the motion from its leg, mm."""
    r = states(motion, tube.points[0], np.linspace(0.0, 1.0, FINE))[0]
    start = tube.points[motion.leg][:, None, :]
    along = tube.points[motion.leg + 1][:, None, :] - start
    x = ((r - start) * along).sum(axis=2) / (along**2).sum(axis=2)
    nearest = start + np.clip(x, 0.0, 1.0)[..., None] * along
    return float(np.linalg.norm(r - nearest, axis=2).max())


def optimum(tube: Tube, guess: Guess, iterations: int = 300) -> tuple[float, Motion]:
    """Return the least duration found inside the tube, s, and its motion; infinity without one.

    Args:
        tube: the constraints.
        guess: a motion inside the tube or near it, with the steps to use.
        iterations: bound on those of the solver.
    """
    narrow = tube._replace(tolerance=INSIDE * tube.tolerance)
    for _ in range(TRIES):
        best, motion = solved(narrow, guess, iterations)
        off = deviation(tube, motion) / tube.tolerance
        if off <= OFF:
            return best, motion
        narrow = narrow._replace(tolerance=narrow.tolerance * INSIDE / min(off, 1.2))
    return np.inf, motion


def solved(tube: Tube, guess: Guess, iterations: int) -> tuple[float, Motion]:
    """Return the least duration found, s, and its motion; infinity if the solver failed.

    Args:
        tube: the constraints.
        guess: a motion inside the tube or near it, with the steps to use.
        iterations: bound on those of the solver.
    """
    groups = int(guess.group[-1]) + 1
    counts = np.bincount(guess.group)
    steps = np.diff(guess.t)
    spans = np.bincount(guess.group, steps)
    clock = float(guess.t[-1]) / groups
    size = float(np.linalg.norm(np.diff(tube.points, axis=0), axis=1).max())
    opti = casadi.Opti()
    n, m = tube.points.shape[1], len(guess.leg)
    span = opti.variable(groups)
    states = tuple(opti.variable(n, m) for _ in range(4))
    opti.minimize(casadi.sum1(span))
    opti.subject_to(span >= 1e-6)
    _hold_to_tube(opti, tube, guess, span, states)
    per = spans[guess.group][:, None]
    opti.set_initial(span, spans / clock)
    values = (
        guess.r[:-1],
        guess.v[:-1] * per,
        guess.a[:-1] * per**2,
        np.diff(guess.a, axis=0) / steps[:, None] * per**3,
    )
    for variable, value in zip(states, values, strict=True):
        opti.set_initial(variable, value.T / size)
    settings: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": iterations,
        "tol": 1e-4,
        "constr_viol_tol": 1e-7,
        "mu_init": 1e-3,
    }
    opti.solver("ipopt", {"print_time": False, "expand": True}, settings)
    with suppress(RuntimeError):
        opti.solve()
    found = opti.debug
    final = np.asarray(found.value(span)) * clock
    motion = Motion(
        (final / counts)[guess.group],
        np.atleast_2d(found.value(states[3])).T * size / final[guess.group][:, None] ** 3,
        guess.leg,
    )
    stats = found.stats()
    if not stats["success"] and stats["iterations"]["inf_pr"][-1] > 1e-5:
        return np.inf, motion
    return float(motion.h.sum()) / slowest_clock(tube, motion), motion


def _hold_to_tube(
    opti: casadi.Opti, tube: Tube, guess: Guess, span: casadi.MX, states: tuple[casadi.MX, ...]
) -> None:
    """Add the motion and the constraints of all steps.

    In a group, derivatives are by the part of the group's steps that has passed. So the motion is
    linear in the variables, and only the limits contain the durations. Units: the mean duration of
    a group and the longest leg.

    Args:
        opti: the problem.
        tube: the constraints.
        guess: the steps.
        span: (groups,): durations of the groups.
        states: position, derivatives of order 1 to 3 at the start of each step.
    """
    r, v, a, j = states
    m, counts = len(guess.leg), np.bincount(guess.group)
    spans = np.bincount(guess.group, np.diff(guess.t))
    clock = float(guess.t[-1]) / len(counts)
    size = float(np.linalg.norm(np.diff(tube.points, axis=0), axis=1).max())
    unit = np.array([clock / size, clock**2 / size, clock**3 / size])
    eps, place = tube.tolerance / size, tube.points / size
    beyond = opti.variable(len(SHARE), m)

    def at(k: int, share: float) -> tuple[casadi.MX, ...]:
        t = share / counts[guess.group[k]]
        rk = r[:, k] + t * (v[:, k] + t * (a[:, k] / 2 + t * j[:, k] / 6))
        return rk, v[:, k] + t * (a[:, k] + t * j[:, k] / 2), a[:, k] + t * j[:, k]

    for value, start in zip((r, v, a), (place[0], 0.0, 0.0), strict=True):
        opti.subject_to(value[:, 0] == start)
    for k in range(m):
        g, leg = int(guess.group[k]), int(guess.leg[k])
        length = float(np.linalg.norm(place[leg + 1] - place[leg]))
        along = (place[leg + 1] - place[leg]) / length
        for x, share in enumerate(SHARE):
            rk, vk, ak = at(k, share)
            off = rk - place[leg]
            on = casadi.dot(off, along)
            across = casadi.sumsqr(off - on * along) / eps**2
            # Only groups beside a corner may go beyond an end of the leg.
            opti.subject_to(across + beyond[x, k] ** 2 <= 1.0)
            if g % 3 == 1:
                opti.subject_to(beyond[x, k] == 0.0)
            else:
                opti.subject_to(beyond[x, k] * eps >= -on)
                opti.subject_to(beyond[x, k] * eps >= on - length)
            if k or x:
                begin = guess.v[k] + share * (guess.v[k + 1] - guess.v[k])
                begins = float(np.linalg.norm(begin)) * spans[g] / size
                _limit(
                    opti,
                    tube,
                    casadi.vertcat(*(unit[o] * span[g] ** (o + 1) for o in range(3))),
                    (vk, ak, j[:, k]),
                    begins,
                )
        rk, vk, ak = at(k, 1.0)
        if k + 1 == m:
            for value, end in zip((rk, vk, ak), (place[-1], 0.0, 0.0), strict=True):
                opti.subject_to(value == end)
            continue
        other = int(guess.group[k + 1])
        slower = span[other] / span[g] if other > g else 1.0
        opti.subject_to(r[:, k + 1] == rk)
        opti.subject_to(v[:, k + 1] == vk * slower)
        opti.subject_to(a[:, k + 1] == ak * slower**2)
        if guess.leg[k + 1] > leg:
            opti.subject_to(casadi.sumsqr(rk - place[leg + 1]) / eps**2 <= 1.0)


def _limit(
    opti: casadi.Opti,
    tube: Tube,
    unit: casadi.MX,
    derivatives: tuple[casadi.MX, ...],
    begins: float,
) -> None:
    """Hold speed, acceleration and jerk at a place within the limits.

    Args:
        opti: the problem.
        tube: the limits.
        unit: (3,): the units of the derivatives, per mm/s, mm/s^2 and mm/s^3.
        derivatives: the first three.
        begins: the speed at which the solver begins.
    """
    limits = tube.limits
    v, a, j = derivatives
    by_axis = (limits.axis_velocity, limits.axis_acceleration, limits.axis_jerk)
    for order, (values, bounds) in enumerate(zip(derivatives, by_axis, strict=True)):
        for i in np.flatnonzero(np.isfinite(bounds)).tolist():
            opti.subject_to(values[i] <= bounds[i] * unit[order])
            opti.subject_to(-values[i] <= bounds[i] * unit[order])
    feed = tube.feed * unit[0]
    opti.subject_to(casadi.sumsqr(v) <= feed**2)
    if not min(limits.tangential_acceleration, limits.tangential_jerk, tube.normal) < np.inf:
        return
    # The speed as a variable of its own keeps the constraints polynomials.
    speed = opti.variable()
    opti.subject_to(speed >= 0.0)
    opti.subject_to(speed**2 == casadi.sumsqr(v) + (1e-5 * feed) ** 2)
    opti.set_initial(speed, begins)
    dot = casadi.dot(v, a)
    if np.isfinite(limits.tangential_acceleration):
        most = limits.tangential_acceleration * unit[1]
        opti.subject_to(dot <= most * speed)
        opti.subject_to(-dot <= most * speed)
    if tube.normal < float(np.linalg.norm(limits.axis_acceleration)):
        most = tube.normal * unit[1]
        opti.subject_to(casadi.sumsqr(a) * speed**2 - dot**2 <= (most * speed) ** 2)
    if np.isfinite(limits.tangential_jerk):
        most = limits.tangential_jerk * unit[2]
        change = (casadi.sumsqr(a) + casadi.dot(v, j)) * speed**2 - dot**2
        opti.subject_to(change <= most * speed**3)
        opti.subject_to(-change <= most * speed**3)
