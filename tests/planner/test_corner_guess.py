"""The slow motion with which the search for a motion past corners begins."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cnc.planner.kernels.corner_guess import slow_motion, slow_state
from tests.planner.test_corner_motions import chain
from tests.support.soak import share


def states(tube, slow, times):
    """Return positions and accelerations (m, d) of a slow motion."""
    r, a = np.empty((2, len(times), tube.axes.shape[1]))
    for k, time in enumerate(times):
        slow_state(tube, slow, time, r[k], a[k])
    return r, a


def random_chain(seed):
    """Return a random tube, perhaps between two states at speed, and the speeds at its ends."""
    rng = np.random.default_rng(seed)
    tube, *_ = chain(rng, int(rng.integers(1, 5)))
    assume((np.linalg.norm(np.diff(tube.along, axis=0), axis=1) > 0.05).all())
    tube = tube._replace(along_jerk=float(tube.jerk.min() * 10 ** rng.uniform(-1.0, 1.0)))
    speeds = rng.choice([0.0, 0.2], 2) * tube.feed[[0, -1]]
    tube.ends[0, 1], tube.ends[1, 1] = speeds[0] * tube.along[0], speeds[1] * tube.along[-1]
    return tube, speeds


@settings(max_examples=share(500, 8), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_it_is_smooth_and_joins_the_states_at_its_ends(seed):
    tube, speeds = random_chain(seed)
    slow = slow_motion(tube)
    times = np.linspace(0.0, slow.passes[-1], 4001)
    r, a = states(tube, slow, times)
    assert r[0] == pytest.approx(tube.ends[0, 0], abs=1e-9)
    assert r[-1] == pytest.approx(tube.ends[1, 0], abs=1e-9)
    dt = times[1]
    v = np.diff(r, axis=0) / dt
    biggest = np.abs(a).max()
    for end, place in ((0, 0), (1, -1)):
        assert np.linalg.norm(v[place]) == pytest.approx(speeds[end], abs=biggest * dt)
    # The second difference is a mean of the acceleration, which changes by no more than that.
    change = np.abs(np.diff(a, axis=0)).max(initial=0.0)
    rounding = 1e-14 * np.abs(r).max() / dt**2
    assert np.abs(np.diff(v, axis=0) / dt - a[1:-1]).max() <= 1.01 * change + rounding + 1e-9


@settings(max_examples=share(500, 8), deadline=None)
@given(seed=st.integers(0, 2**31))
def test_its_turns_keep_to_the_limits(seed):
    """Jerk in each axis and along the path, acceleration, and distance from the corner."""
    tube, _ = random_chain(seed)
    slow = slow_motion(tube)
    for k in range(1, len(tube.feed)):
        times = slow.passes[k] + slow.tau[k] * np.linspace(-0.999, 0.999, 2001)
        r, a = states(tube, slow, times)
        dt = times[1] - times[0]
        v = np.gradient(r, dt, axis=0)
        jerk = slow.jerk[k] * slow.across[k]
        assert (np.abs(jerk) <= tube.jerk * (1.0 + 1e-9)).all()
        assert (np.abs(a) <= tube.acceleration * (1.0 + 1e-9)).all()
        assert np.linalg.norm(r - tube.start[k], axis=1).min() <= 0.5001 * tube.tolerance
        speed = np.linalg.norm(v, axis=1)
        assert speed.max() <= tube.feed[k - 1 : k + 1].min() * (1.0 + 1e-3)
        change = -np.sign(times - slow.passes[k])[:, None] * jerk
        along = ((a * a).sum(axis=1) + (v * change).sum(axis=1)) / speed
        along -= (v * a).sum(axis=1) ** 2 / speed**3
        assert np.abs(along[2:-2]).max() <= tube.along_jerk * (1.0 + 1e-2)
