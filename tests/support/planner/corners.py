"""Plans of straight moves with corners, their distances from the corners, and their legality."""

import numpy as np

from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.planner.corner_choice import with_faster_paths
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from tests.support.planner.motions import AXES, lines, machine, sampled

PER_AXIS = machine(axis=(2400.0, 48000.0), tangential=None, normal=None, jerk=None)
SQUARE = [(10, 0, 0), (10, 10, 0)]
USED = 0.999
"""The part of the jerk limit that the planner uses."""


def planned(points, tolerance, mill=PER_AXIS, feed=300.0, *, chooses=False):
    """Plans of straight moves from the origin, and the look-ahead that made them.

    chooses: whether the faster of spline and corners is chosen.
    """
    ahead = LookAhead(mill)
    mode = [PathMode("t.nc", 1, "blend", tolerance)] if tolerance else []
    blocks = [*mode, lines(points, feed)]
    path = build(blocks, axes=AXES, start=np.zeros(3), offers_corners=chooses)
    items = ahead.plan(with_faster_paths(path, mill))
    return [item for item in items if isinstance(item, PlanChunk)], ahead


def duration(chunks):
    return chunks[-1].t0 + chunks[-1].duration


def distances(points, corners):
    """Of each point from the polygon of the corners, and of each corner from the polygon of the
    points.
    """

    def to_polygon(p, polygon):
        a, b = polygon[:-1], polygon[1:]
        along = b - a
        squared = np.maximum((along**2).sum(axis=1), 1e-300)
        best = np.full(len(p), np.inf)
        for k in range(len(a)):
            off = p - a[k]
            x = np.clip((off @ along[k]) / squared[k], 0.0, 1.0)
            off -= x[:, None] * along[k]
            np.minimum(best, np.einsum("ij,ij->i", off, off), out=best)
        return np.sqrt(best)

    return to_polygon(points, corners), to_polygon(corners, points)


def assert_legal(chunks, mill, periods):
    limits = Limits.of(mill)
    for period in periods:
        points = sampled(chunks, period)
        for order, bound in (
            (1, limits.axis_velocity),
            (2, limits.axis_acceleration),
            (3, limits.axis_jerk),
        ):
            seen = np.abs(np.diff(points, order, axis=0)).max(axis=0, initial=0.0) / period**order
            assert (seen <= bound * 1.001 + 2**order * 1e-11 / period**order).all(), (
                period,
                order,
                seen,
                bound,
            )
        # along the path: differences of the lengths of steps
        speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / period
        assert speed.max(initial=0.0) <= limits.max_feed * 1.001
