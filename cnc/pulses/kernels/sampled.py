"""Sampled interpolation: the position on the path at every period, by predictor and corrector.

s(t) comes from the plan, so the step ds of a period is known, and the u that makes it is sought.
Hui, Wei and Gao (2013, section 3.2) predict u from the three samples before and correct it by
secants until the chord fits to a thousandth; :mod:`cnc.papers.kernels.nurbs_lookahead` has that.
Here both halves are more accurate:

    predictor   u~ = u(s), the table of the piece: as accurate as it, however uneven the steps
    corrector   u = u~ + (ds - L(u_i, u~)) / |r'(u~)| until the rest is rounding; usually one round

L is the arc length from u_i to u~ by a short Gauss quadrature, not the chord (equation 4): chords
are shorter than arcs, so steps of chords gain a little on s(t) at every bend. Newton's last
correction is not measured again where its square is rounding. The root stays bracketed, since next
to a cusp |r'| vanishes.

The step asked for is s(t) less the length made so far. So the rounding of one step is made good by
the next: there is no drift, and no noise in third differences.

Where u is itself the arc length (lines, arcs) nothing has to be sought, nor on timed pieces, where
u follows from the clock.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import curve_arclen, curve_inv_arclen
from cnc.path.kernels.curve import (
    METRIC,
    METRICS,
    TABLE,
    Pieces,
    curve_eval,
    curve_range,
    curve_speed,
)
from cnc.planner.kernels.arrays import PlanArrays
from cnc.planner.kernels.timed import is_timed, timed_length, timed_motion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SNAP = 1e-9
"""mm: a chunk that ends this near to the end of a piece ends with it."""
TINY = 1e-7
"""mm: the relative deviation of a shorter step would be the rounding of positions, and counts as 0.
"""
ROUNDING = 2.3e-16
SETTLED = 1e-16
"""Relative: the part of a step that a correction leaves, its square times the change of speed along
the curve.
"""

STATE = np.dtype(
    [
        ("s", np.float64),
        ("chord", np.float64),
        ("done", np.int64),
        ("piece", np.int64),
        ("begun", np.int64),
        ("made", np.float64),
        ("u", np.float64),
        ("phase", np.int64),
    ]
)
"""State of the samples. Kept from chunk to chunk: the path length s at the last sample (mm), and
the length of the polygon from there to the point reached (mm).

Zero at the start of a chunk: the number of its rows so far, the piece, whether it has been entered,
the arc length made in it (mm), the parameter of the last sample, and the phase.
"""


class Clock(NamedTuple):
    """Times of the samples of a chunk.

    Attributes:
        s_before: path length before the chunk, mm.
        first: time of the first sample, from the start of the chunk, s.
        period: time from one sample to the next, s.
    """

    s_before: float
    first: float
    period: float


class Samples(NamedTuple):
    """Rows of samples, as in :class:`cnc.model.streams.SampleChunk`."""

    position: Floats
    s: Floats
    feed: Floats
    accel: Floats
    jerk: Floats
    step_deviation: Floats
    line: NDArray[np.int32]


@njit
def advance(
    kind: int, data: Floats, at: int, u: float, ds: float, guess: float, upto: float
) -> tuple[float, float]:
    """Return the parameter ds mm behind u, at most ``upto``, and the true arc length between."""
    low = u
    high = upto
    x = guess if low < guess <= high else 0.5 * (low + high)
    length = 0.0
    for _ in range(100):
        length = curve_arclen(kind, data, at, u, x)
        f = length - ds
        if abs(f) <= 2e-15 * ds + ROUNDING * abs(x) * length / (x - u):
            break
        if f > 0.0:
            high = x
        else:
            low = x
        speed = curve_speed(kind, data, at, x)
        near = x - f / speed if speed > 0.0 else low
        if not low < near < high:
            near = 0.5 * (low + high)
            if not low < near < high:
                break
        elif f * f * abs(1.0 - speed * (x - u) / length) <= SETTLED * ds * ds:
            x = near
            length = ds
            break
        x = near
    return x, length


@njit
def deviation(chord: float, ds: float) -> float:
    """Return the relative difference between the step made and the step commanded."""
    return abs(chord - ds) / ds if ds > TINY else 0.0


@njit
def _move_to(
    pieces: Pieces,
    piece_s: Floats,
    local: float,
    snap: float,
    state: NDArray[np.void],
    vertex: Floats,
    r: Floats,
) -> None:
    """Follow the path up to the path coordinate ``local`` (mm), over the ends of pieces between.

    A piece that ends within ``snap`` (mm) counts as passed. The polygon goes on to the point
    reached, which is written into ``vertex`` (n,), with its derivatives into r (4, n).
    """
    now = state[0]
    kind, at, data = pieces
    while True:
        piece = now["piece"]
        k = kind[piece]
        where = at[piece]
        u0, u1 = curve_range(k, data, where)
        measured = data[where + TABLE] != 0.0
        u = now["u"]
        wanted = local - piece_s[piece]
        passes = local >= piece_s[piece + 1] - snap
        if passes:
            u = u1
        elif not measured:
            u = min(max(u0 + wanted, u), u1)
        elif wanted > now["made"]:
            guess = curve_inv_arclen(k, data, where, wanted)
            u, length = advance(k, data, where, u, wanted - now["made"], guess, u1)
            now["made"] += length
        now["u"] = u
        curve_eval(k, data, where, u, r)
        square = 0.0
        for i in range(int(data[where + METRICS])):
            column = int(data[where + METRIC + i])
            square += (r[0, column] - vertex[column]) ** 2
        now["chord"] += math.sqrt(square)
        for i in range(len(vertex)):
            vertex[i] = r[0, i]
        if not passes or piece == len(kind) - 1:
            break
        now["piece"] = piece + 1
        now["u"], _ = curve_range(kind[piece + 1], data, at[piece + 1])
        now["made"] = 0.0


@njit
def samples(
    pieces: Pieces,
    plan: PlanArrays,
    source_line: NDArray[np.int32],
    clock: Clock,
    state: NDArray[np.void],
    vertex: Floats,
    last: bool,
    out: Samples,
) -> None:
    """Write the next rows of a plan chunk, as many as ``out`` has.

    The step made is the polygon from sample to sample, over the ends of pieces between them. So the
    chord cuts no corner that the motion does not cut.

    Args:
        pieces: the pieces of the path.
        plan: the motion along them.
        source_line: (pieces,): source line of each piece.
        clock: times of the samples.
        state: (1,) STATE, kept from call to call.
        vertex: (n,): the last point of the polygon, moved along.
        last: no rows of this chunk come after these. The motion is followed to its end, and
            ``vertex`` becomes the end point.
        out: takes the rows.
    """
    kind, at, data = pieces
    now = state[0]
    n = out.position.shape[1]
    rows = len(out.s)
    r = np.empty((4, n))
    phase = now["phase"]
    if now["begun"] == 0:
        piece = now["piece"]
        while piece < len(kind) - 1 and plan.piece_s[piece + 1] <= plan.s[0]:
            piece += 1
        now["piece"] = piece
        if rows > 0 or last:
            k = kind[piece]
            where = at[piece]
            u0, _ = curve_range(k, data, where)
            u = curve_inv_arclen(k, data, where, plan.s[0] - plan.piece_s[piece])
            now["u"] = u
            now["made"] = curve_arclen(k, data, where, u0, u)
            now["begun"] = 1
    for row in range(rows + (1 if last else 0)):
        ends = row == rows
        t = plan.t[-1] if ends else clock.first + (now["done"] + row) * clock.period
        while phase < len(plan.j) - 1 and t >= plan.t[phase + 1]:
            phase += 1
        dt = max(t - plan.t[phase], 0.0)
        v = plan.v[phase]
        a = plan.a[phase]
        j = plan.j[phase]
        local = min(plan.s[phase] + dt * (v + dt * (0.5 * a + dt * (j / 6.0))), plan.s[-1])
        if ends:
            local = plan.s[-1]
        _move_to(pieces, plan.piece_s, local, SNAP if ends else 0.0, state, vertex, r)
        if not ends:
            piece = now["piece"]
            k = kind[piece]
            where = at[piece]
            u = now["u"]
            timed = is_timed(k, data, where)
            if timed:
                local = plan.piece_s[piece] + timed_length(k, data, where, u, r)
            total = clock.s_before + local
            out.step_deviation[row] = deviation(now["chord"], total - now["s"])
            now["s"] = total
            now["chord"] = 0.0
            for i in range(n):
                out.position[row, i] = vertex[i]
            out.s[row] = total
            out.feed[row] = v + dt * (a + dt * (0.5 * j))
            out.accel[row] = a + dt * j
            out.jerk[row] = j
            if timed:
                curve_eval(k, data, where, u, r)
                out.feed[row], out.accel[row], out.jerk[row], _ = timed_motion(
                    data, where, r, out.feed[row], out.accel[row], j
                )
            out.line[row] = source_line[piece]
    now["done"] += rows
    now["phase"] = phase
