"""Chords of NURBS, against SciPy's B-splines."""

import math
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cnc.path.kernels.bspline import INSIDE, MOST_PARTS, nurbs_chord_ends
from tests.support.soak import share


def divided(at, u, v, sagitta, steepest):
    """Parameters of the ends of chords of a curve ``at`` from u to v, by the rule of the kernel."""
    start, chord = at(u), at(v) - at(u)
    off, size = 0.0, np.linalg.norm(chord)
    for part in INSIDE:
        here = at(u + part * (v - u)) - start
        foot = np.clip(here @ chord / (chord @ chord), 0.0, 1.0)
        off = max(off, np.linalg.norm(here - foot * chord))
    allowed = min(sagitta, max(steepest / 8.0 * size, 0.1 * sagitta))
    if off <= allowed:
        return [v]
    parts = int(np.clip(math.ceil(math.sqrt(1.1 * off / allowed)), 2, MOST_PARTS))
    cuts = np.append(u + np.arange(parts) / parts * (v - u), v)
    return [
        end for first, last in pairwise(cuts) for end in divided(at, first, last, sagitta, steepest)
    ]


@pytest.mark.parametrize(
    ("degree", "sagitta"),
    share(
        list(product((1, 2, 3, 5), (1.0, 0.01, 1e-5))),
        [*product((1, 2, 3, 5), (1.0, 0.01)), (1, 1e-5), (3, 1e-5)],
    ),
)
def test_the_ends_of_chords_within_a_sagitta(degree, sagitta):
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

    spans, steepest = np.unique(knots), 0.05
    ends = nurbs_chord_ends(degree, knots, weighted, spans, sagitta, steepest)
    parts = np.concatenate(
        [np.arange(degree + 1) / (degree + 1) * (v - u) + u for u, v in pairwise(spans)] + [[1.0]]
    )
    u = np.concatenate([divided(at, *both, sagitta, steepest) for both in pairwise(parts)])
    np.testing.assert_allclose(ends, at(u), atol=1e-10)
    before = np.append(0.0, u[:-1])
    fractions = np.linspace(0.0, 1.0, 21)[:, None, None]
    chord = at(u) - at(before)
    here = at(before + fractions[..., 0] * (u - before)) - at(before)
    along = np.clip((here * chord).sum(-1) / (chord * chord).sum(-1), 0.0, 1.0)
    away = np.linalg.norm(here - along[..., None] * chord, axis=-1)
    # Where the curve turns its bend over, it is farthest between the places that are examined.
    assert away.max() < 1.1 * sagitta
