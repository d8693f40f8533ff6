"""Lines through windows, compared with an exhaustive search."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cnc.boards.stepper.kernels.candidates import MAX_CORNERS, Bounds, Polygon, Windows, longest
from tests.support.soak import share


def reach(w, low, high, x, y):
    """Return the largest number of windows, from the first on, that a line x + w y passes."""
    value = x[:, None] + w[None, :] * y[:, None]
    return int(np.cumprod((value >= low) & (value <= high), axis=1).sum(axis=1).max())


@settings(max_examples=share(2000, 13), deadline=None)
@given(st.integers(2, 40), st.floats(0.6, 8.0), st.integers(0, 2**32 - 1))
def test_line_passes_as_many_windows_as_the_best(count, width, seed):
    random = np.random.default_rng(seed)
    w = np.arange(count) * 0.5
    middle = (
        random.uniform(-20, 20) + w * random.uniform(-6, 6) + random.uniform(-1, 1) * w * w / count
    )
    low, high = (
        middle - random.uniform(0.3, 1.0, count) * width,
        middle + random.uniform(0.3, 1.0, count) * width,
    )
    x, y = np.meshgrid(np.arange(-40, 41), np.arange(-12, 13))
    best = reach(w, low, high, x.ravel().astype(float), y.ravel().astype(float))
    assume(best > 0)
    met, found_x, found_y = longest(
        Windows(w, low, high),
        count,
        Bounds(-40.0, 40.0, -12.0, 12.0),
        Polygon(np.empty((2, MAX_CORNERS)), np.empty((2, MAX_CORNERS))),
    )
    assert met == reach(w, low, high, np.array([float(found_x)]), np.array([float(found_y)]))
    # Whole points of a polygon are searched on one line through its middle. In narrow polygons this
    # may miss some.
    assert met <= best
    assert met >= 1
    if width > 4.0:
        assert met >= 0.7 * best
