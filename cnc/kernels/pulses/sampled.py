"""Sampled interpolation: where the path is at every period, by predictor and corrector.

s(t) comes from the plan, so the step ds of a period is known, and the u that makes it is looked
for. Hui, Wei and Gao (2013, section 3.2) foretell u from the three samples before and correct it by
secants until the chord fits to a thousandth; :mod:`cnc.kernels.papers.nurbs_lookahead` has that.
Here both halves go further:

    predictor      u~ = u(s), the table of the piece: to its accuracy at once, however uneven the steps
    corrector      u = u~ + (ds - L(u_i, u~)) / |r'(u~)| until what is left is rounding; one round as a rule

L is the arc length from u_i to u~ by a short Gauss quadrature, not the chord (equation 4): chords
are shorter than arcs, so that steps of chords run ahead of s(t) a little more on every bend.
Newton's last correction is not measured again where its square is rounding. The root stays
bracketed: next to a cusp |r'| vanishes.

The step asked for is s(t) less the length made so far, so that what rounding leaves of one step is
made good by the next: hence no drift, and no noise in third differences.

Where u is itself the arc length (lines, arcs) there is nothing to look for; nor on timed pieces,
where u follows from the clock.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import (
    METRIC,
    METRICS,
    TABLE,
    curve_arclen,
    curve_eval,
    curve_inv_arclen,
    curve_range,
    curve_speed,
)
from cnc.kernels.planner.timed import is_timed, timed_length, timed_motion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SNAP = 1e-9
"""mm: a chunk that ends this near to the end of a piece ends with it."""
TINY = 1e-7
"""mm: the relative deviation of a shorter step would show the rounding of positions, and counts as
0.
"""
ROUNDING = 2.3e-16
SETTLED = 1e-16
"""Relative: what a correction leaves of a step, its square times how unevenly the curve runs
there.
"""

S, CHORD = 0, 1
"""Float state: path length at the last sample, and the length of the polygon from it to where the
motion has been followed.
"""
FLOATS = 2


@njit
def advance(
    kind: int, data: Floats, at: int, u: float, ds: float, guess: float, upto: float
) -> tuple[float, float]:
    """The parameter ds of arc length after u, at most ``upto``, and the arc length that lies
    between in fact.
    """
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
    """Relative difference between the step made and the step commanded."""
    return abs(chord - ds) / ds if ds > TINY else 0.0


@njit
def samples(
    kind: Ints, at: Ints, data: Floats, piece_s: Floats, source_line: NDArray[np.int32],
    phase_t: Floats, phase_s: Floats, phase_v: Floats, phase_a: Floats, phase_j: Floats,
    s_before: float, first: float, done: int, period: float, place: Ints, history: Floats, floats: Floats, vertex: Floats, last: bool,
    position: Floats, s: Floats, feed: Floats, accel: Floats, jerk: Floats, step_deviation: Floats, line: NDArray[np.int32],
) -> None:  # fmt: skip
    """Rows at the times first + k period, counted from the chunk's start, from k = done on and for
    as many k as the outputs have rows.

    kind .. phase_j: as in PlanChunk; s_before: path length before local 0. Carried from call to
    call of one chunk, zeros at its start: place [piece, phase, whether begun], history [arc length
    made in the piece, u of the last sample]. Carried for good: floats, and vertex (n,): the last
    point of the polygon. ``last``: no rows of this chunk come after these; the motion is followed
    to its end, and vertex becomes the end point. Outputs as in SampleChunk.

    The step made is the polygon from sample to sample over the ends of pieces between them: what is
    cut off from a corner there is the chord's, not the interpolator's.
    """
    n = position.shape[1]
    rows = len(s)
    r = np.empty((4, n))
    piece = place[0]
    phase = place[1]
    begun = place[2]
    made = history[0]
    u = history[1]
    if begun == 0:
        while piece < len(kind) - 1 and piece_s[piece + 1] <= phase_s[0]:
            piece += 1
    for row in range(rows + (1 if last else 0)):
        t = first + (done + row) * period if row < rows else phase_t[-1]
        while phase < len(phase_j) - 1 and t >= phase_t[phase + 1]:
            phase += 1
        dt = max(t - phase_t[phase], 0.0)
        v = phase_v[phase]
        a = phase_a[phase]
        j = phase_j[phase]
        local = min(phase_s[phase] + dt * (v + dt * (0.5 * a + dt * (j / 6.0))), phase_s[-1])
        if row == rows:
            local = phase_s[-1]
        while True:
            k = int(kind[piece])
            where = int(at[piece])
            u0, u1 = curve_range(k, data, where)
            measured = data[where + TABLE] != 0.0
            if begun == 0:
                u = curve_inv_arclen(k, data, where, phase_s[0] - piece_s[piece])
                made = curve_arclen(k, data, where, u0, u)
                begun = 1
            wanted = local - piece_s[piece]
            passes = local >= piece_s[piece + 1] - (SNAP if row == rows else 0.0)
            if passes:
                u = u1
            elif not measured:
                u = min(max(u0 + wanted, u), u1)
            elif wanted > made:
                u, length = advance(
                    k, data, where, u, wanted - made, curve_inv_arclen(k, data, where, wanted), u1
                )
                made += length
            curve_eval(k, data, where, u, r)
            square = 0.0
            for i in range(int(data[where + METRICS])):
                column = int(data[where + METRIC + i])
                square += (r[0, column] - vertex[column]) ** 2
            floats[CHORD] += math.sqrt(square)
            for i in range(n):
                vertex[i] = r[0, i]
            if not passes or piece == len(kind) - 1:
                break
            piece += 1
            u, _ = curve_range(int(kind[piece]), data, int(at[piece]))
            made = 0.0
            begun = 1
        if row < rows:
            timed = is_timed(k, data, where)
            total = s_before + (
                piece_s[piece] + timed_length(k, data, where, u, r) if timed else local
            )
            step_deviation[row] = deviation(floats[CHORD], total - floats[S])
            floats[S] = total
            floats[CHORD] = 0.0
            for i in range(n):
                position[row, i] = vertex[i]
            s[row] = total
            feed[row] = v + dt * (a + dt * (0.5 * j))
            accel[row] = a + dt * j
            jerk[row] = j
            if timed:
                curve_eval(k, data, where, u, r)
                feed[row], accel[row], jerk[row], _ = timed_motion(data, where, r, v)
            line[row] = source_line[piece]
    place[0] = piece
    place[1] = phase
    place[2] = begun
    history[0] = made
    history[1] = u
