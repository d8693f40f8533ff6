"""Random chains of short moves on random machines, whose feed changes at every line.

The operator holds, resumes and overrides at random moments. Each motion has to be legal and has to
end at the end of its path.
"""

import math

import numpy as np
import pytest

from cnc.model.blocks import Block, PathMode
from tests.support.planner.motions import lines, random_blocks
from tests.support.planner.operated import assert_legal_under_operator
from tests.support.planner.random_jobs import random_machine
from tests.support.soak import share

TOGETHER = share(25, 3)
"""Seeds in one test."""
FOUND = (302,)
"""Seeds of motions that were illegal. In 302 a hold ended the acceleration beyond a place that the
motion has to cross at constant speed.
"""


def chain(rng: np.random.Generator, size: float) -> list[Block]:
    """Return short moves along a bent line, with feeds that differ by up to a factor of 100."""
    count = int(rng.integers(5, 80))
    chord = size * 10 ** rng.uniform(-2.5, -0.7)
    heading = np.cumsum(rng.normal(0.0, 10 ** rng.uniform(-3.0, 0.0), count))
    if rng.random() < 0.3:
        heading[int(rng.integers(count)) :] += rng.uniform(-math.pi, math.pi)
    rise = rng.normal(0.0, 0.3, count) * (rng.random() < 0.5)
    steps = np.stack((np.cos(heading), np.sin(heading), rise), axis=1)
    steps *= chord * rng.choice((1.0, rng.uniform(0.1, 1.0)), (count, 1))
    fastest = size * 10 ** rng.uniform(-0.5, 2.0)
    feeds = fastest * 10 ** -rng.uniform(0.0, 2.0, count)
    feeds = np.repeat(feeds, int(rng.choice((1, 1, 3, 20))))[:count]
    moves = lines(np.cumsum(steps, axis=0).round(6), feeds)
    tolerance = size * 10 ** rng.uniform(-4.0, -1.0)
    mode = PathMode("t.nc", 1, *(("blend", tolerance) if rng.random() < 0.8 else ("exact-path",)))
    return [mode, moves]


def run(seed: int) -> None:
    """Plan the motion of a seed under its operator."""
    rng = np.random.default_rng(seed)
    mill, size = random_machine(rng, float(rng.choice((1e-3, 1e-4))))
    blocks = chain(rng, size) if rng.random() < 0.7 else random_blocks(rng, 3)
    assert_legal_under_operator(rng, mill, blocks, rng.random() < 0.6, 0.5, seed)


@pytest.mark.parametrize("first", range(0, share(5000, TOGETHER), TOGETHER))
def test_random_chains_under_an_operator_are_legal(first):
    for seed in range(first, first + TOGETHER):
        run(seed)


@pytest.mark.soak
@pytest.mark.parametrize("seed", FOUND)
def test_chains_that_were_illegal_once(seed):
    run(seed)
