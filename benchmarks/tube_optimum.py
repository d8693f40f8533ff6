"""The time-optimal motion inside the tolerance tube of a polygon, by a nonlinear solver.

The motion is a sequence of short steps, each with a constant jerk of every axis and a duration of
its own. IPOPT (through casadi) lowers the sum of the durations. Constraints:

- In the steps of leg k the motion lies within the tolerance of that leg, ends included: the
  distance from a point of the leg, which is a variable too.
- The motion is within the tolerance of a corner where it goes from one leg to the next, so that no
  part of the polygon is left out.
- Speed, acceleration and jerk keep to the limits of each axis and to those along the path. With
  r(t) and v = |r'|: v' = r'.r''/v, v'' = (r''.r'' + r'.r''' - v'^2) / v, and the normal
  acceleration is sqrt(r''.r'' - v'^2).

Constraints hold at the ends and the middle of each step. Between them they may be exceeded a
little. So the result is evaluated at many points, and its clock is slowed until every limit holds:
by a factor l, speeds become l times as large, accelerations l^2 and jerks l^3. The duration is then
that of a motion that is legal. It is a local optimum, so it bounds the true one from above.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from cnc.planner.limits import Limits

Floats = NDArray[np.float64]

SHARE = (0.0, 0.5, 1.0)
"""Places in a step at which constraints hold."""

FINE = 16
"""Points of a step at which the result is evaluated."""

SLOWEST = 1e-3
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
    """

    t: Floats
    r: Floats
    v: Floats
    a: Floats
    leg: NDArray[np.int64]


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

    def most(values: Floats, where: Floats) -> float:
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


def optimum(tube: Tube, guess: Guess, iterations: int = 800) -> tuple[float, Motion]:
    """Return the least duration found, s, and its motion; infinity if the solver failed.

    Args:
        tube: the constraints.
        guess: a motion inside the tube or near it, with the steps to use.
        iterations: bound on those of the solver.
    """
    points, limits = tube.points, tube.limits
    n, m = points.shape[1], len(guess.leg)
    steps = np.diff(guess.t)
    # Units in which all variables are near 1: a mean step, and the displacement of the motion.
    clock = float(guess.t[-1]) / m
    size = float(np.linalg.norm(np.diff(points, axis=0), axis=1).max())
    eps = tube.tolerance / size
    per_v, per_a, per_j = clock / size, clock**2 / size, clock**3 / size
    opti = casadi.Opti()
    h = opti.variable(m)
    r, v, a = opti.variable(n, m + 1), opti.variable(n, m + 1), opti.variable(n, m + 1)
    j = opti.variable(n, m)
    foot = opti.variable(len(SHARE), m)
    feed = tube.feed * per_v
    tangential = (limits.tangential_acceleration * per_a, limits.tangential_jerk * per_j)
    normal = tube.normal * per_a
    along_path = np.isfinite([tangential[0], tangential[1], limits.normal_acceleration])
    chord_binds = normal < np.linalg.norm(limits.axis_acceleration) * per_a
    opti.minimize(casadi.sum1(h))
    opti.subject_to(opti.bounded(0.0, h, 20.0 * np.maximum(steps / clock, 1.0)))
    for i in range(n):
        for values, bound in (
            (v[i, :], limits.axis_velocity[i] * per_v),
            (a[i, :], limits.axis_acceleration[i] * per_a),
            (j[i, :], limits.axis_jerk[i] * per_j),
        ):
            if np.isfinite(bound):
                opti.subject_to(opti.bounded(-bound, values, bound))
    place = points / size
    opti.subject_to(r[:, 0] == place[0])
    opti.subject_to(r[:, m] == place[-1])
    for end in (0, m):
        opti.subject_to(v[:, end] == 0)
        opti.subject_to(a[:, end] == 0)
    soft = 1e-6 * feed
    for k in range(m):
        for x, share in enumerate(SHARE):
            t = share * h[k]
            rk = r[:, k] + t * (v[:, k] + t * (a[:, k] / 2 + t * j[:, k] / 6))
            vk = v[:, k] + t * (a[:, k] + t * j[:, k] / 2)
            ak = a[:, k] + t * j[:, k]
            if share == 1.0:
                opti.subject_to(r[:, k + 1] == rk)
                opti.subject_to(v[:, k + 1] == vk)
                opti.subject_to(a[:, k + 1] == ak)
            leg = int(guess.leg[k])
            start, along = place[leg], place[leg + 1] - place[leg]
            off = rk - start - foot[x, k] * along
            opti.subject_to(opti.bounded(0.0, foot[x, k], 1.0))
            opti.subject_to(casadi.sumsqr(off) / eps**2 <= 1.0)
            squared = casadi.sumsqr(vk) + soft**2
            opti.subject_to(squared / feed**2 <= 1.0)
            speed = casadi.sqrt(squared)
            dot = casadi.dot(vk, ak)
            if np.isfinite(tangential[0]):
                opti.subject_to(opti.bounded(-1.0, dot / (speed * tangential[0]), 1.0))
            if np.isfinite(normal) and (along_path[2] or chord_binds):
                bend = casadi.sumsqr(ak) * squared - dot**2
                opti.subject_to(bend / (squared * normal**2) <= 1.0)
            if np.isfinite(tangential[1]):
                change = (casadi.sumsqr(ak) + casadi.dot(vk, j[:, k]) - dot**2 / squared) / speed
                opti.subject_to(opti.bounded(-1.0, change / tangential[1], 1.0))
        if k + 1 < m and guess.leg[k + 1] > guess.leg[k]:
            corner = place[int(guess.leg[k + 1])]
            opti.subject_to(casadi.sumsqr(r[:, k + 1] - corner) / eps**2 <= 1.0)
    opti.set_initial(h, steps / clock)
    opti.set_initial(r, guess.r.T / size)
    opti.set_initial(v, guess.v.T * per_v)
    opti.set_initial(a, guess.a.T * per_a)
    opti.set_initial(j, (np.diff(guess.a, axis=0) / steps[:, None]).T * per_j)
    for x, share in enumerate(SHARE):
        middle = guess.r[:-1] + share * (guess.r[1:] - guess.r[:-1])
        along = points[guess.leg + 1] - points[guess.leg]
        on = ((middle - points[guess.leg]) * along).sum(1) / (along**2).sum(1)
        opti.set_initial(foot[x, :], np.clip(on, 0.0, 1.0))
    opti.solver(
        "ipopt",
        {"print_time": False},
        {
            "print_level": 0,
            "sb": "yes",
            "max_iter": iterations,
            "tol": 1e-5,
            "constr_viol_tol": 1e-7,
            "mu_strategy": "adaptive",
        },
    )
    try:
        solved = opti.solve()
    except RuntimeError:
        solved = opti.debug
        if solved.stats()["iterations"]["inf_pr"][-1] > 1e-6:
            return np.inf, Motion(steps, np.diff(guess.a, axis=0) / steps[:, None], guess.leg)
    motion = Motion(
        np.asarray(solved.value(h)) * clock,
        np.atleast_2d(solved.value(j)).T / per_j,
        guess.leg,
    )
    return float(motion.h.sum()) / slowest_clock(tube, motion), motion
