"""The time from a hold to rest, beside the shortest ramp that the axes permit.

    python -m benchmarks.holds [--seed N] [--count N] [--family NAME...] [--list]

Programs are those of :mod:`benchmarks.optimum_cases` and the polygons of :mod:`benchmarks.corners`,
made anew from the seed. A hold is requested at a random moment of the run. Until the end of the
slice that the board has, at most SLICE later, the motion is settled. From there each axis needs at
least the time of its own shortest ramp to rest, which ruckig finds. The longest of these is a lower
bound for every motion to rest, on the path or not. Where the path bends, no motion reaches it.

``over`` is the time by which the motion rests later than the slice and 1.1 times that bound. A line
for each family has its median and largest value, the share above 0, and the share in which a motion
past corners was under way at the request.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

from benchmarks import corners, optimum_cases
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held
from cnc.model.operator_control import Control
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import LINE, curve_eval_s
from cnc.planner.kernels.timed import is_timed
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import SLICE
from cnc.session.pipeline import path_of

Floats = NDArray[np.float64]
Random = np.random.Generator

LONGER = 1.1
"""Part of the shortest ramp that a hold may take."""
POLYGONS = "polygons"
SEED = 1
COUNT = 500


class Program(NamedTuple):
    """A program: its family, its blocks, and the machine."""

    family: str
    blocks: list[Block]
    machine: Machine


class Outcome(NamedTuple):
    """A hold.

    Attributes:
        moment: of the request, s.
        rest: the time at which the motion rests, s.
        ramp: the lower bound of the time to rest from the end of the slice, s.
        past_corner: whether a motion past corners was under way at the end of the slice.
    """

    moment: float
    rest: float
    ramp: float
    past_corner: bool

    @property
    def over(self) -> float:
        """The time above a slice and LONGER times the bound, s."""
        return self.rest - self.moment - SLICE - LONGER * self.ramp


def programs(seed: int, count: int, families: list[str]) -> Iterator[Program]:
    """Yield about ``count`` programs, evenly over the families."""
    for family in families:
        for k in range(max(round(count / len(families)), 1)):
            rng = np.random.default_rng([seed, list(FAMILIES).index(family), k])
            if family == POLYGONS:
                kinds = corners.FAMILIES
                polygon = corners.random_case(kinds[k % len(kinds)], rng)
                yield Program(family, corners.blocks_of(polygon), polygon.machine)
            else:
                yield Program(family, *optimum_cases.FAMILIES[family][0](rng))


FAMILIES = (POLYGONS, *optimum_cases.FAMILIES)


def motion(program: Program, control: Control | None = None) -> Iterator[PlanChunk | Block]:
    """Yield the plans of a program, and holds."""
    machine = program.machine
    yield from LookAhead(machine, control).plan(path_of(program.blocks, machine, np.zeros(3)))


def state(plan: PlanChunk, time: float) -> tuple[Floats, Floats, bool]:
    """Return velocity and acceleration of each axis at a time, and whether it is past a corner."""
    t = min(max(time - plan.t0, 0.0), plan.duration)
    k = min(int(np.searchsorted(plan.phase_t, t, side="right")) - 1, len(plan.phase_j) - 1)
    dt = t - float(plan.phase_t[k])
    v0, a0, j = float(plan.phase_v[k]), float(plan.phase_a[k]), float(plan.phase_j[k])
    s = float(plan.phase_s[k]) + dt * (v0 + dt * (a0 / 2 + dt * j / 6))
    v, a = v0 + dt * (a0 + dt * j / 2), a0 + dt * j
    m = int(np.searchsorted(plan.piece_s, s, side="right")) - 1
    m = min(max(m, 0), len(plan.path) - 1)
    kind, at, data = int(plan.path.kind[m]), int(plan.path.at[m]), plan.path.data
    here = min(max(s - float(plan.piece_s[m]), 0.0), float(plan.path.length[m]))
    q = np.zeros((4, len(plan.path.axes)))
    u = 0.0 if kind == LINE else curve_inv_arclen(kind, data, at, here)
    curve_eval_s(kind, data, at, u, q)
    return q[1] * v, q[2] * v * v + q[1] * a, bool(is_timed(kind, data, at))


def shortest_ramp(v: float, a: float, acceleration: float, jerk: float) -> float:
    """Return the time of the fastest motion to rest under one bound each, s."""
    given, found = InputParameter(1), Trajectory(1)
    given.control_interface = ControlInterface.Velocity
    given.current_position, given.current_velocity, given.current_acceleration = [0.0], [v], [a]
    given.target_velocity, given.target_acceleration = [0.0], [0.0]
    given.max_velocity, given.max_acceleration, given.max_jerk = [1e9], [acceleration], [jerk]
    done = Ruckig(1).calculate(given, found) in (Result.Working, Result.Finished)
    return float(found.duration) if done else inf


def shortest_stop(v: Floats, a: Floats, limits: Limits) -> float:
    """Return a lower bound of the time to rest from the velocity and acceleration of each axis."""
    bounds = [
        shortest_ramp(float(v[i]), float(a[i]), float(most), float(limits.axis_jerk[i]))
        for i, most in enumerate(limits.axis_acceleration)
        if np.isfinite(most) and np.isfinite(limits.axis_jerk[i])
    ]
    speed = float(np.linalg.norm(v))
    most, jerk = limits.tangential_acceleration, limits.tangential_jerk
    if speed > 0.0 and np.isfinite(most) and np.isfinite(jerk):
        bounds.append(shortest_ramp(speed, float(v @ a) / speed, most, jerk))
    return max([bound for bound in bounds if bound < inf], default=0.0)


def held(program: Program, rng: Random) -> Outcome:
    """Hold a program at a random moment.

    The plan in which the moment lies has been handed out already. The motion may end before it
    rests because of the hold: then that is the rest.
    """
    plain = [item for item in motion(program, Control()) if isinstance(item, PlanChunk)]
    whole = plain[-1].t0 + plain[-1].duration
    moment = rng.uniform(0.0, whole)
    settled = min(moment + SLICE, whole)
    plan = next(plan for plan in plain if plan.t0 + plan.duration >= settled)
    v, a, past_corner = state(plan, settled)
    ramp = shortest_stop(v, a, Limits.of(program.machine))
    control, end = Control(), 0.0
    for item in motion(program, control):
        if isinstance(item, Held):
            return Outcome(moment, end, ramp, past_corner)
        if isinstance(item, PlanChunk):
            end = item.t0 + item.duration
            if end >= moment and not control.held:
                control.hold()
    return Outcome(moment, end, ramp, past_corner)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Times from a hold to rest.")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--family", nargs="*", choices=FAMILIES)
    parser.add_argument("--list", action="store_true", help="print each hold")
    arguments = parser.parse_args()
    families = arguments.family or list(FAMILIES)
    found: dict[str, list[Outcome]] = {family: [] for family in families}
    rng = np.random.default_rng([arguments.seed, len(FAMILIES)])
    for program in programs(arguments.seed, arguments.count, families):
        outcome = held(program, rng)
        found[program.family].append(outcome)
        if arguments.list:
            print(
                f"{program.family:26} request {outcome.moment:8.4f}  rest after"
                f" {outcome.rest - outcome.moment:8.4f}  ramp {outcome.ramp:7.4f}"
                f"  over {outcome.over:8.4f}{'  past a corner' if outcome.past_corner else ''}",
                flush=True,
            )
    print(f"\nseed {arguments.seed}; over: s")
    print(f"{'family':26} {'holds':>5} {'median':>8} {'worst':>8} {'over 0':>7} {'in corners':>10}")
    for family, outcomes in found.items():
        if outcomes:
            over = np.array([outcome.over for outcome in outcomes])
            inside = np.mean([outcome.past_corner for outcome in outcomes])
            print(
                f"{family:26} {len(over):5d} {np.median(over):8.4f} {over.max():8.4f}"
                f" {np.mean(over > 0.0):7.1%} {inside:10.1%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
