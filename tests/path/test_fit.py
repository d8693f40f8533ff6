"""Fitted chains: smoothness, feeds, streaming, memory, and exact moves."""

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

from cnc.model.blocks import Dwell, Message, PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE, SPAN
from tests.support.path.fitted import (
    EPS,
    assert_sound,
    assert_within,
    blend,
    circle,
    fitted,
    pieces,
    sampled,
    terrain,
)
from tests.support.path.path_cases import XYZ, ends, evaluate, lines
from tests.support.soak import share


@pytest.mark.parametrize(
    ("points", "least"),
    [
        (circle(50, 0.15), 50),
        (circle(50, 0.15, 3), 50),
        (circle(2, 0.1), 5),
        (circle(0.5, 0.05, 3), 3),
        (terrain(rows=3), 7),
        (terrain(rows=3, digits=4), 6),
        (terrain(rows=3, uneven=True), 4),
        (terrain(rows=2, step=0.05), 20),
        (circle(2, 0.3), 1.5),
    ][:: share(1, 2)],
)
def test_a_span_covers_many_moves(points, least):
    chunks = fitted(points)
    assert (len(points) - 1) / sum(len(chunk) for chunk in chunks) >= least
    assert_sound(chunks)
    assert_within(chunks, points, EPS)
    # Inside the bend by d, a curve is shorter by d times the angle that it turns.
    steps = np.diff(points, axis=0)
    moved = np.linalg.norm(steps, axis=1)
    cosines = (steps[1:] * steps[:-1]).sum(axis=1) / (moved[1:] * moved[:-1])
    turned = np.arccos(np.clip(cosines, -1.0, 1.0)).sum()
    length = sum(chunk.length.sum() for chunk in chunks)
    assert length == pytest.approx(moved.sum(), abs=EPS * turned)


@pytest.mark.parametrize("step", [0.05, 0.15, 1.0, 5.0, 100.0])
@pytest.mark.parametrize("way", [(1, 0, 0), (0.6, 0.8, 0), (0.48, -0.64, 0.6)])
def test_a_straight_run_is_one_line(step, way):
    points = np.outer(np.append(np.arange(0, 100 - step / 2, step), 100), way) + [300, 20, -7]
    chunks = fitted(points)
    (chunk,) = chunks
    assert list(chunk.kind) == [LINE] and chunk.length == pytest.approx([100])
    assert np.array_equal(evaluate(chunk, 0, ends(chunk, 0)[1])[0], points[-1])


def line_arc_line(radius=10.0, chord=0.15, leg=50.0):
    a = np.linspace(0, np.pi / 2, int(np.ceil(radius * np.pi / 2 / chord)) + 1)
    bend = np.column_stack((leg + radius * np.sin(a), radius - radius * np.cos(a), 0 * a))
    return np.round(np.vstack(([0, 0, 0], bend, bend[-1] + [0, leg, 0])), 4)


@pytest.mark.parametrize("radius", [0.7, 2, 10, 100])
def test_lines_beside_an_arc_stay_lines(radius):
    points = line_arc_line(radius)
    chunks = fitted(points)
    everything = pieces(chunks)
    kinds = [chunk.kind[k] for chunk, k in everything]
    assert kinds[0] == kinds[-1] == LINE and set(kinds[1:-1]) == {SPAN}
    for chunk, k in (everything[0], everything[-1]):
        assert chunk.length[k] > 50 - 2 * np.sqrt(radius)
    assert_sound(chunks)
    assert_within(chunks, points, EPS)
    # The curve may swing out of the bend within the tolerance, once on either side. It has no
    # other waves: a bend of the other sense is at its ends alone.
    curve, _, _ = sampled(chunks, 50)
    step = np.diff(curve, axis=0)
    turn = step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0]
    moved = np.linalg.norm(step, axis=1)
    bend = turn / np.maximum(moved[:-1] * moved[1:] * 0.5 * (moved[:-1] + moved[1:]), 1e-300)
    bend = bend[np.abs(bend) > 1e-3 / radius]
    assert np.count_nonzero(np.diff(np.sign(bend))) <= 2


@pytest.mark.parametrize(
    ("turn", "legs"),
    [
        (turn, legs)
        for turn in (40.0, 60.0, 75.0, 90.0)
        for legs in ((8.0, 0.2), (0.2, 8.0), (0.3, 0.3))
        if turn < 80.0 or max(legs) < 1.0
    ],
)
@pytest.mark.parametrize("count", [1, 7])
def test_a_turn_with_a_short_leg_is_rounded(turn, legs, count):
    """A blend that fits into such a leg is slower than the spline, which is not bound to it."""
    a = np.radians(turn)
    u = np.array([[1, 0, 0], [np.cos(a), np.sin(a), 0]])
    first = np.outer(np.linspace(0, legs[0], count + 1), u[0])
    points = np.vstack((first, first[-1] + np.outer(np.linspace(0, legs[1], count + 1)[1:], u[1])))
    chunks = fitted(points)
    assert_sound(chunks)
    assert_within(chunks, points, EPS)
    assert sum((chunk.tolerance > 0).sum() for chunk in chunks) == 0


@pytest.mark.parametrize(("turn", "legs"), [(60.0, 1.0), (90.0, 0.5), (100.0, 0.2), (170.0, 0.2)])
def test_a_turn_with_long_legs_or_a_sharp_one_is_a_corner(turn, legs):
    a = np.radians(turn)
    step = legs * np.array([np.cos(a), np.sin(a), 0])
    chunks = fitted([[0, 0, 0], [legs, 0, 0], [legs, 0, 0] + step])
    assert sum((chunk.tolerance > 0).sum() for chunk in chunks) == 1


def test_corners_are_kept():
    square = np.array([[0, 0], [20, 0], [20, 20], [0, 20], [0, 0]])
    points = np.vstack(
        [a + np.outer(np.arange(0, 1, 0.01), b - a) for a, b in pairwise(square)] + [square[-1:]]
    )
    (chunk,) = fitted(np.column_stack((points, 0 * points[:, 0])))
    assert list(chunk.kind) == [LINE] * 4 and list(chunk.tolerance) == [EPS, EPS, EPS, 0]
    assert [tuple(evaluate(chunk, k, ends(chunk, k)[1])[0][:2]) for k in range(4)] == [
        (20, 0),
        (20, 20),
        (0, 20),
        (0, 0),
    ]


def test_beside_a_corner_the_path_is_straight_as_far_as_a_blend_needs():
    bow = circle(20, 0.4, turns=0.25)
    along = 0.5 * (bow[-1] - bow[-2]) / np.linalg.norm(bow[-1] - bow[-2])
    straight = bow[-1] + along * np.arange(1, 21)[:, None]
    aside = along @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    points = np.vstack((bow, straight, straight[-1] + aside * np.arange(1, 60)[:, None]))
    chunks = fitted(points)
    everything = pieces(chunks)
    (corner,) = [k for k, (chunk, i) in enumerate(everything) if chunk.tolerance[i] > 0]
    for chunk, k in everything[corner : corner + 2]:
        assert chunk.kind[k] == LINE and chunk.length[k] >= 4 * EPS / np.sin(np.pi / 4)
    assert_sound(chunks)
    assert_within(chunks, points, EPS)


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_moves_no_longer_than_their_rounding(digits):
    """Moves as short as the last digit turn by up to 90 degrees.

    A spline within the tolerance is smooth.
    """
    radius = 400 * 10.0**-digits
    points = circle(radius, 0.7 * 10.0**-digits, digits, 0.5)
    points = points[np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 0)]
    tolerance = 4 * 10.0**-digits
    chunks = fitted(points, tolerance=tolerance)
    assert_sound(chunks)
    assert_within(chunks, points, tolerance)
    assert sum((chunk.tolerance > 0).sum() for chunk in chunks) == 0


def test_each_stretch_has_its_own_feed():
    points = terrain(rows=2)
    rng = np.random.default_rng(2)
    feeds = rng.choice([10.0, 20.0, 25.0], len(points) - 1)
    feeds[200:400] = 30.0
    chunks = fitted(points, feeds)
    assert_sound(chunks)
    assert_within(chunks, points, EPS)
    curve, found, line = sampled(chunks)
    assert (np.diff(line) >= 0).all()
    middle = 0.5 * (points[:-1] + points[1:])
    for p, feed in list(zip(curve, found, strict=True))[:: share(7, 28)]:
        # the programmed feeds within reach of the point: near a vertex that of either side
        near = (
            np.linalg.norm(middle - p, axis=1)
            <= 0.5 * np.linalg.norm(np.diff(points, axis=0), axis=1) + 2 * EPS
        )
        assert feed in feeds[near]
    assert found[0] == feeds[0] and found[-1] == feeds[-1]


def test_moves_are_handed_out_before_the_last_and_memory_is_bounded():
    def stream(count):
        yield blend()
        for k in range(count):
            t = (k * 1000 + np.arange(1, 1001)) * 0.01
            yield lines(np.column_stack((t, np.sin(t), np.cos(0.3 * t))), line=1 + 1000 * k)
            nonlocal read
            read = k

    read = 0
    path = build(stream(100), axes=XYZ, start=np.array([0, 0, 1.0]))
    next(path)
    assert read < 60
    for _ in build(stream(10), axes=XYZ, start=np.array([0, 0, 1.0])):
        pass
    tracemalloc.start()
    for _ in build(stream(share(1000, 150)), axes=XYZ, start=np.array([0, 0, 1.0])):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6


def test_a_speck_without_end_is_bounded_too():
    rng = np.random.default_rng(4)

    def stream():
        yield blend()
        for _ in range(share(40, 10)):
            yield lines(rng.normal(size=(4000, 3)) * 1e-4)

    path = list(build(stream(), axes=XYZ, start=np.zeros(3)))
    assert sum(chunk.length.sum() for chunk in path) < 1.0


@pytest.mark.parametrize("run", [7, 100, 1000])
def test_blocks_of_any_length_make_the_same_within_the_tolerance(run):
    points = terrain(rows=3)
    chunks = fitted(points, run=run)
    assert_sound(chunks)
    assert_within(chunks, points, EPS)
    whole = fitted(points)
    assert sum(map(len, chunks)) == sum(map(len, whole))


def test_windows_go_on_smoothly():
    points = np.round(circle(200, 0.1, 8, 2.0), 4)
    chunks = fitted(points)
    assert len(points) > 5 * 4096
    assert_sound(chunks)
    curve, _, _ = sampled(chunks)
    assert np.abs(np.hypot(*curve.T[:2]) - 200).max() <= EPS
    assert sum((chunk.tolerance > 0).sum() for chunk in chunks) == 0


@pytest.mark.parametrize(
    "mode",
    [
        [],
        [PathMode("part.nc", 1, "exact-path")],
        [PathMode("part.nc", 1, "exact-stop")],
        [blend(0.0)],
    ],
)
def test_without_a_tolerance_the_path_is_exact(mode):
    points = circle(5, 0.15)
    (chunk,) = build([*mode, lines(points[1:])], axes=XYZ, start=points[0])
    assert set(chunk.kind) == {LINE} and len(chunk) == len(points) - 1


def test_what_ends_a_chain():
    points = circle(5, 0.15)
    half = len(points) // 2
    first, second = lines(points[1:half]), lines(points[half:])
    for between, stops in [
        ([Dwell("part.nc", 5, 0.1)], 2),
        ([Message("part.nc", 5, "on")], 1),
        ([blend(0.02)], 1),
    ]:
        items = list(build([blend(), first, *between, second], axes=XYZ, start=points[0]))
        chunks = [item for item in items if isinstance(item, PathChunk)]
        assert sum(chunk.stop_after.sum() for chunk in chunks) == stops
        starts = [evaluate(chunk, k, ends(chunk, k)[0])[0] for chunk, k in pieces(chunks)]
        assert any(np.array_equal(start, points[half - 1]) for start in starts)
    feeds = np.full(len(points) - 1, 25.0)
    feeds[half] = np.nan
    chunks = fitted(points, feeds)
    ((chunk, k),) = [(chunk, k) for chunk, k in pieces(chunks) if np.isnan(chunk.feed[k])]
    assert chunk.kind[k] == LINE and np.array_equal(
        evaluate(chunk, k, ends(chunk, k)[0])[0], points[half]
    )
