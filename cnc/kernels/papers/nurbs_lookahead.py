r"""Sampled interpolation of a bare curve as the paper has it: feed step by chord error and normal
acceleration, look-ahead by going back.

Hui, Wei, Gao, TELKOMNIKA 11(5), 2013, sections 3.2 and 4; the baseline beside the planner and
:mod:`cnc.kernels.pulses.sampled`. There is no plan: each period of T finds its own step, a chord
from the last sample r(u_i) to the next.

    predictor, equation 3      u~ = (9 u_i - 6 u_(i-1) + u_(i-2)) / 4; by the tangent where there are not three samples yet, or u~ <= u_i
    equation 4                 dL~ = |r(u~) - r(u_i)|, and h~ is the distance of the curve from that chord at the middle of u
    chord error, equation 6    dL1 = sqrt(h_max / h~) dL~
    normal acceleration, 7     dL2 = T/2 sqrt(a_N / (2 h_max)) dL1   (mended: printed, the root takes in dL1, and the units do not fit;
                               rho = dL1^2 / (8 h_max) and (dL2 / T)^2 = a_N rho give this)
    equation 8                 dL = min(dL0, dL1, dL2), dL0 by the S-curve: the acceleration grows by J T a period up to A and sinks in
                               time for F
    corrector, equation 5      u~ = u_i + dL / dL~ (u~ - u_i) until |dL - dL~| / dL <= delta_max (mended: again and again, for the predictor
                               is exact for even steps only); bracketed, as the secant of a chord may swing beside a cusp

Equations 6 to 8 bring the speed down as suddenly as the curve bends. The look-ahead of section 4.2
goes back from such a place:

    v |-----------B                    c) The speed falls by more than T A a period until, at A, it does no more: from A back along the
      |            \_   i                samples with a speed that grows by T A a period, until it meets them, at B.
      |              \_ :             d) From B again, slower by (V_B - V_A) / n <= T A a period, n as small as T A permits. What the n
      |                \_               steps lack of the way is made by whole periods of V_B first and one shorter step, which is put
      |__________________A___ s          where it fits between its neighbours.

The end of the curve is such a place with V_A = 0. Going back holds the acceleration, and nothing
holds the jerk; h is held by the bend of the step foretold, and a step that meets a corner first
learns of it too late. The plans of :mod:`cnc.planner` keep to all of them.
"""

from __future__ import annotations

import math

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import U0, U1, Floats, Ints, curve_eval

FEED, PERIOD, NORMAL, TANGENTIAL, JERK, CHORD_ERROR, DEVIATION = 0, 1, 2, 3, 4, 5, 6
"""Limits: mm/s, s, mm/s^2, mm/s^2, mm/s^3, mm, relative."""
LIMITS = 7
DONE, NO_ROOM, STUCK = 0, 1, 2
"""Outcomes of :func:`interpolate`: at the end of the curve; more samples than the arrays hold;
going back never came to an end.
"""
SECANTS, CORRECTIONS = 8, 60
"""Equation 5 is used so often at most; from then on the step in u is doubled until there is a
bracket, and that is halved.
"""
TOLERANCE = 1e-6
"""By this part a speed may drop more than T A before the look-ahead goes back: rounding is no
reason.
"""
TRIES = 16
"""How often a sample may be made on average."""


@njit
def position(kind: Ints, at: Ints, data: Floats, piece: int, u: float, r: Floats) -> int:
    """Position and derivatives at u into r (4, n). piece: where to look first; returns the piece
    that u lies in.
    """
    while piece > 0 and u < data[at[piece] + U0]:
        piece -= 1
    while piece < at.shape[0] - 1 and u >= data[at[piece] + U1]:
        piece += 1
    curve_eval(int(kind[piece]), data, int(at[piece]), u, r)
    return piece


@njit
def distance(p: Floats, q: Floats) -> float:
    """Between the positions p[0] and q[0] of p, q (4, n)."""
    square = 0.0
    for i in range(p.shape[1]):
        square += (q[0, i] - p[0, i]) ** 2
    return math.sqrt(square)


@njit
def offset(p: Floats, q: Floats, m: Floats) -> float:
    """Distance of m from the straight line through p and q."""
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
        # the foot's distance by components: |e|^2 - (e.d)^2 / |d|^2 would lose all digits on a flat curve
        square = 0.0
        for i in range(p.shape[1]):
            d = q[0, i] - p[0, i]
            square += (m[0, i] - p[0, i] - along / chord * d) ** 2
    return math.sqrt(square)


@njit
def next_step(
    kind: Ints, at: Ints, data: Floats, piece: int, limits: Floats, u2: float, u1: float, u: float, step: float,
    p: Floats, q: Floats, m: Floats,
) -> tuple[float, float, float, float]:  # fmt: skip
    """One period from u on, whose position is in p: ``step`` mm (dL0) or less by equations 3 to 8.

    u2, u1: parameters of the two samples before (u2 = u1 = u: there are none). q and m are work; q
    ends up at the new sample. Returns the new u (the end of the curve where the step reaches it),
    the step asked for in the end (dL), the chord made, and its error h.
    """
    end = data[at[-1] + U1]
    guess = 0.25 * (9.0 * u - 6.0 * u1 + u2)
    if not (u2 < u1 < u < guess):
        speed = 0.0
        for i in range(p.shape[1]):
            speed += p[1, i] * p[1, i]
        guess = u + step / math.sqrt(speed) if speed > 0.0 else 0.5 * (u + end)
    guess = min(guess, end)
    here = position(kind, at, data, piece, guess, q)
    position(kind, at, data, piece, 0.5 * (u + guess), m)
    chord = distance(p, q)
    error = offset(p, q, m)
    allowed = limits[CHORD_ERROR]
    if error > 0.0:
        by_error = math.sqrt(allowed / error) * chord
        step = min(
            step,
            by_error,
            0.5 * limits[PERIOD] * math.sqrt(0.5 * limits[NORMAL] / allowed) * by_error,
        )
    low = u
    high = end
    k = 0
    moved = False
    while (
        abs(step - chord) > limits[DEVIATION] * step
        and k < CORRECTIONS
        and not (guess == end and chord < step)
    ):
        if chord > step:
            high = guess
        else:
            low = guess
        # where the curve turns back the chord hardly grows: the secant would leave the
        # neighbourhood, or go on by tiny steps
        guess = u + (2.0 if k >= SECANTS and chord < step else min(step / chord, 2.0)) * (guess - u)
        if guess >= high and high == end:
            guess = end
        elif not low < guess < high or (k >= SECANTS and high < end):
            guess = 0.5 * (low + high)
        here = position(kind, at, data, here, guess, q)
        chord = distance(p, q)
        k += 1
        moved = True
    if moved:
        position(kind, at, data, piece, 0.5 * (u + guess), m)
        error = offset(p, q, m)
    return guess, step, chord, error


@njit
def raised(v: float, a: float, limits: Floats) -> float:
    """The S-curve's next speed after v with acceleration a: towards F, which is met with no
    acceleration left.
    """
    period = limits[PERIOD]
    jerk = limits[JERK]
    # a, a - J T, a - 2 J T .. sum up to what is missing
    fading = jerk * (
        math.sqrt(0.25 * period * period + 2.0 * max(limits[FEED] - v, 0.0) / jerk) - 0.5 * period
    )
    return min(
        v + period * min(max(a, 0.0) + jerk * period, limits[TANGENTIAL], fading), limits[FEED]
    )


@njit
def interpolate(
    kind: Ints, at: Ints, data: Floats, limits: Floats, look_ahead: bool,
    u: Floats, where: Floats, step: Floats, chord: Floats, error: Floats, deviation: Floats, queue: Floats, p: Floats, q: Floats, m: Floats,
) -> tuple[int, int, int]:  # fmt: skip
    """Samples from rest at the start of a curve to its end; see the head of the module.

    kind, at, data: the pieces of one curve, over which u runs on. Outputs, one a sample: u,
    position (room, n), and of the period that led there the step by speed, the chord made, its
    error (mm), and its relative deviation from what was asked for. That is the step by speed and
    what the chords before have left of theirs: so they keep to the way that the look-ahead has laid
    out. queue (room,) and p, q, m (4, n) are work.

    Returns an outcome, the number of samples, and how often the look-ahead went back.
    """
    room = u.shape[0]
    period = limits[PERIOD]
    most = period * limits[TANGENTIAL]
    end = data[at[-1] + U1]
    u[0] = data[at[0] + U0]
    step[0] = 0.0
    chord[0] = 0.0
    error[0] = 0.0
    deviation[0] = 0.0
    piece = position(kind, at, data, 0, u[0], p)
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
        feed = raised(v, (v - before) / period, limits)
        if queued > 0:
            queued -= 1
            feed = min(feed, queue[queued])
        wanted = max(feed * period + owed, 0.5 * feed * period)
        to, asked, made, h = next_step(
            kind, at, data, piece, limits, u[max(i - 2, 0)], u[max(i - 1, 0)], u[i], wanted, p, q, m
        )
        arrived = to == end
        asked = made if arrived else asked
        # the last step may be any part of a period, and the speed after it is 0
        new = feed * period if asked == wanted else min(asked, feed * period)
        falls = (v - new / period > most * (1.0 + TOLERANCE)) or (
            arrived and new / period > most * (1.0 + TOLERANCE)
        )
        if look_ahead and ((arrived and falls) or (falling and (arrived or not falls))):
            # A is the end of the curve, or the sample at which the speed has ceased to fall too
            # fast
            way = 0.0 if falling else made
            low = v if falling else 0.5 * most
            j = i
            while j > 0 and _slowing(step[j] / period, low, most, period) > way:
                way += chord[j]
                j -= 1
            queued = _fill(step[j] / period, low, most, period, way, not falling, queue)
            owed = 0.0
            falling = False
            backs += 1
            i = j
            piece = position(kind, at, data, piece, u[i], p)
        elif i + 1 >= room:
            outcome = NO_ROOM
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
        if outcome == DONE and tried > TRIES * room:
            outcome = STUCK
    return outcome, i + 1, backs


@njit
def _periods(v: float, low: float, most: float) -> int:
    """Periods in which v comes down to ``low`` by at most ``most`` each; one at least."""
    return max(math.ceil((v - low) / most * (1.0 - TOLERANCE)), 1)


@njit
def _slowing(v: float, low: float, most: float, period: float) -> float:
    """The way of these periods: steps of v - dv, v - 2 dv .. low."""
    n = _periods(v, low, most)
    return period * (n * low + 0.5 * (n - 1) * (v - low)) if v > low else period * low


@njit
def _fill(
    v: float, low: float, most: float, period: float, way: float, arrives: bool, queue: Floats
) -> int:
    """Speeds from v at B down to ``low`` at A, ``way`` mm further on, last first into ``queue``;
    returns how many.
    """
    n = _periods(v, low, most) if v > low else 0
    rest = way - (_slowing(v, low, most, period) if n > 0 else 0.0)
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
