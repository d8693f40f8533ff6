"""Fitted chains: their points, and the distances between them and the programmed moves."""

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.path.kernels.curve import LINE
from tests.support.path.path_cases import XYZ, ends, evaluate, evaluate_s, lines

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


def distances(points, polygon, enough=0.0):
    """Return the distance of each point from the polygon, by brute force.

    A distance of up to ``enough`` may be that from the sides beside a near vertex only, which is
    an upper bound.
    """
    a, along = polygon[:-1], np.diff(polygon, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-300)

    def from_sides(points, a, along, squared):
        x = np.clip(((points - a) * along).sum(axis=-1) / squared, 0.0, 1.0)
        return np.linalg.norm(points - (a + x[..., None] * along), axis=-1)

    _, near = cKDTree(polygon).query(points, k=min(3, len(polygon)))
    near = near.reshape(len(points), -1)
    sides = np.clip(np.concatenate((near - 1, near), axis=1), 0, len(along) - 1)
    best = from_sides(points[:, None], a[sides], along[sides], squared[sides]).min(axis=1)
    for k in np.flatnonzero(best > enough):
        best[k] = from_sides(points[k], a, along, squared).min()
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
        distances(curve[:, :3], points, tolerance).max()
        <= tolerance * (1 + 1e-9) + 1e-12 * np.abs(points).max()
    )
    assert (
        distances(inside.reshape(-1, 3), curve[:, :3], tolerance).max()
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
