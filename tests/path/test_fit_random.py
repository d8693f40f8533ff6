"""Random chains, fitted: within the tolerance, smooth, and complete."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from cnc.path.kernels.fit_spline import KNOT, Chain, points_of
from cnc.path.kernels.fit_squares import with_cuts
from cnc.path.kernels.fit_stretches import first_knots
from tests.support.path.fitted import ALL, EPS, assert_sound, distances, fitted, pieces, sampled
from tests.support.path.path_cases import XYZ, ends, evaluate
from tests.support.soak import share


def random_points(rng, count, axes):
    """Return random walks with all hard cases: noise, repeated points, spikes, loops, reversals,
    leaps, tiny moves.
    """
    points = [rng.uniform(-50, 50, axes)]
    heading = rng.normal(size=axes)
    while len(points) < count:
        here, many = points[-1], int(rng.integers(1, 40))
        size = 10 ** rng.uniform(-3, 0.5)
        heading /= np.linalg.norm(heading)
        match rng.integers(0, 9):
            case 0 | 1 | 2:
                turn = np.linalg.qr(
                    np.eye(axes) + rng.normal(size=(axes, axes)) * 10 ** rng.uniform(-3, -0.5)
                )[0]
                turn *= np.sign(np.diag(turn))
                for _ in range(many):
                    heading = turn @ heading
                    points.append(points[-1] + size * rng.uniform(0.1, 1.0) * heading)
            case 3:
                points += list(
                    here
                    + size * np.outer(np.arange(1, many + 1), heading)
                    + rng.normal(size=(many, axes)) * 10 ** rng.uniform(-6, -2)
                )
            case 4:
                points += [here] * many
            case 5:
                points += [here + size * rng.normal(size=axes), here]
            case 6:
                points.append(here + 1e-3 * heading)
            case 7:
                points.append(here + rng.choice([1.0, 30.0, 1e3, 1e6]) * heading)
            case 8:
                points += list(here + 10 ** rng.uniform(-4, -1) * rng.normal(size=(many, axes)))
    points = np.array(points[:count])
    return np.round(points, int(rng.integers(2, 6))) if rng.random() < 0.7 else points


@settings(max_examples=share(3000, 4), deadline=None)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(2, 250),
    axes=st.integers(1, 3),
    tolerance=st.floats(-3.5, -1),
)
def test_random_chains(seed, count, axes, tolerance):
    rng = np.random.default_rng(seed)
    points, tolerance = random_points(rng, count, axes), 10**tolerance
    runs = 10 ** rng.uniform(0.5, 2)
    feeds = 10.0 + (np.arange(count - 1) // runs) % 3
    chunks = fitted(points, feeds, tolerance, XYZ[:axes])
    if not np.abs(np.diff(points, axis=0)).max() > 1e-9:
        return
    assert_sound(chunks)
    padded = np.column_stack((points, np.zeros((count, 3 - axes))))
    everything = pieces(chunks)
    curve, _, _ = sampled(chunks)
    curve = np.column_stack((curve, np.zeros((len(curve), 3 - axes))))
    slack = 1e-12 * np.abs(points).max() + 2e-9
    inside = (
        padded[:-1, None] + np.linspace(0, 1, 4)[None, :, None] * np.diff(padded, axis=0)[:, None]
    )
    assert distances(curve, padded, tolerance).max() <= tolerance * (1 + 1e-9) + slack
    assert distances(inside.reshape(-1, 3), curve, tolerance).max() <= 1.02 * tolerance + slack
    assert np.array_equal(evaluate(*everything[0], ends(*everything[0])[0])[0], points[0])
    assert evaluate(*everything[-1], ends(*everything[-1])[1])[0] == pytest.approx(
        points[-1], abs=1.1e-9
    )


@pytest.mark.parametrize("seed", range(share(300, 8)))
def test_knots_lie_on_moves_shorter_than_their_spacing(seed):
    """The point of a knot behind vertices that do not count is not on a line past them."""
    rng = np.random.default_rng(seed)
    tolerance = 0.1
    steps = tolerance * rng.uniform(0.1, 0.45, (30, 1)) * rng.normal(size=(30, 3))
    steps[rng.integers(1, 30, 4)] *= 60.0
    points = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
    chain = Chain(points, np.empty(31), np.arange(3), np.ones(3, np.bool_))
    knots = first_knots(chain, np.zeros(31, np.bool_), tolerance, np.zeros(0, KNOT))
    while len(knots) < 80:
        knots = with_cuts(chain, knots, np.diff(knots["t"]) > tolerance / 10.0)
    places = np.empty((len(knots), 3))
    points_of(chain, knots, places)
    assert not knots["on"].all()
    assert distances(places, points).max() <= 1e-9


@settings(max_examples=share(500, 3), deadline=None)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(2, 150),
    axes=st.sampled_from([("x", "a"), ("x", "y", "z", "b", "c"), ALL, ("a",)]),
)
def test_other_axes_follow_within_the_tolerance(seed, count, axes):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.02, 0.3, count))
    waves, phase = rng.uniform(2, 9, len(axes)), rng.uniform(0, 6, len(axes))
    points = np.round(5 * np.sin(t[:, None] / waves + phase), 3)
    if rng.random() < 0.3:
        points[:, rng.integers(0, len(axes))] = 7.0
    if rng.random() < 0.3:
        points[count // 2 :, 0] = points[count // 2, 0]
    chunks = fitted(points, tolerance=EPS, axes=axes)
    if not chunks:
        return
    curve, _, _ = sampled(chunks)
    linear, others = (
        [k for k, axis in enumerate(axes) if axis in "xyz"],
        [k for k, axis in enumerate(axes) if axis not in "xyz"],
    )

    def apart(p, polygon):
        """Return the larger of the distance over x y z and that of each other axis, from dense
        points of the polygon.
        """
        count = 2 + int(np.abs(np.diff(polygon, axis=0)).max() / (0.2 * EPS))
        dense = (
            polygon[:-1, None]
            + np.linspace(0, 1, count)[None, :, None] * np.diff(polygon, axis=0)[:, None]
        ).reshape(-1, len(axes))

        def from_points(p, dense):
            gap = np.abs(dense - p)
            across = np.linalg.norm(gap[..., linear], axis=-1)
            return np.maximum(across, gap[..., others].max(axis=-1, initial=0.0)).min(axis=-1)

        _, near = cKDTree(dense).query(p, k=min(8, len(dense)))
        gaps = from_points(p[:, None], dense[near.reshape(len(p), -1)])  # upper bounds
        for k in np.flatnonzero(gaps > 1.1 * EPS):
            gaps[k] = from_points(p[k], dense)
        return gaps.max()

    assert apart(curve[:: max(1, len(curve) // 60)], points) <= 1.1 * EPS
    assert apart(points[:: max(1, count // 20)], curve) <= 1.1 * EPS
    assert_sound(chunks)


@pytest.mark.parametrize("seed", [1041, 1976])
def test_a_broken_chain_that_ends_with_a_move_of_no_length_along_it(seed):
    """The last vertices do not count, so the last span has no length; a part near it is anew."""
    rng = np.random.default_rng(seed)
    axes = int(rng.integers(1, 4))
    tolerance = 10 ** rng.uniform(-3.5, -1)
    points = random_points(rng, int(rng.integers(2, 250)), axes)
    chunks = fitted(points, tolerance=tolerance, axes=XYZ[:axes])
    chunk = chunks[-1]
    last = len(chunk) - 1
    assert evaluate(chunk, last, ends(chunk, last)[1])[0] == pytest.approx(points[-1], abs=1.1e-9)
