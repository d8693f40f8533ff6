"""All algorithms for grid moves side by side: steps, distance from the path, and time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import process_time

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline
from cnc.model.choices import Algorithm
from cnc.papers.page import Cell, Section, Table
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ALGORITHMS, ReferencePulse

AXES = ("x", "y", "z")
STEPS_PER_MM = 1000.0
SPEED = 10.0
"""mm/s."""
REPEATS = 5
"""Times are the least of so many."""


def section() -> Section:
    """One table: a row a path and algorithm."""
    rows = [
        row for name, start, block in _paths() for row in _compared(name, np.array(start), block)
    ]
    return Section(
        "All algorithms side by side",
        "The same paths at a constant 10 mm/s and 1000 steps/mm by every algorithm that takes "
        "them (`--algorithm` of cncrun; if none is "
        "named, half steps on lines and arcs, enclosing lines on other curves). "
        "A row is a grid move of one axis or several. *Distance* is the largest, over axes and "
        "rows, of a grid point from the path where the row is due; the time of a row includes its "
        "time stamp.",
        (
            Table(
                "Steps, distance and time",
                (
                    "path",
                    "algorithm",
                    "rows",
                    "steps",
                    "distance, BLU",
                    "ns a row",
                    "million steps/s",
                ),
                rows,
            ),
        ),
    )


def _paths() -> Iterator[tuple[str, Sequence[float], Block]]:
    """Name, start and block."""
    points = np.array(
        [[0.0, 0.0], [30.0, 5.0], [10.0, 20.0], [-10.0, 20.0], [0.0, 5.0], [20.0, 0.0]]
    )
    knots = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 3.0])
    weights = np.array([1.0, 2.0, 1.0, 0.5, 1.0, 1.0])
    end = np.array([[80.0, 50.0, 30.0]])
    yield (
        "line in space",
        (0.0, 0.0, 0.0),
        Polyline("", 1, end, np.array([SPEED]), np.array([1], np.int32)),
    )
    yield (
        "circle of 10 mm",
        (10.0, 0.0),
        ArcFeed("", 1, "XY", (0.0, 0.0), np.array([10.0, 0.0]), 10.0, 1.0, SPEED),
    )
    yield (
        "helix of 10 mm",
        (10.0, 0.0, 0.0),
        ArcFeed("", 1, "XY", (0.0, 0.0), np.array([10.0, 0.0, 5.0]), 10.0, 1.0, SPEED),
    )
    yield (
        "cubic NURBS in a plane",
        points[0].tolist(),
        NurbsFeed("", 1, 3, knots, points, weights, SPEED),
    )
    space = np.column_stack((points, np.array([0.0, 8.0, -5.0, 10.0, 3.0, 6.0])))
    yield (
        "cubic NURBS in space",
        space[0].tolist(),
        NurbsFeed("", 1, 3, knots, space, weights, SPEED),
    )


def _compared(name: str, start: NDArray[np.float64], block: Block) -> Iterator[list[Cell]]:
    (path,) = (
        item
        for item in build([block], axes=AXES[: len(start)], start=start)
        if isinstance(item, PathChunk)
    )
    piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
    length = float(piece_s[-1])
    ends, steady = np.array([0.0, length]), np.full(2, SPEED)
    plan = PlanChunk(path, piece_s, 0.0, 0.0, ends / SPEED, ends, steady, np.zeros(2), np.zeros(1))
    for algorithm in (
        algorithm
        for algorithm in ALGORITHMS
        if algorithm != "half-step" or not isinstance(block, NurbsFeed)
    ):
        step, error, seconds = min(
            (_rows(plan, start, algorithm) for _ in range(REPEATS)), key=lambda run: run[2]
        )
        steps = int(np.count_nonzero(step))
        yield [
            name,
            algorithm,
            len(step),
            steps,
            error,
            seconds / len(step) * 1e9,
            steps / seconds / 1e6,
        ]


def _rows(
    plan: PlanChunk, start: NDArray[np.float64], algorithm: Algorithm
) -> tuple[NDArray[np.int8], float, float]:
    """Steps, largest distance, seconds."""
    pulses = ReferencePulse(np.full(len(start), STEPS_PER_MM), start, algorithm=algorithm)
    began = process_time()
    chunks = [*pulses.pulses(plan), *pulses.settle()]
    seconds = process_time() - began
    return np.concatenate([chunk.step for chunk in chunks]), pulses.error_blu, seconds
