"""Enclosing lines and shortest normals, piece by piece, against an independent evaluation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from geomdl import NURBS
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.model.blocks import ArcFeed, NurbsFeed
from cnc.papers.enclosing_line import Algorithm, as_printed, fitted, interpolate
from cnc.path.kernels.curve import curve_range
from cnc.pulses.kernels.grid_moves import Piece
from cnc.pulses.kernels.windows import begin_window, following, new_window, next_window
from tests.support.papers.enclosing_line import (
    BARE,
    BOTH,
    Rows,
    check,
    check_squares,
    enclosing_line_rows,
    kiritsis_rows,
    nurbs,
    walk,
)
from tests.support.pulses.plans import FILE, arc, path_of, polyline, trident
from tests.support.soak import share


@BOTH
@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")  # next to cusps
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=share(400, 1))
def test_random_curves(generator: Rows, seed: int) -> None:
    """Degree 1 to 5, up to 40 control points, weights 0.1 to 10, two to five axes, BLU from 1e-4 to
    1 mm.
    """
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 6))
    axes = int(rng.choice([2, 2, 3, 4, 5]))
    block = nurbs(rng, axes, degree, int(rng.integers(degree + 1, share(41, 10))), 10.0)
    fine = 10.0 ** rng.uniform(0.0, 4.0)
    block.control_points[:] *= rng.uniform(0.5, 30.0) / fine
    check(generator, [block], block.control_points[0], fine * rng.uniform(0.3, 1.0, axes))


@BOTH
@pytest.mark.parametrize("seed", range(share(60, 1)))
def test_against_geomdl(generator: Rows, seed: int) -> None:
    """Every grid point is within half a BLU of the curve in each axis.

    Every point of the curve is within one BLU of a grid point.
    """
    rng = np.random.default_rng(seed)
    degree, axes = int(rng.integers(1, 6)), int(rng.integers(2, 4))
    block = nurbs(rng, axes, degree, int(rng.integers(degree + 1, 12)), 10.0)
    scale = rng.uniform(10.0, 30.0, axes)
    rows = walk(
        generator, path_of([block], block.control_points[0]), block.control_points[0], scale
    )
    curve = NURBS.Curve()
    curve.degree = degree
    curve.ctrlpts = block.control_points.tolist()
    curve.weights = block.weights.tolist()
    curve.knotvector = block.knots.tolist()
    points = np.array(curve.evaluate_list(np.linspace(0.0, 1.0, 20_001).tolist())) * scale
    dense = np.abs(np.diff(points, axis=0)).max()
    apart = np.abs(rows.grid[:, None] - points[None]).max(axis=2)
    assert apart.min(axis=1).max() <= 0.5 + dense
    assert apart.min(axis=0).max() <= 1.0 + 1e-6


@BOTH
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=share(400, 4))
def test_arcs_and_lines_of_any_size(generator: Rows, seed: int) -> None:
    """Sizes from 1 um to 1 m, BLU from 1e-4 to 1 mm and different for each axis, ends on and off
    the grid.
    """
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-3.0, 3.0)
    blu = min(max(size / 10.0 ** rng.uniform(-1.0, share(3.5, 2.5)), 1e-4), 1.0)
    axes = int(rng.integers(2, 5))
    start, center, end = rng.uniform(-1.0, 1.0, (3, axes)) * size
    scale = rng.uniform(0.3, 1.0, axes) / blu
    if rng.random() < 0.5:
        scale[:] = 1.0 / blu
        start, center, end = (np.round(2.0 * p / blu) * 0.5 * blu for p in (start, center, end))
    if rng.random() < 0.5 and np.hypot(*(start - center)[:2]) > 1e-3 * size:
        turns = float(rng.choice([1.0, -1.0, 0.25, rng.uniform(-1.5, 1.5)]))
        check(
            generator,
            [
                arc(
                    start,
                    (float(center[0]), float(center[1])),
                    turns,
                    rise=float(end[-1]) * (axes > 2),
                )
            ],
            start,
            scale,
        )
    elif np.abs(end - start).max() > 1e-6:
        check(generator, [polyline([end, center])], start, scale)


@pytest.mark.parametrize("seed", range(share(200, 1)))
def test_each_row_is_the_exit_from_the_square(seed: int) -> None:
    """All steps of a Bezier of degree 2 to 5, in order, by an independent walk."""
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(2, 6))
    axes = int(rng.integers(2, 5))
    block = nurbs(rng, axes, degree, degree + 1, 3.0)
    check_squares([block], block.control_points[0], rng.uniform(3.0, 60.0, axes), 4000)


@BOTH
@pytest.mark.parametrize("octant", range(0, 8, share(1, 3)))
@pytest.mark.parametrize("turns", [0.125, -0.125, 1.0, -0.7])
def test_arcs(generator: Rows, octant: int, turns: float) -> None:
    angle = octant * np.pi / 4
    center = (0.0137, -0.3)
    start = np.array([center[0] + 0.5 * np.cos(angle), center[1] + 0.5 * np.sin(angle)])
    check(generator, [arc(start, center, turns)], start, [100.0, 80.0])


@BOTH
def test_helix_spiral_and_lines(generator: Rows) -> None:
    start = np.array([1.0, 0.0, 0.0])
    check(generator, [arc(start, (0.0, 0.0), 1.25, rise=0.333)], start, 50.0)
    spiral = ArcFeed(FILE, 1, "XY", (0.0, 0.0), np.array([0.0, 1.2, 0.1]), 1.0, 0.25, 10.0)
    check(
        generator,
        [spiral, polyline([[0.3, -0.2, 0.5], [0.3, -0.2, 0.9], [0.7, 0.2, 0.5]])],
        start,
        [100.0, 70.0, 130.0],
    )


def test_a_line_steps_with_its_longest_axis() -> None:
    rows = check(enclosing_line_rows, [polyline([[0.9, 0.31, -0.07]])], np.zeros(3), 100.0)
    assert len(rows.step) == 90
    assert rows.step.sum(axis=0).tolist() == [90, 31, -7]


def test_the_circle_of_the_paper() -> None:
    """1 mm, BLU 0.001 mm: 8 cos(45 degrees) steps for a BLU of radius, the sum of the longer axes
    of the octants, none half a BLU off.
    """
    start = np.array([1.0, 0.0])
    for generator in (enclosing_line_rows, kiritsis_rows):
        rows = walk(
            generator, path_of([arc(start, (0.0, 0.0), 1.0)], start), start, np.full(2, 1000.0)
        )
        assert len(rows.step) == pytest.approx(8 * math.sqrt(0.5) * 1000, abs=2)
        assert 0.48 < rows.error <= 0.5
        radii = np.hypot(*rows.grid.T)
        assert np.abs(radii - 1000.0).max() <= 0.5
        assert (rows.grid[-1] == rows.grid[0]).all()


def test_as_printed() -> None:
    """The paper's procedure as printed works at BLU 0.001 mm.

    At 1 mm it makes a null step and is more than half a BLU off.
    """
    polynomial = fitted(*BARE["polynomial"])
    circle = path_of([arc([1.0, 0.0], (0.0, 0.0), 1.0)], [1.0, 0.0])
    for curve, rows, error in ((circle, 5656, 0.4999), (polynomial, 16185, 0.499999)):
        steps = as_printed(curve, 1000.0)
        baseline = as_printed(curve, 1000.0, Algorithm.KIRITSIS)
        assert len(steps.step) == len(baseline.step) == pytest.approx(rows, abs=1)
        assert steps.error_blu == pytest.approx(error, abs=2 * 10.0 ** -len(str(error)[2:]))
        assert 0.48 < baseline.error_blu < 0.5
        assert steps.null == baseline.null == 0
        assert (np.diff(steps.u) > 0.0).all()
    coarse = as_printed(polynomial, 1.0)
    assert coarse.null == 1 and coarse.error_blu == pytest.approx(0.534, abs=1e-3)


@pytest.mark.parametrize("radius", [10.0, 100.0, 1000.0])
def test_windows_stay_wide_however_far_from_the_origin(radius: float) -> None:
    """Rounding at a million BLU must not be mistaken for the polynomial's error, which narrower
    windows would reduce.
    """
    path = path_of([arc([radius, 0.0], (0.0, 0.0), 1.0)], [radius, 0.0])
    piece = Piece(int(path.kind[0]), path.data, int(path.at[0]), 0.0)
    u, u1 = curve_range(piece.kind, piece.data, piece.at)
    window = new_window(2)
    begin_window(piece, u, window)
    width = u1 - u
    windows = 0
    while u < u1:
        u, width, by_table = next_window(piece, u, u1, width, np.full(2, 1e4), window)
        assert not by_table
        window = following(window)
        windows += 1
        assert windows <= 80


@BOTH
def test_turning_inside_the_square(generator: Rows) -> None:
    """Waves a fraction of a BLU high, and hairpins narrower than the square."""
    for height in share((0.3, 0.49, 0.51, 0.7, 0.99, 1.01, 1.4), (0.49, 1.01)):
        points = np.array(
            [
                [0.0, 0.0],
                [1.0, height],
                [2.0, -height],
                [3.0, height],
                [4.0, -height],
                [5.0, height],
                [6.0, 0.0],
            ]
        )
        knots = np.concatenate((np.zeros(4), [0.25, 0.5, 0.75], np.ones(4)))
        check(generator, [NurbsFeed(FILE, 1, 3, knots, points, np.ones(7), 1.0)], [0.0, 0.0], 1.0)
        check(
            generator,
            [NurbsFeed(FILE, 1, 3, knots, points[:, ::-1] + 0.37, np.ones(7), 1.0)],
            [0.37, 0.37],
            [1.0, 2.0],
        )
        hairpin = np.array([[0.2, 0.1], [9.0, 0.1 + height], [9.0, 0.1 - height], [0.3, 0.4]])
        check(
            generator,
            [NurbsFeed(FILE, 1, 3, np.repeat([0.0, 1.0], 4), hairpin, np.ones(4), 1.0)],
            hairpin[0],
            1.0,
        )


@BOTH
def test_cusps_and_repeated_control_points(generator: Rows) -> None:
    knots = np.repeat([0.0, 1.0], 4)
    for points in (
        [[0.0, 0], [1, 1], [0, 1], [1, 0]],
        [[0.0, 0], [0, 0], [1, 1], [2, 0]],
        [[0.0, 0], [1, 1], [2, 0], [2, 0]],
    ):
        check(
            generator,
            [NurbsFeed(FILE, 1, 3, knots, np.array(points), np.ones(4), 1.0)],
            points[0],
            50.0,
        )
        check(
            generator,
            [NurbsFeed(FILE, 1, 3, knots, np.array(points), np.ones(4), 1.0)],
            points[0],
            [1.0, 3.0],
        )


@BOTH
def test_off_the_grid_and_closed(generator: Rows) -> None:
    """Ends off the grid, on half-grid lines, and at the start of the curve."""
    closed = trident()
    closed.control_points[-1] = closed.control_points[0]
    rows = check(generator, [closed], [10.0, 10.0], [10.0, 13.0])
    assert (rows.grid[0] == rows.grid[-1]).all()
    for size in (0.005, 0.0049, 0.0051, 0.015, 0.0151):
        rows = check(generator, [arc([size, 0.0], (0.0, 0.0), 1.0)], [size, 0.0], 100.0)
        assert (np.abs(rows.grid[-1] - rows.grid[0]) <= (1 if size in (0.005, 0.015) else 0)).all()
    assert not len(
        check(generator, [arc([0.0049, 0.0], (0.0, 0.0), 1.0)], [0.0049, 0.0], 100.0).step
    )


@pytest.mark.parametrize("noise", [0.0, 1e-13, -1e-13])
@BOTH
def test_an_axis_on_a_half_grid_line_is_quiet(generator: Rows, noise: float) -> None:
    rows = check(
        generator,
        [polyline([[0.1 * k, 0.005 + noise * (-1) ** k] for k in range(1, 9)])],
        [0.0, 0.005],
        100.0,
    )
    assert not rows.step[:, 1].any()
    rows = check(generator, [arc([0.0, 0.0, 0.005], (1.0, 0.0), 0.75)], [0.0, 0.0, 0.005], 100.0)
    assert not rows.step[:, 2].any()


@BOTH
def test_buffers_and_parts(generator: Rows) -> None:
    """Small buffers and a walk in parts give the same rows."""
    blocks = [trident(), polyline([[9.5, 1.0], [8.0, 0.73]]), arc([8.0, 0.73], (9.0, 0.7), 0.6)]
    whole = check(generator, blocks, [10.0, 10.0], [20.0, 31.0])
    for room in share((1, 7, len(whole.step)), (7,)):
        again = check(generator, blocks, [10.0, 10.0], [20.0, 31.0], room=room)
        if (
            generator is enclosing_line_rows
        ):  # where a normal's foot is taken to be hangs on where Newton's step began
            np.testing.assert_array_equal(again.step, whole.step)
            assert np.abs(again.reach - whole.reach).max() <= 1e-8
    check(generator, blocks, [10.0, 10.0], [20.0, 31.0], parts=37)


@pytest.mark.parametrize("algorithm", Algorithm)
@pytest.mark.parametrize("name", [*BARE][:: share(1, 2)])
def test_bare_curves(name: str, algorithm: Algorithm) -> None:
    """Curves of two functions: each grid point is within half a BLU when it is due, and the curve
    stays in the square until the next.
    """
    position, derivative, u0, u1 = BARE[name]
    curve = fitted(position, derivative, u0, u1)
    scale = np.array([70.0, 50.0, 90.0])[: len(curve.axes)]
    steps = interpolate(curve, scale, algorithm)
    assert steps.null == 0 and steps.error_blu <= 0.5 + 1e-8
    assert (np.diff(steps.u) >= 0.0).all()
    r = np.array([position(u) for u in steps.u.tolist()])
    assert np.abs(r * scale - steps.grid[1:]).max() <= 0.5 + 1e-5
    assert np.abs(np.array(position(u1)) * scale - steps.grid[-1]).max() <= 0.5 + 1e-5
    if algorithm is Algorithm.ENCLOSING_LINE:
        dense = np.linspace(u0, u1, 20001)
        held = steps.grid[np.searchsorted(steps.u, dense)]
        assert (
            np.abs(np.array([position(u) for u in dense.tolist()]) * scale - held).max()
            <= 1.0 + 1e-5
        )


def test_a_fitted_curve_is_the_curve() -> None:
    for name, pieces in (("polynomial", 1), ("cusp", 2)):
        position, derivative, u0, u1 = BARE[name]
        assert len(fitted(position, derivative, u0, u1)) == pieces
    with pytest.raises(ValueError, match="no length"):
        fitted(lambda u: [1.0, 2.0], lambda u: [0.0, 0.0], 0.0, 1.0)
    with pytest.raises(ValueError, match="one smooth curve"):
        as_printed(fitted(*BARE["knot in space"]), 10.0)
