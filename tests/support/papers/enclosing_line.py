"""Walks of enclosing lines and shortest normals, and their checks by an independent evaluation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from cnc.model.blocks import Block, NurbsFeed
from cnc.path.chunk import PathChunk
from cnc.path.kernels.arclength import curve_inv_arclen
from cnc.path.kernels.curve import curve_eval, curve_range
from cnc.pulses.kernels.enclosing_line import monotone_rows
from cnc.pulses.kernels.grid_moves import Grid, Moves, Piece
from tests.support.pulses.oracle import Segment, segments_of
from tests.support.pulses.plans import FILE, at_rest, path_of
from tests.support.soak import share

Floats = NDArray[np.float64]


Ints = NDArray[np.int64]


Rows = Callable[..., tuple[int, float, float, float]]


enclosing_line_rows: Rows = partial(monotone_rows, False)


kiritsis_rows: Rows = partial(monotone_rows, True)


BOTH = pytest.mark.parametrize(
    "generator", [enclosing_line_rows, kiritsis_rows], ids=["enclosing-line", "kiritsis"]
)


@dataclass
class Walk:
    """Result of a generator for a path: rows, path coordinates, grid points before and after each,
    and its largest error.
    """

    step: NDArray[np.int8]
    reach: Floats
    grid: Ints
    error: float


def walk(
    generator: Rows,
    path: PathChunk,
    start: ArrayLike,
    scale: Floats,
    *,
    room: int = 4096,
    parts: int = 1,
) -> Walk:
    """Return all rows of a path, with buffers of ``room`` rows, each piece in ``parts``."""
    grid = Grid(scale, np.rint(np.asarray(start) * scale).astype(np.int64))
    first = grid.point.copy()
    moves = Moves(np.zeros((room, len(first)), np.int8), np.zeros(room))
    steps, places = [np.empty((0, len(first)), np.int8)], [np.empty(0)]
    error = s0 = 0.0
    for kind, at, length in zip(
        path.kind.tolist(), path.at.tolist(), path.length.tolist(), strict=True
    ):
        u, u1 = curve_range(kind, path.data, at)
        width = 0.0
        for upto in np.linspace(u, u1, parts + 1)[1:]:
            while u < upto:
                rows, u, off, width = generator(
                    Piece(kind, path.data, at, s0), u, float(upto), width, grid, 0, moves
                )
                error = max(error, off)
                steps.append(moves.step[:rows].copy())
                places.append(moves.s[:rows].copy())
        s0 += length
    rows, off = at_rest(path, s0 - length, grid, moves)
    steps.append(moves.step[:rows].copy())
    places.append(moves.s[:rows].copy())
    whole = np.concatenate(steps)
    np.testing.assert_array_equal(first + whole.sum(axis=0, dtype=np.int64), grid.point)
    return Walk(
        whole,
        np.concatenate(places),
        first + np.cumsum(np.vstack((0 * first, whole)), axis=0, dtype=np.int64),
        max(error, off),
    )


def check(
    generator: Rows, blocks: Sequence[Block], start: ArrayLike, steps_per_mm: ArrayLike, **how: int
) -> Walk:
    """Check every row by the records, and some rows by the oracle."""
    origin = np.asarray(start, dtype=np.float64)
    scale = np.array(np.broadcast_to(np.asarray(steps_per_mm, dtype=np.float64), origin.shape))
    path = path_of(blocks, origin)
    rows = walk(generator, path, origin, scale, **how)
    segments = segments_of(blocks, origin)
    assert (np.abs(rows.step) <= 1).all()
    assert rows.step.any(axis=1).all()
    assert (np.diff(rows.reach) >= -1e-9).all()
    assert rows.error <= 0.5 + 1e-8
    assert (np.abs(rows.grid[-1] - segments[-1].q(np.array(1.0)) * scale) <= 0.5 + 1e-8).all()
    before = np.concatenate(([0.0], np.cumsum(path.length)))
    here = np.empty((4, len(origin)))
    worst = 0.0
    for place, point in zip(rows.reach, rows.grid[1:], strict=True):
        piece = min(int(np.searchsorted(before, place, side="right")) - 1, len(path) - 1)
        kind, at = int(path.kind[piece]), int(path.at[piece])
        curve_eval(
            kind, path.data, at, curve_inv_arclen(kind, path.data, at, place - before[piece]), here
        )
        worst = max(worst, float(np.abs(here[0] * scale - point).max()))
    assert worst <= 0.5 + 1e-8 * scale.max() + 1e-7
    by_oracle(rows, segments, scale)
    return rows


def by_oracle(rows: Walk, segments: Sequence[Segment], scale: Floats) -> None:
    """Check some rows at the places that scipy's arc length gives."""
    ends = np.cumsum([0.0] + [segment.length(1.0) for segment in segments])
    for k in range(0, len(rows.reach), max(len(rows.reach) // share(20, 4), 1)):
        number = min(int(np.searchsorted(ends, rows.reach[k], side="right")) - 1, len(segments) - 1)
        s = min(max(rows.reach[k] - ends[number], 0.0), segments[number].length(1.0))
        w = brentq(lambda w, n=number, s=s: segments[n].length(w) - s, 0.0, 1.0, xtol=1e-15)
        off = np.abs(segments[number].q(np.array(w)) * scale - rows.grid[k + 1]).max()
        assert off <= 0.5 + 1e-6 * max(1.0, scale.max() / 100.0)


def by_squares(
    segments: Sequence[Segment], scale: Floats, grid: Ints, dense: int
) -> tuple[Ints, bool]:
    """Return the grid points of the rule, from dense points and bisection: the curve leaves the
    square, and the offset there is rounded. The second result is False if rounding would decide
    between two neighbours; then the points end there.
    """
    g = grid.copy()
    found = []
    for segment in segments:
        w = np.linspace(0.0, 1.0, dense + 1)
        p = segment.q(w) * scale
        k = 0
        low = 0.0
        while True:
            outside = np.flatnonzero(np.abs(p[k:] - g).max(axis=1) > 1.0)
            if not len(outside):
                break
            k += int(outside[0])
            low = max(low, w[max(k - 1, 0)])
            high = w[k]
            for _ in range(60):
                middle = 0.5 * (low + high)
                inside = np.abs(segment.q(np.array(middle)) * scale - g).max() <= 1.0
                low, high = (middle, high) if inside else (low, middle)
            off = segment.q(np.array(high)) * scale - g
            if np.abs(np.abs(off) - 0.5).min() < 1e-5:
                return np.array(found), False
            g += np.rint(off).astype(np.int64)
            found.append(g.copy())
        off = p[-1] - g
    if np.abs(np.abs(off) - 0.5).min() < 1e-5:
        return np.array(found), False
    if (np.abs(off) > 0.5).any():
        found.append(g + np.rint(off).astype(np.int64))
    return np.array(found).reshape(-1, len(grid)), True


def check_squares(
    blocks: Sequence[Block], start: ArrayLike, steps_per_mm: ArrayLike, dense: int
) -> None:
    """Check that the rows equal those of :func:`by_squares`, if the path is one piece."""
    origin = np.asarray(start, dtype=np.float64)
    scale = np.array(np.broadcast_to(np.asarray(steps_per_mm, dtype=np.float64), origin.shape))
    rows = check(enclosing_line_rows, blocks, start, scale)
    if len(path_of(blocks, origin)) > 1:
        return
    expected, through = by_squares(segments_of(blocks, origin), scale, rows.grid[0], dense)
    np.testing.assert_array_equal(rows.grid[1 : len(expected) + 1], expected)
    assert not through or len(expected) == len(rows.step)


def nurbs(
    rng: np.random.Generator, axes: int, degree: int, points: int, heaviest: float
) -> NurbsFeed:
    """Return a NURBS with random control points in [-1, 1] and weights from 1 / heaviest to
    heaviest.
    """
    inner = np.sort(rng.uniform(0.02, 0.98, points - degree - 1))
    knots = np.concatenate((np.zeros(degree + 1), inner, np.ones(degree + 1)))
    weights = np.exp(rng.uniform(-1.0, 1.0, points) * math.log(heaviest))
    return NurbsFeed(FILE, 1, degree, knots, rng.uniform(-1.0, 1.0, (points, axes)), weights, 10.0)


BARE: dict[
    str, tuple[Callable[[float], list[float]], Callable[[float], list[float]], float, float]
] = {
    "circle": (lambda u: [np.cos(u), np.sin(u)], lambda u: [-np.sin(u), np.cos(u)], 0.0, 2 * np.pi),
    "polynomial": (
        lambda u: [1.22 * u - u * u, 5.25 - u * u],
        lambda u: [1.22 - 2 * u, -2 * u],
        0.0,
        4.0,
    ),
    "cusp": (lambda u: [u * u, u**3], lambda u: [2 * u, 3 * u * u], -1.0, 1.3),
    "astroid": (
        lambda u: [np.cos(u) ** 3, np.sin(u) ** 3],
        lambda u: [-3 * np.cos(u) ** 2 * np.sin(u), 3 * np.sin(u) ** 2 * np.cos(u)],
        0.0,
        2 * np.pi,
    ),
    "corner": (lambda u: [u, abs(u - 0.3)], lambda u: [1.0, math.copysign(1.0, u - 0.3)], 0.0, 1.0),
    "knot in space": (
        lambda u: [np.sin(u) + 2 * np.sin(2 * u), np.cos(u) - 2 * np.cos(2 * u), -np.sin(3 * u)],
        lambda u: [
            np.cos(u) + 4 * np.cos(2 * u),
            -np.sin(u) + 4 * np.sin(2 * u),
            -3 * np.cos(3 * u),
        ],
        0.1,
        0.1 + 2 * np.pi,
    ),
}
