"""Grid moves with time stamps per second on one core, by kind of path and by algorithm.

The speed of a plain loop and of a memory copy is printed beside them.

make bench
python -m benchmarks.interpolators [--steps N] [--flat N]

A step is one step of one axis: a row in which three axes step is three. Plans are made beforehand.
The time is that from the plan to the chunks of pulses.
"""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.machine.load import load_machine
from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline
from cnc.model.choices import Algorithm
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.session.kernel_cache import ensure_compiled

Floats = NDArray[np.float64]
FEED = 100.0
"""mm/s."""
STEPS = 10_000_000
"""About as many in each measurement."""
REPEAT = 3
RADIUS = 10.0
CHORD = 0.5


def polyline(points: Floats) -> Polyline:
    """Straight moves through the points (k, axes)."""
    return Polyline(
        "", 1, points, np.full(len(points), FEED), np.arange(1, len(points) + 1, dtype=np.int32)
    )


def long_lines(axes: int) -> tuple[Floats, list[Block]]:
    """Moves across the whole table, in all directions."""
    points = np.random.default_rng(1).uniform(0.0, 300.0, (40, axes))
    return points[0], [polyline(points[1:])]


def chords(axes: int) -> tuple[Floats, list[Block]]:
    """Chords of 0.5 mm along a smooth winding curve."""
    angle = np.arange(6000) * CHORD / 30.0
    points = np.stack(
        (60.0 * np.sin(0.5 * angle), 60.0 * np.cos(0.37 * angle), 10.0 * np.sin(0.9 * angle)),
        axis=1,
    )[:, :axes]
    return points[0], [polyline(points[1:].round(4))]


def circles(axes: int) -> tuple[Floats, list[Block]]:
    """Full circles of 10 mm; helices with three axes."""
    start = np.array([RADIUS, 0.0, 0.0])[:axes]
    blocks: list[Block] = []
    for turn in range(1, 61):
        end = start + np.array([0.0, 0.0, 1.0 * turn])[:axes]
        blocks.append(ArcFeed("", turn, "XY", (0.0, 0.0), end, RADIUS, 1.0, FEED))
    return start, blocks


def splines(axes: int) -> tuple[Floats, list[Block]]:
    """One cubic with 400 control points about 10 mm apart."""
    rng = np.random.default_rng(2)
    points = np.cumsum(rng.normal(0.0, 10.0 / axes**0.5, (400, axes)), axis=0)
    knots = np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, 398), np.ones(3)))
    return points[0], [NurbsFeed("", 1, 3, knots, points, rng.uniform(0.5, 2.0, 400), FEED)]


CASES: Sequence[
    tuple[
        str, Callable[[int], tuple[Floats, list[Block]]], int, tuple[Algorithm | None, ...], float
    ]
] = (
    ("long lines, 3 axes", long_lines, 3, (None, "crossings"), 40e6),
    ("chords of 0.5 mm, 3 axes", chords, 3, (None, "crossings"), 30e6),
    (
        "circles R10",
        circles,
        2,
        (None, "enclosing-line", "kiritsis", "crossings", "point-by-point"),
        30e6,
    ),
    ("helices R10", circles, 3, (None, "enclosing-line", "crossings"), 30e6),
    ("cubic NURBS, 2 axes", splines, 2, (None, "kiritsis", "crossings", "point-by-point"), 15e6),
    ("cubic NURBS, 3 axes", splines, 3, (None, "crossings"), 15e6),
)
"""Name, path, axes, algorithms to be timed (None: the choice by piece), and the goal of the first
in steps per second.
"""


def plans_of(start: Floats, blocks: list[Block]) -> list[PlanChunk]:
    """Return the plan of the default machine for a path."""
    machine = load_machine()
    names = machine.axis_names[: len(start)]
    machine = machine.model_copy(
        update={"axes": {name: axis for name, axis in machine.axes.items() if name in names}}
    )
    path = build(blocks, axes=names, start=start, tolerance=0.0)
    return [item for item in LookAhead(machine).plan(path) if isinstance(item, PlanChunk)]


def scale_of(axes: int) -> Floats:
    """Steps per mm of the default machine."""
    return load_machine().steps_per_mm[:axes]


def later(chunks: list[PlanChunk], times: int) -> Iterator[PlanChunk]:
    """Yield the same motion again and again, each time later.

    Paths are closed, or their ends count as one point.
    """
    duration = chunks[-1].t0 + chunks[-1].duration
    for k in range(times):
        for c in chunks:
            phases = (c.phase_t, c.phase_s, c.phase_v, c.phase_a, c.phase_j)
            yield PlanChunk(c.path, c.piece_s, c.t0 + k * duration, c.s0, *phases)


def timed(
    chunks: list[PlanChunk], start: Floats, algorithm: Algorithm | None, steps_wanted: int
) -> tuple[float, int, int, float]:
    """Return seconds, steps, rows and largest error of about so many steps."""
    scale = scale_of(len(start))
    once = sum(
        int(np.count_nonzero(rows.step))
        for c in chunks
        for rows in ReferencePulse(scale, start, algorithm=algorithm).pulses(c)
    )
    best = np.inf
    for _ in range(REPEAT):
        seconds, steps, rows, error = 0.0, 0, 0, 0.0
        for _ in range(max(1, steps_wanted // once)):
            pulses = ReferencePulse(scale, start, 5000.0, algorithm=algorithm)
            for chunk in chunks:
                began = process_time()
                made = list(pulses.pulses(chunk))
                seconds += process_time() - began
                steps += sum(int(np.count_nonzero(each.step)) for each in made)
                rows += sum(len(each.step) for each in made)
            error = pulses.error_blu
        best = min(best, seconds)
    return best, steps, rows, error


@njit
def bresenham(count: int, y_end: int, z_end: int, x_end: int, step: NDArray[np.int8]) -> int:
    """Run the plain loop for a line in three axes, X the longest, and return the number of steps.

    Only the steps of the axes are written, into step (rows, 3), again and again.
    """
    f = x_end >> 1
    g = x_end >> 1
    room = len(step)
    steps = 0
    row = 0
    for _ in range(count):
        f -= y_end
        g -= z_end
        y = 0
        z = 0
        if f < 0:
            f += x_end
            y = 1
        if g < 0:
            g += x_end
            z = 1
        step[row, 0] = 1
        step[row, 1] = y
        step[row, 2] = z
        steps += 1 + y + z
        row += 1
        if row == room:
            row = 0
    return steps


def machine_itself() -> None:
    """Memory copy and Bresenham's loop."""
    rows = 65536
    step = np.empty((rows, 3), np.int8)
    bresenham(10, 7, 3, 10, step)
    seconds = []
    for _ in range(REPEAT):
        began = process_time()
        steps = bresenham(20_000_000, 700_001, 300_007, 1_000_000, step)
        seconds.append(process_time() - began)
    print(
        f"{'plain Bresenham loop, 3 axes, no times':40} "
        f"{steps / min(seconds) / 1e6:8.1f} million steps/s"
    )
    source, target = np.zeros(1 << 27, np.int8), np.ones(1 << 27, np.int8)
    seconds = []
    for _ in range(REPEAT):
        began = process_time()
        np.copyto(target, source)
        seconds.append(process_time() - began)
    rate = len(source) / min(seconds)
    print(
        f"{'memory copy':40} {rate / 1e9:8.2f} GB/s = "
        f"{rate / 15e6:.0f} million rows/s of 15 bytes\n"
    )


def flat(steps_wanted: int) -> None:
    """Print the largest memory of the process while so many steps are made and discarded."""
    start, blocks = circles(2)
    chunks = plans_of(start, blocks)
    pulses = ReferencePulse(scale_of(2), start, 5000.0)
    shown, steps, began = 0, 0, perf_counter()
    for chunk in later(chunks, sys.maxsize):
        for rows in pulses.pulses(chunk):
            steps += int(np.count_nonzero(rows.step))
        if steps >= shown:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(f"{steps:14d} steps {perf_counter() - began:8.1f} s {memory:8.1f} MB")
            shown += steps_wanted // 5
        if steps >= steps_wanted:
            break


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description="Speed of the reference-pulse interpolators, after compilation."
    )
    parser.add_argument(
        "--steps", type=int, default=STEPS, help="about so many in each measurement"
    )
    parser.add_argument(
        "--flat", type=int, default=0, help="only watch the memory over so many steps"
    )
    parser.add_argument("--only", default="", help="only the paths whose name contains this")
    arguments = parser.parse_args()
    ensure_compiled(None)
    if arguments.flat:
        flat(arguments.flat)
        return
    machine_itself()
    print(
        f"{'path':26} {'algorithm':16} {'rows':>10} {'steps':>10} {'error BLU':>10} "
        f"{'ns/row':>8} {'M steps/s':>10} {'wanted':>7}"
    )
    for name, path, axes, algorithms, wanted in CASES:
        if arguments.only not in name:
            continue
        start, blocks = path(axes)
        chunks = plans_of(start, blocks)
        for number, algorithm in enumerate(algorithms):
            seconds, steps, rows, error = timed(chunks, start, algorithm, arguments.steps)
            goal = f"{wanted / 1e6:7.0f}" if number == 0 else ""
            speed = f"{seconds / rows * 1e9:8.1f} {steps / seconds / 1e6:10.1f}"
            print(
                f"{name:26} {algorithm or 'by piece':16} {rows:10d} {steps:10d} "
                f"{error:10.6f} {speed} {goal}",
                flush=True,
            )


if __name__ == "__main__":
    main()
