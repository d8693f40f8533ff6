"""Chains of chords as long as the tolerance permits, as CAM systems write them."""

import numpy as np
import pytest

from benchmarks import cam_programs
from benchmarks.chains import chain, distance, duration, moves, path, sampled, smooth
from cnc.api import parse
from cnc.model.blocks import ArcFeed, NurbsFeed, PathMode, Polyline
from cnc.path.kernels.curve import START
from tests.support.path.fitted import assert_sound
from tests.support.planner.motions import path_of
from tests.support.soak import share

SEEDS = range(500, 500 + share(400, 6))


@pytest.mark.parametrize("seed", SEEDS[:: share(1, 2)])
def test_the_spline_keeps_within_the_tolerance_and_its_knots_do_not_collapse(seed):
    case = chain(seed)
    chunks = path(moves(case.points, case.tolerance), case.points[0])
    assert_sound(chunks)
    curve = sampled(chunks, 96)
    assert distance(curve, case.points) <= case.tolerance
    assert distance(case.points, curve) <= 1.02 * case.tolerance
    assert sum(map(len, chunks)) <= 2 * (len(case.points) - 1)


@pytest.mark.parametrize("seed", range(1500, 1500 + share(100, 2)))
def test_the_motion_is_as_fast_as_along_the_smooth_curve(seed):
    case = chain(seed)
    chunks = path(moves(case.points, case.tolerance), case.points[0])
    knots, control = smooth(case)
    curve = path([NurbsFeed("", 1, 5, knots, control, np.ones(len(control)), 300.0)], control[0])
    assert duration(chunks) <= 1.08 * duration(curve)


@pytest.mark.parametrize("seed", [777056, 30000280, 30000706, 30001081, 30001267])
def test_a_hairpin_of_a_few_tolerances_is_as_fast_as_the_smooth_curve(seed):
    test_the_motion_is_as_fast_as_along_the_smooth_curve(seed)


@pytest.mark.parametrize("seed", [47000183, 91000038, 91000298])
def test_the_ends_of_a_chain_are_not_cut_again_and_again(seed):
    """Between the last vertices the first spline bulged by up to nine tolerances."""
    case = chain(seed)
    chunks = path(moves(case.points, case.tolerance), case.points[0])
    assert sum(map(len, chunks)) <= len(case.points) - 1
    test_the_motion_is_as_fast_as_along_the_smooth_curve(seed)


@pytest.mark.parametrize("seed", [30000110, 30000303])
def test_a_span_that_is_little_off_is_not_cut_again_and_again(seed):
    """Moves of a smooth curve became a polyline in steps of half a tolerance, with corners."""
    case = chain(seed)
    chunks = path(moves(case.points, case.tolerance), case.points[0])
    joints = np.concatenate([chunk.tolerance for chunk in chunks])
    assert (joints[:-1] == 0.0).all()
    test_the_motion_is_as_fast_as_along_the_smooth_curve(seed)


def test_a_window_goes_on_from_the_one_before():
    """Chords of a circle many windows long: C4 throughout, and no seam is seen."""
    radius, tolerance, part = 40.0, 0.01, 0.9
    step = 2.0 * np.arccos(1.0 - part * tolerance / radius)
    angle = np.arange(0.0, 6000.0) * step
    points = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), angle / 50.0)).round(
        4
    )
    chunks = path(moves(points, tolerance), points[0])
    assert_sound(chunks)
    assert sum((chunk.tolerance > 0.0).sum() for chunk in chunks) <= 1
    assert sum(map(len, chunks)) <= 1.02 * len(points)
    some = sampled(chunks[:8], 24)
    off = np.abs(np.hypot(some[:, 0], some[:, 1]) - radius * (1.0 - 0.5 * (step / 2.0) ** 2 / 2.0))
    assert off.max() <= 1.5 * tolerance


def test_pieces_of_a_cam_program_join_exactly(tmp_path):
    """The last control point of a fitted chain was the vertex but for 9e-16 mm."""
    file = tmp_path / "p.nc"
    cam_programs.write(file, "fusion", 560, 72)
    moves = [block for block in parse(file) if isinstance(block, Polyline | ArcFeed)]
    ends = []
    for chunk in path_of([PathMode("p.nc", 1, "blend", 0.01), *moves]):
        n = len(chunk.axes)
        ends.append(chunk.data[chunk.at[:, None] + START + np.arange(2 * n)])
    start, end = np.split(np.concatenate(ends), 2, axis=1)
    np.testing.assert_array_equal(start[1:], end[:-1])
