r"""Fastest motion along a path within a machine's limits, on a fine grid, as a reference.

Three times bound a motion from rest to rest along a given path:
- T2, without a limit of jerk: a linear programme for v^2 on the grid. No motion is faster.
- T3, with jerk: a nonlinear programme (casadi, IPOPT). Each cell of the grid is a phase of constant
  jerk. The limits of acceleration are held at its ends, that of jerk in its middle: then the time
  is exact to the second order of the grid's spacing.
- ours: the planner's.
T3 has speed v and acceleration a at each point of the grid, and for each cell of length d a
duration h and a jerk j:

    d = h v0 + h^2 a0 / 2 + h^3 j / 6,   v1 = v0 + h a0 + h^2 j / 2,   a1 = a0 + h j.

The limits follow from the exact derivatives q', q'', q''' of the path by its length:

    |q' v|,   |q'' v^2 + q' a|,   |q''' v^3 + 3 q'' v a + q' j|.

The grid's points are even in time, in the planner's motion and then in the first optimum. Knots and
tight bends are points. Constant speed beside a junction and stops are those of the planner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_matrix

from benchmarks.optimum_path import Grid, Route
from cnc.machine.models import Machine
from cnc.model.blocks import AxisLetter, Block
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.corners import CornerBlending
from cnc.planner.joints import Joints
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

CELLS_IN_RAMP = 10.0
"""Cells in the time in which the jerk reaches the largest acceleration."""
FEWEST, MOST = 120, 900
"""Least and largest number of cells of the grid, without those at knots."""


class Motion(NamedTuple):
    """A motion over a grid: duration, speed and acceleration at the points, time at the points."""

    duration: float
    v: Floats
    a: Floats
    t: Floats


@dataclass(frozen=True)
class Times:
    """Durations of a motion along one path, s: without jerk, with it, the planner's."""

    t2: float
    t3: float
    ours: float
    solved: bool
    """Whether the nonlinear programme was solved for every stretch."""


def with_path(grid: Grid, limits: Limits) -> tuple[Floats, Floats, Floats]:
    """Return the derivatives with a column for the path itself, and all limits of a and j."""
    own = np.zeros((*grid.q.shape[:3], 1))
    own[:, :, 0] = 1.0
    q = np.concatenate((grid.q, own), axis=3)
    a = np.append(limits.axis_acceleration, limits.tangential_acceleration)
    return q, a, np.append(limits.axis_jerk, limits.tangential_jerk)


def without_jerk(grid: Grid, limits: Limits) -> float:
    """Return T2, s: the time of the fastest motion with limits of speed and acceleration alone."""
    q, most, _ = with_path(grid, limits)
    n, d = len(grid.flat), np.diff(grid.s)
    some = np.isfinite(most)
    rows, columns, values = [], [], []
    row = 0
    for m in range(n):
        for side in range(2):
            by_slope = q[m, side, 0, some] / (2.0 * d[m]) / most[some]
            by_square = q[m, side, 1, some] / most[some]
            at = row + np.arange(int(some.sum()))
            for column, value in (
                (m, -by_slope + by_square * (side == 0)),
                (m + 1, by_slope + by_square * (side == 1)),
            ):
                rows.append(at)
                columns.append(np.full(len(at), column))
                values.append(value)
            row += len(at)
    matrix = coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (row, n + 1)
    ).tocsr()
    top = np.full(n + 1, inf)
    top[:-1] = grid.top[:, 0]
    top[1:] = np.minimum(top[1:], grid.top[:, 1])
    top[0] = top[-1] = 0.0
    both = coo_matrix(np.vstack((matrix.toarray(), -matrix.toarray())))
    found = linprog(
        -np.ones(n + 1), both, np.ones(2 * row), bounds=[(0.0, v * v) for v in top], method="highs"
    )
    speed = np.sqrt(np.maximum(found.x, 0.0))
    return float((2.0 * d / np.maximum(speed[1:] + speed[:-1], 1e-300)).sum())


def with_jerk(grid: Grid, limits: Limits, start: Motion) -> tuple[Motion, bool]:
    """Return the motion of T3 and whether the programme was solved; ``start``: a first guess."""
    import casadi

    q, most_a, most_j = with_path(grid, limits)
    n, d = len(grid.flat), np.diff(grid.s)
    h0 = np.maximum(np.diff(start.t), 1e-9)
    unit_h, unit_v = float(h0.mean()), float(start.v.max())
    unit_a = max(float(np.abs(start.a).max()), unit_v / (unit_h * n))
    jerk0 = np.diff(start.a) / h0
    unit_j = max(float(np.abs(jerk0).max()), unit_a / (unit_h * n))
    x = casadi.SX.sym("x", 4 * n + 2)
    v, a = unit_v * x[: n + 1], unit_a * x[n + 1 : 2 * n + 2]
    h, j = unit_h * x[2 * n + 2 : 3 * n + 2], unit_j * x[3 * n + 2 :]
    v0, v1, a0, a1 = v[:-1], v[1:], a[:-1], a[1:]
    equal = [
        (h * (v0 + h * (a0 / 2 + h * j / 6)) - d) / d,
        (v0 + h * (a0 + h * j / 2) - v1) / unit_v,
        (a0 + h * j - a1) / unit_a,
    ]
    held: list[Any] = []
    v_half, a_half = v0 + h * (a0 / 2 + h * j / 8), (a0 + a1) / 2
    for i in range(q.shape[3]):
        if np.isfinite(most_a[i]):
            for side, v_here, a_here in ((0, v0, a0), (1, v1, a1)):
                held.append((q[:, side, 0, i] * a_here + q[:, side, 1, i] * v_here**2) / most_a[i])
        if np.isfinite(most_j[i]):
            q1, q2, q3 = q[:, 2, 0, i], q[:, 2, 1, i], q[:, 2, 2, i]
            held.append((q1 * j + 3 * q2 * v_half * a_half + q3 * v_half**3) / most_j[i])
    g = casadi.vertcat(*equal, *held)
    count = 3 * n
    low = np.concatenate((np.zeros(count), -np.ones(g.shape[0] - count)))
    high = np.concatenate((np.zeros(count), np.ones(g.shape[0] - count)))
    top = np.full(n + 1, inf)
    top[:-1] = grid.top[:, 0]
    top[1:] = np.minimum(top[1:], grid.top[:, 1])
    x_low, x_high = np.full(4 * n + 2, -inf), np.full(4 * n + 2, inf)
    x_low[: n + 1], x_high[: n + 1] = 0.0, top / unit_v
    x_low[2 * n + 2 : 3 * n + 2] = 1e-6
    for m in np.flatnonzero(grid.flat):
        x_low[n + 1 + m : n + 3 + m] = x_high[n + 1 + m : n + 3 + m] = 0.0
    for k in (0, n):
        x_low[k] = x_high[k] = x_low[n + 1 + k] = x_high[n + 1 + k] = 0.0
    guess = np.concatenate((start.v / unit_v, start.a / unit_a, h0 / unit_h, jerk0 / unit_j))
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "ipopt.tol": 1e-6,
        "ipopt.max_iter": 400,
        "ipopt.mu_strategy": "adaptive",
    }
    problem = {"x": x, "f": casadi.sum1(h) / (unit_h * n), "g": g}
    solver = casadi.nlpsol("fastest", "ipopt", problem, options)
    found = solver(x0=guess, lbx=x_low, ubx=x_high, lbg=low, ubg=high)
    status = solver.stats()["return_status"]
    y = np.array(found["x"]).ravel()
    t = np.concatenate(([0.0], np.cumsum(unit_h * y[2 * n + 2 : 3 * n + 2])))
    motion = Motion(float(t[-1]), unit_v * y[: n + 1], unit_a * y[n + 1 : 2 * n + 2], t)
    return motion, status in ("Solve_Succeeded", "Solved_To_Acceptable_Level")


def effort_of(grid: Grid, motion: Motion, limits: Limits) -> Floats:
    """Return the measure along the grid, (n + 1,), in which the points of the next are even.

    Half of it is the time, half the change of the jerk that the bends of the path use.
    """
    q, _, most = with_path(grid, limits)
    v, a = np.stack((motion.v[:-1], motion.v[1:]), 1), np.stack((motion.a[:-1], motion.a[1:]), 1)
    bend = 3.0 * q[:, :2, 1] * (v * a)[..., None] + q[:, :2, 2] * v[..., None] ** 3
    change = (np.abs(bend[:, 1] - bend[:, 0]) / most).max(axis=1)
    share = np.diff(motion.t) / motion.duration
    if change.sum() > 0.0:
        share += change / max(change.sum(), 1.0)
    return np.concatenate(([0.0], np.cumsum(share)))


class Follower:
    """The planner's motion, for the first grid and the first guess."""

    def __init__(self, plans: Sequence[PlanChunk]) -> None:
        self.duration = float(sum(plan.duration for plan in plans))
        rows = []
        for plan in plans:
            for k in range(len(plan.phase_j)):
                rows.append(
                    (
                        plan.phase_t[k + 1] - plan.phase_t[k],
                        plan.s0 + plan.phase_s[k],
                        plan.phase_v[k],
                        plan.phase_a[k],
                        plan.phase_j[k],
                    )
                )
        self.rows = np.array(rows)
        self.t = np.concatenate(([0.0], np.cumsum(self.rows[:, 0])))

    def at_times(self, t: Floats) -> Floats:
        """Return the path lengths, mm, at some times, s."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.rows) - 1)
        _, s, v, a, j = self.rows[k].T
        dt = t - self.t[k]
        return np.asarray(s + dt * (v + dt * (0.5 * a + dt * j / 6.0)))

    def at_places(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Return time, speed and acceleration at some path lengths."""
        k = np.clip(np.searchsorted(self.rows[:, 1], s, side="right") - 1, 0, len(self.rows) - 1)
        h, start, v, a, j = self.rows[k].T
        low, high = np.zeros(len(s)), h.copy()
        for _ in range(60):
            dt = 0.5 * (low + high)
            before = start + dt * (v + dt * (0.5 * a + dt * j / 6.0)) < s
            low, high = np.where(before, dt, low), np.where(before, high, dt)
        dt = 0.5 * (low + high)
        return self.t[k] + dt, v + dt * (a + 0.5 * dt * j), a + dt * j


def cells_for(duration: float, limits: Limits) -> int:
    """Return the number of cells for a motion of ``duration`` seconds."""
    own = slice(limits.tip_columns, None)
    a = min(limits.tangential_acceleration, float(limits.axis_acceleration[own].max()))
    j = min(limits.tangential_jerk, float(limits.axis_jerk[own].max()))
    ramp = a / j if a < inf and j < inf else duration / FEWEST
    return int(np.clip(CELLS_IN_RAMP * duration / ramp, FEWEST, MOST))


def times_of(
    blocks: Sequence[Block],
    axes: Sequence[AxisLetter],
    machine: Machine,
    passes: int = 2,
    start: Floats | None = None,
) -> Times:
    """Return the three times of a path from rest to rest.

    Args:
        blocks: the path.
        axes: letters of its columns.
        machine: its limits, and its kinematics.
        passes: grids, each with the motion of the one before.
        start: (axes,): start of the path, mm or degrees; 0 without it.

    Raises:
        ValueError: the path is not one motion, or its plan breaks a limit.
    """
    limits = Limits.of(machine)
    begin = np.zeros(len(axes)) if start is None else start

    def joint_path() -> Iterator[PathChunk | Block]:
        return Joints(machine).path(build(blocks, axes=tuple(axes), start=begin), begin)

    ahead = LookAhead(machine)
    plans = [item for item in ahead.plan(joint_path()) if isinstance(item, PlanChunk)]
    if ahead.audit.violations:
        raise ValueError(f"the plan breaks a limit: {ahead.audit.violations}")
    path = CornerBlending(limits).blended(joint_path())
    chunks = [item for item in path if isinstance(item, PathChunk)]
    route, follower = Route(chunks, limits), Follower(plans)
    t2 = t3 = 0.0
    solved = True
    for first, last in zip(route.stops[:-1], route.stops[1:], strict=True):
        ends = follower.at_places(np.array([first, last]))[0]
        count = cells_for(float(ends[1] - ends[0]), limits)
        places = follower.at_times(np.linspace(ends[0], ends[1], count + 1)[1:-1])
        motion: Motion | None = None
        s = places
        for _ in range(passes):
            earlier, s = s, route.points(first, last, places)
            if motion is None:
                t, v, a = follower.at_places(s)
                halves = follower.at_times(0.5 * (t[1:] + t[:-1]))
            else:
                t = np.interp(s, earlier, motion.t)
                v, a = np.interp(t, motion.t, motion.v), np.interp(t, motion.t, motion.a)
                halves = np.interp(0.5 * (t[1:] + t[:-1]), motion.t, earlier)
            v[0] = v[-1] = a[0] = a[-1] = 0.0
            grid = route.grid(s, halves)
            motion, fine = with_jerk(grid, limits, Motion(0.0, v, a, t))
            effort = effort_of(grid, motion, limits)
            places = np.interp(np.linspace(0.0, effort[-1], count + 1)[1:-1], effort, s)
        assert motion is not None
        t2, t3, solved = t2 + without_jerk(grid, limits), t3 + motion.duration, solved and fine
    return Times(t2, t3, follower.duration, solved)
