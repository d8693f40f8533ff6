"""Chords of NURBS, against SciPy's B-splines."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cnc.path.kernels.bspline import INSIDE, nurbs_sagittas


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_the_ends_and_distances_of_chords(degree):
    rng = np.random.default_rng(degree)
    count = degree + 6
    inner = np.sort(rng.uniform(0.1, 0.9, count - degree - 1))
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    weights = rng.uniform(0.5, 2.0, count)
    weighted = np.column_stack((rng.normal(size=(count, 3)) * 10.0, np.ones(count)))
    weighted *= weights[:, None]
    spline = BSpline(knots, weighted, degree)

    def at(u):
        value = spline(u)
        return value[..., :3] / value[..., 3:]

    u = np.unique(np.concatenate((knots, rng.uniform(0.0, 1.0, 9))))
    ends, size, off = nurbs_sagittas(degree, knots, weighted, u)
    start, chord = at(u[:-1]), np.diff(at(u), axis=0)
    np.testing.assert_allclose(ends, at(u[1:]), atol=1e-11)
    np.testing.assert_allclose(size, np.linalg.norm(chord, axis=1), atol=1e-11)
    expected = np.zeros(len(size))
    for part in INSIDE:
        here = at(u[:-1] + part * np.diff(u)) - start
        share = np.clip((here * chord).sum(axis=1) / (chord * chord).sum(axis=1), 0.0, 1.0)
        away = np.linalg.norm(here - share[:, None] * chord, axis=1)
        expected = np.maximum(expected, away)
    np.testing.assert_allclose(off, expected, atol=1e-11)
