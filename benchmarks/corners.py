"""Motion around corners under a tolerance, compared with the optimum inside the tolerance tube.

    python -m benchmarks.corners [--seed N] [--cases N] [--family NAME] [--jobs N]

Random polygons are made from the seed: turns of 5 to 175 degrees, legs of 0.5 to 50 mm, tolerances
of 0.005 to 0.5 mm, two and three axes. The machines have limits of each axis, equal or not, limits
along the path, or both. Each is planned under G64 P, and the duration is divided by that of the
motion that :mod:`benchmarks.tube_optimum` finds. Where the path is limited and has a corner,
:mod:`benchmarks.heading_optimum` seeks it instead. The solvers begin from our motion.

The deviation is that of the planned motion from the polygon, relative to the tolerance. Two more
ratios tell where time is lost:

- "along ours": our duration over that of the fastest motion along our own path, which
  :mod:`benchmarks.optimum` finds. It is below 1 where stops are passed, because that path goes
  through the corner. What is lost there is lost by the planner, the rest by the path.
- "along best": the duration of our plan along the path of the optimum over that of the optimum.
  The path is fitted again, within a part of the tolerance. So it is the ratio that a better
  path would reach.

Where the solver ends with a motion that is slower than ours, the optimum is not known: such a case
counts as not solved.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from time import process_time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import heading_optimum
from benchmarks.optimum import times_of
from benchmarks.tube_optimum import Guess, Tube, optimum, states
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import AxisLetter, Block, PathMode, Polyline
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import curve_eval
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.pipeline import path_of

Floats = NDArray[np.float64]

AXES: tuple[AxisLetter, ...] = ("x", "y", "z")
FAMILIES = ("axis", "unequal", "path", "both")
STEPS = (10, 8, 10)
"""Steps of the solver for each leg: behind a corner, in the middle, before the next corner."""

SLOWED = 1.02
"""The solver begins with our motion slowed by this, which lies inside the limits."""

UNKNOWN = 1.005
"""A motion of the solver that takes so many times as long as ours is no optimum."""

SHARES = np.arange(6) / 6.0
"""Places in a step at which the path of the optimum is read."""

CLOSE = 0.01
"""Points of that path that are closer to the one before are left out; a part of the tolerance."""

FITTED = 0.05
"""Part of the tolerance within which that path is fitted again."""


class Case(NamedTuple):
    """A program: a polygon, a tolerance, a feed and a machine.

    Attributes:
        family: the kind of limits.
        points: (n + 1, 3): the corners, from the origin, mm.
        tolerance: mm.
        feed: mm/s.
        machine: its limits.
    """

    family: str
    points: Floats
    tolerance: float
    feed: float
    machine: Machine

    @property
    def turns(self) -> list[float]:
        """The turns at the corners, degrees."""
        legs = np.diff(self.points, axis=0)
        legs /= np.linalg.norm(legs, axis=1)[:, None]
        cosines = (legs[1:] * legs[:-1]).sum(axis=1)
        return [math.degrees(math.acos(min(1.0, max(-1.0, float(c))))) for c in cosines]

    def __str__(self) -> str:
        legs = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        turns = " ".join(f"{turn:.0f}" for turn in self.turns)
        return (
            f"{self.family:8} P{self.tolerance:.3f} F{self.feed:.0f} turns {turns}"
            f" legs {' '.join(f'{leg:.2g}' for leg in legs)}"
        )


class Result(NamedTuple):
    """One case: durations of four motions, s, and our deviation / tolerance.

    They are ours, the optimum in the tube (NaN where it is not known), the fastest along our path,
    and our plan along the path of the optimum (NaN without it).
    """

    case: Case
    ours: float
    best: float
    along: float
    along_best: float
    deviation: float


def random_polygon(rng: np.random.Generator) -> Floats:
    """Return the corners of a random polygon of one to five corners, in the plane or not."""
    flat = rng.random() < 0.5
    size = 10 ** rng.uniform(math.log10(0.5), math.log10(50.0))
    heading = np.array([math.cos(angle := rng.uniform(0, 2 * math.pi)), math.sin(angle), 0.0])
    if rng.random() < 0.3:
        heading = np.array([1.0, 0.0, 0.0])
    points = [np.zeros(3)]
    for k in range(int(rng.choice((2, 2, 2, 3, 4, 6)))):
        if k:
            across = rng.normal(size=3) * [1, 1, 0 if flat else 1]
            across -= across @ heading * heading
            turn = math.radians(rng.uniform(5.0, 175.0))
            heading = math.cos(turn) * heading + math.sin(turn) * across / np.linalg.norm(across)
        leg = min(50.0, max(0.5, size * 10 ** rng.uniform(-0.5, 0.5)))
        points.append(points[-1] + leg * heading)
    return np.array(points)


def random_machine(family: str, rng: np.random.Generator) -> Machine:
    """Return a machine with limits of the kind that ``family`` names."""
    accel, jerk = 10 ** rng.uniform(2.7, 3.9), 10 ** rng.uniform(4.0, 5.7)
    along = family in ("path", "both")
    axes = {}
    for name in AXES:
        ratio = 10 ** rng.uniform(-1.0, 0.0) if family == "unequal" else 1.0
        axes[name] = Axis(
            steps_per_mm=100.0,
            max_velocity=400.0,
            max_acceleration=None if family == "path" else accel * ratio,
            max_jerk=None if family == "path" else jerk * ratio,
        )
    return Machine(
        axes=axes,
        path=PathLimits(
            max_feed=300.0,
            max_tangential_acceleration=accel * rng.uniform(0.7, 1.5) if along else None,
            max_normal_acceleration=accel * rng.uniform(0.7, 2.5) if along else None,
            max_jerk=jerk * rng.uniform(0.7, 2.0) if along else None,
        ),
    )


def random_case(family: str, rng: np.random.Generator) -> Case:
    """Return a random program."""
    return Case(
        family,
        random_polygon(rng),
        10 ** rng.uniform(math.log10(0.005), math.log10(0.5)),
        10 ** rng.uniform(1.0, math.log10(300.0)),
        random_machine(family, rng),
    )


def blocks_of(case: Case) -> list[Block]:
    """Return the program of a case."""
    count = len(case.points) - 1
    moves = Polyline(
        "",
        1,
        case.points[1:],
        np.full(count, case.feed),
        np.arange(1, count + 1, dtype=np.int32),
    )
    return [PathMode("", 1, "blend", case.tolerance), moves]


def planned(case: Case) -> list[PlanChunk]:
    """Return our plans."""
    items = LookAhead(case.machine).plan(path_of(blocks_of(case), case.machine, np.zeros(3)))
    return [item for item in items if isinstance(item, PlanChunk)]


def positions(chunks: list[PlanChunk], times: Floats) -> Floats:
    """Return the positions at ascending times (m, 3), mm."""
    q = np.zeros((4, 3))
    rows = []
    n = 0
    for time in times:
        while n + 1 < len(chunks) and time > chunks[n].t0 + chunks[n].duration:
            n += 1
        chunk = chunks[n]
        t = max(time - chunk.t0, 0.0)
        i = min(int(np.searchsorted(chunk.phase_t, t, side="right")) - 1, len(chunk.phase_j) - 1)
        dt = t - chunk.phase_t[i]
        v, a, j = chunk.phase_v[i], chunk.phase_a[i], chunk.phase_j[i]
        s = chunk.phase_s[i] + dt * (v + dt * (a / 2 + dt * j / 6))
        m = int(np.searchsorted(chunk.piece_s, s, side="right")) - 1
        m = min(max(m, 0), len(chunk.path) - 1)
        kind, at = int(chunk.path.kind[m]), int(chunk.path.at[m])
        local = min(max(s - chunk.piece_s[m], 0.0), chunk.path.length[m])
        u = curve_inv_arclen(kind, chunk.path.data, at, local)
        curve_eval(kind, chunk.path.data, at, u, q)
        rows.append(q[0].copy())
    return np.array(rows)


def off_polygon(r: Floats, points: Floats) -> Floats:
    """Return the distance of each position from the polygon, mm."""
    best = np.full(len(r), np.inf)
    for start, end in pairwise(points):
        along = end - start
        x = np.clip(((r - start) @ along) / (along @ along), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(r - start - x[:, None] * along, axis=1))
    return best


def times_passed(case: Case, fine: Floats, r: Floats) -> list[float]:
    """Return the times at which a motion is closest to start, corners and end."""
    passed = [0.0]
    for corner in case.points[1:-1]:
        near = np.linalg.norm(r - corner, axis=1)
        near[fine <= passed[-1]] = np.inf
        passed.append(float(fine[int(np.argmin(near))]))
    return [*passed, float(fine[-1])]


def guess_of(case: Case, fine: Floats, r: Floats) -> tuple[Guess, float]:
    """Return our motion on the solver's steps, and its deviation, mm."""
    dt = fine[1]
    v = np.gradient(r, dt, axis=0)
    a = np.gradient(v, dt, axis=0)
    passed = times_passed(case, fine, r)
    steps: list[float] = []
    leg: list[int] = []
    group: list[int] = []
    jerk = np.abs(np.gradient(a, dt, axis=0)).max()
    near = 4.0 * (24.0 * case.tolerance / jerk) ** (1.0 / 3.0)
    for k in range(len(passed) - 1):
        whole = passed[k + 1] - passed[k]
        side = min(0.3 * whole, near)
        for count, duration in zip(STEPS, (side, whole - 2.0 * side, side), strict=True):
            group += [group[-1] + 1 if group else 0] * count
            steps += [duration / count] * count
        leg += [k] * sum(STEPS)
    t = np.concatenate(([0.0], np.cumsum(steps)))

    def at(values: Floats) -> Floats:
        return np.stack([np.interp(t, fine, values[:, i]) for i in range(3)], axis=1)

    guess = Guess(
        t * SLOWED, at(r), at(v) / SLOWED, at(a) / SLOWED**2, np.array(leg), np.array(group)
    )
    return guess, float(off_polygon(r, case.points).max())


def run(case: Case) -> Result:
    """Plan a case, and find its optimum."""
    chunks = planned(case)
    ours = chunks[-1].t0 + chunks[-1].duration
    fine = np.linspace(0.0, ours, 20001)
    r = positions(chunks, fine)
    guess, off = guess_of(case, fine, r)
    used = np.flatnonzero(np.ptp(case.points, axis=0) > 0.0)
    guess = guess._replace(r=guess.r[:, used], v=guess.v[:, used], a=guess.a[:, used])
    tube = Tube(case.points, case.tolerance, case.feed, Limits.of(case.machine)).of_axes(used)
    along_best = math.nan
    if case.family in ("path", "both") and len(case.points) > 2:
        passed = np.array(times_passed(case, fine, r))
        best = heading_optimum.optimum(tube, fine[::2], r[::2, used], passed)
    else:
        best, motion = optimum(tube, guess)
        if best < UNKNOWN * ours:
            route = np.zeros((len(motion.h) * len(SHARES), 3))
            route[:, used] = states(motion, tube.points[0], SHARES)[0].reshape(-1, len(used))
            along_best = duration_along(case, np.vstack((route, case.points[-1])))
    best = min(best, ours) if best < UNKNOWN * ours else math.nan
    along = times_of(blocks_of(case), AXES, case.machine).t3
    return Result(case, ours, best, along, along_best, off / case.tolerance)


def duration_along(case: Case, route: Floats) -> float:
    """Return the duration of our plan near points (m, 3) that follow each other closely, s."""
    points = [route[0]]
    for point in route[1:-1]:
        if min(np.linalg.norm(point - end) for end in (points[-1], route[-1])) > (
            CLOSE * case.tolerance
        ):
            points.append(point)
    points.append(route[-1])
    near = case._replace(points=np.array(points), tolerance=FITTED * case.tolerance)
    last = planned(near)[-1]
    return last.t0 + last.duration


def cases(seed: int, count: int, families: tuple[str, ...]) -> Iterator[Case]:
    """Yield ``count`` random programs of each family."""
    for family in families:
        rng = np.random.default_rng([seed, FAMILIES.index(family)])
        for _ in range(count):
            yield random_case(family, rng)


def main() -> None:
    """Print a line for each case, and a table of the families."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=10, help="of each family")
    parser.add_argument("--family", choices=FAMILIES)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    families = (options.family,) if options.family else FAMILIES
    started = process_time()
    found: list[Result] = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for each in pool.map(run, cases(options.seed, options.cases, families)):
            found.append(each)
            print(
                f"{each.ours:8.4f} {each.best:8.4f} {each.ours / each.best:7.3f}"
                f"  {each.deviation:5.3f}  {each.ours / each.along:6.3f}"
                f" {each.along_best / each.best:6.3f}  {each.case}",
                flush=True,
            )
    print(
        f"{'family':10} {'cases':>6} {'solved':>7} {'median':>7} {'worst':>7} {'above 1.10':>11}"
        f" {'along ours':>11} {'along best':>11} {'worst':>7}"
    )
    for family in families:
        those = [each for each in found if each.case.family == family]
        solved = [each.ours / each.best for each in those if each.best == each.best]
        ratios = solved or [math.nan]
        over = sum(ratio > 1.1 for ratio in ratios)
        along = np.median([each.ours / each.along for each in those])
        better = [each.along_best / each.best for each in those if each.best == each.best]
        better = better or [math.nan]
        print(
            f"{family:10} {len(those):6} {len(solved):7} {np.median(ratios):7.3f}"
            f" {max(ratios):7.3f} {over:11} {along:11.3f} {np.median(better):11.3f}"
            f" {max(better):7.3f}"
        )
    print(f"CPU {process_time() - started:.0f} s, and that of {options.jobs} processes")


if __name__ == "__main__":
    main()
