"""Corners beside moves that are shorter than half the tolerance, which the fit leaves out."""

import math

import numpy as np
import pytest

from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead
from tests.support.planner.corners import PER_AXIS, distances, planned
from tests.support.planner.motions import AXES, lines, sampled
from tests.support.soak import share

TOLERANCE = 0.01


def missed(chunks, points):
    """Return the distances of motion and vertices from each other, in tolerances."""
    on_motion = sampled(chunks, 2e-5)
    off, left_out = distances(on_motion, np.asarray(points, float))
    return max(off.max(), left_out.max()) / TOLERANCE


@pytest.mark.parametrize("size", share([0.1, 0.28, 0.45], [0.45]))
@pytest.mark.parametrize("before", [True, False])
def test_a_move_that_is_left_out_at_a_corner_stays_within_the_tolerance(size, before):
    # The short move goes away from the side to which the ramps cut the corner.
    short = (0, 0, -size * TOLERANCE) if not before else (size * TOLERANCE, 0, 0)
    corner = np.array([0.8, 0.0, 0.0])
    points = [corner, corner + short, (0.8, 0.9, 0.5)]
    chunks, _ = planned(points, TOLERANCE)
    assert missed(chunks, [(0, 0, 0), *points]) <= 1.001


@pytest.mark.parametrize("rest", [[], [(0.8, 1.2, 1.2), (0.8, 0.9, 1.5)]])
def test_a_move_that_is_left_out_behind_a_traverse_stays_within_the_tolerance(rest):
    # With more moves a curve follows the line behind the corner.
    corner = np.array([0.8, 0.0, 0.0])
    points = [corner, corner + [0, 0, -0.45 * TOLERANCE], (0.8, 0.9, 0.5), *rest]
    blocks = [
        PathMode("t.nc", 1, "blend", TOLERANCE),
        lines(points[:1], math.nan),
        lines(points[1:], 300.0, 2),
    ]
    chunks = list(LookAhead(PER_AXIS).plan(build(blocks, axes=AXES, start=np.zeros(3))))
    assert missed([c for c in chunks if hasattr(c, "phase_t")], [(0, 0, 0), *points]) <= 1.001
