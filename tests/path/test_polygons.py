"""Polygons in chains: which vertices stay corners where the motion passes them."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE
from cnc.path.kernels.fit_spline import find_polygons
from cnc.planner.joints import SHORT_LEGS, Joints
from tests.support.planner.motions import AXES, lines, machine
from tests.support.soak import share

METRIC = np.arange(3)


def marks(points, tolerance, few=SHORT_LEGS):
    corner = np.zeros(len(points), np.bool_)
    find_polygons(np.asarray(points, float), METRIC, tolerance, few, corner)
    return corner


@settings(max_examples=share(500, 25), deadline=None)
@given(
    radius=st.floats(0.5, 100.0),
    tolerance=st.floats(1e-3, 0.2),
    sagitta=st.floats(0.05, 1.0),
    digits=st.integers(4, 6),
)
def test_chords_of_a_curve_within_the_tolerance_are_no_polygon(radius, tolerance, sagitta, digits):
    step = 2.0 * math.acos(max(1.0 - sagitta * tolerance / radius, 0.9))
    angles = np.arange(0.0, 1.5 * math.pi, step)
    points = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0.0 * angles], axis=1)
    assume(len(points) > SHORT_LEGS + 2)
    assert not marks(points.round(digits), tolerance).any()


@pytest.mark.parametrize("turn", [6.0, 20.0, 60.0, 120.0, 175.0])
def test_long_legs_beside_corners_are_a_polygon(turn):
    legs = np.array(
        [
            [math.cos(k * math.radians(turn)), math.sin(k * math.radians(turn)), 0.0]
            for k in range(12)
        ]
    )
    points = np.concatenate((np.zeros((1, 3)), np.cumsum(5.0 * legs, axis=0)))
    assert marks(points, 0.04).tolist() == [False, *[True] * 11, False]


def test_a_few_vertices_with_short_legs_are_corners_and_many_are_a_curve():
    zigzag = [(k * 0.3, 0.1 * (k % 2), 0.0) for k in range(30)]
    assert marks(zigzag[:6], 0.1).tolist() == [False, True, True, True, True, False]
    assert not marks(zigzag, 0.1).any()
    assert not marks(zigzag[:6], 0.1, 0).any()


@pytest.mark.parametrize(
    ("limits", "short_legs"),
    [
        ({"axis": (2400.0, 48_000.0), "tangential": None, "jerk": None}, SHORT_LEGS),
        ({"axis": (2400.0, 48_000.0)}, SHORT_LEGS),
        ({}, 0),
    ],
)
def test_polygons_with_long_legs_stay_straight_on_all_linear_machines(limits, short_legs):
    assert Joints(machine(**limits)).short_legs == short_legs


@pytest.mark.parametrize("short_legs", [SHORT_LEGS, 0, None])
def test_the_legs_of_a_polygon_stay_straight_where_corners_are_passed(short_legs):
    points = [(5, 0, 0), (9, 1, 0), (12, 4, 0), (13, 9, 0)]
    path = build(
        [PathMode("t.nc", 1, "blend", 0.05), lines(points, 20.0)],
        axes=AXES,
        start=np.zeros(3),
        short_legs=short_legs,
    )
    kinds = np.concatenate([chunk.kind for chunk in path if isinstance(chunk, PathChunk)])
    assert (kinds == LINE).all() == (short_legs is not None)
    assert short_legs is None or len(kinds) == 4
