"""Distance between two motions, from dense points of both.

It is the larger of the two directed distances (Hausdorff distance).
"""

import numpy as np
from scipy.spatial import cKDTree

from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE, curve_eval, curve_range

NEAR = 6


def dense(points: np.ndarray, spacing: float) -> np.ndarray:
    """Return points along a polyline (k, 3): its vertices, and others at most ``spacing`` apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    counts = np.maximum(np.ceil(steps / spacing), 1.0).astype(int)
    each = np.repeat(np.arange(len(steps)), counts)
    within = (np.arange(len(each)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[each]
    inside = points[each] + within[:, None] * (points[each + 1] - points[each])
    return np.concatenate((inside, points[-1:]))


def farthest(points: np.ndarray, line: np.ndarray) -> float:
    """Return the largest distance of ``points`` (k, 3) from a polyline.

    ``line`` (m, 3) are the vertices of the polyline; they lie near to each other.
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
    """Return the distance between two polylines (k, 3), in both directions."""
    a, b = dense(one, spacing), dense(other, spacing)
    return max(farthest(a, b), farthest(b, a))


def path_points(chunk: PathChunk, tolerance: float = 1e-4) -> np.ndarray:
    """Return points (k, axes) along a path, by the kernel that makes the pulses."""
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
