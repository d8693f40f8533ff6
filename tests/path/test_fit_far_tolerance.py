"""Chains whose moves are far shorter than the tolerance, with rounded coordinates."""

import numpy as np
import pytest

from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.path.kernels.curve import SPAN, U1, curve_eval
from tests.support.planner.motions import AXES, lines
from tests.support.soak import share

PLACES = np.linspace(0.0, 1.0, 40)


def chain(rng):
    """Return the vertices of a slightly bent chain, and its tolerance."""
    count, step = int(rng.integers(5, 120)), 10 ** rng.uniform(-3.3, -2.0)
    tolerance = count * step / rng.uniform(0.4, 4.0)
    heading = rng.uniform(0.0, 6.3) + rng.uniform(-2e-3, 2e-3) * np.arange(count)
    moves = step * np.stack((np.cos(heading), np.sin(heading), np.zeros(count)), axis=1)
    return np.round(np.cumsum(moves, axis=0), 4), tolerance


@pytest.mark.parametrize("seed", range(share(1000, 60)))
def test_no_piece_goes_back(seed):
    """A piece that turns round has a cusp, where no motion is possible."""
    points, tolerance = chain(np.random.default_rng([seed, 91]))
    blocks = [PathMode("t.nc", 1, "blend", tolerance), lines(points, 10.0)]
    place = np.empty((4, 3))
    for path in build(blocks, axes=AXES, start=np.zeros(3)):
        for k in np.flatnonzero(path.kind == SPAN).tolist():
            positions = []
            for part in PLACES:
                at = int(path.at[k])
                curve_eval(SPAN, path.data, at, part * float(path.data[at + U1]), place)
                positions.append(place[0].copy())
            steps = np.diff(positions, axis=0)
            assert (steps @ (positions[-1] - positions[0]) > 0.0).all()
