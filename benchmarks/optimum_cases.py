"""The planner's times on random motions by family, beside the fastest ones.

    python -m benchmarks.optimum_cases [--seed N] [--count N] [--family NAME...] [--list]

Paths, feeds and machines are made from the seed. A line for each family has the ratio of the
planner's time to T3 of :mod:`benchmarks.optimum`: its median, its largest value, and the share of
the cases above 1.05. The path is the one that the planner follows: chains are fitted and corners
have their blends before either time is found. ``--list`` prints each case.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.optimum import Times, times_of
from cnc.machine.models import Axis, Board, Machine, PathLimits
from cnc.model.blocks import ArcFeed, AxisLetter, Block, NurbsFeed, PathMode, Polyline

Floats = NDArray[np.float64]
Random = np.random.Generator

AXES: tuple[AxisLetter, ...] = ("x", "y", "z")
SLOW = 1.05
"""A case counts as slow above this ratio."""
SEED = 1
COUNT = 200


class Case(NamedTuple):
    """A motion: its blocks, and the machine."""

    blocks: list[Block]
    machine: Machine


def random_machine(rng: Random, kind: str | None = None) -> Machine:
    """Return a machine with limits of each axis, along the path, or both; axes often differ."""
    accel = 10 ** rng.uniform(2.5, 3.9)
    jerk = accel / 10 ** rng.uniform(-2.0, -1.0)
    kind = kind or str(rng.choice(["axis", "path", "both"], p=[0.5, 0.2, 0.3]))
    unequal = rng.random() < 0.5
    parts = 10 ** rng.uniform(-0.7, 0.0, 3) if unequal else np.ones(3)
    axes = {
        letter: Axis(
            steps_per_mm=100.0,
            max_velocity=400.0 * part,
            max_acceleration=accel * part if kind != "path" else None,
            max_jerk=jerk * part if kind != "path" else None,
        )
        for letter, part in zip(AXES, parts.tolist(), strict=True)
    }
    along = kind != "axis"
    path = PathLimits(
        max_feed=300.0,
        max_tangential_acceleration=accel * rng.uniform(0.5, 1.2) if along else None,
        max_normal_acceleration=accel * rng.uniform(0.8, 2.5) if along else None,
        max_jerk=jerk * rng.uniform(0.5, 1.2) if along else None,
        chord_error=0.001,
        period=1e-3 if rng.random() < 0.5 else 1e-4,
    )
    return Machine(axes=axes, path=path, board=Board(max_step_rate=1e9))


def feed_of(rng: Random) -> float:
    """Return a feed, mm/s."""
    return float(10 ** rng.uniform(1.3, 2.47))


def moves(points: Floats, feed: float | Floats) -> Polyline:
    """Return straight moves from machine zero along ``points`` (n, 3), which begin there."""
    n = len(points) - 1
    feeds = np.broadcast_to(np.asarray(feed, float), (n,)).copy()
    return Polyline("", 1, points[1:] - points[0], feeds, np.arange(1, n + 1, dtype=np.int32))


def nurbs(rng: Random) -> Case:
    """Return an exact NURBS of degree 3 or 5 with 5 to 30 points, some of them hairpins."""
    degree = int(rng.choice((3, 5)))
    count = int(rng.integers(max(5, degree + 1), 31))
    step = rng.normal(0.0, 10 ** rng.uniform(0.0, 1.2), (count, 3))
    step[:, 2] *= rng.choice((0.0, 0.5))
    for k in range(2, count):
        if rng.random() < 0.15:
            step[k] = -rng.uniform(0.7, 1.0) * step[k - 1]
    step[0] = 0.0
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    weights = 10 ** rng.uniform(-0.3, 0.3, count) if rng.random() < 0.3 else np.ones(count)
    block = NurbsFeed("", 1, degree, knots, np.cumsum(step, axis=0), weights, feed_of(rng))
    return Case([PathMode("", 1, "exact-path"), block], random_machine(rng))


def arc(start: Floats, heading: float, turn: float, radius: float, rise: float, feed: float):  # type: ignore[no-untyped-def]
    """Return an arc by ``turn`` (rad, positive for the left), and the heading at its end."""
    side = math.copysign(1.0, turn)
    centre = start[:2] + side * radius * np.array([-math.sin(heading), math.cos(heading)])
    out = heading + turn
    end = np.array([*(centre - side * radius * np.array([-math.sin(out), math.cos(out)])), 0.0])
    end[2] = start[2] + rise
    if abs(turn) == 2.0 * math.pi:
        end[:2] = start[:2]
    place = (float(centre[0]), float(centre[1]))
    return ArcFeed("", 1, "XY", place, end, radius, turn / (2.0 * math.pi), feed), out


def simple(rng: Random) -> Case:
    """Return a line, an arc, a circle or a helix."""
    feed, radius = feed_of(rng), 10 ** rng.uniform(-0.5, 1.6)
    turn = float(rng.choice((-1.0, 1.0))) * float(
        rng.choice((rng.uniform(0.3, 6.0), 2.0 * math.pi, 4.0 * math.pi))
    )
    rise = float(rng.choice((0.0, rng.normal(0.0, radius))))
    block: Block
    if rng.random() < 0.25:
        block = moves(np.array([np.zeros(3), rng.normal(0.0, 30.0, 3)]), feed)
    else:
        if abs(turn) > 2.0 * math.pi:
            turn = math.copysign(4.0 * math.pi, turn)
        block, _ = arc(np.zeros(3), rng.uniform(0.0, 6.0), turn, radius, rise, feed)
    return Case([PathMode("", 1, "exact-path"), block], random_machine(rng))


def tangent(rng: Random) -> Case:
    """Return lines and arcs that join with one direction."""
    feed, here, heading = feed_of(rng), np.zeros(3), rng.uniform(0.0, 6.0)
    blocks: list[Block] = [PathMode("", 1, "exact-path")]
    for k in range(int(rng.integers(3, 8))):
        if k % 2 == 0:
            step = 10 ** rng.uniform(0.0, 1.3) * np.array([math.cos(heading), math.sin(heading), 0])
            blocks.append(Polyline("", 1, (here + step)[None], np.array([feed]), np.array([1])))
            here = here + step
        else:
            turn = float(rng.choice((-1.0, 1.0))) * rng.uniform(0.3, 3.0)
            bow, heading = arc(here, heading, turn, 10 ** rng.uniform(0.0, 1.3), 0.0, feed)
            blocks.append(bow)
            here = bow.end
    return Case(blocks, random_machine(rng))


def smooth_curve(rng: Random, count: int, chord: float) -> Floats:
    """Return points of a smooth curve in the plane, ``chord`` apart, whose curvature changes."""
    u = np.linspace(0.0, 1.0, count)
    bend = sum(
        rng.normal(0.0, 1.0) * np.sin(2.0 * math.pi * (k * u + rng.random())) for k in range(4)
    )
    largest = 10 ** rng.uniform(-1.3, 0.0)
    heading = np.cumsum(bend / np.abs(bend).max() * largest * chord)
    steps = chord * np.stack((np.cos(heading), np.sin(heading), np.zeros(count)), axis=1)
    return np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))


def short_points(rng: Random, tolerance: float) -> Floats:
    """Return points whose chords leave a smooth curve by a small part of the tolerance."""
    points = smooth_curve(rng, int(rng.integers(100, 400)), 10 ** rng.uniform(-1.0, -0.3))
    return np.asarray(points.round(int(rng.choice((4, 6)))))


def short(rng: Random) -> Case:
    """Return a chain of short moves under G64 P0.01 or P0.005."""
    tolerance = float(rng.choice((0.01, 0.005)))
    block = moves(short_points(rng, tolerance), feed_of(rng))
    return Case([PathMode("", 1, "blend", tolerance), block], random_machine(rng))


def finishing(rng: Random) -> Case:
    """Return a row of a finishing pass over a surface, which moves three axes."""
    count, chord = int(rng.integers(150, 400)), 10 ** rng.uniform(-1.0, -0.4)
    along = chord * np.arange(count)
    wave = 10 ** rng.uniform(0.5, 1.3)
    height = 0.3 * wave * np.sin(along / wave + rng.uniform(0.0, 6.0))
    across = 0.5 * wave * np.sin(along / (2.0 * wave) + rng.uniform(0.0, 6.0))
    points = np.stack((along, across, height), axis=1).round(4)
    return Case(
        [PathMode("", 1, "blend", 0.01), moves(points - points[0], feed_of(rng))],
        random_machine(rng),
    )


def mixed(rng: Random) -> Case:
    """Return a chain whose feed changes, on a machine with unequal axes."""
    points = short_points(rng, 0.01)
    n = len(points) - 1
    each = int(rng.choice((1, 5, 40)))
    levels = 10 ** rng.uniform(0.8, 2.4, n // each + 1)
    block = moves(points, np.repeat(levels, each)[:n])
    machine = random_machine(rng, str(rng.choice(("axis", "both"))))
    return Case([PathMode("", 1, "blend", 0.01), block], machine)


def corners(rng: Random) -> Case:
    """Return straight moves with sharp corners under a tolerance."""
    points = np.cumsum(rng.normal(0.0, 10.0, (int(rng.integers(3, 10)), 3)), axis=0)
    points[:, 2] = 0.0
    tolerance = 10 ** rng.uniform(-2.3, -0.5)
    block = moves(points - points[0], feed_of(rng))
    return Case([PathMode("", 1, "blend", tolerance), block], random_machine(rng))


FAMILIES: dict[str, tuple[Callable[[Random], Case], int]] = {
    "exact NURBS": (nurbs, 6),
    "lines, arcs, helices": (simple, 3),
    "tangent chains": (tangent, 3),
    "short segments": (short, 5),
    "finishing in three axes": (finishing, 2),
    "mixed feeds, unequal axes": (mixed, 3),
    "corners": (corners, 3),
}
"""Families of cases, each with its share of the cases."""


def cases(seed: int, count: int, chosen: list[str] | None = None) -> list[tuple[str, int, Case]]:
    """Return about ``count`` cases of a seed: family, number, case."""
    names = [name for name in FAMILIES if not chosen or name in chosen]
    total = sum(FAMILIES[name][1] for name in names)
    found = []
    for name in names:
        make, part = FAMILIES[name]
        for k in range(max(round(count * part / total), 1)):
            rng = np.random.default_rng([seed, list(FAMILIES).index(name), k])
            found.append((name, k, make(rng)))
    return found


def summary(ratios: list[float]) -> str:
    """Return median, largest value and share above SLOW."""
    if not ratios:
        return "-"
    found = np.array(ratios)
    return f"{np.median(found):8.4f} {found.max():8.4f} {np.mean(found > SLOW):9.1%}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Times of plans beside the fastest ones.")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--family", nargs="*", choices=FAMILIES)
    parser.add_argument("--list", action="store_true", help="print each case")
    arguments = parser.parse_args()
    found: dict[str, list[float]] = {}
    unsolved: dict[str, int] = {}
    for name, number, case in cases(arguments.seed, arguments.count, arguments.family):
        times: Times = times_of(case.blocks, AXES, case.machine)
        if arguments.list:
            print(
                f"{name:26} {number:4d}  T2 {times.t2:8.4f}  T3 {times.t3:8.4f}  "
                f"ours {times.ours:8.4f}  {times.ours / times.t3:7.4f}"
                f"{'' if times.solved else '  T3 not solved'}",
                flush=True,
            )
        found.setdefault(name, [])
        unsolved[name] = unsolved.get(name, 0) + (not times.solved)
        if times.solved:
            found[name].append(times.ours / times.t3)
    print(f"\nours / T3, seed {arguments.seed}")
    print(f"{'family':26} {'cases':>5} {'median':>8} {'worst':>8} {'over 1.05':>9} {'unsolved':>8}")
    for name, ratios in found.items():
        print(f"{name:26} {len(ratios):5d} {summary(ratios)} {unsolved[name]:8d}", flush=True)
    smooth = [ratio for name, ratios in found.items() if name != "corners" for ratio in ratios]
    print(f"{'all but corners':26} {len(smooth):5d} {summary(smooth)}")


if __name__ == "__main__":
    main()
