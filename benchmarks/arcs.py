"""Programs of lines, arcs and NURBS as CAM systems write them, under G64 P, made by a seed.

Tangent lines and arcs have jumps of curvature at their joints. On the exact path a machine with a
limit of jerk has to slow down at each. Under a tolerance they are fitted
(:mod:`cnc.path.fit_curves`).

    python -m benchmarks.arcs [--seed N] [--cases N]

A line for each family and kind of limits: the time under G64 P in parts of that along the exact
path (mean, least, most), pieces of both paths, and CPU time of both, path and plan.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.chains import AXES
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import ArcFeed, Block, NurbsFeed, PathMode, Polyline
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.kernel_cache import ensure_compiled

Floats = NDArray[np.float64]
Random = np.random.Generator
KINDS = ("path", "axis")


class Program:
    """A program that grows at its end, from the origin.

    Args:
        feed: mm/s.
        digits: to which coordinates are rounded; None: they are not.
    """

    def __init__(self, feed: float, digits: int | None) -> None:
        self.blocks: list[Polyline | ArcFeed | NurbsFeed] = []
        self.here = np.zeros(3)
        self.heading = 0.0
        self._feed = feed
        self._digits = digits

    def line(self, length: float) -> None:
        """Go straight on."""
        step = np.array([math.cos(self.heading), math.sin(self.heading), 0.0])
        self.line_to(self.here + length * step)

    def line_to(self, end: Floats) -> None:
        """Go straight to a point (3,)."""
        end = self._rounded(end)
        if np.linalg.norm(end - self.here) > 1e-6:
            number = len(self.blocks) + 1
            feeds, numbers = np.array([self._feed]), np.array([number], np.int32)
            self.blocks.append(Polyline("", number, end[None], feeds, numbers))
            self.here = end

    def arc(self, radius: float, turn: float, rise: float = 0.0) -> None:
        """Go on along an arc; turn: rad, to the left positive; rise: along z, mm."""
        aside = math.copysign(radius, turn)

        def normal() -> Floats:
            return aside * np.array([-math.sin(self.heading), math.cos(self.heading), 0.0])

        center = self._rounded(self.here + normal())
        exact = self.here + normal()
        self.heading += turn
        end = self._rounded(exact - normal() + [0.0, 0.0, rise])
        own = float(np.linalg.norm((self.here - center)[:2]))
        middle = (float(center[0]), float(center[1]))
        number, turns = len(self.blocks) + 1, turn / (2.0 * math.pi)
        self.blocks.append(ArcFeed("", number, "XY", middle, end, own, turns, self._feed))
        self.here = end

    def nurbs(self, points: Floats, degree: int) -> None:
        """Go on along a B-spline with more control points (m, 3)."""
        control = self._rounded(np.vstack((self.here[None], points)))
        count = len(control)
        inner = np.linspace(0.0, 1.0, count - degree + 1)
        knots = np.concatenate((np.zeros(degree), inner, np.ones(degree)))
        number = len(self.blocks) + 1
        self.blocks.append(
            NurbsFeed("", number, degree, knots, control, np.ones(count), self._feed)
        )
        self.here = control[-1].copy()
        last = control[-1] - control[-2]
        self.heading = math.atan2(last[1], last[0])

    def _rounded(self, values: Floats) -> Floats:
        return values if self._digits is None else np.round(values, self._digits)


def _rectangles(random: Random, program: Program) -> None:
    """Rounded rectangles inside each other."""
    width, height = random.uniform(8.0, 40.0, 2)
    for _ in range(3):
        radius = min(float(random.choice([0.5, 1, 2, 3, 6])), width / 2.2, height / 2.2)
        program.heading = 0.0
        for side in range(4):
            program.line((width, height)[side % 2] - 2.0 * radius)
            program.arc(radius, math.pi / 2.0)
        width, height = width - 1.5, height - 1.5
        if min(width, height) < 3.0:
            break
        program.line_to(program.here + [0.75, 0.75, 0.0])


def _slots(random: Random, program: Program) -> None:
    """Slots that go down by helical ends."""
    radius, length = float(random.choice([1, 2, 4, 8])), random.uniform(3.0, 40.0)
    for _ in range(6):
        program.line(length)
        program.arc(radius, math.pi, -0.3)


def _bends(random: Random, program: Program) -> None:
    """Arcs that turn to the left and the right in turn."""
    for k in range(8):
        program.arc(10.0 ** random.uniform(0.0, 1.3), random.uniform(0.3, 2.5) * (-1) ** k)


def _mixed(random: Random, program: Program) -> None:
    """Lines and arcs in any order."""
    for _ in range(10):
        if random.random() < 0.4:
            program.line(random.uniform(1.0, 12.0))
        else:
            turn = random.uniform(0.2, 2.5) * random.choice([-1.0, 1.0])
            program.arc(10.0 ** random.uniform(-0.3, 1.5), turn)


def _adaptive(random: Random, program: Program) -> None:
    """Loops of adaptive clearing."""
    size = random.uniform(3.0, 8.0)
    for _ in range(10):
        radius = size * random.uniform(0.8, 1.2)
        program.arc(radius, random.uniform(1.2, 2.4))
        program.arc(0.4 * radius, 0.9)
        program.line(random.uniform(0.5, 4.0))
        program.arc(0.4 * radius, 0.9)
        program.line(random.uniform(1.0, 4.0))


def _filtered(random: Random, program: Program) -> None:
    """Short arcs through the points of a curve."""
    bend = 0.0
    for _ in range(40):
        bend = max(min(bend + random.normal() * 0.03, 0.5), -0.5)
        own = bend if abs(bend) > 0.005 else 0.005
        program.arc(1.0 / abs(own), random.uniform(0.3, 3.0) * own)


def _helices(random: Random, program: Program) -> None:
    """Helical entries with whole circles."""
    radius = random.uniform(2.0, 15.0)
    program.line(5.0)
    program.arc(radius, 2.0 * math.pi * int(random.integers(1, 4)), -2.0)
    program.arc(radius, 2.0 * math.pi)
    program.arc(0.5 * radius, math.pi)
    program.line(4.0)


def _splines(random: Random, program: Program) -> None:
    """NURBS and arcs in turn."""
    for _ in range(3):
        turn = random.uniform(0.5, 2.0) * random.choice([-1.0, 1.0])
        program.arc(random.uniform(2.0, 10.0), turn)
        heading, here, points = program.heading, program.here.copy(), []
        for _ in range(int(random.integers(4, 9))):
            step = np.array([math.cos(heading), math.sin(heading), 0.0])
            here = here + random.uniform(2.0, 6.0) * step
            points.append(here)
            heading += random.normal() * 0.6
        degree = int(random.choice([3, 3, 5])) if len(points) > 4 else 3
        program.nurbs(np.array(points), degree)


FAMILIES: dict[str, Callable[[Random, Program], None]] = {
    "rectangles": _rectangles,
    "slots": _slots,
    "bends": _bends,
    "mixed": _mixed,
    "adaptive": _adaptive,
    "filtered": _filtered,
    "helices": _helices,
    "splines": _splines,
}


class Case(NamedTuple):
    """The moves of a program, and a tolerance in mm."""

    moves: list[Polyline | ArcFeed | NurbsFeed]
    tolerance: float


def case(family: str, seed: int) -> Case:
    """Return the program of a seed."""
    random = np.random.default_rng([seed, list(FAMILIES).index(family)])
    tolerance = float(random.choice([0.005, 0.01, 0.02, 0.05]))
    feed = float(random.choice([50.0, 100.0, 300.0]))
    program = Program(feed, int(random.choice([3, 4])) if random.random() < 0.7 else None)
    FAMILIES[family](random, program)
    return Case(program.blocks, tolerance)


def machine(kind: str) -> Machine:
    """Return a machine with limits along the path or of each axis."""
    along = kind == "path"
    axis = Axis(
        steps_per_mm=1000.0,
        max_velocity=300.0,
        max_acceleration=None if along else 2400.0,
        max_jerk=None if along else 48_000.0,
    )
    path = PathLimits(
        max_feed=300.0,
        chord_error=1.0,
        max_tangential_acceleration=2400.0 if along else None,
        max_normal_acceleration=2400.0 if along else None,
        max_jerk=48_000.0 if along else None,
    )
    return Machine(axes=dict.fromkeys(AXES, axis), path=path)


class Run(NamedTuple):
    """A planned program: time of the motion in s, pieces of its path, CPU time in s."""

    duration: float
    pieces: int
    cpu: float


def run(moves: list[Polyline | ArcFeed | NurbsFeed], tolerance: float, kind: str) -> Run:
    """Plan moves under a tolerance; 0: on the exact path."""
    began = time.process_time()
    blocks: list[Block] = [PathMode("", 1, "blend" if tolerance else "exact-path", tolerance)]
    path = list(build([*blocks, *moves], axes=AXES, start=np.zeros(3)))
    end = 0.0
    for plan in LookAhead(machine(kind)).plan(iter(path)):
        if isinstance(plan, PlanChunk):
            end = plan.t0 + plan.duration
    pieces = sum(len(item) for item in path if isinstance(item, PathChunk))
    return Run(end, pieces, time.process_time() - began)


def main() -> None:
    """Print a line for each family and kind of limits."""
    parser = argparse.ArgumentParser(description="Lines, arcs and NURBS under G64 P.")
    parser.add_argument("--seed", type=int, default=1, help="the cases are made from it")
    parser.add_argument("--cases", type=int, default=10)
    arguments = parser.parse_args()
    ensure_compiled(None)
    for kind in KINDS:
        run(*case("mixed", 0), kind)
    print(f"{'family':12} {'limits':6} {'mean':>7} {'least':>7} {'most':>7}  pieces, CPU s")
    for family in FAMILIES:
        for kind in KINDS:
            exact, fitted = [], []
            for number in range(arguments.cases):
                one = case(family, 1000 * arguments.seed + number)
                exact.append(run(one.moves, 0.0, kind))
                fitted.append(run(*one, kind))
            parts = [b.duration / a.duration for a, b in zip(exact, fitted, strict=True)]
            pieces = [sum(each.pieces for each in runs) for runs in (exact, fitted)]
            cpu = [sum(each.cpu for each in runs) for runs in (exact, fitted)]
            print(
                f"{family:12} {kind:6} {np.mean(parts):7.3f} {min(parts):7.3f} {max(parts):7.3f}"
                f"  {pieces[0]} -> {pieces[1]}, {cpu[0]:.2f} -> {cpu[1]:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
