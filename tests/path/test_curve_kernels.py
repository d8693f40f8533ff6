"""Position, derivatives, arc length and its inverse against SciPy, quadrature and closed
formulas.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from cnc.model.blocks import NurbsFeed
from cnc.path.kernels.arclength import curve_arclen, curve_inv_arclen
from cnc.path.kernels.curve import ARC, LINE, SPAN, curve_speed
from tests.support.path.path_cases import (
    XYZ,
    arc,
    dense,
    ends,
    evaluate,
    evaluate_s,
    lines,
    nurbs_chunk,
    nurbs_oracle,
    piece,
    random_nurbs,
    whole,
)
from tests.support.soak import share

TRIDENT = NurbsFeed(
    "part.nc",
    1,
    3,
    np.array([0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1.0]),
    np.array(
        [[10, 0, 0], [20, 20, 0], [12, 8, 0], [10, 20, 0], [8, 8, 0], [0, 20, 0], [10, 0, 0]], float
    ),
    np.ones(7),
    300.0,
)


def speed(chunk, k, u):
    """Return |dr/du| from the derivative of the position, over x y z."""
    return float(np.linalg.norm(evaluate(chunk, k, u)[1][:3]))


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 9])
@pytest.mark.parametrize("knots", ["random", "multiple", "full"])
def test_spans_are_the_nurbs(degree, knots):
    """The error is 1e-10 of each derivative's size over the span, since rounding grows with degree
    and weights. On a piece at a hairpin, 1e-5 of the parameter long, the third derivative keeps
    five digits (checked with 50 digits).
    """
    rng = np.random.default_rng([degree, len(knots)])
    for _ in range(share(40, 2)):
        block = random_nurbs(rng, degree, int(rng.integers(degree + 1, degree + 12)), knots=knots)
        chunk = nurbs_chunk(block)
        oracle = nurbs_oracle(block)
        assert (chunk.kind == SPAN).all()
        shortest = np.diff(np.unique(block.knots)).min()
        for k in range(len(chunk)):
            u0, u1 = ends(chunk, k)
            us = u0 + (u1 - u0) * np.linspace(0.01, 0.99, 9)
            expected = np.array([oracle(u) for u in us])
            got = np.array([evaluate(chunk, k, u) for u in us])
            size = np.abs(expected).max(axis=(0, 2))
            assert np.all(
                np.abs(got - expected).max(axis=(0, 2))
                <= 1e-10 * size + 1e-8 * size[1] / min(shortest, u1 - u0) ** np.arange(-1, 3)
            )
            assert np.abs(got[:, 0] - expected[:, 0]).max() < 1e-12 * 20 * 10


@pytest.mark.parametrize("weights", [(1.0, 1.0), (1e-3, 1e3)])
def test_ends_are_exact_and_pieces_join(weights):
    rng = np.random.default_rng(5)
    for degree in (1, 2, 3, 5, 9):
        block = random_nurbs(rng, degree, degree + 6, weights=weights)
        chunk = nurbs_chunk(block)
        assert np.array_equal(evaluate(chunk, 0, ends(chunk, 0)[0])[0], block.control_points[0])
        assert np.array_equal(
            evaluate(chunk, len(chunk) - 1, ends(chunk, len(chunk) - 1)[1])[0],
            block.control_points[-1],
        )
        for k in range(len(chunk) - 1):
            assert ends(chunk, k)[1] == ends(chunk, k + 1)[0]
            assert np.array_equal(
                evaluate(chunk, k, ends(chunk, k)[1])[0],
                evaluate(chunk, k + 1, ends(chunk, k + 1)[0])[0],
            )


def test_an_end_is_reached_without_a_jump():
    rng = np.random.default_rng(6)
    for degree in (2, 3, 9):
        chunk = nurbs_chunk(random_nurbs(rng, degree, degree + 4, weights=(1e-2, 1e2)))
        for k in range(len(chunk)):
            u1 = ends(chunk, k)[1]
            before = evaluate(chunk, k, np.nextafter(u1, -1))[0]
            assert (
                np.abs(before - evaluate(chunk, k, u1)[0]).max()
                < 1e-12 + 2e-16 * speed(chunk, k, u1) + 1e-12 * chunk.length[k]
            )


def test_an_axis_that_stands_still_stays_put():
    rng = np.random.default_rng(7)
    block = random_nurbs(rng, 3, 9)
    block.control_points[:, 2] = 0.1
    chunk = nurbs_chunk(block)
    for k in range(len(chunk)):
        assert np.all(dense(chunk, k, 50)[:, 2] == 0.1)
    straight = whole([lines([[1 / 3, 7.1, 0.3]])], [0.0, 7.1, 0.3])
    assert np.all(dense(straight, 0, 50)[:, 1:] == [7.1, 0.3])


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 9])
def test_arc_length_against_quadrature(degree):
    rng = np.random.default_rng(degree)
    for _ in range(share(20, 2)):
        chunk = nurbs_chunk(random_nurbs(rng, degree, degree + 3))
        for k in range(len(chunk)):
            u0, u1 = ends(chunk, k)
            cuts = np.linspace(u0, u1, 33)
            expected = [
                quad(lambda u, k=k, c=chunk: speed(c, k, u), a, b, epsabs=1e-12, epsrel=1e-12)[0]
                for a, b in pairwise(cuts)
            ]
            assert chunk.length[k] == pytest.approx(sum(expected), rel=1e-12, abs=1e-9)
            assert curve_arclen(*piece(chunk, k), u0, u1) == pytest.approx(
                chunk.length[k], rel=1e-14
            )
            for i in (0, 7, 20):
                assert curve_arclen(*piece(chunk, k), cuts[i], cuts[i + 1]) == pytest.approx(
                    expected[i], rel=1e-10, abs=1e-11
                )
                assert curve_arclen(*piece(chunk, k), cuts[i + 9], cuts[i]) == pytest.approx(
                    -sum(expected[i : i + 9]), rel=1e-12, abs=1e-9
                )
            middle = 0.5 * (u0 + u1)
            assert curve_speed(*piece(chunk, k), middle) == pytest.approx(
                speed(chunk, k, middle), rel=1e-12
            )


@pytest.mark.parametrize("accuracy", [1e-6, 1e-9, 1e-11])
def test_inverse_is_as_accurate_as_asked(accuracy):
    rng = np.random.default_rng(11)
    blocks = [
        random_nurbs(rng, d, d + 4, weights=w)
        for d in (1, 2, 3, 5, 9)
        for w in ((1.0, 1.0), (0.1, 10.0), (1e-3, 1e3))
    ]
    for block in [TRIDENT, *blocks]:
        chunk = nurbs_chunk(block, accuracy=accuracy)
        for k in range(len(chunk)):
            shape = piece(chunk, k)
            u0, u1 = ends(chunk, k)
            length = chunk.length[k]
            assert curve_inv_arclen(*shape, 0.0) == u0 and curve_inv_arclen(*shape, length) == u1
            assert (
                curve_inv_arclen(*shape, -1.0) == u0 and curve_inv_arclen(*shape, 2 * length) == u1
            )
            s = np.sort(rng.uniform(0, length, share(3000, 160)))
            u = np.array([curve_inv_arclen(*shape, x) for x in s])
            back = np.array([curve_arclen(*shape, u0, x) for x in u])
            # where |dr/du| is huge (weights that differ a million times) the digits of u itself are
            # the limit
            digits = 1e-15 * max(speed(chunk, k, u0), speed(chunk, k, u1)) * max(abs(u0), abs(u1))
            assert np.abs(back - s).max() <= accuracy + 1e-14 * length + digits
            far = np.diff(s) > 1e-9
            assert np.all(np.diff(u)[far] > 0.0)


def test_derivatives_by_arc_length():
    """|q'| = 1, q' . q'' = 0, and central differences over arc length agree with the next
    derivative.
    """
    rng = np.random.default_rng(13)
    for degree in (2, 3, 4, 9):
        chunk = nurbs_chunk(
            random_nurbs(rng, degree, degree + 3, weights=(0.5, 2.0)), accuracy=1e-12
        )
        for k in range(len(chunk)):
            shape = piece(chunk, k)
            for part in (0.2, 0.5, 0.8):
                s = part * chunk.length[k]
                status, q = evaluate_s(chunk, k, curve_inv_arclen(*shape, s))
                assert status == 0
                assert np.linalg.norm(q[1]) == pytest.approx(1.0, rel=1e-13)
                assert abs(q[1] @ q[2]) <= 1e-10 * np.linalg.norm(q[2]) + 1e-12
                h = 1e-3 / max(1.0, np.linalg.norm(q[2]), np.linalg.norm(q[3]) ** 0.5)
                ahead = evaluate_s(chunk, k, curve_inv_arclen(*shape, s + h))[1]
                behind = evaluate_s(chunk, k, curve_inv_arclen(*shape, s - h))[1]
                slope = (ahead - behind) / (2 * h)
                for order in (1, 2, 3):
                    assert np.abs(slope[order - 1] - q[order]).max() <= 1e-3 * (
                        1.0 + np.abs(q[order]).max()
                    )


def test_line():
    chunk = whole([lines([[3.0, 4.0, 0.0], [3.1, 4.0, 1e-7]])], [0.0, 0.0, 0.0])
    assert (chunk.kind == LINE).all()
    assert chunk.length == pytest.approx([5.0, math.hypot(0.1, 1e-7)], rel=1e-14)
    status, q = evaluate_s(chunk, 0, 2.5)
    assert status == 0
    assert q == pytest.approx(
        np.array([[1.5, 2.0, 0], [0.6, 0.8, 0], [0, 0, 0], [0, 0, 0]]), abs=1e-15
    )
    assert np.array_equal(evaluate(chunk, 1, ends(chunk, 1)[1])[0], [3.1, 4.0, 1e-7])
    assert curve_inv_arclen(*piece(chunk, 0), 1.25) == 1.25
    assert curve_arclen(*piece(chunk, 0), 1.0, 3.5) == 2.5


PLANES = [("XY", 0, 1, 2), ("ZX", 2, 0, 1), ("YZ", 1, 2, 0)]


@pytest.mark.parametrize(("plane", "i", "j", "k"), PLANES)
@pytest.mark.parametrize("turns", [0.25, -0.25, 0.5, -0.7, 1.0, -1.0, 0.001])
@pytest.mark.parametrize("rise", [0.0, 3.0])
def test_arcs_in_all_planes(plane, i, j, k, turns, rise):
    radius, begin = 10.0, 0.3
    start, end = np.zeros(3), np.zeros(3)
    start[i], start[j], start[k] = 2 + radius * math.cos(begin), -1 + radius * math.sin(begin), 5.0
    angle = 2 * math.pi * turns
    end[i], end[j], end[k] = (
        2 + radius * math.cos(begin + angle),
        -1 + radius * math.sin(begin + angle),
        5.0 + rise,
    )
    if abs(turns) == 1.0:
        end[i], end[j] = start[i], start[j]
    chunk = whole([arc(end, (2, -1), turns, plane)], start)
    assert list(chunk.kind) == [ARC]
    length = math.hypot(radius * angle, rise)
    assert chunk.length[0] == pytest.approx(length, rel=1e-13)
    u0, u1 = ends(chunk, 0)
    assert np.array_equal(evaluate(chunk, 0, u0)[0], start)
    assert np.array_equal(evaluate(chunk, 0, u1)[0], end)
    for part in (0.0, 0.1, 0.5, 0.9, 1.0):
        s = part * length
        q = evaluate_s(chunk, 0, curve_inv_arclen(*piece(chunk, 0), s))[1]
        phi, rate = begin + part * angle, angle / length
        expected = np.zeros((4, 3))
        expected[:, k] = [5.0 + part * rise, rise / length, 0, 0]
        expected[0, [i, j]] = 2 + radius * math.cos(phi), -1 + radius * math.sin(phi)
        expected[1, [i, j]] = -radius * rate * math.sin(phi), radius * rate * math.cos(phi)
        expected[2, [i, j]] = -radius * rate**2 * math.cos(phi), -radius * rate**2 * math.sin(phi)
        expected[3, [i, j]] = radius * rate**3 * math.sin(phi), -radius * rate**3 * math.cos(phi)
        assert q == pytest.approx(expected, abs=1e-12)


def test_several_turns_become_one_piece_each():
    chunk = whole([arc([-10.0, 0.0, 7.0], (0, 0), -3.5)], [10.0, 0.0, 0.0])
    assert len(chunk) == 4
    assert chunk.length.sum() == pytest.approx(math.hypot(7 * math.pi * 10, 7), rel=1e-13)
    for k in range(3):
        assert ends(chunk, k)[1] == ends(chunk, k + 1)[0]
        last, first = (
            evaluate(chunk, k, ends(chunk, k)[1]),
            evaluate(chunk, k + 1, ends(chunk, k + 1)[0]),
        )
        assert np.array_equal(last[0], first[0])
        assert last == pytest.approx(first, abs=1e-12)
    whole_turns = whole([arc([10.0, 0.0, 0.0], (0, 0), 3.0)], [10.0, 0.0, 0.0])
    assert len(whole_turns) == 3


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e6])
def test_arcs_of_any_size_end_where_they_should(radius):
    """Centre and end have the digits of a program. The end is exact and reached without a jump."""
    rng = np.random.default_rng(17)
    for _ in range(20):
        a, turns = rng.uniform(-3, 3), rng.uniform(-0.99, 0.99)
        digits = 9 if radius < 1 else 4
        start = np.round([radius * math.cos(a), radius * math.sin(a), 0.0], digits)
        b = a + 2 * math.pi * turns
        end = np.round([radius * math.cos(b), radius * math.sin(b), 1.0], digits)
        chunk = whole([arc(end, (0, 0), turns)], start)
        u0, u1 = ends(chunk, 0)
        assert np.array_equal(evaluate(chunk, 0, u1)[0], end)
        near = evaluate(chunk, 0, u1 - 1e-9 * (u1 - u0))
        assert (
            np.abs(near[0] + near[1] * 1e-9 * (u1 - u0) - end).max() < 4e-16 * radius * 20 + 1e-12
        )
        assert chunk.length[0] == pytest.approx(
            math.hypot(radius * 2 * math.pi * turns, 1.0), rel=1e-3
        )


@pytest.mark.parametrize("mismatch", [1e-6, 1e-3, 0.5, -0.5, -9.9])
def test_spirals_change_their_radius_evenly(mismatch):
    turns = 0.75
    angle = 2 * math.pi * turns
    end = np.array([0.0, -(10.0 + mismatch), 2.0])
    chunk = whole([arc(end, (0, 0), turns)], [10.0, 0.0, 0.0])
    assert np.array_equal(evaluate(chunk, 0, ends(chunk, 0)[1])[0], end)

    def exact(w):
        return np.array(
            [
                (10 + mismatch * w) * math.cos(angle * w),
                (10 + mismatch * w) * math.sin(angle * w),
                2 * w,
            ]
        )

    u0, u1 = ends(chunk, 0)
    for w in np.linspace(0, 1, 41):
        assert evaluate(chunk, 0, u0 + w * (u1 - u0))[0] == pytest.approx(exact(w), abs=1e-13 * 10)
    length = quad(
        lambda w: math.hypot(mismatch, (10 + mismatch * w) * angle, 2.0), 0, 1, epsabs=1e-13
    )[0]
    assert chunk.length[0] == pytest.approx(length, rel=1e-12)
    for s in np.linspace(0, length, 57):
        u = curve_inv_arclen(*piece(chunk, 0), s)
        assert curve_arclen(*piece(chunk, 0), u0, u) == pytest.approx(s, abs=1e-9)
        status, q = evaluate_s(chunk, 0, u)
        assert status == 0
        assert np.linalg.norm(q[1]) == pytest.approx(1.0, rel=1e-12)


def test_length_is_measured_over_the_axes_that_count():
    axes = ("x", "a", "y", "z", "u")
    start = [0.0, 0, 0, 0, 0]
    moves = [[3.0, 90, 4, 0, 1], [3, 180, 4, 0, 1], [3, 270, 4, 0, 4], [3, 270, 4, 1, 4]]
    chunk = whole([lines(moves)], start, axes)
    assert chunk.length == pytest.approx([5.0, 90.0, 3.0, 1.0])
    q = evaluate_s(chunk, 0, 2.0)[1]
    assert q[1] == pytest.approx([0.6, 18.0, 0.8, 0.0, 0.2])
    helix = whole([arc([0.0, 36, 10, 3, 0], (0, 0), 0.25)], [10.0, 0, 0, 0, 0], axes)
    assert helix.length[0] == pytest.approx(math.hypot(5 * math.pi, 3))
    assert evaluate(helix, 0, ends(helix, 0)[1] / 2)[0, 1] == pytest.approx(18.0)
    block = random_nurbs(np.random.default_rng(3), 3, 8, axes=5)
    spline = nurbs_chunk(block, axes)
    xyz = nurbs_chunk(
        NurbsFeed(
            "part.nc",
            7,
            3,
            block.knots,
            block.control_points[:, [0, 2, 3]].copy(),
            block.weights,
            10.0,
        ),
        XYZ,
    )
    assert spline.length == pytest.approx(xyz.length, rel=1e-12)
    oracle = nurbs_oracle(block)
    for u in (0.11, 0.5, 0.93):
        k = next(k for k in range(len(spline)) if ends(spline, k)[0] <= u <= ends(spline, k)[1])
        assert evaluate(spline, k, u)[0] == pytest.approx(oracle(u)[0], abs=1e-11)
