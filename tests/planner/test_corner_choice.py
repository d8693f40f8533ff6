"""Corners with short legs have blends, or one motion passes them: the faster of both is kept."""

from dataclasses import replace

import numpy as np
import pytest

from cnc.planner.corner_choice import SHORT, Trials
from cnc.planner.kernels.corner_places import MOST_CORNERS
from cnc.planner.limits import Limits
from cnc.planner.work import Work
from tests.support.planner.corners import assert_legal, distances, duration, planned
from tests.support.planner.motions import lines, machine, path_of, sampled
from tests.support.soak import share

EPS = 0.1


def polygon(turns, legs):
    heading = np.radians(np.cumsum([0.0, *turns]))
    steps = np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], 1)
    return np.cumsum(np.array(legs)[:, None] * steps, axis=0)


def with_blends(monkeypatch, points, mill, feed):
    """The plan without the choice."""
    with monkeypatch.context() as patch:
        patch.setattr(
            Trials,
            "passed_together",
            lambda self, path, rests: np.zeros(len(path), np.bool_),
        )
        return planned(points, EPS, mill, feed)[0]


@pytest.mark.parametrize("seed", range(share(60, 6)))
def test_the_choice_is_never_slower_than_blends(seed, monkeypatch):
    rng = np.random.default_rng([seed, 21])
    corners = int(rng.integers(1, 6))
    points = polygon(
        rng.uniform(5.0, 175.0, corners), EPS * 10 ** rng.uniform(0.3, 1.6, corners + 1)
    )
    accel, jerk = 10 ** rng.uniform(2.7, 3.9), 10 ** rng.uniform(4.0, 5.7)
    mill = machine(tangential=accel, normal=accel * rng.uniform(0.5, 3.0), jerk=jerk)
    feed = 10 ** rng.uniform(1.0, 2.5)
    chunks, ahead = planned(points, EPS, mill, feed)
    assert not ahead.audit.violations
    assert_legal(chunks, mill, (1e-3,))
    off, missed = distances(sampled(chunks, 5e-5), np.vstack((np.zeros(3), points)))
    assert off.max() <= EPS
    assert missed.max() <= EPS * (1.0 + 1e-3)
    assert duration(chunks) < 1.002 * duration(with_blends(monkeypatch, points, mill, feed))


def chosen(points, mill):
    (chunk,) = path_of([lines(points, 50.0)])
    tolerance = np.where(np.arange(len(chunk)) < len(chunk) - 1, EPS, 0.0)
    return Trials(Limits.of(mill), Work()).passed_together(
        replace(chunk, tolerance=tolerance), True
    )


SLOW_TURNS = machine(tangential=5000.0, normal=8800.0, jerk=826_000.0)
"""Between short legs the acceleration counts, and a motion that swings out is faster."""


def test_corners_of_short_legs_alone_are_passed_together():
    turns, short, long = [160.0, 59.0], 3.7 * EPS, 2.0 * SHORT * EPS
    assert chosen(polygon(turns, [short] * 3), SLOW_TURNS).tolist() == [True, True, False]
    assert not chosen(polygon(turns, [long] * 3), SLOW_TURNS).any()
    both = polygon([*turns, 30.0, *turns], [short] * 3 + [long] + [short] * 2)
    assert chosen(both, SLOW_TURNS).tolist()[:2] == [True, True]


def test_corners_that_one_motion_cannot_pass_have_blends():
    points = polygon([160.0, 59.0] * MOST_CORNERS, [3.7 * EPS] * (2 * MOST_CORNERS + 1))
    assert not chosen(points, SLOW_TURNS).any()


def test_limits_of_axes_leave_no_choice():
    axes = machine(axis=(5000.0, 826_000.0), tangential=None, normal=None, jerk=None)
    assert not chosen(polygon([160.0, 59.0], [3.7 * EPS] * 3), axes).any()


def test_corners_beside_the_border_of_a_chunk_have_blends():
    """From or to a rest there the times of both ways would be wrong, by up to a tenth."""
    (chunk,) = path_of([lines(polygon([160.0, 59.0], [3.7 * EPS] * 3), 50.0)])
    chunk = replace(chunk, tolerance=np.array([EPS, EPS, 0.0]))
    goes_on = replace(chunk, stop_after=np.zeros(3, np.bool_))
    limits = Limits.of(SLOW_TURNS)
    assert Trials(limits, Work()).passed_together(chunk, True).any()
    assert not Trials(limits, Work()).passed_together(chunk, False).any()
    assert not Trials(limits, Work()).passed_together(goes_on, True).any()
