"""Turning points, bounding boxes, cusps and singular ends against dense sampling and closed
formulas.
"""

import math
from itertools import pairwise

import numpy as np
import pytest

from cnc.model.blocks import NurbsFeed
from cnc.path.chunk import bounding_box
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import MAX_TURNING_POINTS, SPAN, TABLE, curve_turning_points
from tests.support.path.path_cases import (
    arc,
    dense,
    ends,
    evaluate,
    evaluate_s,
    lines,
    nurbs_chunk,
    piece,
    random_nurbs,
    whole,
)
from tests.support.soak import share


def turning(chunk, k, axis):
    out = np.empty(MAX_TURNING_POINTS)
    return out[: curve_turning_points(*piece(chunk, k), axis, out)].copy()


def bezier(points, weights=None):
    points = np.array(points, float)
    degree = len(points) - 1
    knots = np.repeat([0.0, 1.0], degree + 1)
    return NurbsFeed(
        "part.nc",
        2,
        degree,
        knots,
        points,
        np.ones(degree + 1) if weights is None else np.array(weights, float),
        10.0,
    )


def check_turning(chunk, k, axis):
    """Check that the sampled derivative changes its sign at each turning point, and only there."""
    u0, u1 = ends(chunk, k)
    at = turning(chunk, k, axis)
    assert np.all((at > u0) & (at < u1)) and np.all(np.diff(at) > 0)
    slopes = np.array([evaluate(chunk, k, u)[1, axis] for u in np.linspace(u0, u1, 801)])
    tiny = 1e-9 * np.abs(slopes).max()
    signs = np.sign(np.where(np.abs(slopes) <= tiny, 0.0, slopes))
    told = signs[signs != 0]
    seen = int(np.sum(told[1:] != told[:-1]))
    assert len(at) >= seen
    if len(told) == len(signs):
        # Two turning points within one sampling step cancel out in the samples; one can hide only
        # where slopes are too small to tell.
        assert (len(at) - seen) % 2 == 0
    edges = np.concatenate(([u0], at, [u1]))
    for n, (a, b) in enumerate(pairwise(edges)):
        inside = np.array([evaluate(chunk, k, u)[1, axis] for u in np.linspace(a, b, 9)[1:-1]])
        inside = inside[np.abs(inside) > tiny]
        assert np.all(inside > 0) or np.all(inside < 0), (n, inside)


@pytest.mark.parametrize("degree", share([2, 3, 4, 5, 9], [2, 3, 9]))
@pytest.mark.parametrize("weights", [(1.0, 1.0), (0.1, 10.0), (1e-3, 1e3)])
def test_turning_points_of_spans(degree, weights):
    rng = np.random.default_rng(degree)
    for _ in range(share(60, 1)):
        chunk = nurbs_chunk(random_nurbs(rng, degree, degree + 4, weights=weights))
        for k in range(len(chunk)):
            for axis in range(3):
                check_turning(chunk, k, axis)


@pytest.mark.parametrize("mismatch", [0.0, 1e-4, 3.0, -9.99])
@pytest.mark.parametrize("turns", [0.9, -0.9, 0.1, -0.1, 2.7][:: share(1, 2)])
def test_turning_points_of_arcs(turns, mismatch):
    for begin in share((0.0, 0.3, math.pi / 2, 3.0), (0.3, math.pi / 2)):
        angle = begin + 2 * math.pi * turns
        start = [10 * math.cos(begin), 10 * math.sin(begin), 0.0]
        radius = 10 + mismatch
        chunk = whole(
            [arc([radius * math.cos(angle), radius * math.sin(angle), 1.0], (0, 0), turns)], start
        )
        for k in range(len(chunk)):
            for axis in range(3):
                check_turning(chunk, k, axis)


def test_turning_points_of_a_circle_are_its_quadrants():
    chunk = whole(
        [arc([math.cos(0.3), math.sin(0.3), 0.0], (0, 0), 1.0)], [math.cos(0.3), math.sin(0.3), 0.0]
    )
    assert turning(chunk, 0, 0) == pytest.approx([math.pi - 0.3, 2 * math.pi - 0.3], abs=1e-14)
    assert turning(chunk, 0, 1) == pytest.approx(
        [math.pi / 2 - 0.3, 1.5 * math.pi - 0.3], abs=1e-14
    )
    from_quadrant = whole([arc([1.0, 0.0, 0.0], (0, 0), 1.0)], [1.0, 0.0, 0.0])
    assert turning(from_quadrant, 0, 0) == pytest.approx([math.pi], abs=1e-14)


def test_a_double_root_is_no_turning_point():
    """x' = 3 (1 - 2t)^2 touches zero. A small change makes it cross zero twice, or not at all."""
    for pull, count in ((1.0, 0), (1.001, 2), (0.999, 0)):
        chunk = nurbs_chunk(bezier([[0, 0, 0], [1, 5, 0], [1 - pull, 9, 0], [2 - pull, 20, 0]]))
        assert len(chunk) == 1
        assert len(turning(chunk, 0, 0)) == count


@pytest.mark.parametrize("weights", [(1.0, 1.0), (0.1, 10.0)])
def test_boxes_against_dense_sampling(weights):
    rng = np.random.default_rng(23)
    blocks = [random_nurbs(rng, d, d + 5, weights=weights) for d in (1, 2, 3, 5, 9)]
    chunks = [nurbs_chunk(b) for b in blocks]
    arcs = [arc([0.0, 20.0, 1], (0, 10), 0.5), arc([0, 20.0, 1], (-7, 20), 1.0)]
    chunks.append(whole([lines([[1.0, -2, 3], [0, 0, 0]]), *arcs], [5.0, 5, 5]))
    chunks.append(whole([arc([0.0, 0, 25], (10.0, 0.0), -1.75, "YZ")], [0.0, 0, 3]))
    for chunk in chunks:
        low, high = bounding_box(chunk)
        assert low.shape == high.shape == (len(chunk), 3)
        for k in range(len(chunk)):
            points = dense(chunk, k, 1001)
            assert np.all(points.min(axis=0) >= low[k] - 1e-12) and np.all(
                points.max(axis=0) <= high[k] + 1e-12
            )
            step = np.abs(np.diff(points, axis=0)).max()
            assert np.all(points.min(axis=0) - low[k] <= step) and np.all(
                high[k] - points.max(axis=0) <= step
            )


def test_box_of_a_bulge():
    chunk = whole([arc([0.0, 10, 0], (0, 0), 0.25), arc([0.0, 10, 0], (0, 0), 1.0)], [10.0, 0, 0])
    low, high = bounding_box(chunk)
    assert low == pytest.approx(np.array([[0, 0, 0], [-10, -10, 0]]), abs=1e-14)
    assert high == pytest.approx(np.array([[10, 10, 0], [10, 10, 0]]), abs=1e-14)
    parabola = nurbs_chunk(bezier([[0, 0, 0], [1, 2, 0], [2, 0, 0]]))
    assert bounding_box(parabola)[1][0] == pytest.approx([2.0, 1.0, 0.0], abs=1e-15)


CUSP = [[0, 0, 0], [10, 10, 0], [0, 10, 0], [10, 0, 0]]
"""A cubic with crossed legs: x' = y' = 0 at t = 1/2."""


@pytest.mark.parametrize("weights", [[1, 1, 1, 1], [2, 2, 2, 2]])
def test_a_cusp_is_cut(weights):
    chunk = nurbs_chunk(bezier(CUSP, weights))
    assert len(chunk) == 2
    assert ends(chunk, 0)[1] == ends(chunk, 1)[0] == pytest.approx(0.5, abs=1e-9)
    assert chunk.length[0] == pytest.approx(chunk.length[1], rel=1e-9)
    status, q = evaluate_s(chunk, 0, ends(chunk, 0)[1])
    assert status == 1
    assert q[1:] == pytest.approx(np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]]), abs=1e-6)
    assert evaluate_s(chunk, 1, ends(chunk, 1)[0])[1][1] == pytest.approx([0, -1, 0], abs=1e-6)
    for k in range(2):
        s = np.linspace(0, chunk.length[k], 500)
        u = np.array([curve_inv_arclen(*piece(chunk, k), x) for x in s])
        assert np.all(np.diff(u) > 0) and np.isfinite(u).all()
        points = np.array([evaluate(chunk, k, x)[0] for x in u])
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        assert np.all(gaps <= s[1] * (1 + 1e-9) + 1e-9)


def test_a_rational_cusp_in_a_span_of_many():
    """The same cusp with projective weights, in the middle of a NURBS."""
    points = np.array(
        [[0, 0, 0], [10, 10, 0], [0, 10, 0], [10, 0, 0], [15, -3, 0], [20, 4, 0], [22, 4, 0]], float
    )
    knots = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2.0])
    chunk = nurbs_chunk(
        NurbsFeed("part.nc", 2, 3, knots, points, np.array([1, 3, 9, 27, 27, 27, 27.0]), 10.0)
    )
    assert len(chunk) == 3
    # with weights 1, 3, 9, 27 the parameter 3 t / (1 + 2 t) runs through the polynomial curve: the
    # cusp is where that is 1/2
    assert ends(chunk, 0)[1] == pytest.approx(0.25, abs=1e-7)
    assert evaluate_s(chunk, 0, ends(chunk, 0)[1])[0] == 1


def test_a_stall_without_a_turn_is_cut():
    """r' = 6 (1 - 2t)^2 along a line: the direction stays, but |dr/du| vanishes inside."""
    chunk = nurbs_chunk(bezier([[-1, -2, 0], [1, 2, 0], [-1, -2, 0], [1, 2, 0]]))
    assert len(chunk) == 2
    assert chunk.length == pytest.approx([math.sqrt(5)] * 2, rel=1e-9)
    for k, u in ((0, ends(chunk, 0)[1]), (1, ends(chunk, 1)[0])):
        status, q = evaluate_s(chunk, k, u)
        assert status == 1 and q[1] == pytest.approx(np.array([1, 2, 0]) / math.sqrt(5), abs=1e-9)


def test_a_hairpin_is_cut_at_its_tip():
    """The sharpest point of a very narrow loop lies at the end of a piece."""
    chunk = nurbs_chunk(bezier([[0, 0, 0], [10, 10, 0], [0.01, 10, 0], [10, 0, 0]]))
    assert len(chunk) == 2
    assert ends(chunk, 0)[1] == pytest.approx(0.5, abs=1e-3)
    status, _ = evaluate_s(chunk, 0, ends(chunk, 0)[1])
    assert status == 0


@pytest.mark.parametrize("repeats", [2, 3])
def test_repeated_control_points_at_the_ends(repeats):
    inner = [[4.0, 8.0, 1.0], [9.0, 2.0, 5.0]]
    points = [[0.0, 0, 0]] * repeats + inner + [[20.0, 1, 0]] * repeats
    chunk = nurbs_chunk(bezier(points))
    assert len(chunk) == 1 and chunk.kind[0] == SPAN
    towards = np.array(inner[0]) / np.linalg.norm(inner[0])
    status, q = evaluate_s(chunk, 0, 0.0)
    assert status == 1 and q[1] == pytest.approx(towards, abs=1e-12) and np.all(q[2:] == 0)
    arriving = np.array(points[-1]) - inner[1]
    status, q = evaluate_s(chunk, 0, 1.0)
    assert status == 1 and q[1] == pytest.approx(arriving / np.linalg.norm(arriving), abs=1e-12)
    s = np.linspace(0, chunk.length[0], 400)
    u = np.array([curve_inv_arclen(*piece(chunk, 0), x) for x in s])
    assert u[0] == 0 and u[-1] == 1 and np.all(np.diff(u) > 0)


@pytest.mark.parametrize("degree", [2, 3, 5, 9])
def test_a_line_from_a_standstill(degree):
    """All control points but the last are equal: s = L t^degree, so the inverse is known.

    No row of the table may be wasted on the start.
    """
    block = bezier([[-4.0, 42.0, 0.0]] * degree + [[-57.0, -95.0, 0.0]])
    chunk = nurbs_chunk(block)
    length = math.hypot(53, 137)
    assert chunk.length[0] == pytest.approx(length, rel=1e-14)
    for s in np.linspace(0, length, 200):
        assert length * curve_inv_arclen(*piece(chunk, 0), s) ** degree == pytest.approx(
            s, abs=1e-9
        )
    table = chunk.at[0] + int(chunk.data[chunk.at[0] + TABLE])
    assert chunk.data[table] < 300


def test_a_span_of_equal_points_vanishes():
    p = [1.0, 2.0, 3.0]
    points = np.array([p, p, p, p, [4, 4, 4], [6, 4, 4], [8, 5, 4]], float)
    knots = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2.0])
    chunk = nurbs_chunk(NurbsFeed("part.nc", 2, 3, knots, points, np.ones(7), 10.0))
    assert len(chunk) == 1
    assert ends(chunk, 0) == (1.0, 2.0)
