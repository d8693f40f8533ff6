"""The frame in which the motion past a polygon is given by its heading.

Limits along the path are simple where the motion is given by its heading. In its own frame, the
unit vector T of the direction is (cos h, sin h) in a plane, and (cos e cos h, cos e sin h, sin e)
in space. With the position r, the angles q = (h) or (h, e), their rates w, the speed v and the
acceleration a along the path,

    r' = v T(q),  q' = w,  w' = u,  v' = a,

the normal acceleration is v |T'|, and a' is the jerk along the path, v''. The acceleration of the
axes is a T + v T', and their jerk a' T + 2 a T' + v T''. All are smooth, also for a motion that
stops and turns there. In r and its derivatives (:mod:`benchmarks.tube_optimum`) they are not, so a
solver seldom finds a legal motion there.

A polygon in a plane has a frame in that plane. Else the axis e = 90 degrees of the frame is as far
as possible from the directions of the polygon.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from benchmarks.tube_optimum import Tube

Floats = NDArray[np.float64]

FLAT = 1e-6
"""Parts of a unit vector below this are none."""


class Units(NamedTuple):
    """Units of the variables: length, mm, and time, s."""

    length: float
    time: float


class Frame(NamedTuple):
    """The frame of a polygon.

    Attributes:
        basis: (axes, n): its axes; n is 2 for a polygon in a plane, else 3.
        change: derivative of a state by its rate, (3 n,).
        used: what is limited at a state, relative to its bound, for a state and a rate.
        order: (limits,): the order of each in 1 / time.
    """

    basis: Floats
    change: casadi.Function
    used: casadi.Function
    order: Floats

    def joined(
        self, x: casadi.MX, end: casadi.MX, u: casadi.MX, h: casadi.MX
    ) -> tuple[casadi.MX, casadi.MX]:
        """Return the state in the middle of a step, and what its ends miss by Simpson's rule."""
        first, last = self.change(x, u), self.change(end, u)
        middle = (x + end) / 2 + h / 8 * (first - last)
        return middle, end - x - h / 6 * (first + 4 * self.change(middle, u) + last)

    def advanced(self, x: Floats, u: Floats, h: float) -> Floats:
        """Return the state at the end of a step, by Runge and Kutta's method."""
        first = self.change(x, u)
        second = self.change(x + h / 2 * first, u)
        third = self.change(x + h / 2 * second, u)
        fourth = self.change(x + h * third, u)
        step = h / 6 * (first + 2 * second + 2 * third + fourth)
        return np.asarray(x + np.asarray(step).ravel())


def basis_of(points: Floats) -> Floats:
    """Return the axes of a frame for a polygon (axes, n)."""
    legs = np.diff(points, axis=0)
    legs /= np.linalg.norm(legs, axis=1)[:, None]
    _, size, rows = np.linalg.svd(legs)
    if (size > FLAT).sum() <= 2:
        return np.asarray(rows[:2].T)
    between = legs[1:] + legs[:-1]
    between = between[np.linalg.norm(between, axis=1) > FLAT]
    seen = np.vstack((legs, between / np.linalg.norm(between, axis=1)[:, None]))
    tried = np.random.default_rng(0).normal(size=(500, 3))
    tried /= np.linalg.norm(tried, axis=1)[:, None]
    pole = tried[int(np.argmin(np.abs(tried @ seen.T).max(axis=1)))]
    _, _, rows = np.linalg.svd(pole[None, :])
    return np.stack((rows[1], rows[2], pole), axis=1)


def frame_of(tube: Tube, unit: Units) -> Frame:
    """Return the frame of a tube's polygon, and what is limited in it."""
    limits, basis = tube.limits, basis_of(tube.points)
    n = basis.shape[1]
    x, u = casadi.SX.sym("x", 3 * n), casadi.SX.sym("u", n)
    angles, rates, v, a = x[n : 2 * n - 1], x[2 * n - 1 : 3 * n - 2], x[3 * n - 2], x[3 * n - 1]
    ahead = casadi.vertcat(casadi.cos(angles[0]), casadi.sin(angles[0]))
    if n == 3:
        ahead = casadi.vertcat(casadi.cos(angles[1]) * ahead, casadi.sin(angles[1]))
    first = casadi.jtimes(ahead, angles, rates)
    second = casadi.jtimes(first, angles, rates) + casadi.jtimes(ahead, angles, u[:-1])
    change = casadi.vertcat(v * ahead, rates, u[:-1], a, u[-1])
    found = [
        (v, tube.feed, 1),
        (a, limits.tangential_acceleration, 2),
        (u[-1], limits.tangential_jerk, 3),
    ]
    # Its square is smooth where the path is straight.
    bounds = [(casadi.sumsqr(v * first), tube.normal**2, 4, 2)]
    velocity = casadi.mtimes(basis, v * ahead)
    pull = casadi.mtimes(basis, a * ahead + v * first)
    jerk = casadi.mtimes(basis, u[-1] * ahead + 2.0 * a * first + v * second)
    for i in np.flatnonzero(np.abs(basis).max(axis=1) > FLAT).tolist():
        found += [
            (velocity[i], float(limits.axis_velocity[i]), 1),
            (pull[i], float(limits.axis_acceleration[i]), 2),
            (jerk[i], float(limits.axis_jerk[i]), 3),
        ]
    bounds += [(value, bound, order, 1) for value, bound, order in found]
    bounds = [each for each in bounds if math.isfinite(each[1])]
    ratios = [
        value * (unit.length**power / (bound * unit.time**order))
        for value, bound, order, power in bounds
    ]
    return Frame(
        basis,
        casadi.Function("change", [x, u], [change]),
        casadi.Function("used", [x, u], [casadi.vertcat(*ratios)]),
        np.array([float(order) for _, _, order, _ in bounds]),
    )
