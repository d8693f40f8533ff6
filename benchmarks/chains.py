"""Chains of short moves as CAM systems write them, made from smooth curves by a seed.

A CAM system follows a smooth curve with chords. Their distance from it, the sagitta, is a part of
its own tolerance, and the tolerance of G64 P is often about as large. Each case has the curve as
well, so the motion along the fitted path can be compared with that along the curve.

    python -m benchmarks.chains [--seed N] [--cases N] [--limits KIND] [--optimum]

A line for each chain: moves, pieces of the fitted path, its largest distance from the moves in
tolerances, the time of the motion along it in parts of that along the smooth curve, and the CPU
time of the fit. Families of lines and arcs come below 1: their curvature jumps, the spline's not.
``--limits`` chooses the machine: limits of each axis, along the path, or both. With ``--optimum``
the time along the smooth curve is that of the fastest motion (:mod:`benchmarks.optimum`), and not
that of the planner. That takes some seconds for each chain.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from benchmarks.optimum import times_of
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import AxisLetter, Block, NurbsFeed, PathMode, Polyline
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_eval, curve_range
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.kernel_cache import ensure_compiled

Floats = NDArray[np.float64]

FINE = 20001
"""Points at which a curve is tabulated."""
LONGEST = 5.0
"""mm: longest chord."""
AXES: tuple[AxisLetter, ...] = ("x", "y", "z")
FEED = 300.0
"""mm/s."""
LIMITS = ("axis", "path", "both")
"""Kinds of limits of a machine."""
RUN = 4096
"""Moves in one block, as the reader makes them."""


class Chain(NamedTuple):
    """A chain of chords, and the curve under it.

    Attributes:
        name: family, sagitta in parts of the tolerance, digits, axes.
        points: (m + 1, 3): ends of the chords, mm.
        tolerance: of G64, mm.
        curve: (FINE, 3): points along the smooth curve, mm.
    """

    name: str
    points: Floats
    tolerance: float
    curve: Floats


def _spline(random: np.random.Generator, dimensions: int) -> Floats:
    """Return points along a random curve with a continuous fourth derivative."""
    count = int(random.integers(6, 14))
    size = 10.0 ** random.uniform(0.3, 1.2)
    heading = random.uniform(0.0, 2.0 * math.pi)
    control = [np.zeros(3)]
    for _ in range(count):
        heading += random.normal() * 0.9
        step = np.array([math.cos(heading), math.sin(heading), 0.6 * random.normal()])
        step[2] *= dimensions == 3
        control.append(control[-1] + size * random.uniform(0.6, 1.4) * step)
    knots = np.concatenate((np.zeros(5), np.linspace(0.0, 1.0, count - 3), np.ones(5)))
    points: Floats = BSpline(knots, np.array(control), 5)(np.linspace(0.0, 1.0, FINE))
    return points


def _offset(random: np.random.Generator) -> Floats:
    """Return points along an offset of a plane curve that keeps a radius of at least 0.3 mm."""
    points = _spline(random, 2)
    u = np.linspace(0.0, 1.0, FINE)
    first = np.gradient(points, u, axis=0, edge_order=2)
    second = np.gradient(first, u, axis=0, edge_order=2)
    speed = np.linalg.norm(first, axis=1)
    bend = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    normal = np.stack((-first[:, 1], first[:, 0], 0.0 * speed), axis=1) / speed[:, None]
    radius = 1.0 / max(float(bend.max()), 1e-3) - 0.3
    moved: Floats = points + min(radius, random.uniform(0.5, 6.0)) * normal
    return moved


def _arcs(random: np.random.Generator) -> Floats:
    """Return points along lines and arcs that follow each other at tangents."""
    here, heading, parts = np.zeros(2), 0.0, [np.zeros((1, 2))]
    for _ in range(int(random.integers(3, 8))):
        turn = random.uniform(0.3, 2.5) * random.choice([-1.0, 1.0])
        radius = 10.0 ** random.uniform(0.2, 1.5)
        line = random.uniform(0.0, 1.0) < 0.4
        length = random.uniform(2.0, 12.0) if line else radius * abs(turn)
        s = np.linspace(0.0, length, 4001)[1:]
        bend = 0.0 if line else math.copysign(1.0 / radius, turn)
        angle = heading + bend * s
        if line:
            part = s[:, None] * [math.cos(heading), math.sin(heading)]
        else:
            part = np.stack(
                (np.sin(angle) - math.sin(heading), math.cos(heading) - np.cos(angle)), axis=1
            )
            part /= bend
        parts.append(here + part)
        here, heading = parts[-1][-1], float(angle[-1])
    points = np.concatenate(parts)
    return np.column_stack((points, np.zeros(len(points))))


def lengths(points: Floats) -> Floats:
    """Return the length along points (m, n) at each of them, mm."""
    along: Floats = np.concatenate(
        ([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    )
    return along


def chords(curve: Floats, sagitta: float, digits: int) -> Floats:
    """Return ends of chords of a curve (FINE, 3), in places chosen by its bend, rounded."""
    s = lengths(curve)
    even = np.linspace(0.0, s[-1], FINE)
    points = np.stack([np.interp(even, s, curve[:, c]) for c in range(3)], axis=1)
    step = max(1, FINE // 4000)
    second = (points[2 * step :] - 2.0 * points[step:-step] + points[: -2 * step]) / (
        step * even[1]
    ) ** 2
    bend = np.pad(np.linalg.norm(second, axis=1), step, mode="edge")
    size = np.minimum(np.sqrt(8.0 * sagitta / np.maximum(bend, 1e-9)), LONGEST)
    number = np.concatenate(([0.0], np.cumsum(np.diff(even) * 2.0 / (size[1:] + size[:-1]))))
    count = max(math.ceil(number[-1]), 4)
    at = np.interp(np.linspace(0.0, number[-1], count + 1), number, even)
    ends = np.stack([np.interp(at, even, points[:, c]) for c in range(3)], axis=1).round(digits)
    keep = np.append(True, np.abs(np.diff(ends, axis=0)).max(axis=1) > 0.0)
    found: Floats = ends[keep]
    return found


def chain(seed: int) -> Chain:
    """Return the chain of a seed: its family, sagitta, digits and axes are random."""
    random = np.random.default_rng(seed)
    family = ("spline", "spline 3-axis", "offset", "arcs")[int(random.integers(4))]
    match family:
        case "spline":
            curve = _spline(random, 2)
        case "spline 3-axis":
            curve = _spline(random, 3)
        case "offset":
            curve = _offset(random)
        case _:
            curve = _arcs(random)
    tolerance = float(random.choice([0.005, 0.01, 0.02]))
    part = float(random.uniform(0.1, 1.0))
    digits = int(random.choice([3, 4]))
    curve = curve - curve.min(axis=0)
    points = chords(curve, part * tolerance, digits)
    name = f"{seed}: {family}, sagitta {part:.2f} of {tolerance:g}, {digits} digits"
    return Chain(name, points, tolerance, curve)


def smooth(case: Chain, pieces_per_move: float = 3.0) -> tuple[Floats, Floats]:
    """Return knots and control points of the quintic spline through the curve of a chain."""
    s = lengths(case.curve)
    own = lengths(case.points)
    move = np.linspace(0.0, 1.0, int(pieces_per_move * (len(own) - 1)) + 1)
    at = np.interp(move, np.linspace(0.0, 1.0, len(own)), own / own[-1]) * s[-1]
    points = np.stack([np.interp(at, s, case.curve[:, c]) for c in range(3)], axis=1)
    spline = make_interp_spline(at, points, 5)
    knots: Floats = spline.t
    control: Floats = spline.c
    return knots, control


def machine(limits: str = "axis") -> Machine:
    """Return a machine with 300 mm/s, 2400 mm/s^2, 48 000 mm/s^3.

    Args:
        limits: of which kind: one of LIMITS.
    """
    a, j = 2400.0, 48_000.0
    per_axis, along = limits != "path", limits != "axis"
    axis = Axis(
        steps_per_mm=1000.0,
        max_velocity=FEED,
        max_acceleration=a if per_axis else None,
        max_jerk=j if per_axis else None,
    )
    path = PathLimits(
        max_feed=FEED,
        chord_error=1.0,
        max_tangential_acceleration=a if along else None,
        max_normal_acceleration=a if along else None,
        max_jerk=j if along else None,
    )
    return Machine(axes=dict.fromkeys(AXES, axis), path=path)


def moves(points: Floats, tolerance: float) -> Iterator[Block]:
    """Yield the blocks of straight moves through points (m + 1, 3) under G64 P."""
    yield PathMode("", 1, "blend", tolerance)
    for first in range(1, len(points), RUN):
        some = points[first : first + RUN]
        lines = np.arange(first, first + len(some), dtype=np.int32)
        yield Polyline("", first, some, np.full(len(some), FEED), lines)


def path(blocks: Iterable[Block], start: Floats) -> list[PathChunk]:
    """Return the path of blocks."""
    return [c for c in build(blocks, axes=AXES, start=start) if isinstance(c, PathChunk)]


def duration(chunks: list[PathChunk], limits: str = "axis") -> float:
    """Return the time of the planned motion along a path, s; ``limits``: one of LIMITS."""
    end = 0.0
    for plan in LookAhead(machine(limits)).plan(iter(chunks)):
        if isinstance(plan, PlanChunk):
            end = plan.t0 + plan.duration
    return end


def sampled(chunks: list[PathChunk], count: int = 64) -> Floats:
    """Return ``count`` points along each piece of a path."""
    found, out = [], np.empty((4, 3))
    for chunk in chunks:
        for kind, at in zip(chunk.kind.tolist(), chunk.at.tolist(), strict=True):
            for u in np.linspace(*curve_range(kind, chunk.data, at), count):
                curve_eval(kind, chunk.data, at, float(u), out)
                found.append(out[0].copy())
    points: Floats = np.array(found)
    return points


def distance(points: Floats, polygon: Floats) -> float:
    """Return the largest distance of points (m, 3) from a polygon (k, 3), mm."""
    a, along = polygon[:-1], np.diff(polygon, axis=0)
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    worst = 0.0
    for first in range(0, len(points), 256):
        p = points[first : first + 256, None]
        x = np.clip(((p - a) * along).sum(axis=2) / square, 0.0, 1.0)
        apart = np.linalg.norm(p - a - x[..., None] * along, axis=2).min(axis=1)
        worst = max(worst, float(apart.max()))
    return worst


def main() -> None:
    """Print a line for each chain, and a summary."""
    parser = argparse.ArgumentParser(description="CAM chains: motion along the fitted path.")
    parser.add_argument("--seed", type=int, default=1, help="the cases are made from it")
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--limits", choices=LIMITS, default="axis", help="of the machine")
    parser.add_argument("--optimum", action="store_true", help="compare with the fastest motion")
    arguments = parser.parse_args()
    ensure_compiled(None)
    path(moves(chain(0).points, chain(0).tolerance), chain(0).points[0])
    ratios, worst = [], 0.0
    for number in range(arguments.cases):
        case = chain(1000 * arguments.seed + number)
        knots, control = smooth(case)
        curve = NurbsFeed("", 1, 5, knots, control, np.ones(len(control)), FEED)
        began = time.process_time()
        chunks = path(moves(case.points, case.tolerance), case.points[0])
        seconds = time.process_time() - began
        on_path, count = sampled(chunks), len(case.points) - 1
        off = max(distance(on_path, case.points), distance(case.points, on_path)) / case.tolerance
        if arguments.optimum:
            best = times_of([curve], AXES, machine(arguments.limits), start=control[0]).t3
        else:
            best = duration(path([curve], control[0]), arguments.limits)
        ratios.append(duration(chunks, arguments.limits) / best)
        worst = max(worst, off)
        print(
            f"{case.name:58} {count:5d} moves {sum(map(len, chunks)):5d} pieces "
            f"off {off:5.3f}  time {ratios[-1]:6.3f}  {seconds / count * 1e6:6.1f} us/move",
            flush=True,
        )
    print(
        f"time / smooth: median {np.median(ratios):.3f} worst {max(ratios):.3f} "
        f"(wanted 1.02, 1.08); largest distance {worst:.3f} tolerances"
    )


if __name__ == "__main__":
    main()
