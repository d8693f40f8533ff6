"""Knots and lengths of splines, against formulas and against quadrature of scipy's splines."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import BSpline

from cnc.gcode.core import splines as curves


def test_knots_by_hand() -> None:
    assert curves.clamped_uniform(5, 2).tolist() == [0, 0, 0, 1, 2, 3, 3, 3]
    assert curves.clamped_uniform(4, 3).tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert curves.clamped_uniform(2, 1).tolist() == [0, 0, 1, 1]
    assert curves.clamped([0.5, 0.25, 0.0, 2.0], 3).tolist() == [
        0,
        0,
        0,
        0,
        0.5,
        0.75,
        0.75,
        2.75,
        2.75,
        2.75,
        2.75,
    ]
    assert curves.bezier_knots(2).tolist() == [0, 0, 0, 1, 1, 1]


def test_length_of_a_straight_line() -> None:
    for degree in range(1, 6):
        points = np.linspace([1.0, 2.0, 3.0], [4.0, -2.0, 15.0], degree + 3)
        found = curves.curve_length(
            curves.clamped_uniform(degree + 3, degree), points, np.ones(degree + 3)
        )
        assert found == pytest.approx(13.0, rel=1e-14)


def test_a_parabola() -> None:
    # y = x^2 from -2 to 2: the arc length of a parabola in closed form.
    points = np.array([[-2.0, 4.0], [0.0, -4.0], [2.0, 4.0]])
    expected = 2 * math.sqrt(17) + math.asinh(4) / 2
    assert curves.curve_length(curves.bezier_knots(2), points, np.ones(3)) == pytest.approx(
        expected, rel=1e-13
    )


def test_a_circle_of_four_rational_quarters() -> None:
    s = math.sqrt(0.5)
    points = (
        np.array(
            [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], float
        )
        * 30
    )
    weights = np.array([1, s, 1, s, 1, s, 1, s, 1])
    knots = curves.clamped([1, 0, 1, 0, 1, 0, 1], 2)
    assert curves.curve_length(knots, points, weights) == pytest.approx(60 * math.pi, rel=1e-13)


def test_cusps() -> None:
    # There and back on a line: the speed is |3 - 6t| * 2, the way 3.
    points = np.array([[0.0], [3.0], [0.0]])
    assert curves.curve_length(curves.bezier_knots(2), points, np.ones(3)) == pytest.approx(
        3.0, rel=1e-10
    )
    # x = 4 s^3, y = 3 s^2 for s from -1/2 to 1/2: the speed is 6 |s| sqrt(4 s^2 + 1).
    points = np.array([[-0.5, 0.75], [0.5, -0.25], [-0.5, -0.25], [0.5, 0.75]])
    assert curves.curve_length(curves.bezier_knots(3), points, np.ones(4)) == pytest.approx(
        2**1.5 - 1, rel=1e-10
    )


def test_length_of_a_point() -> None:
    assert curves.curve_length(curves.bezier_knots(3), np.full((4, 3), 7.0), np.ones(4)) == 0.0


@pytest.mark.parametrize("seed", range(12))
def test_random_curves_against_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    degree = int(random.integers(1, 6))
    pieces = int(random.integers(1, 6))
    points = random.uniform(-50, 50, (pieces + degree, 3))
    weights = random.uniform(0.3, 3.0, pieces + degree)
    knots = curves.clamped(random.uniform(0.1, 2.0, pieces), degree)
    top = BSpline(knots, points * weights[:, None], degree)
    bottom = BSpline(knots, weights, degree)

    def speed(u: float) -> float:
        w = bottom(u)
        return float(np.linalg.norm((top(u, 1) - bottom(u, 1) * top(u) / w) / w))

    inner = np.unique(knots)
    expected = sum(
        quad(speed, a, b, epsabs=1e-12, epsrel=1e-12, limit=400)[0]
        for a, b in itertools.pairwise(inner)
    )
    assert curves.curve_length(knots, points, weights) == pytest.approx(expected, rel=1e-9)
