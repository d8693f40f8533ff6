"""The cut part as a binary STL file: a closed surface over the grid of heights.

Each corner of the surface stands at the centre of a cell, and at the edges of the stock. The top is
two triangles for each square of four corners. Walls close the sides down to the bottom of the
stock. Where a cut goes through, the surface lies in the bottom. Rows of corners that are equal to
the rows beside them are left out, so that flat places and straight walls take few triangles.

Source of the format: 3D Systems, "StereoLithography Interface Specification", 1989.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.report.targets import BytesTarget
from cnc.stock.simulation import Material

MOST_TRIANGLES = 4_000_000
"""Limit on the triangles (200 MB). A finer grid is written with wider squares."""
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])

Floats = NDArray[np.float64]


def reduced(material: Material, most: int) -> tuple[Floats, Floats, Floats]:
    """Return a grid of at most about ``most`` corners over the material.

    Returns:
        x (nx,) and y (ny,) of the corners, and the heights (nx, ny), mm. Of the cells that a corner
        stands for the highest counts, so that nothing looks cut that is not.
    """
    factor = max(1, int(np.ceil(np.sqrt(material.heights.size / most))))
    nx, ny = material.heights.shape
    rows, columns = np.arange(0, nx, factor), np.arange(0, ny, factor)
    heights = np.maximum.reduceat(np.maximum.reduceat(material.heights, rows, 0), columns, 1)
    sides = []
    for axis, count in ((0, len(rows)), (1, len(columns))):
        centres = material.low[axis] + (np.arange(count) + 0.5) * factor * material.cell
        sides.append(np.minimum(centres, material.high[axis]))
    return sides[0], sides[1], np.maximum(heights, material.low[2])


def write_stl(material: Material, target: BytesTarget) -> int:
    """Write the part to a file; return the number of triangles."""
    x, y, z = reduced(material, MOST_TRIANGLES // 2)
    # Corners at the edges of the stock, with the heights of the nearest cells.
    x = np.concatenate(([material.low[0]], x, [material.high[0]]))
    y = np.concatenate(([material.low[1]], y, [material.high[1]]))
    z = np.pad(z, 1, mode="edge")
    rows, columns = _needed(z), _needed(z.T)
    x, y, z = x[rows], y[columns], z[np.ix_(rows, columns)]
    nx, ny = z.shape
    count = 4 * ((nx - 1) * (ny - 1) + (nx - 1) + (ny - 1))
    target.write(b"cut part".ljust(80) + np.uint32(count).astype("<u4").tobytes())
    floor = np.full(ny, material.low[2])
    for i in range(nx - 1):
        top = [_corners(x[i + k], y, z[i + k]) for k in (0, 1)]
        bottom = [_corners(x[i + k], y, floor) for k in (0, 1)]
        target.write(_strip(top[0], top[1]))
        target.write(_strip(bottom[1], bottom[0]))
        for j, flip in ((0, True), (ny - 1, False)):
            upper = np.stack((top[0][j], top[1][j]))
            lower = np.stack((bottom[0][j], bottom[1][j]))
            target.write(_strip(upper, lower) if flip else _strip(lower, upper))
    for i, flip in ((0, False), (nx - 1, True)):
        upper, lower = _corners(x[i], y, z[i]), _corners(x[i], y, floor)
        target.write(_strip(upper, lower) if flip else _strip(lower, upper))
    return int(count)


def _needed(z: Floats) -> NDArray[np.bool_]:
    """Return which rows (n,) of heights (n, m) differ from a row beside them, or are the ends."""
    changes = (z[1:] != z[:-1]).any(axis=1)
    return np.concatenate(([True], changes)) | np.concatenate((changes, [True]))


def _corners(x: float, y: Floats, z: Floats) -> Floats:
    """Return points (n, 3) with one x."""
    return np.stack((np.full(len(y), x), y, z), axis=1)


def _strip(first: Floats, second: Floats) -> bytes:
    """Return the triangles between two rows of points (n, 3).

    They face the cross product of the way from ``first`` to ``second`` and that along the rows.
    """
    a, b, c, d = first[:-1], second[:-1], second[1:], first[1:]
    triangles = np.zeros(2 * len(a), TRIANGLE)
    triangles["corners"][0::2] = np.stack((a, b, c), axis=1)
    triangles["corners"][1::2] = np.stack((a, c, d), axis=1)
    corners = triangles["corners"].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    triangles["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    return triangles.tobytes()
