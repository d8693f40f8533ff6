"""The places where an axis meets its lines, against roots by Brent's method."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from cnc.pulses.kernels.enclosing_line import CLOSE, PLACES, next_places, window_rows
from cnc.pulses.kernels.grid_moves import Moves
from cnc.pulses.kernels.polynomial import POLYNOMIAL, interpolate
from tests.support.soak import share

Floats = NDArray[np.float64]


def _arc(radius: float, begin: float, sweep: float) -> Floats:
    """Return the window of an arc about the origin (2, POLYNOMIAL), BLU."""
    poly = np.zeros((2, POLYNOMIAL))
    for axis, turn in enumerate((0.0, -0.5 * np.pi)):
        a, b = begin + turn, begin + turn + sweep
        start, end = (
            [
                radius * np.cos(angle),
                -radius * sweep * np.sin(angle),
                -radius * sweep**2 * np.cos(angle) / 2.0,
                radius * sweep**3 * np.sin(angle) / 6.0,
            ]
            for angle in (a, b)
        )
        interpolate(poly, axis, *start, *end)
    return poly


@pytest.mark.parametrize("seed", range(share(60, 10)))
def test_places_are_where_the_axis_is_at_its_lines(seed: int) -> None:
    random = np.random.default_rng(seed)
    radius = 10.0 ** random.uniform(0.5, 5.0)
    sweep = min(300.0 / radius, 1.2)
    c = _arc(radius, random.uniform(0.0, 0.5 * np.pi - sweep), sweep)[seed % 2]
    series = np.polynomial.Polynomial(c[:8])
    sign = float(np.sign(series(1.0) - series(0.0)))
    low = random.uniform(0.0, 0.5)
    ahead = int(np.floor(sign * series(low))) + 1
    goal = sign * float(series(1.0)) - 1e-9
    places, off = np.empty(PLACES), np.empty(PLACES)
    lines = int(np.ceil(goal)) - ahead
    if lines > 0:
        count = next_places(c, ahead, sign, low, goal, places, off)
        assert 1 <= count <= min(lines, PLACES)
        for k in range(count):
            root = brentq(series - sign * (ahead + k), low, 1.0, xtol=1e-15)
            assert abs(series(places[k]) - sign * (ahead + k)) <= CLOSE
            assert places[k] == pytest.approx(root, abs=2.0 * CLOSE / abs(series.deriv()(root)))
        if radius > 3e4 and abs(series.deriv()(low)) > 0.4 * radius * sweep:
            assert count == min(lines, PLACES)


@pytest.mark.parametrize("seed", range(share(20, 6)))
def test_rows_are_where_the_curve_leaves_the_square(seed: int) -> None:
    random = np.random.default_rng(seed)
    radius = 10.0 ** random.uniform(1.0, 4.0)
    sweep = min(300.0 / radius, 1.2)
    poly = _arc(radius, random.uniform(0.0, 0.5 * np.pi - sweep), sweep)
    ends = np.array([np.polynomial.Polynomial(c[:8])(1.0) for c in poly])
    grid = np.rint(poly[:, 0]).astype(np.int64)
    moves = Moves(np.zeros((1000, 2), np.int8), np.zeros(1000))
    point = grid.copy()
    rows, done, error = window_rows(poly, ends, 0.0, point, 0.0, 0, 1000, moves)
    assert done == 1.0
    assert error <= 0.5 + 1e-9
    x = 0.0
    for row in range(rows):
        leaves = []
        for c, g in zip(poly, grid.tolist(), strict=True):
            sign = np.sign(c[1])
            from_line = np.polynomial.Polynomial(c[:8]) - (g + sign)
            if sign * from_line(1.0) > 0.0:
                leaves.append(brentq(from_line, x, 1.0, xtol=1e-15))
        at = min(leaves)
        assert moves.s[row] == pytest.approx(at, abs=1e-7 / radius / sweep)
        here = np.array([np.polynomial.Polynomial(c[:8])(at) for c in poly])
        off = here - grid
        clear = np.abs(np.abs(off) - 0.5) > 1e-6
        assert (moves.step[row] == np.rint(off))[clear].all()
        grid += moves.step[row]
        x = at
    assert (grid == point).all()
