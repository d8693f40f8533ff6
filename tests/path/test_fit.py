"""Fitted chains: distances, ends, smoothness, feeds, streaming, memory, and exact moves."""

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.kernels.path.curve import ARC, LINE, SPAN
from cnc.model.blocks import Dwell, Message, PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from tests.support.path.path_cases import XYZ, arc, ends, evaluate, evaluate_s, lines
from tests.support.soak import share

EPS = 0.01
ALL = ("x", "y", "z", "a", "b", "c", "u", "v", "w")


def blend(tolerance=EPS):
    return PathMode("part.nc", 1, "blend", tolerance)


def fitted(points, feeds=25.0, tolerance=EPS, axes=XYZ, run=4096):
    """Return the chunks of a polyline that begins at points[0], in blocks of ``run`` moves."""
    points = np.asarray(points, float)
    feeds = np.broadcast_to(np.asarray(feeds, float), len(points) - 1)
    blocks = [blend(tolerance)]
    blocks += [
        lines(points[1 + k : 1 + k + run], feeds[k : k + run], 1 + k)
        for k in range(0, len(points) - 1, run)
    ]
    return list(build(blocks, axes=axes, start=points[0]))


def pieces(chunks):
    return [(chunk, k) for chunk in chunks for k in range(len(chunk))]


def sampled(chunks, count=64):
    """Return points along all pieces, the feed at each, and the source line."""
    points, feeds, line = [], [], []
    for chunk, k in pieces(chunks):
        count_here = 2 if chunk.kind[k] == LINE else count
        points += [evaluate(chunk, k, u)[0] for u in np.linspace(*ends(chunk, k), count_here)]
        feeds += [chunk.feed[k]] * count_here
        line += [chunk.line[k]] * count_here
    return np.array(points), np.array(feeds), np.array(line)


def distances(points, polygon):
    """Return the distance of each point from the polygon, by brute force."""
    a, along = polygon[:-1], np.diff(polygon, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-300)
    best = np.full(len(points), np.inf)
    for first in range(0, len(points), 256):
        p = points[first : first + 256, None]
        x = np.clip(((p - a) * along).sum(axis=2) / squared, 0.0, 1.0)
        best[first : first + 256] = np.linalg.norm(p - (a + x[..., None] * along), axis=2).min(
            axis=1
        )
    return best


def assert_within(chunks, points, tolerance):
    """Check both distances over x y z.

    Between samples the spline is off its chord by its sagitta, which gets a part of the tolerance.
    """
    curve, _, _ = sampled(chunks)
    points = np.asarray(points)[:, :3]
    inside = (
        points[:-1, None] + np.linspace(0, 1, 5)[None, :, None] * np.diff(points, axis=0)[:, None]
    )
    assert (
        distances(curve[:, :3], points).max()
        <= tolerance * (1 + 1e-9) + 1e-12 * np.abs(points).max()
    )
    assert (
        distances(inside.reshape(-1, 3), curve[:, :3]).max()
        <= 1.02 * tolerance + 1e-12 * np.abs(points).max()
    )


def assert_sound(chunks):
    """Check that the curve has no gap, is smooth except at corners, and is finite."""
    for chunk in chunks:
        assert (
            np.isfinite(chunk.data).all()
            and (chunk.length > 0).all()
            and np.isfinite(chunk.length).all()
        )
    everything = pieces(chunks)
    whole = sum(chunk.length.sum() for chunk in chunks)
    for (a, i), (b, j) in pairwise(everything):
        left, right = evaluate(a, i, ends(a, i)[1])[0], evaluate(b, j, ends(b, j)[0])[0]
        assert np.array_equal(left, right)
        if a.tolerance[i] == 0.0:
            faults, left = evaluate_s(a, i, ends(a, i)[1])
            more, right = evaluate_s(b, j, ends(b, j)[0])
            assert faults == more == 0
            size = min(a.length[i], b.length[j])
            # Derivatives are differences of coordinates, by differences of lengths along the chain.
            # Both are rounded: at 1 km by 1e-10 mm. A second derivative is 20 second differences of
            # four roundings, on either side.
            rounding = 320.0 * np.spacing(max(np.abs(left[0]).max(), whole)) / size
            assert np.abs(left[1] - right[1]).max() <= 1e-6 + rounding
            assert (
                np.abs(left[2] - right[2]).max() * size
                <= 1e-6 + 1e-12 / size + 1e-5 * np.abs(left[2]).max() * size + rounding
            )


def circle(radius, chord, digits=4, turns=1.0):
    t = np.linspace(0, 2 * np.pi * turns, round(2 * np.pi * radius * turns / chord) + 1)
    return np.round(np.column_stack((radius * np.cos(t), radius * np.sin(t), 0 * t)), digits)


def terrain(rows=5, length=60.0, step=0.15, over=1.0, digits=3, uneven=False):
    """Return rows over a surface of sines, joined by half circles."""
    rng, parts, radius = np.random.default_rng(1), [], over / 2
    for row in range(rows):
        x = np.arange(0.0, length + 1e-9, step)
        if uneven:
            x = np.cumsum(rng.uniform(0.02, 0.5, int(length / 0.26)))
            x *= length / x[-1]
        a = np.linspace(-np.pi / 2, np.pi / 2, max(3, int(np.pi * radius / step)))[1:-1]
        x, y = (
            np.append(x, length + radius * np.cos(a)),
            np.append(0 * x, radius + radius * np.sin(a)) + row * over,
        )
        parts.append(np.column_stack((x if row % 2 == 0 else length - x, y)))
    x, y = np.concatenate(parts).T
    return np.round(
        np.column_stack((x, y, 3 * np.sin(x / 7 + 0.3 * np.sin(y / 5)) * np.cos(y / 9))), digits
    )


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
    ],
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
    points = np.vstack(
        (
            bow,
            bow[-1]
            + (bow[-2] - bow[-1]) @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] * np.arange(1, 60)[:, None],
        )
    )
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


def random_points(rng, count, axes):
    """Return random walks with all hard cases: noise, repeated points, spikes, loops, reversals,
    leaps, tiny moves.
    """
    points = [rng.uniform(-50, 50, axes)]
    heading = rng.normal(size=axes)
    while len(points) < count:
        here, many = points[-1], int(rng.integers(1, 40))
        size = 10 ** rng.uniform(-3, 0.5)
        heading /= np.linalg.norm(heading)
        match rng.integers(0, 9):
            case 0 | 1 | 2:
                turn = np.linalg.qr(
                    np.eye(axes) + rng.normal(size=(axes, axes)) * 10 ** rng.uniform(-3, -0.5)
                )[0]
                turn *= np.sign(np.diag(turn))
                for _ in range(many):
                    heading = turn @ heading
                    points.append(points[-1] + size * rng.uniform(0.1, 1.0) * heading)
            case 3:
                points += list(
                    here
                    + size * np.outer(np.arange(1, many + 1), heading)
                    + rng.normal(size=(many, axes)) * 10 ** rng.uniform(-6, -2)
                )
            case 4:
                points += [here] * many
            case 5:
                points += [here + size * rng.normal(size=axes), here]
            case 6:
                points.append(here + 1e-3 * heading)
            case 7:
                points.append(here + rng.choice([1.0, 30.0, 1e3, 1e6]) * heading)
            case 8:
                points += list(here + 10 ** rng.uniform(-4, -1) * rng.normal(size=(many, axes)))
    points = np.array(points[:count])
    return np.round(points, int(rng.integers(2, 6))) if rng.random() < 0.7 else points


@settings(max_examples=share(3000, 15), deadline=None)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(2, 250),
    axes=st.integers(1, 3),
    tolerance=st.floats(-3.5, -1),
)
def test_random_chains(seed, count, axes, tolerance):
    rng = np.random.default_rng(seed)
    points, tolerance = random_points(rng, count, axes), 10**tolerance
    runs = 10 ** rng.uniform(0.5, 2)
    feeds = 10.0 + (np.arange(count - 1) // runs) % 3
    chunks = fitted(points, feeds, tolerance, XYZ[:axes])
    if not np.abs(np.diff(points, axis=0)).max() > 1e-9:
        return
    assert_sound(chunks)
    padded = np.column_stack((points, np.zeros((count, 3 - axes))))
    everything = pieces(chunks)
    curve, _, _ = sampled(chunks)
    curve = np.column_stack((curve, np.zeros((len(curve), 3 - axes))))
    slack = 1e-12 * np.abs(points).max() + 2e-9
    inside = (
        padded[:-1, None] + np.linspace(0, 1, 4)[None, :, None] * np.diff(padded, axis=0)[:, None]
    )
    assert distances(curve, padded).max() <= tolerance * (1 + 1e-9) + slack
    assert distances(inside.reshape(-1, 3), curve).max() <= 1.02 * tolerance + slack
    assert np.array_equal(evaluate(*everything[0], ends(*everything[0])[0])[0], points[0])
    assert evaluate(*everything[-1], ends(*everything[-1])[1])[0] == pytest.approx(
        points[-1], abs=1.1e-9
    )


@settings(max_examples=share(500, 5), deadline=None)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(2, 150),
    axes=st.sampled_from([("x", "a"), ("x", "y", "z", "b", "c"), ALL, ("a",)]),
)
def test_other_axes_follow_within_the_tolerance(seed, count, axes):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.02, 0.3, count))
    waves, phase = rng.uniform(2, 9, len(axes)), rng.uniform(0, 6, len(axes))
    points = np.round(5 * np.sin(t[:, None] / waves + phase), 3)
    if rng.random() < 0.3:
        points[:, rng.integers(0, len(axes))] = 7.0
    if rng.random() < 0.3:
        points[count // 2 :, 0] = points[count // 2, 0]
    chunks = fitted(points, tolerance=EPS, axes=axes)
    if not chunks:
        return
    curve, _, _ = sampled(chunks)
    linear, others = (
        [k for k, axis in enumerate(axes) if axis in "xyz"],
        [k for k, axis in enumerate(axes) if axis not in "xyz"],
    )

    def apart(p, polygon):
        """Return the larger of the distance over x y z and that of each other axis, from dense
        points of the polygon.
        """
        count = 2 + int(np.abs(np.diff(polygon, axis=0)).max() / (0.2 * EPS))
        dense = (
            polygon[:-1, None]
            + np.linspace(0, 1, count)[None, :, None] * np.diff(polygon, axis=0)[:, None]
        ).reshape(-1, len(axes))
        worst = 0.0
        for row in p:
            gap = np.abs(dense - row)
            worst = max(
                worst,
                np.maximum(
                    np.linalg.norm(gap[:, linear], axis=1), gap[:, others].max(axis=1, initial=0.0)
                ).min(),
            )
        return worst

    assert apart(curve[:: max(1, len(curve) // 60)], points) <= 1.1 * EPS
    assert apart(points[:: max(1, count // 20)], curve) <= 1.1 * EPS
    assert_sound(chunks)


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
        for _ in range(40):
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
    (chunk,) = build(
        [
            blend(),
            first,
            arc(points[half - 1] + [0, 1, 0], points[half - 1][:2] + [0, 0.5], 0.5),
            second,
        ],
        axes=XYZ,
        start=points[0],
    )
    assert ARC in chunk.kind
