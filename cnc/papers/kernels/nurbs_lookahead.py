r"""Sampled interpolation of a bare NURBS with look-ahead, as in Hui, Wei and Gao 2013.

Their paper is in TELKOMNIKA 11(5), 2013; this is sections 3.2 and 4. The chord error and the normal
acceleration limit the feed step, and the look-ahead goes back.

This is the baseline beside the planner
and :mod:`cnc.pulses.kernels.sampled`. There is no plan: each period T finds its own step, a chord
from the last sample r(u_i) to the next.

    predictor, equation 3      u~ = (9 u_i - 6 u_(i-1) + u_(i-2)) / 4
    equation 4                 dL~ = |r(u~) - r(u_i)|, and h~ is the distance of the curve from that
                               chord at the middle of u
    chord error, equation 6    dL1 = sqrt(h_max / h~) dL~
    normal acceleration, 7     dL2 = T/2 sqrt(a_N / (2 h_max)) dL1
    equation 8                 dL = min(dL0, dL1, dL2), dL0 by the S-curve: acceleration grows by
                               J T a period up to A and falls before F
    corrector, equation 5      u~ = u_i + dL / dL~ (u~ - u_i) until |dL - dL~| / dL <= delta_max

The predictor goes along the tangent with fewer than three samples, or where u~ <= u_i.

Corrected: as printed the root of equation 7 takes in dL1, and the units do not match; rho = dL1^2 /
(8 h_max) and (dL2 / T)^2 = a_N rho give the form above. Equation 5 is repeated, for the predictor
is exact for even steps only. It is bracketed, since the secant of a chord may swing beside a cusp.

Equations 6 to 8 reduce the speed as suddenly as the curve bends. The look-ahead of section 4.2 goes
back from such a place:

    v |-----------B
      |            \_   i
      |              \_ :             d
      |                \_
      |__________________A___ s

c) The speed falls by more than T A a period until, at A, it no longer does: from A back along the
samples with a speed that grows by T A a period, until it meets them, at B. ) From B again, slower
by (V_B - V_A) / n <= T A a period, n as small as T A permits. The n steps fall short of the
distance. The rest is made first, by whole periods of V_B and one shorter step, which is put where
it fits between its neighbours.

The end of the curve is such a place with V_A = 0. Going back limits the acceleration, and nothing
limits the jerk. h is limited by the bend of the predicted step; a step that meets a corner detects
it too late. The plans of :mod:`cnc.planner` keep all of these limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import U0, U1, Floats, Pieces, curve_eval

# Speeds from B down to A, where the look-ahead of Hui, Wei and Gao 2013 (section 4.2) goes back.
#
# The drawing is at the head of this file.

TOLERANCE = 1e-6
"""By this part a speed may fall more than T A before the look-ahead goes back: rounding is no
reason.
"""


@njit
def periods_between(v: float, low: float, most: float) -> int:
    """Return the number of periods from v down to ``low``, by at most ``most`` each; at least 1."""
    return max(math.ceil((v - low) / most * (1.0 - TOLERANCE)), 1)


@njit
def slowing_distance(v: float, low: float, most: float, period: float) -> float:
    """Return the distance of these periods: steps of v - dv, v - 2 dv .. low."""
    n = periods_between(v, low, most)
    return period * (n * low + 0.5 * (n - 1) * (v - low)) if v > low else period * low


@njit
def fill_speeds(
    v: float, low: float, most: float, period: float, distance: float, arrives: bool, queue: Floats
) -> int:
    """Write speeds from v at B down to ``low`` at A, ``distance`` mm ahead, into ``queue``.

    The last speed comes first. arrives: A is the end of the curve.

    Returns:
        The number of speeds.
    """
    n = periods_between(v, low, most) if v > low else 0
    rest = distance - (slowing_distance(v, low, most, period) if n > 0 else 0.0)
    fast = max(v, low)
    whole = min(int(rest / (fast * period)), queue.shape[0] - n - 1) if rest > 0.0 else 0
    odd = rest / period - whole * fast
    count = 0
    placed = odd < (0.0 if arrives else low)
    for k in range(n):
        speed = low + k * (v - low) / n
        if not placed and odd <= speed:
            queue[count] = odd
            count += 1
            placed = True
        queue[count] = speed
        count += 1
    if not placed:
        queue[count] = odd
        count += 1
    for _ in range(whole):
        queue[count] = fast
        count += 1
    return count


DONE, ARRAYS_FULL, STUCK = 0, 1, 2
"""Outcomes of :func:`interpolate`: at the end of the curve; more samples than the arrays hold; the
look-ahead never came to an end.
"""
SECANTS, CORRECTIONS = 8, 60
"""Equation 5 is used at most SECANTS times. From then on the step in u is doubled until there is a
bracket, and that is halved; CORRECTIONS is the limit for both.
"""
TRIES = 16
"""Largest mean number of times that a sample is made."""


class Limits(NamedTuple):
    """Limits of the interpolation.

    Attributes:
        feed: mm/s.
        period: s.
        normal: normal acceleration, mm/s^2.
        tangential: tangential acceleration, mm/s^2.
        jerk: mm/s^3.
        chord_error: mm.
        deviation: relative deviation of the chord from the step.
    """

    feed: float
    period: float
    normal: float
    tangential: float
    jerk: float
    chord_error: float
    deviation: float


class Samples(NamedTuple):
    """One row for each sample: its place, and the period that led to it.

    Attributes:
        u: parameter.
        position: (rows, n), mm.
        step: step that the speed asked for, mm.
        chord: chord made, mm.
        error: distance of the curve from the chord, mm.
        deviation: relative deviation of the chord from the step asked for.
    """

    u: Floats
    position: Floats
    step: Floats
    chord: Floats
    error: Floats
    deviation: Floats


@njit
def _evaluate(pieces: Pieces, piece: int, u: float, r: Floats) -> int:
    """Write position and derivatives at u into r (4, n).

    piece: the piece that is tried first.

    Returns:
        The piece in which u lies.
    """
    kind, at, data = pieces
    while piece > 0 and u < data[at[piece] + U0]:
        piece -= 1
    while piece < at.shape[0] - 1 and u >= data[at[piece] + U1]:
        piece += 1
    curve_eval(kind[piece], data, at[piece], u, r)
    return piece


@njit
def _distance(p: Floats, q: Floats) -> float:
    """Return the distance of the positions p[0] and q[0] of p, q (4, n)."""
    square = 0.0
    for i in range(p.shape[1]):
        square += (q[0, i] - p[0, i]) ** 2
    return math.sqrt(square)


@njit
def _offset(p: Floats, q: Floats, m: Floats) -> float:
    """Return the distance of m[0] from the straight line through p[0] and q[0]."""
    chord = 0.0
    along = 0.0
    square = 0.0
    for i in range(p.shape[1]):
        d = q[0, i] - p[0, i]
        e = m[0, i] - p[0, i]
        chord += d * d
        along += d * e
        square += e * e
    if chord > 0.0:
        # By components: |e|^2 - (e.d)^2 / |d|^2 would lose all digits on a flat curve.
        square = 0.0
        for i in range(p.shape[1]):
            d = q[0, i] - p[0, i]
            square += (m[0, i] - p[0, i] - along / chord * d) ** 2
    return math.sqrt(square)


@njit
def _next_step(
    pieces: Pieces,
    piece: int,
    limits: Limits,
    before: tuple[float, float],
    u: float,
    step: float,
    p: Floats,
    q: Floats,
    m: Floats,
) -> tuple[float, float, float, float]:
    """Make the step of one period from u on, ``step`` mm (dL0) or less, by equations 3 to 8.

    Args:
        pieces: the pieces of the curve.
        piece: the piece in which u lies.
        limits: the limits.
        before: parameters of the last sample but one and of the last; both u if there are none.
        u: parameter of this sample.
        step: largest step, mm.
        p: (4, n): position and derivatives at u.
        q: (4, n): takes those at the new sample.
        m: (4, n): work space.

    Returns:
        The new u (the end of the curve where the step reaches it), the step asked for in the end
        (dL), the chord made, and its error h.
    """
    u2, u1 = before
    _, at, data = pieces
    end = data[at[-1] + U1]
    guess = 0.25 * (9.0 * u - 6.0 * u1 + u2)
    if not (u2 < u1 < u < guess):
        speed = 0.0
        for i in range(p.shape[1]):
            speed += p[1, i] * p[1, i]
        guess = u + step / math.sqrt(speed) if speed > 0.0 else 0.5 * (u + end)
    guess = min(guess, end)
    here = _evaluate(pieces, piece, guess, q)
    _evaluate(pieces, piece, 0.5 * (u + guess), m)
    chord = _distance(p, q)
    error = _offset(p, q, m)
    allowed = limits.chord_error
    if error > 0.0:
        by_error = math.sqrt(allowed / error) * chord
        step = min(
            step,
            by_error,
            0.5 * limits.period * math.sqrt(0.5 * limits.normal / allowed) * by_error,
        )
    low = u
    high = end
    k = 0
    moved = False
    while (
        abs(step - chord) > limits.deviation * step
        and k < CORRECTIONS
        and not (guess == end and chord < step)
    ):
        if chord > step:
            high = guess
        else:
            low = guess
        # Where the curve turns back the chord hardly grows. The secant would leave the
        # neighbourhood, or go on by tiny steps.
        guess = u + (2.0 if k >= SECANTS and chord < step else min(step / chord, 2.0)) * (guess - u)
        if guess >= high and high == end:
            guess = end
        elif not low < guess < high or (k >= SECANTS and high < end):
            guess = 0.5 * (low + high)
        here = _evaluate(pieces, here, guess, q)
        chord = _distance(p, q)
        k += 1
        moved = True
    if moved:
        _evaluate(pieces, piece, 0.5 * (u + guess), m)
        error = _offset(p, q, m)
    return guess, step, chord, error


@njit
def _raised(v: float, a: float, limits: Limits) -> float:
    """Return the next speed of the S-curve after v with acceleration a.

    It approaches F, where the acceleration is 0.
    """
    period = limits.period
    jerk = limits.jerk
    # a, a - J T, a - 2 J T .. sum up to the speed that is missing
    fading = jerk * (
        math.sqrt(0.25 * period * period + 2.0 * max(limits.feed - v, 0.0) / jerk) - 0.5 * period
    )
    return min(
        v + period * min(max(a, 0.0) + jerk * period, limits.tangential, fading), limits.feed
    )


@njit
def interpolate(
    pieces: Pieces,
    limits: Limits,
    look_ahead: bool,
    out: Samples,
    queue: Floats,
    p: Floats,
    q: Floats,
    m: Floats,
) -> tuple[int, int, int]:
    """Write samples from rest at the start of a curve to its end.

    The deviation of a sample is that from the step by speed and the rests that earlier chords left.
    So the chords keep to the distances of the look-ahead.

    Args:
        pieces: the pieces of one curve, over which the parameter runs on.
        limits: the limits.
        look_ahead: whether to go back from places where the speed falls too fast.
        out: takes the samples.
        queue: (rows,): work space.
        p: (4, n): work space.
        q: (4, n): work space.
        m: (4, n): work space.

    Returns:
        An outcome, the number of samples, and how often the look-ahead went back.
    """
    _, at, data = pieces
    u, where, step, chord, error, deviation = out
    rows = u.shape[0]
    period = limits.period
    most = period * limits.tangential
    end = data[at[-1] + U1]
    u[0] = data[at[0] + U0]
    step[0] = 0.0
    chord[0] = 0.0
    error[0] = 0.0
    deviation[0] = 0.0
    piece = _evaluate(pieces, 0, u[0], p)
    where[0] = p[0]
    i = 0
    queued = 0
    owed = 0.0
    falling = False
    backs = 0
    tried = 0
    outcome = DONE
    while outcome == DONE and u[i] < end:
        v = step[i] / period
        before = step[i - 1] / period if i > 0 else 0.0
        feed = _raised(v, (v - before) / period, limits)
        if queued > 0:
            queued -= 1
            feed = min(feed, queue[queued])
        wanted = max(feed * period + owed, 0.5 * feed * period)
        last = (u[max(i - 2, 0)], u[max(i - 1, 0)])
        to, asked, made, h = _next_step(pieces, piece, limits, last, u[i], wanted, p, q, m)
        arrived = to == end
        asked = made if arrived else asked
        # The last step may be any part of a period, and the speed after it is 0.
        new = feed * period if asked == wanted else min(asked, feed * period)
        falls = (v - new / period > most * (1.0 + TOLERANCE)) or (
            arrived and new / period > most * (1.0 + TOLERANCE)
        )
        if look_ahead and ((arrived and falls) or (falling and (arrived or not falls))):
            # A is the end of the curve, or the sample at which the speed no longer falls too fast.
            distance = 0.0 if falling else made
            low = v if falling else 0.5 * most
            j = i
            while j > 0 and slowing_distance(step[j] / period, low, most, period) > distance:
                distance += chord[j]
                j -= 1
            queued = fill_speeds(step[j] / period, low, most, period, distance, not falling, queue)
            owed = 0.0
            falling = False
            backs += 1
            i = j
            piece = _evaluate(pieces, piece, u[i], p)
        elif i + 1 >= rows:
            outcome = ARRAYS_FULL
        else:
            falling = look_ahead and falls
            i += 1
            u[i] = to
            step[i] = new
            chord[i] = made
            error[i] = h
            deviation[i] = abs(asked - made) / asked
            owed = asked - made
            p, q = q, p
            where[i] = p[0]
        tried += 1
        if outcome == DONE and tried > TRIES * rows:
            outcome = STUCK
    return outcome, i + 1, backs
