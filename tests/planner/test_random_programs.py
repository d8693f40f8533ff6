"""Random programs of all kinds of moves on random machines, under an operator.

Limits of the axes differ by up to three decades. Feeds change at every line, by up to a factor of
100, from 1 mm/min to the largest feed. Tolerances are 0.001 to 0.5 mm. Each motion has to be legal
and has to end at the end of its path.
"""

import math

import numpy as np
import pytest

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Block, Dwell, PathMode
from tests.support.planner.motions import AXES, arc, lines, nurbs
from tests.support.planner.operated import assert_legal_under_operator
from tests.support.soak import share

TOGETHER = share(20, 1)
"""Programs in one test."""
SLOWEST = 1.0 / 60.0
"""mm/s: 1 mm/min."""

STEP_OF_FEED = 100.0


def random_machine(rng: np.random.Generator) -> Machine:
    """Return a machine whose axes have limits over three decades, with any kinds of limits."""
    kind = str(rng.choice(("path", "axes", "both")))
    accel = 10 ** rng.uniform(1.5, 4.5, 3)
    seconds = 10 ** rng.uniform(-2.5, -0.5, 3)
    if rng.random() < 0.5:
        accel[:], seconds[:] = accel[0], seconds[0]
    velocity = 10 ** rng.uniform(0.0, 3.0, 3)
    axes = {
        letter: Axis(
            steps_per_mm=100.0,
            max_velocity=velocity[i],
            max_acceleration=accel[i] if kind != "path" else None,
            max_jerk=accel[i] / seconds[i] if kind != "path" else None,
        )
        for i, letter in enumerate(AXES)
    }
    along, ramp = 10 ** rng.uniform(1.5, 4.5), 10 ** rng.uniform(-2.5, -0.5)
    path = PathLimits(
        max_feed=velocity.max(),
        max_tangential_acceleration=along if kind != "axes" else None,
        max_normal_acceleration=along * rng.uniform(0.5, 3.0) if kind != "axes" else None,
        max_jerk=along / ramp if kind != "axes" else None,
        chord_error=10 ** rng.uniform(-4.0, -2.0),
        period=float(rng.choice((1e-3, 1e-4))),
    )
    return Machine(axes=axes, path=path)


def random_feeds(rng: np.random.Generator, count: int, most: float) -> np.ndarray:
    """Return feeds that differ by up to STEP_OF_FEED from one to the next."""
    step = rng.uniform(-1.0, 1.0, count) * math.log(STEP_OF_FEED) * rng.choice((0.1, 1.0))
    low, high = math.log(SLOWEST), math.log(most)
    levels = rng.uniform(low, high) + np.cumsum(step)
    folded = np.abs((levels - low) % (2.0 * (high - low)) - (high - low))
    return np.exp(high - folded)


def random_program(rng: np.random.Generator, machine: Machine) -> list[Block]:
    """Return blocks whose moves take at most about a second each at their feed."""
    blocks: list[Block] = []
    here, line = np.zeros(3), 1
    heading = rng.uniform(0.0, 2.0 * math.pi)
    for _ in range(int(rng.integers(1, 5))):
        if rng.random() < 0.7:
            tolerance = 10 ** rng.uniform(-3.0, -0.3)
            blocks.append(PathMode("t.nc", line, "blend", tolerance))
        elif rng.random() < 0.5:
            blocks.append(PathMode("t.nc", line, "exact-path"))
        kind = int(rng.integers(6))
        if kind <= 2:
            count = int(rng.integers(3, 60))
            feeds = random_feeds(rng, count, machine.path.max_feed)
            length = np.clip(feeds * 10 ** rng.uniform(-3.0, -0.5), 1e-3, 10.0)
            if rng.random() < 0.5:
                length[:] = np.median(length)
            turns = heading + np.cumsum(rng.normal(0.0, 10 ** rng.uniform(-3.0, 0.3), count))
            rise = rng.normal(0.0, 0.3, count) * rng.choice((0.0, 1.0))
            steps = length[:, None] * np.stack((np.cos(turns), np.sin(turns), rise), axis=1)
            points = (here + np.cumsum(steps, axis=0)).round(4)
            apart = np.linalg.norm(np.diff(points, axis=0, prepend=here[None]), axis=1) > 0.0
            if apart.any():
                blocks.append(lines(points[apart], feeds[apart], line))
                here, heading = points[apart][-1], float(turns[-1])
            line += count
            continue
        feed = float(random_feeds(rng, 1, machine.path.max_feed)[0])
        size = float(np.clip(feed * 10 ** rng.uniform(-1.5, 0.0), 0.01, 20.0))
        if kind == 3:
            side = float(rng.choice((-1.0, 1.0)))
            normal = side * np.array([-math.sin(heading), math.cos(heading)])
            turns = side * rng.uniform(0.02, 0.99)
            rise = rng.normal(0.0, size) * rng.choice((0.0, 1.0))
            bow = arc(here, here[:2] + size * normal, turns, feed, rise, line)
            blocks.append(bow)
            here, heading = bow.end, heading + 2.0 * math.pi * turns
        elif kind == 4:
            degree = int(rng.choice((2, 3, 5)))
            steps = rng.normal(0.0, size, (degree + int(rng.integers(1, 8)), 3))
            steps[:, 2] *= rng.choice((0.0, 1.0))
            points = here + np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
            blocks.append(nurbs(points, 10 ** rng.uniform(-0.5, 0.5, len(points)), degree, feed))
            here = points[-1]
        elif rng.random() < 0.8:
            here = here + rng.normal(0.0, size, 3)
            blocks.append(lines(here, math.nan, line))
        else:
            blocks.append(Dwell("t.nc", line, rng.uniform(0.0, 0.02)))
        line += 1
    return blocks


def run(seed: int) -> None:
    """Plan the motion of a seed, half of the time under an operator."""
    rng = np.random.default_rng([seed, 20])
    machine = random_machine(rng)
    blocks = random_program(rng, machine)
    assert_legal_under_operator(rng, machine, blocks, rng.random() < 0.5, 1.0, seed)


@pytest.mark.parametrize("first", range(0, share(5000, TOGETHER), TOGETHER))
def test_random_programs_under_an_operator_are_legal(first):
    for seed in range(first, first + TOGETHER):
        run(seed)
