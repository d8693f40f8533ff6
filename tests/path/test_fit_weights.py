"""Weights of the spans of a fitted chain: speeds that a motion of limited jerk can reach."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from cnc.path.kernels.fit_program import _speed
from cnc.path.kernels.fit_spline import KNOT


def knots_at(t, inside=()):
    """Return knots at parameters t, all of them vertices but those with the numbers ``inside``."""
    knots = np.zeros(len(t), KNOT)
    knots["t"], knots["on"] = t, True
    knots["on"][list(inside)] = False
    return knots


def speed_at(distance, slow, fast):
    """Return the speed that a motion with jerk 1 reaches from ``slow``, at most ``fast``."""

    def left(u):
        return (u + slow) * math.sqrt(u - slow) - distance

    return fast if left(fast) <= 0.0 else brentq(left, slow, fast)


@pytest.mark.parametrize("usual", [0.5, 1.0, 4.0, 20.0])
def test_a_slow_span_limits_the_speeds_about_it(usual):
    knots = knots_at([0.0, 9.0, 18.0, 19.0, 29.0, 60.0])
    lengths = np.diff(knots["t"])
    middles = knots["t"][:-1] + 0.5 * lengths
    for span, own in enumerate(usual * lengths):
        expected = min(
            speed_at(abs(middle - middles[span]), usual * length, own)
            for middle, length in zip(middles, lengths, strict=True)
            if usual * length <= own
        )
        assert _speed(knots, span, usual) == pytest.approx(expected, rel=1e-6)


def test_knots_inside_a_move_change_no_speed():
    whole = _speed(knots_at([0.0, 8.0, 16.0, 24.0]), 1, 0.1)
    cut = knots_at([0.0, 8.0, 10.0, 12.0, 14.0, 16.0, 24.0], inside=(2, 3, 4))
    assert [_speed(cut, k, 0.1) for k in range(1, 5)] == [whole] * 4
