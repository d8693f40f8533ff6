"""Paths and plans for the tests of the interpolators, made without the planner: any legal phases
over the pieces.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import curve_range
from cnc.planner.plan import PlanChunk
from cnc.pulses.kernels.grid_moves import Grid, Moves, Piece, round_to

FILE = "p.nc"
NAMES = ("x", "y", "z", "a", "b", "c", "u", "v", "w")


def polyline(points: ArrayLike, line: int = 1) -> Polyline:
    """Return straight moves at 10 mm/s."""
    p = np.atleast_2d(np.asarray(points, dtype=np.float64))
    return Polyline(
        FILE, line, p, np.full(len(p), 10.0), np.arange(line, line + len(p), dtype=np.int32)
    )


def path_of(
    blocks: Sequence[Block], start: ArrayLike, axes: Sequence[str] | None = None
) -> PathChunk:
    """Return the blocks as one chunk of path."""
    origin = np.asarray(start, dtype=np.float64)
    names = tuple(axes) if axes is not None else NAMES[: len(origin)]
    chunks = [c for c in build(blocks, axes=names, start=origin) if isinstance(c, PathChunk)]
    assert len(chunks) == 1
    return chunks[0]


def arc(
    start: ArrayLike, center: tuple[float, float], turns: float, *, rise: float = 0.0, line: int = 1
) -> ArcFeed:
    """Return an arc in the XY plane, from start by ``turns``; the third axis rises along it."""
    p = np.asarray(start, dtype=np.float64)
    d = p[:2] - center
    c, s = np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)
    end = p.copy()
    end[:2] = np.asarray(center) + [c * d[0] - s * d[1], s * d[0] + c * d[1]]
    if len(end) > 2:
        end[2] += rise
    return ArcFeed(FILE, line, "XY", center, end, float(np.hypot(*d)), turns, 10.0)


def trident(line: int = 1) -> NurbsFeed:
    """Return the curve of the paper on sampled interpolation, as printed."""
    points = np.array(
        [[10, 10], [20, 10], [12, 8], [10, 20], [8, 8], [0, 20], [10, 0]], dtype=np.float64
    )
    knots = np.array([0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1])
    return NurbsFeed(FILE, line, 3, knots, points, np.ones(7), 300.0)


def rest_to_rest(length: float, v: float, a: float, j: float) -> list[tuple[float, float]]:
    """Return (duration, jerk) of the phases that cover ``length`` from rest to rest within the
    limits.
    """

    def distance(peak: float) -> float:
        return peak * (peak / a + a / j) if peak * j >= a * a else 2.0 * peak * np.sqrt(peak / j)

    if distance(v) > length:
        low, high = 0.0, v
        for _ in range(200):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if distance(middle) < length else (low, middle)
        v = low
    t1 = a / j if v * j >= a * a else np.sqrt(v / j)
    t2 = v / (j * t1) - t1
    t4 = max(length - distance(v), 0.0) / v
    return [(t1, j), (t2, 0.0), (t1, -j), (t4, 0.0), (t1, -j), (t2, 0.0), (t1, j)]


def plan_of(
    path: PathChunk,
    phases: Sequence[tuple[float, float]] | None = None,
    *,
    t0: float = 0.0,
    s0: float = 0.0,
    v: float = 50.0,
    a: float = 1000.0,
    j: float = 20000.0,
) -> PlanChunk:
    """Return a plan over the whole path from rest. ``phases`` are (duration, jerk); without them it
    runs from rest to rest within v, a, j. It ends exactly at the end of the path.
    """
    piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
    todo = [
        (t, jerk) for t, jerk in (phases or rest_to_rest(float(piece_s[-1]), v, a, j)) if t > 0.0
    ]
    rows = [(0.0, 0.0, 0.0, 0.0)]
    for index, (dt, jerk) in enumerate(todo):
        t, s, speed, acc = rows[-1]
        acc0 = acc if index == 0 or rows[-1][3] != 0.0 else 0.0
        rows.append(
            (
                t + dt,
                s + dt * (speed + dt * (acc0 / 2 + dt * jerk / 6)),
                speed + dt * (acc0 + dt * jerk / 2),
                acc0 + dt * jerk,
            )
        )
    table = np.array(rows)
    table[-1, 1:] = piece_s[-1], 0.0, 0.0
    return PlanChunk(
        path,
        piece_s,
        t0,
        s0,
        *(np.ascontiguousarray(c) for c in table.T),
        np.array([jerk for _, jerk in todo]),
    )


def at_constant_speed(path: PathChunk, v: float) -> PlanChunk:
    """Return the whole path in one phase without acceleration."""
    piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
    s = np.array([0.0, piece_s[-1]])
    return PlanChunk(path, piece_s, 0.0, 0.0, s / v, s, np.full(2, v), np.zeros(2), np.zeros(1))


def state_at(plan: PlanChunk, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return s, v, a (3, k) at the times t from the chunk's start."""
    k = np.clip(np.searchsorted(plan.phase_t, t, side="right") - 1, 0, len(plan.phase_j) - 1)
    dt = t - plan.phase_t[k]
    v, a, j = plan.phase_v[k], plan.phase_a[k], plan.phase_j[k]
    return np.stack(
        (
            plan.phase_s[k] + dt * (v + dt * (a / 2 + dt * j / 6)),
            v + dt * (a + dt * j / 2),
            a + dt * j,
        )
    )


def at_rest(path: PathChunk, s0: float, grid: Grid, moves: Moves) -> tuple[int, float]:
    """Write the rows that round the grid point to the end of a path, whose last piece begins at s0.

    Returns:
        The number of rows, and the largest error in BLU.
    """
    piece = Piece(int(path.kind[-1]), path.data, int(path.at[-1]), s0)
    _, u1 = curve_range(piece.kind, piece.data, piece.at)
    here = np.empty((4, len(grid.point)))
    rows, _, error, _ = round_to(piece, u1, u1, grid, here, 0.0, 0, moves)
    return rows, float(error)


def pieces(path: PathChunk, first: int, last: int) -> PathChunk:
    """Return pieces first .. last of a path."""
    some = slice(first, last + 1)
    return PathChunk(
        path.axes,
        path.file,
        path.kind[some],
        path.at[some],
        path.data,
        path.length[some],
        path.feed[some],
        path.line[some],
        path.stop_after[some],
        path.tolerance[some],
    )


def cut(plan: PlanChunk, times: Sequence[float]) -> list[PlanChunk]:
    """Return the same motion in several chunks, cut at ``times`` from its start, inside phases and
    pieces too.
    """
    ends = sorted({0.0, *(float(t) for t in times if 0.0 < t < plan.duration), plan.duration})
    chunks = []
    for begin, end in itertools.pairwise(ends):
        inner = plan.phase_t[(plan.phase_t > begin) & (plan.phase_t < end)]
        t = np.concatenate(([begin], inner, [end]))
        s, v, a = state_at(plan, t)
        k = np.searchsorted(plan.phase_t, t[:-1], side="right") - 1
        a[:-1] = plan.phase_a[k] + (t[:-1] - plan.phase_t[k]) * plan.phase_j[k]
        if end == plan.duration:
            s[-1], v[-1], a[-1] = plan.phase_s[-1], plan.phase_v[-1], plan.phase_a[-1]
        first = int(
            np.clip(np.searchsorted(plan.piece_s, s[0], side="right") - 1, 0, len(plan.path) - 1)
        )
        last = int(
            np.clip(
                np.searchsorted(plan.piece_s, s[-1], side="left") - 1, first, len(plan.path) - 1
            )
        )
        base = plan.piece_s[first]
        chunks.append(
            PlanChunk(
                pieces(plan.path, first, last),
                plan.piece_s[first : last + 2] - base,
                plan.t0 + begin,
                plan.s0 + base,
                t - begin,
                s - base,
                v,
                a,
                plan.phase_j[k],
            )
        )
    return chunks
