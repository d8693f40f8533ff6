"""Blocks for the tests of the path, and independent evaluations of them."""

import numpy as np
from scipy.interpolate import BSpline

from cnc.model.blocks import ArcFeed, NurbsFeed, Polyline
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_eval, curve_eval_s, curve_range

XYZ = ("x", "y", "z")


def random_nurbs(rng, degree, count, axes=3, weights=(0.1, 10.0), size=20.0, knots="random"):
    """Return a clamped NURBS block.

    Knots are "random" (inside), "multiple" (some doubled) or "full" (some of multiplicity degree).
    """
    inner = count - degree - 1
    values = np.sort(rng.uniform(0.05, 0.95, inner))
    if knots == "multiple" and degree > 1:
        values[1::2] = values[: len(values[1::2]) * 2 : 2]
    if knots == "full" and inner >= degree:
        values[:degree] = values[degree - 1]
        values.sort()
    knots = np.concatenate((np.zeros(degree + 1), values, np.ones(degree + 1)))
    points = rng.uniform(-size, size, (count, axes))
    w = np.exp(rng.uniform(*np.log(weights), count))
    return NurbsFeed("part.nc", 7, degree, knots, points, w, 10.0)


def nurbs_oracle(block):
    """Return a function u -> (4, n): position and three derivatives by SciPy's B-splines in
    homogeneous coordinates and the quotient rule.
    """
    homogeneous = np.column_stack((block.weights, block.weights[:, None] * block.control_points))
    spline = BSpline(block.knots, homogeneous, block.degree)

    def evaluate(u):
        h = np.array([spline(u, k) for k in range(4)])
        w, a = h[:, :1], h[:, 1:]
        r = np.empty_like(a)
        r[0] = a[0] / w[0]
        r[1] = (a[1] - w[1] * r[0]) / w[0]
        r[2] = (a[2] - 2 * w[1] * r[1] - w[2] * r[0]) / w[0]
        r[3] = (a[3] - 3 * w[1] * r[2] - 3 * w[2] * r[1] - w[3] * r[0]) / w[0]
        return r

    return evaluate


def whole(blocks, start, axes=XYZ, accuracy=1e-9):
    """Return the single chunk of a few moving blocks."""
    chunks = list(build(blocks, axes=axes, start=np.array(start, float), accuracy=accuracy))
    assert len(chunks) == 1 and isinstance(chunks[0], PathChunk)
    return chunks[0]


def nurbs_chunk(block, axes=XYZ, accuracy=1e-9):
    return whole([block], block.control_points[0], axes, accuracy)


def lines(points, feeds=10.0, line=1):
    """Return a polyline block; feeds are a number, or one for each move."""
    points = np.array(points, float)
    feeds = np.broadcast_to(np.array(feeds, float), len(points)).copy()
    return Polyline(
        "part.nc", line, points, feeds, np.arange(line, line + len(points), dtype=np.int32)
    )


def arc(end, center, turns, plane="XY", line=3):
    return ArcFeed(
        "part.nc",
        line,
        plane,
        (float(center[0]), float(center[1])),
        np.array(end, float),
        0.0,
        turns,
        10.0,
    )


def piece(chunk, k):
    """Return (kind, data, at) of piece k, as the kernels take them."""
    return int(chunk.kind[k]), chunk.data, int(chunk.at[k])


def evaluate(chunk, k, u):
    out = np.empty((4, len(chunk.axes)))
    curve_eval(*piece(chunk, k), float(u), out)
    return out


def evaluate_s(chunk, k, u):
    out = np.empty((4, len(chunk.axes)))
    status = curve_eval_s(*piece(chunk, k), float(u), out)
    return status, out


def ends(chunk, k):
    u0, u1 = curve_range(*piece(chunk, k))
    return float(u0), float(u1)


def dense(chunk, k, count=2001):
    """Return positions (count, n) at even steps of the parameter."""
    return np.array([evaluate(chunk, k, u)[0] for u in np.linspace(*ends(chunk, k), count)])
