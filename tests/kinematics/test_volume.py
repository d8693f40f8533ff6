"""The error of a volume: against nested splines of another library, its inverse and its series."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series
from cnc.kinematics.volume import Volume
from tests.support.soak import share


def some_volume(dice: np.random.Generator, *, flat: bool = False) -> Volume:
    """Return a volume; a flat one has one place along Z."""
    counts = dice.integers(2, 8, 3)
    counts[2] = 1 if flat else counts[2]
    grid = [np.cumsum(dice.uniform(15.0, 40.0, n)) - 100.0 for n in counts]
    return Volume(grid, dice.normal(0.0, 0.005, (*counts, 3)))


def inside(volume: Volume, dice: np.random.Generator, count: int) -> np.ndarray:
    return np.stack([dice.uniform(p[0] - 1e-3, p[-1] + 1e-3, count) for p in volume.grid], axis=1)


def natural(places, values, at):
    """Return the values at a place by scipy's splines; those of one place are constant."""
    if len(places) == 1:
        return values[0]
    return CubicSpline(places, values, bc_type="natural")(at)


@pytest.mark.parametrize("flat", [False, True])
def test_the_error_is_the_product_of_natural_splines(flat: bool) -> None:
    dice = np.random.default_rng(share(None, 1))
    for _ in range(10):
        volume = some_volume(dice, flat=flat)
        places = np.stack([dice.uniform(p[0], p[-1] + 1e-9, 20) for p in volume.grid], axis=1)
        expected = []
        for place in places:
            values = volume.errors
            for along, at in zip(volume.grid, place, strict=True):
                values = natural(along, values, at)
            expected.append(values)
        assert np.abs(volume.error(places) - expected).max() < 1e-12


def test_the_correction_undoes_the_error_at_the_points_and_back() -> None:
    dice = np.random.default_rng(share(None, 2))
    for _ in range(10):
        volume = some_volume(dice)
        points = np.stack(np.meshgrid(*volume.grid, indexing="ij"), axis=-1).reshape(-1, 3)
        sent = points - volume.correction(points)
        assert np.abs(sent + volume.error(sent) - points).max() < 1e-11
        places = inside(volume, dice, 100)
        places[50:] += dice.uniform(-10.0, 10.0, (50, 3))
        tips = volume.reached(places)
        assert np.abs(tips - volume.correction(tips) - places).max() < 1e-11


def test_values_and_two_derivatives_have_no_jump_at_the_borders_of_cells() -> None:
    dice = np.random.default_rng(share(None, 3))
    volume = some_volume(dice)
    for axis in range(3):
        places = inside(volume, dice, 30)
        places[:, axis] = dice.choice(volume.grid[axis], 30)
        step = np.zeros(3)
        step[axis] = 1e-3
        # Derivatives of each side by one-sided differences of a cubic.
        sides = [
            np.stack([volume.correction(places + sign * k * step) for k in range(4)])
            for sign in (1.0, -1.0)
        ]
        firsts, seconds = [], []
        for sign, v in zip((1.0, -1.0), sides, strict=True):
            firsts.append(sign * (-11.0 * v[0] + 18.0 * v[1] - 9.0 * v[2] + 2.0 * v[3]) / 6e-3)
            seconds.append((2.0 * v[0] - 5.0 * v[1] + 4.0 * v[2] - v[3]) / 1e-6)
        assert np.abs(firsts[0] - firsts[1]).max() < 1e-10
        assert np.abs(seconds[0] - seconds[1]).max() < 1e-7


def test_the_series_are_those_of_the_correction_along_a_path() -> None:
    """A path of second degree; the terms of order 0 to 8 give its values beside the place."""
    dice = np.random.default_rng(share(None, 4))
    volume = some_volume(dice)
    start = inside(volume, dice, 50)
    rates, bends = dice.normal(0.0, 1.0, (2, 50, 3))
    zero = np.zeros(50)
    tip = [Series([start[:, k], rates[:, k], bends[:, k], *[zero] * 6]) for k in range(3)]
    series = volume.series(tip, volume.cells(start, start, start))
    u = 1e-3
    near = start + rates * u + bends * u * u
    same = volume.cells(start, start, start).numbers == volume.cells(near, near, near).numbers
    value = np.stack([sum(t * u**k for k, t in enumerate(s.terms)) for s in series], axis=-1)
    assert same.all(axis=1).sum() > 40
    assert np.abs(value - volume.correction(near))[same.all(axis=1)].max() < 1e-15


def test_a_part_that_leaves_its_cell_has_no_bounds() -> None:
    volume = some_volume(np.random.default_rng(5))
    knot = float(volume.grid[0][1])
    start = np.array([[knot - 5.0, -90.0, -90.0], [knot - 5.0, -90.0, -90.0]])
    end = np.array([[knot, -90.0, -90.0], [knot + 1.0, -90.0, -90.0]])
    way = end[:, 0] - start[:, 0]
    tip = [
        Series([Interval(start[:, 0], end[:, 0]), Interval(way, way), *[0.0] * 7]),
        *(Series([Interval(start[:, k], start[:, k]), *[0.0] * 8]) for k in (1, 2)),
    ]
    series = volume.series(tip, volume.cells(start, 0.5 * (start + end), end))
    for correction in series:
        assert np.isfinite(correction.terms[-1].hi).tolist() == [True, False]
