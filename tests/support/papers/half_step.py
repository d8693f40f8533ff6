"""Rows by half steps, their checks, and random lines and arcs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from cnc.model.blocks import ArcFeed, Block, Polyline
from cnc.path.kernels.curve import curve_range
from cnc.pulses.kernels.grid_moves import Grid, Moves, Piece
from cnc.pulses.kernels.half_step import half_step_rows
from tests.support.pulses.oracle import segments_of
from tests.support.pulses.plans import FILE, arc, at_rest, path_of, polyline

Floats = NDArray[np.float64]


Ints = NDArray[np.int64]


@dataclass
class Run:
    """All rows of a path."""

    origin: Ints
    step: NDArray[np.int8]
    reach: Floats
    error: float
    done: list[int]  # rows up to the end of each piece

    @property
    def points(self) -> Ints:
        """Grid points, with the first one."""
        return self.origin + np.concatenate(
            (
                np.zeros((1, len(self.origin)), np.int64),
                np.cumsum(self.step, axis=0, dtype=np.int64),
            )
        )


def run(
    blocks: Sequence[Block],
    start: ArrayLike,
    scale: ArrayLike,
    *,
    room: int = 50_000,
    cuts: Sequence[float] = (),
    origin: Ints | None = None,
    rows_of: Callable[..., Any] = half_step_rows,
) -> Run:
    """Return the rows of the blocks, in buffers of ``room`` rows.

    Each piece is done in parts that end at ``cuts`` (of 1).
    """
    path = path_of(blocks, start)
    scales = np.broadcast_to(np.asarray(scale, np.float64), (len(path.axes),)).copy()
    point = (
        np.rint(np.asarray(start) * scales).astype(np.int64) if origin is None else origin.copy()
    )
    first = point.copy()
    grid = Grid(scales, point)
    moves = Moves(np.empty((room, len(point)), np.int8), np.empty(room))
    steps, reaches, error, s0 = [], [], 0.0, 0.0
    done = []
    for kind, at, length in zip(
        path.kind.tolist(), path.at.tolist(), path.length.tolist(), strict=True
    ):
        piece = Piece(kind, path.data, at, s0)
        u0, u1 = curve_range(kind, path.data, at)
        u = u0
        for part in (*sorted(cuts), 1.0):
            upto = u1 if part == 1.0 else u0 + part * (u1 - u0)
            while u < upto:
                rows, u, off = rows_of(piece, u, upto, grid, 0, moves)
                assert u == upto or rows == room
                error = max(error, off)
                steps.append(moves.step[:rows].copy())
                reaches.append(moves.s[:rows].copy())
        s0 += length
        done.append(sum(map(len, steps)))
    # where the motion rests
    rows, off = at_rest(path, s0 - length, grid, moves)
    steps.append(moves.step[:rows].copy())
    reaches.append(moves.s[:rows].copy())
    done[-1] += rows
    error = max(error, off)
    return Run(first, np.concatenate(steps), np.concatenate(reaches), error, done)


def check(
    blocks: Sequence[Block],
    start: ArrayLike,
    scale: ArrayLike,
    rows_of: Callable[..., Any] = half_step_rows,
    lag: float = 1.5,
) -> Run:
    """Check the rows of a path: half a BLU in each axis at each row, at most ``lag`` between rows,
    so that no row is missing. With half-step deviation the leader is a step behind before its row,
    the others half a step more.
    """
    origin = np.asarray(start, np.float64)
    scales = np.broadcast_to(np.asarray(scale, np.float64), origin.shape)
    rows = run(blocks, start, scales, rows_of=rows_of)
    points = rows.points
    assert (np.abs(rows.step) <= 1).all() and rows.step.any(axis=1).all()
    assert (np.diff(rows.reach) >= 0.0).all()
    close = 1e-8 + 2e-15 * float(np.abs(points).max())
    assert rows.error <= 0.5 + close
    s0, first = 0.0, 0
    segments = segments_of(blocks, origin)
    # lines are pieces, an arc is one a turn
    for segment, last in zip(
        segments, rows.done if len(segments) > 1 else rows.done[-1:], strict=True
    ):
        length = segment.length(1.0)
        w = _places(segment.length, (rows.reach[first:last] - s0), length)
        assert (w <= 1.0 + 1e-9).all() and (w >= -1e-9).all()
        off = np.abs(points[first + 1 : last + 1] - segment.q(w) * scales)
        assert off.max(initial=0.0) <= 0.5 + close
        before = np.abs(points[first:last] - segment.q(w) * scales)
        assert before.max(initial=0.0) <= lag + 1e-6
        dense = np.linspace(0.0, 1.0, 500)
        held = first + np.searchsorted(w, dense + 1e-12, side="right")
        assert np.abs(points[held] - segment.q(dense) * scales).max() <= lag + 1e-6
        s0, first = s0 + length, last
    assert first == len(rows.step)
    assert (np.abs(points[-1] - segments[-1].q(np.array(1.0)) * scales) <= 0.5 + close).all()
    return rows


def _places(length: Callable[[float], float], s: Floats, whole: float) -> Floats:
    """Return w of the arc lengths, by Newton's method where the length is no multiple of w."""
    if abs(length(0.3) - 0.3 * whole) < 1e-13 * whole:
        return s / whole
    w = s / whole
    table = np.linspace(0.0, 1.0, 65)
    lengths = np.array([length(float(x)) for x in table])
    chebyshev = np.polynomial.Chebyshev.fit(table, lengths, 30)
    slope = chebyshev.deriv()
    for _ in range(5):
        w = w - (chebyshev(w) - s) / slope(w)
    return np.asarray(w)


EXPONENT = st.floats(-3.0, 3.0)


def scales_for(draw: st.DrawFn, axes: int, size: float, most: float) -> Floats:
    """Draw steps/mm from 1 to 10 000 (BLU 1 mm to 1e-4 mm), so that ``size`` mm are at most
    ``most`` steps.
    """
    high = min(10_000.0, most / size)
    low = min(1.0, high)
    exponents = [draw(st.floats(math.log10(low), math.log10(high))) for _ in range(axes)]
    return np.array([round(10.0**e, 3) or 0.001 for e in exponents])


@st.composite
def lines(draw: st.DrawFn) -> tuple[list[Polyline], Floats, Floats]:
    """Draw polylines with moves of 1 um to 1 m, with ends on and off the grid."""
    axes = draw(st.integers(1, 5))
    size = 10.0 ** draw(EXPONENT)
    scale = scales_for(draw, axes, size, 3000.0)
    digits = draw(st.sampled_from([2, 3, 5, 15]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points = np.round(rng.uniform(-size, size, (draw(st.integers(2, 5)), axes)), digits)
    if draw(st.booleans()):
        points = np.rint(points * scale) / scale
    if draw(st.booleans()):
        points[:, : rng.integers(axes) + 1] = np.rint(points[:, :1] * scale[0]) / scale[0]
    assume((np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-8).all())
    return [polyline(points[1:])], points[0], scale


@st.composite
def arcs(draw: st.DrawFn) -> tuple[list[ArcFeed], Floats, Floats]:
    """Draw arcs in both directions, of up to 2.3 turns, helices and spirals, with centre, radius
    and ends off the grid.
    """
    axes = draw(st.integers(2, 4))
    radius = 10.0 ** draw(EXPONENT)
    scale = scales_for(draw, axes, radius, 400.0)
    if draw(st.booleans()):
        scale[1] = scale[0]
    if draw(st.booleans()):
        radius = max(float(np.rint(radius * scale[0])), 1.0) / scale[0]
    angle = draw(st.floats(0.0, 2 * math.pi))
    center = (draw(st.floats(-2, 2)) * radius, draw(st.floats(-2, 2)) * radius)
    if draw(st.booleans()):
        center = (round(center[0] * scale[0]) / scale[0], round(center[1] * scale[1]) / scale[1])
        angle = draw(st.integers(0, 7)) * math.pi / 4
    start = np.zeros(axes)
    start[:2] = center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle)
    turns = draw(st.floats(0.01, 2.3)) * draw(st.sampled_from([1, -1]))
    block = arc(start, center, turns, rise=draw(st.sampled_from([0.0, 0.1, 3.0, 50.0])) * radius)
    growth = 1.0 + draw(st.sampled_from([0.0, 0.0, 1e-4, -1e-3, 0.2, -0.5]))
    end = block.end.copy()
    end[:2] = np.asarray(center) + growth * (end[:2] - center)
    if axes > 3:
        end[3] = draw(st.floats(-3, 3)) * radius
    return [ArcFeed(FILE, 1, "XY", center, end, radius, turns, 10.0)], start, scale


def circle(radius: float, turns: float = 1.0) -> tuple[list[ArcFeed], Floats]:
    start = np.array([radius, 0.0])
    return [arc(start, (0.0, 0.0), turns)], start
