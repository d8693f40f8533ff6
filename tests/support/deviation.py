"""How far two motions are from each other, by dense points of both: the larger of both directed
distances.
"""

import numpy as np
from scipy.spatial import cKDTree

from cnc.kernels.path.curve import LINE, curve_eval, curve_range
from cnc.path.chunk import PathChunk

NEAR = 6


def dense(points: np.ndarray, spacing: float) -> np.ndarray:
    """Points along a polyline (k, 3), at most ``spacing`` apart, its vertices among them."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    counts = np.maximum(np.ceil(steps / spacing), 1.0).astype(int)
    each = np.repeat(np.arange(len(steps)), counts)
    within = (np.arange(len(each)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[each]
    inside = points[each] + within[:, None] * (points[each + 1] - points[each])
    return np.concatenate((inside, points[-1:]))


def farthest(points: np.ndarray, line: np.ndarray) -> float:
    """The largest distance of a point (k, 3) from the polyline through ``line`` (m, 3), whose
    points lie near to each other.
    """
    tree = cKDTree(line)
    nearest = tree.query(points, k=min(NEAR, len(line)))[1].reshape(len(points), -1)
    best = np.full(len(points), np.inf)
    for column in nearest.T:
        for begin in (np.maximum(column - 1, 0), np.minimum(column, len(line) - 2)):
            a, d = line[begin], line[begin + 1] - line[begin]
            square = np.einsum("ij,ij->i", d, d)
            t = np.clip(
                np.einsum("ij,ij->i", points - a, d) / np.where(square > 0.0, square, 1.0), 0.0, 1.0
            )
            best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * d, axis=1))
    return float(best.max())


def deviation(one: np.ndarray, other: np.ndarray, spacing: float = 0.05) -> float:
    """Of two polylines (k, 3) from each other, in both directions."""
    a, b = dense(one, spacing), dense(other, spacing)
    return max(farthest(a, b), farthest(b, a))


def path_points(chunk: PathChunk, tolerance: float = 1e-4) -> np.ndarray:
    """Points (k, axes) along a path, from the kernel that the pulses are made with."""
    rows = []
    for k in range(len(chunk)):
        kind, at, length = int(chunk.kind[k]), int(chunk.at[k]), float(chunk.length[k])
        u0, u1 = curve_range(kind, chunk.data, at)
        count = 1 if kind == LINE else int(np.clip(length / 0.01, 16, 4000))
        out = np.empty((4, len(chunk.axes)))
        for u in np.linspace(u0, u1, count + 1)[(k > 0) :].tolist():
            curve_eval(kind, chunk.data, at, float(u), out)
            rows.append(out[0].copy())
    return np.array(rows)
