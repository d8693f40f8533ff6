"""Samples per second of a cubic NURBS on one core: of a plan, and by the paper's interpolator.

The paper's interpolator finds the speed as well.

make bench
python -m benchmarks.sampled
"""

from __future__ import annotations

from collections.abc import Callable
from time import process_time

import numpy as np
from numpy.typing import NDArray

from cnc.machine.load import load_machine
from cnc.model.blocks import NurbsFeed
from cnc.papers.nurbs_lookahead import interpolate
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses.sampled import Sampled

FEED = 100.0
"""mm/s, of the plan."""
PERIOD = 0.001
REPEAT = 5
WANTED = 0.5
"""Microseconds a sample; the paper needed 5 to 57."""


def curve() -> tuple[NDArray[np.float64], PathChunk]:
    """A cubic with 400 control points about 10 mm apart, in three axes, and its first point."""
    rng = np.random.default_rng(2)
    points = np.cumsum(rng.normal(0.0, 10.0 / 3.0**0.5, (400, 3)), axis=0)
    knots = np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, 398), np.ones(3)))
    block = NurbsFeed("", 1, 3, knots, points, rng.uniform(0.5, 2.0, 400), FEED)
    (path,) = (
        item
        for item in build([block], axes=("x", "y", "z"), start=points[0])
        if isinstance(item, PathChunk)
    )
    return points[0], path


def planned(start: NDArray[np.float64], path: PathChunk) -> int:
    """Samples of the curve at a steady speed."""
    ends = np.concatenate(([0.0], np.cumsum(path.length)))
    length, still, steady = float(ends[-1]), np.zeros(2), np.full(2, FEED)
    plan = PlanChunk(
        path,
        ends,
        0.0,
        0.0,
        np.array([0.0, length / FEED]),
        np.array([0.0, length]),
        steady,
        still,
        np.zeros(1),
    )
    return sum(len(chunk.s) for chunk in Sampled(PERIOD, start).samples(plan))


def main() -> None:
    """Print a table."""
    start, path = curve()
    limits = load_machine("paper-nurbs").path
    cases: list[tuple[str, Callable[[], int]]] = [
        ("of a plan", lambda: planned(start, path)),
        (
            "the paper's, adaptive step alone",
            lambda: len(interpolate(path, limits, look_ahead=False).u),
        ),
        ("the paper's, with look-ahead", lambda: len(interpolate(path, limits).u)),
    ]
    print(
        f"{'samples of a cubic NURBS':34} {'samples':>8} {'us each':>8} {'wanted':>7} "
        f"{'samples/s':>10}"
    )
    for name, work in cases:
        count, least = work(), np.inf
        for _ in range(REPEAT):
            began = process_time()
            work()
            least = min(least, process_time() - began)
        print(
            f"{name:34} {count:8d} {1e6 * least / count:8.3f} {WANTED:7.1f} {count / least:10.0f}"
        )


if __name__ == "__main__":
    main()
