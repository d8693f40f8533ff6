"""Reference pulses on a bare curve by enclosing lines and by Kiritsis.

There is no plan: the results are grid points and their places on the curve. The kernels are those
that run programs (:mod:`cnc.kernels.pulses.monotone`), and the paper's procedures as printed, for
comparison.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import comb
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.kernels.papers.enclosing_line import enclosing_line_as_printed, kiritsis_as_printed
from cnc.kernels.path.arclength import curve_inv_arclen
from cnc.kernels.path.curve import START, curve_range
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.pulses.catch_up import round_to
from cnc.kernels.pulses.grid_moves import Grid, Moves, Piece
from cnc.kernels.pulses.monotone import monotone_rows
from cnc.model.blocks import NurbsFeed
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.pulses.arrays import pieces_of

Floats = NDArray[np.float64]
Function = Callable[[float], ArrayLike]

ROWS = 65536
"""Most iterations at a time."""
DEGREE = 7
NODES = np.array([0.0, 1 / 3, 2 / 3, 1.0])
"""Places in a piece at which the polynomial has the position and the derivative of the curve."""
CHECKS = np.array([0.15, 0.5, 0.85])
NARROWEST = 2.0**-40
"""Part of the whole range that is not divided any more, because the derivative jumps in it."""
AXES = ("x", "y", "z", "a", "b", "c", "u", "v", "w")


class Algorithm(Enum):
    """Choice of the next grid point: nearest to the exit from the square, or shortest normal."""

    ENCLOSING_LINE = "enclosing line"
    KIRITSIS = "Kiritsis"


PRINTED = {
    Algorithm.ENCLOSING_LINE: enclosing_line_as_printed,
    Algorithm.KIRITSIS: kiritsis_as_printed,
}


@dataclass(frozen=True, slots=True)
class Steps:
    """One row for each iteration.

    Attributes:
        step: (m, n): -1, 0 or 1 for each axis.
        u: (m,): parameter of the curve.
        grid: (m + 1, n): grid points, with the first.
        error_blu: largest distance of a grid point from r(u), in any axis, or straight where the
            procedure is as printed.
        seconds: computing time.
    """

    step: NDArray[np.int8]
    u: Floats
    grid: NDArray[np.int64]
    error_blu: float
    seconds: float

    @property
    def null(self) -> int:
        """Number of iterations in which no axis steps."""
        return int((self.step == 0).all(axis=1).sum())


def interpolate(
    curve: PathChunk, steps_per_mm: ArrayLike, algorithm: Algorithm = Algorithm.ENCLOSING_LINE
) -> Steps:
    """Return the grid points of a curve, from its rounded start to its rounded end.

    Each is within half a BLU of the curve in every axis.
    """
    pieces, grid = _arrays(curve, steps_per_mm)
    first = grid.point.copy()
    moves = Moves(np.empty((ROWS, len(first)), dtype=np.int8), np.empty(ROWS))
    steps = [moves.step[:0].copy()]
    places = [moves.s[:0].copy()]
    error = seconds = 0.0
    by_normal = algorithm is Algorithm.KIRITSIS
    for kind, at in zip(pieces.kind.tolist(), pieces.at.tolist(), strict=True):
        piece = Piece(kind, pieces.data, at, 0.0)
        u, u1 = curve_range(kind, pieces.data, at)
        width = 0.0
        while u < u1:
            begin = perf_counter()
            rows, u, off, width = monotone_rows(by_normal, piece, u, u1, width, grid, 0, moves)
            seconds += perf_counter() - begin
            steps.append(moves.step[:rows].copy())
            reached = [curve_inv_arclen(kind, pieces.data, at, s) for s in moves.s[:rows].tolist()]
            places.append(np.array(reached))
            error = max(error, float(off))
    here = np.empty((4, len(first)))
    rows, _, off, _ = round_to(piece, u1, u1, grid, here, error, 0, moves)
    steps.append(moves.step[:rows].copy())
    places.append(np.full(rows, u1))
    return _steps(np.concatenate(steps), np.concatenate(places), first, float(off), seconds)


def as_printed(
    curve: PathChunk, steps_per_mm: ArrayLike, algorithm: Algorithm = Algorithm.ENCLOSING_LINE
) -> Steps:
    """Carry out the printed procedure on a curve of one piece in two axes.

    Only signs are corrected. It stops before it would pass the end.
    """
    if len(curve) != 1 or len(curve.axes) != 2:
        raise ValueError("the printed procedures take one smooth curve in two axes")
    kernel = PRINTED[algorithm]
    pieces, grid = _arrays(curve, steps_per_mm)
    first = grid.point.copy()
    most = 4 * int(np.ceil(float(curve.length[0]) * grid.scale.max())) + 16
    moves = Moves(np.empty((most, 2), dtype=np.int8), np.empty(most))
    begin = perf_counter()
    rows, error = kernel(int(pieces.kind[0]), pieces.data, int(pieces.at[0]), grid, moves)
    seconds = perf_counter() - begin
    return _steps(moves.step[:rows], moves.s[:rows], first, float(error), seconds)


def fitted(
    position: Function, derivative: Function, u0: float, u1: float, accuracy: float = 1e-9
) -> PathChunk:
    """Return a curve r(u), given as position (mm) and derivative by u, as pieces of path.

    Each piece is the polynomial of degree 7 with r and r' at four places (Hermite). It is halved
    until three places between agree to ``accuracy`` mm.
    """
    breaks = [u0]
    points = [np.asarray(position(u0), dtype=np.float64)[None]]
    waiting = [(u0, u1)]
    while waiting:
        a, b = waiting.pop()
        width = b - a
        values = np.array([position(u) for u in a + width * NODES])
        control = FROM_NODES @ np.concatenate(
            (values, width * np.array([derivative(u) for u in a + width * NODES]))
        )
        control[0], control[-1] = values[0], values[-1]
        off = np.abs(
            _bernstein(CHECKS) @ control - np.array([position(u) for u in a + width * CHECKS])
        ).max()
        if off > accuracy and width > NARROWEST * (u1 - u0):
            middle = 0.5 * (a + b)
            waiting += [(middle, b), (a, middle)]
        else:
            breaks.append(b)
            points.append(control[1:])
    knots = np.concatenate(([u0], np.repeat(breaks, DEGREE), [u1]))
    control = np.concatenate(points)
    block = NurbsFeed("", 1, DEGREE, knots, control, np.ones(len(control)), 1.0)
    chunks = [
        item
        for item in build([block], axes=AXES[: control.shape[1]], start=control[0])
        if isinstance(item, PathChunk)
    ]
    if len(chunks) != 1:
        raise ValueError(
            "the curve has no length"
            if not chunks
            else f"the curve needs {len(breaks) - 1} pieces: is it smooth?"
        )
    return chunks[0]


def _bernstein(t: Floats, degree: int = DEGREE) -> Floats:
    """Return the Bernstein polynomials at t (k,): (k, degree + 1)."""
    i = np.arange(degree + 1)
    choose = np.array([comb(degree, k) for k in i.tolist()], dtype=np.float64)
    return np.asarray(choose * t[:, None] ** i * (1.0 - t[:, None]) ** (degree - i))


def _bernstein_slopes(t: Floats) -> Floats:
    """Return their derivatives (The NURBS Book, equation 1.9)."""
    lower = _bernstein(t, DEGREE - 1)
    return DEGREE * (np.pad(lower, ((0, 0), (1, 0))) - np.pad(lower, ((0, 0), (0, 1))))


FROM_NODES = np.linalg.inv(np.concatenate((_bernstein(NODES), _bernstein_slopes(NODES))))
"""Matrix from values and derivatives by t at NODES to Bernstein coefficients."""


def _arrays(curve: PathChunk, steps_per_mm: ArrayLike) -> tuple[Pieces, Grid]:
    """Return the pieces of a curve, and the grid with the rounded start as its point."""
    pieces = pieces_of(curve)
    scale = np.array(np.broadcast_to(np.asarray(steps_per_mm, dtype=np.float64), len(curve.axes)))
    start = pieces.data[pieces.at[0] + START :][: len(scale)]
    return pieces, Grid(scale, np.rint(start * scale).astype(np.int64))


def _steps(
    step: NDArray[np.int8], u: Floats, first: NDArray[np.int64], error: float, seconds: float
) -> Steps:
    grid = first + np.concatenate(
        (np.zeros((1, step.shape[1]), np.int64), np.cumsum(step, axis=0, dtype=np.int64))
    )
    return Steps(step.copy(), u.copy(), grid, error, seconds)
