"""The lead of a bull nose, compared with a dense search along the move."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cnc.stock.kernels.sweep import BULL, Cutter, height, lead
from tests.support.soak import share


@settings(max_examples=share(5000, 20), deadline=None)
@given(st.floats(-2.0, 1.0), st.floats(-1.5, 1.0), st.floats(-3.0, 2.0), st.floats(0.0, 1.0))
@example(0.98, 0.55, -1.5, 0.86)
@example(-1.9, 1.0, -2.9, 0.005)
@example(0.0, 0.0, 2.0, 1.0)
def test_the_lead_of_a_bull_nose_leaves_nearly_the_least(flat, rise, slope, beside):
    """Exponents of the lengths (mm) and of the slope; the distance from the move, in radii."""
    cutter = Cutter(BULL, 10**flat + 10**rise, 10**flat, 10**rise)
    m, v = 10**slope, beside * cutter.radius
    rim = math.sqrt(max(0.0, cutter.radius**2 - v**2))
    found = lead(cutter, m, v)
    assert 0.0 <= found <= rim * (1.0 + 1e-9) + 1e-9

    def left(s):
        return height(cutter, min(math.hypot(v, s), cutter.radius)) - m * s

    least = min(left(s) for s in np.linspace(0.0, rim, 2000).tolist())
    assert left(found) <= least + 1e-5 * cutter.radius
