"""The methods of the Curve protocol, on the three curves."""

import math

import numpy as np
import pytest

from cnc.path.curve import Arc, Curve, Line, Nurbs
from tests.support.path.path_cases import XYZ, nurbs_oracle, random_nurbs


def nurbs(block):
    return Nurbs(XYZ, block.degree, block.knots, block.control_points, block.weights)


BLOCK = random_nurbs(np.random.default_rng(2), 3, 9)
CURVES = [
    Line(XYZ, np.array([1.0, 2, 3]), np.array([4.0, -2, 3])),
    Arc(XYZ, np.array([10.0, 0, 0]), np.array([-10.0, 0, 6]), "XY", (0.0, 0.0), 2.5),
    Arc(XYZ, np.array([10.0, 0, 0]), np.array([0, 12.0, 6]), "XY", (0.0, 0.0), -0.75),
    nurbs(BLOCK),
]


@pytest.mark.parametrize("curve", CURVES)
def test_protocol(curve):
    assert isinstance(curve, Curve)
    u0, u1 = curve.u_range
    length = curve.arclen(u0, u1)
    assert curve.arclen(u1, u0) == -length
    assert curve.inv_arclen(0.0) == u0 and curve.inv_arclen(length) == pytest.approx(u1)
    low, high = curve.bounding_box()
    for part in (0.13, 0.5, 0.77):
        u = u0 + part * (u1 - u0)
        assert np.all(curve.eval(u) >= low - 1e-12) and np.all(curve.eval(u) <= high + 1e-12)
        h = 1e-5 * (u1 - u0)
        for order in (1, 2, 3):
            before = curve.eval if order == 1 else lambda x, k=order - 1: curve.deriv(x, k)
            slope = (before(u + h) - before(u - h)) / (2 * h)
            assert slope == pytest.approx(curve.deriv(u, order), rel=1e-3, abs=1e-3)
        r1, r2 = curve.deriv(u), curve.deriv(u, 2)
        assert curve.curvature(u) == pytest.approx(
            np.linalg.norm(np.cross(r1, r2)) / np.linalg.norm(r1) ** 3, rel=1e-9, abs=1e-12
        )
        s = curve.arclen(u0, u)
        assert curve.inv_arclen(s) == pytest.approx(u, abs=1e-8)
        assert curve.inv_arclen(s, 1e-12) == pytest.approx(u, abs=1e-11)


@pytest.mark.parametrize("curve", CURVES)
def test_subsegment(curve):
    u0, u1 = curve.u_range
    a, b = u0 + 0.21 * (u1 - u0), u0 + 0.83 * (u1 - u0)
    part = curve.subsegment(a, b)
    v0, v1 = part.u_range
    assert part.eval(v0) == pytest.approx(curve.eval(a), abs=1e-12)
    assert part.eval(v1) == pytest.approx(curve.eval(b), abs=1e-12)
    assert part.arclen(v0, v1) == pytest.approx(curve.arclen(a, b), abs=1e-9)
    for s in np.linspace(0, part.arclen(v0, v1), 7):
        expected = curve.eval(curve.inv_arclen(curve.arclen(u0, a) + s, 1e-12))
        assert part.eval(part.inv_arclen(s, 1e-12)) == pytest.approx(expected, abs=1e-9)


def test_a_whole_subsegment_is_the_same_nurbs():
    curve = nurbs(BLOCK)
    part = curve.subsegment(0.0, 1.0)
    oracle = nurbs_oracle(BLOCK)
    for u in np.linspace(0.01, 0.99, 23):
        assert part.eval(u) == pytest.approx(oracle(u)[0], abs=1e-11)
        assert part.deriv(u) == pytest.approx(oracle(u)[1], rel=1e-9, abs=1e-9)


def test_values():
    line, arc = CURVES[0], CURVES[1]
    assert line.arclen(0.0, 5.0) == 5.0 and line.curvature(2.0) == 0.0
    assert arc.curvature(3.0) == pytest.approx(
        10 * (5 * math.pi) ** 2 / ((50 * math.pi) ** 2 + 36), rel=1e-12
    )
    assert arc.bounding_box()[0] == pytest.approx([-10, -10, 0])
    cusp = Nurbs(
        XYZ,
        3,
        np.repeat([0.0, 1.0], 4),
        np.array([[0, 0, 0], [10, 10, 0], [0, 10, 0], [10.0, 0, 0]]),
        np.ones(4),
    )
    assert cusp.curvature(0.5) == math.inf
    with pytest.raises(ValueError):
        line.deriv(0.0, 4)
    with pytest.raises(ValueError):
        Line(XYZ, np.zeros(3), np.zeros(3)).arclen(0, 1)
