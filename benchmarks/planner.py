"""Speed, legality and cost of plans.

    make bench
    python -m benchmarks.planner [--whole] [--moves N...]

The first table has one motion in each line: its best known time, the wanted one and ours. It shows
the limit that its traces at 1 ms and at 0.1 ms use most, and the share of it that differences of
positions use. The plans for the two periods differ, since the chord error depends on the period.
The last columns are the times of two other planners (``benchmarks/baselines.py``).

The second table has the CPU time of planning a finishing pass of short moves, the fitting of its
chains included. ``--whole`` checks a program of a million moves, from text to pulses, and measures
its memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks import finishing
from benchmarks.baselines import Bounds, capped, trapezoid
from cnc.api import check
from cnc.machine.models import Machine
from cnc.model.blocks import Block, PathMode, Polyline
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.kernel_cache import ensure_compiled
from tests.support.planner.figures import Case, cases, with_period
from tests.support.planner.legality import examine

PERIODS = (1e-3, 1e-4)
MOVES = (10_000, 100_000, 1_000_000)
WHOLE = 1_000_000
RUN = 4096
"""Moves in one block, as the reader makes them."""


def bounds_of(machine: Machine, feed: float) -> Bounds:
    """Return one bound of each kind, for planners without limits of axes."""
    path, axis = machine.path, next(iter(machine.axes.values()))
    accel = path.max_tangential_acceleration or axis.max_acceleration or 0.0
    return Bounds(
        feed, accel, path.max_normal_acceleration or accel, path.max_jerk or axis.max_jerk or 0.0
    )


def row(case: Case, folder: Path) -> str:
    """Return a line of the first table."""
    found = [examine(case.program, with_period(case.machine, period), folder) for period in PERIODS]
    ours = found[0].duration
    feed = float(case.program.split("F", 1)[1].split()[0]) / 60.0
    bounds = bounds_of(case.machine, feed)
    used = "  ".join(f"{name:>23} {ratio:7.4f}" for name, ratio in (each.largest for each in found))
    verdict = ", ".join(
        (["slower than wanted"] if round(ours, 4) > round(case.wanted, 4) else [])
        + [wrong for each in found for wrong in each.wrong]
    )
    others = f"{capped(case.points, bounds):9.3f} {trapezoid(case.points, bounds):9.3f}"
    times = f"{case.best:8.4f} {case.wanted:8.4f} {ours:8.4f} {ours / case.best:6.3f}"
    return f"{case.name:30} {times}  {used} {others}  {verdict or 'ok'}"


def blocks_of(moves: int) -> Iterator[Block]:
    """Yield the blocks of a finishing pass."""
    points = finishing.points(moves)
    yield PathMode("", 1, "blend", finishing.TOLERANCE)
    for first in range(1, len(points), RUN):
        some = points[first : first + RUN]
        yield Polyline(
            "",
            first,
            some,
            np.full(len(some), finishing.FEED),
            np.arange(first, first + len(some), dtype=np.int32),
        )


def planning(moves: int, machine: Machine) -> tuple[float, float]:
    """Return the CPU seconds of fitting and planning, and the seconds of motion."""
    blocks = list(blocks_of(moves))
    start = finishing.points(1)[0]
    began, last = process_time(), 0.0
    for item in LookAhead(machine).plan(build(blocks, axes=finishing.AXES, start=start)):
        if isinstance(item, PlanChunk):
            last = item.t0 + item.duration
    return process_time() - began, last


def whole(moves: int) -> dict[str, float]:
    """Check a program of so many moves in a process of its own.

    Returns:
        CPU seconds after start-up, the largest memory in MB, and figures of the motion.
    """
    command = [sys.executable, "-m", "benchmarks.planner", "--check", str(moves)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    measured: dict[str, float] = json.loads(shown)
    return measured


def check_here(moves: int) -> None:
    """Check a short program to load everything, then measure the long one."""
    with tempfile.TemporaryDirectory(prefix="cnc-") as folder:
        program = Path(folder) / "finishing.nc"
        for length in (2000, moves):
            finishing.write(program, length)
            began = process_time()
            report = check(program, finishing.machine())
            report.raise_if_faulty()
            seconds = process_time() - began
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1e6 if sys.platform == "darwin" else 1e3
    )
    print(
        json.dumps(
            {
                "seconds": seconds,
                "megabytes": memory,
                "duration": report.duration_s,
                "steps": sum(report.steps.values()),
            }
        )
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Times, legality and cost of plans.")
    parser.add_argument(
        "--whole", action="store_true", help="check a program of a million moves, too"
    )
    parser.add_argument(
        "--moves",
        type=int,
        nargs="*",
        default=MOVES,
        help="lengths of the finishing pass whose planning is measured",
    )
    parser.add_argument(
        "--check", type=int, help="only check a program of so many moves, and print what it took"
    )
    arguments = parser.parse_args()
    if arguments.check:
        check_here(arguments.check)
        return
    ensure_compiled(None)
    print(
        f"{'motion, times in s':30} {'best':>8} {'wanted':>8} {'ours':>8} {'/best':>6}  "
        f"{'most used at 1 ms':>31}  "
        f"{'most used at 0.1 ms':>31} {'capped':>9} {'trapezoid':>9}"
    )
    with tempfile.TemporaryDirectory(prefix="cnc-") as folder:
        for case in cases():
            print(row(case, Path(folder)), flush=True)
    planning(2000, finishing.machine())
    print(
        f"\n{'planning, fit included':24} {'moves':>9} {'CPU s':>8} {'us/move':>8} "
        f"{'moves/s':>9} {'motion s':>9}   wanted: 200 000 moves/s"
    )
    machines = {
        "limits along the path": finishing.machine(),
        "limits of each axis": finishing.machine(tangential=False, per_axis=True),
    }
    for name, machine in machines.items():
        for moves in arguments.moves:
            seconds, motion = planning(moves, machine)
            print(
                f"{name:24} {moves:9d} {seconds:8.3f} {seconds / moves * 1e6:8.2f} "
                f"{moves / seconds:9.0f} {motion:9.2f}",
                flush=True,
            )
    if arguments.whole:
        took = whole(WHOLE)
        print(
            f"\ncheck of {WHOLE} moves, text to pulses, after start-up: "
            f"{took['duration']:.0f} s of motion, {took['steps']:.0f} steps"
        )
        print(
            f"CPU {took['seconds']:.1f} s (wanted: 15), "
            f"memory {took['megabytes']:.0f} MB (wanted: 500)"
        )


if __name__ == "__main__":
    main()
