"""Points along a path at a given spacing, for users of its shape alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import LENGTH, LINE, START, U0, U1, curve_eval
from cnc.path.chunk import PathChunk
from cnc.path.records import Floats

Ints = NDArray[np.int64]


def points_along(
    chunk: PathChunk, spacing: float | Floats, pieces: Ints | None = None
) -> tuple[Floats, Ints]:
    """Return points (k, n) of a chunk, and the index (k,) of the piece on which each lies.

    Each piece gives points inside and its end. Its start is the end of the piece before.

    Args:
        chunk: the path.
        spacing: largest distance of points in mm of arc length, one or (m,); on arcs and spans it
            holds about.
        pieces: indices of the pieces; all of them without it.
    """
    chosen = np.arange(len(chunk)) if pieces is None else pieces
    n = len(chunk.axes)
    at = chunk.at[chosen]
    parts = np.maximum(np.ceil(chunk.data[at + LENGTH] / spacing), 1.0).astype(np.int64)
    owner = np.repeat(np.arange(len(chosen)), parts)
    first = np.cumsum(parts) - parts
    share = (np.arange(len(owner)) - first[owner] + 1) / parts[owner]
    columns = at[:, None] + START + np.arange(2 * n)
    ends = chunk.data[columns]
    points = ends[owner, :n] + share[:, None] * (ends[owner, n:] - ends[owner, :n])
    out = np.empty((4, n))
    for index in np.flatnonzero(chunk.kind[chosen] != LINE).tolist():
        kind, record = int(chunk.kind[chosen[index]]), int(at[index])
        u0, u1 = float(chunk.data[record + U0]), float(chunk.data[record + U1])
        for row in range(int(first[index]), int(first[index] + parts[index])):
            curve_eval(kind, chunk.data, record, u0 + float(share[row]) * (u1 - u0), out)
            points[row] = out[0]
    return points, chosen[owner]
