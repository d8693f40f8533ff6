"""The paper's sampled interpolator on curves: a second implementation of its equations, and its
limits on random curves.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cnc.machine.models import PathLimits
from cnc.model.blocks import NurbsFeed
from cnc.papers.nurbs_lookahead import Samples, interpolate
from tests.support.pulses.plans import FILE, arc, path_of, polyline, trident
from tests.support.soak import share

Floats = NDArray[np.float64]

LIMITS = PathLimits(
    max_feed=300.0,
    max_tangential_acceleration=2400.0,
    max_normal_acceleration=4903.325,
    max_jerk=48000.0,
    chord_error=0.001,
    period=0.001,
    step_deviation=0.001,
)
F, T, A, A_N, J, H_MAX, DELTA_MAX = 300.0, 0.001, 2400.0, 4903.325, 48000.0, 0.001, 0.001


class Rational:
    """A NURBS evaluated by SciPy: a B-spline of homogeneous points."""

    def __init__(self, block: NurbsFeed) -> None:
        homogeneous = np.column_stack(
            [block.weights, block.control_points * block.weights[:, None]]
        )
        self.spline = BSpline(block.knots, homogeneous, block.degree)
        self.end = float(block.knots[-1])

    def __call__(self, u: Floats | float) -> Floats:
        value = self.spline(u)
        return value[..., 1:] / value[..., :1]

    def speed(self, u: float) -> float:
        value, slope = self.spline(u), self.spline(u, 1)
        return float(np.linalg.norm((slope[1:] - slope[0] * value[1:] / value[0]) / value[0]))


def off_chord(p: Floats, q: Floats, m: Floats) -> float:
    """Return the distance of m from the line through p and q."""
    along = (q - p) / np.linalg.norm(q - p)
    return float(np.linalg.norm((m - p) - ((m - p) @ along) * along))


def by_the_equations(curve: Rational) -> tuple[list[float], list[float], list[float]]:
    """Return u, speed and chord error of the adaptive step alone, by equations 3 to 8 as corrected,
    and the S-curve.
    """
    u, v, h = [0.0], [0.0], [0.0]
    owed = 0.0
    while u[-1] < curve.end:
        rise = max((v[-1] - v[-2]) / T if len(v) > 1 else 0.0, 0.0) + J * T
        # the acceleration from which it fades by J T a period just as F is met
        fading = max(np.roots([1 / (2 * J), T / 2, v[-1] - F]).real)
        feed = v[-1] + T * min(rise, A, fading)
        step = wanted = feed * T + owed
        p = curve(u[-1])
        if len(u) > 2:
            guess = (9 * u[-1] - 6 * u[-2] + u[-3]) / 4
        else:
            guess = u[-1] + step / curve.speed(u[-1])
        guess = min(guess, curve.end)
        q = curve(guess)
        chord = float(np.linalg.norm(q - p))
        error = off_chord(p, q, curve((u[-1] + guess) / 2))
        step_1 = np.sqrt(H_MAX / error) * chord
        step = min(step, step_1, T / 2 * np.sqrt(A_N / (2 * H_MAX)) * step_1)
        while abs(step - chord) / step > DELTA_MAX and not (guess == curve.end and chord < step):
            guess = min(u[-1] + step / chord * (guess - u[-1]), curve.end)
            q = curve(guess)
            chord = float(np.linalg.norm(q - p))
        u.append(guess)
        h.append(off_chord(p, q, curve((u[-2] + guess) / 2)))
        v.append(
            feed
            if step == wanted and guess < curve.end
            else min(chord if guess == curve.end else step, feed * T) / T
        )
        owed = step - chord
    return u, v, h


def test_the_adaptive_step_is_what_the_equations_say() -> None:
    block = trident()
    samples = interpolate(path_of([block], [10.0, 10.0]), LIMITS, look_ahead=False)
    u, v, h = by_the_equations(Rational(block))
    assert len(samples.u) == len(u)
    np.testing.assert_allclose(samples.u, u, rtol=0, atol=1e-8)
    np.testing.assert_allclose(samples.feed, v, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(samples.chord_error, h, rtol=1e-5, atol=1e-12)


def holds(samples: Samples, curve: Rational, stops: bool = True) -> None:
    """Check that samples reach the exact end of the curve, and keep the requested steps and the
    limits of speed and acceleration.
    """
    assert samples.u[0] == 0.0 and samples.u[-1] == curve.end
    assert (np.diff(samples.u) > 0.0).all()
    np.testing.assert_allclose(samples.position, curve(samples.u), rtol=0, atol=1e-9)
    chord = np.linalg.norm(np.diff(samples.position, axis=0), axis=1)
    np.testing.assert_allclose(samples.chord[1:], chord, rtol=1e-9, atol=1e-12)
    assert samples.deviation.max() <= DELTA_MAX
    assert samples.feed.max() <= F * (1 + 1e-12)
    accel = np.diff(samples.feed, append=0.0) / T
    assert accel.max() <= A * (1 + 1e-9)
    if stops:
        assert accel.min() >= -A * (1 + 1e-5)
        # what is asked for and what is made do not drift apart
        assert abs(samples.step.sum() - samples.chord.sum()) <= 0.002 * samples.chord.sum()


@st.composite
def curves(draw: st.DrawFn) -> NurbsFeed:
    """Draw curves of degree 1 to 5, up to 40 points some mm apart in 2 or 3 axes, weights 0.1 to
    10.
    """
    degree = draw(st.integers(1, 5))
    count = draw(st.integers(degree + 1, 40))
    dimension = draw(st.integers(2, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points = np.cumsum(rng.uniform(-20.0, 20.0, (count, dimension)), axis=0)
    inner = np.sort(rng.uniform(0.05, 0.95, count - degree - 1))
    weights = 10.0 ** rng.uniform(-1.0, 1.0, count)
    return NurbsFeed(
        FILE,
        1,
        degree,
        np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)]),
        points,
        weights,
        100.0,
    )


@settings(max_examples=share(400, 6))
@given(curves())
def test_random_curves_are_run_within_the_limits(block: NurbsFeed) -> None:
    assume(np.diff(np.unique(block.knots)).min() > 1e-3)
    path = path_of([block], block.control_points[0])
    holds(interpolate(path, LIMITS), Rational(block))
    holds(interpolate(path, LIMITS, look_ahead=False), Rational(block), stops=False)


def test_the_look_ahead_goes_back_and_without_it_the_acceleration_breaks() -> None:
    path = path_of([trident()], [10.0, 10.0])
    alone, ahead = (interpolate(path, LIMITS, look_ahead=flag) for flag in (False, True))
    assert alone.went_back == 0 and np.diff(alone.feed).min() < -10 * A * T
    assert 3 <= ahead.went_back <= 12
    assert len(ahead.u) > len(alone.u)
    # it brakes at the limit, and is as fast as the adaptive step where nothing is ahead
    assert np.diff(ahead.feed).min() <= -0.98 * A * T
    np.testing.assert_array_equal(ahead.u[:60], alone.u[:60])


def test_a_straight_line_is_run_by_the_s_curve() -> None:
    samples = interpolate(path_of([polyline([[60.0, 0.0, 0.0]])], np.zeros(3)), LIMITS)
    jerk = np.diff(samples.feed, 2) / T**2
    top = int(np.argmax(samples.feed))
    assert samples.feed.max() == pytest.approx(F, rel=1e-9)
    assert np.abs(jerk[: top - 1]).max() <= J * (1 + 1e-6)
    # V/2 (V/A + A/J) to get there, V^2 / 2A back: going back knows nothing of the jerk
    assert samples.position[top, 0] == pytest.approx(F / 2 * (F / A + A / J), abs=2 * F * T)
    assert 60.0 - samples.position[
        np.flatnonzero(samples.feed > F - 2 * A * T)[-1], 0
    ] == pytest.approx(F * F / (2 * A), abs=2 * F * T)


def test_a_circle_is_run_at_the_speed_of_its_normal_acceleration() -> None:
    limits = LIMITS.model_copy(update={"max_tangential_acceleration": None, "max_jerk": None})
    start = np.array([5.0, 0.0])
    samples = interpolate(path_of([arc(start, (0.0, 0.0), 0.75)], start), limits)
    middle = samples.feed[5:-2]
    assert middle == pytest.approx(np.full(len(middle), np.sqrt(A_N * 5.0)), rel=1e-3)
    assert samples.chord_error[5:-2] == pytest.approx(
        np.full(len(middle), A_N * T * T / 8), rel=3e-3
    )


def test_pieces_over_which_the_parameter_does_not_run_on_are_refused() -> None:
    path = path_of([polyline([[1.0, 0.0], [1.0, 1.0]])], np.zeros(2))
    with pytest.raises(ValueError, match="run on"):
        interpolate(path, LIMITS)


def test_a_curve_with_a_cusp_is_run() -> None:
    points = np.array([[0.0, 0.0], [10.0, 10.0], [0.0, 10.0], [10.0, 0.0]])
    block = NurbsFeed(FILE, 1, 3, np.array([0, 0, 0, 0, 1, 1, 1, 1.0]), points, np.ones(4), 100.0)
    holds(interpolate(path_of([block], points[0]), LIMITS), Rational(block))
