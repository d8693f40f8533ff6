"""The arcs of :mod:`cnc.kernels.pulses.half_step`: what leads, how far it is seen ahead, and which
candidate is the nearer one.

y, s ^            ,-o b      Window from a to b in which one axis, the leader p, is the fastest: the positions y of the others, the arc
     |        ,-'            length s and the parameter u as polynomials of p. A row is on each grid line of p, where
     |     o'                y is compared with the half-grid line next to the grid point.
     |   ,'|  |  |  |
     | o a |  |  |  |
     +-----+--+--+--+--> p
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import TABLE, Floats, Ints, curve_arclen, curve_eval, curve_range
from cnc.kernels.pulses.catch_up import prepare, round_to
from cnc.kernels.pulses.crossings import (
    CHECKS,
    EXACT,
    POLYNOMIAL,
    ROUNDING,
    SHORTEST,
    SLACK,
    SLACK_PER_BLU,
    interpolate,
    length_rates,
    risen,
    slack,
)


@njit
def arc_rows(
    kind: int, data: Floats, at: int, u: float, upto: float, s0: float, scale: Floats, grid: Ints, here: Floats, error: float, rows: int,
    step: NDArray[np.int8], reach: Floats,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """The rows at which an arc's leader is on a grid line; see :func:`half_step_rows`. Returns also
    whether room was left.
    """
    n = len(grid)
    room = len(reach)
    u0, u1 = curve_range(kind, data, at)
    measured = n if data[at + TABLE] != 0.0 else -1
    poly = np.empty((n + 1, POLYNOMIAL))
    lengths = np.empty((2, 4))
    moved = np.empty(n, np.int64)
    ra = np.empty((4, n))
    rb = np.empty((4, n))
    widest = (u1 - u0) / 8.0
    shortest = SHORTEST * (u1 - u0)
    width = widest
    wider_off = math.inf
    full = False
    ua = u
    curve_eval(kind, data, at, ua, ra)
    lengths[0, 0] = curve_arclen(kind, data, at, u0, ua)
    while ua < upto and not full:
        leader = _fastest(ra, scale)
        sign = 1 if ra[1, leader] > 0.0 else -1
        if sign * (ra[0, leader] * scale[leader] - grid[leader]) >= 1.0:
            rows, u, error, done = round_to(
                kind, data, at, u, ua, s0, scale, grid, here, error, rows, step, reach
            )
            if not done:
                full = True
                break
        ub = ua + width if upto - (ua + width) > 0.1 * width else upto
        curve_eval(kind, data, at, ub, rb)
        if _lead(rb, leader, scale) < 0.0:
            ub = _lead_ends(kind, data, at, ua, ub, leader, scale, ra, rb)
        off = _fit(kind, data, at, ua, ub, leader, scale, ra, rb, here, lengths, poly)
        # the error goes with the eighth power of the width
        width = min(
            (ub - ua)
            * min(max(0.9 * math.sqrt(math.sqrt(math.sqrt(1.0 / max(off, 1e-9)))), 0.1), 4.0),
            widest,
        )
        if off > 1.0 and not 0.5 * wider_off < off < ROUNDING and ub - ua > shortest:
            width = min(width, 0.7 * (ub - ua))
            wider_off = off
            continue
        wider_off = off if off > 1.0 else math.inf
        # what was taken with more than is allowed would not be better for being narrower
        width = max(width, ub - ua if off > 1.0 else shortest)
        pa = ra[0, leader] * scale[leader]
        pb = rb[0, leader] * scale[leader]
        lines = max(math.floor(sign * (pb - grid[leader]) + slack(pb)), 0)
        count = min(lines, room - rows)
        x = (grid[leader] + sign - pa) / (pb - pa) if count > 0 else 0.0
        dx = 1.0 / abs(pb - pa) if count > 0 else 0.0
        made = count
        for i in range(n):
            moved[i] = 0
            if i != leader:
                c = poly[i]
                far = 0.5 + slack(max(abs(ra[0, i]), abs(rb[0, i])) * scale[i])
                if (
                    ra[1, i] == 0.0
                    and rb[1, i] == 0.0
                    and ra[0, i] == rb[0, i]
                    and abs(c[0] - grid[i]) <= far
                ):
                    _rests(step[rows : rows + count, i])
                    error = max(error, abs(c[0] - grid[i]) if count > 0 else 0.0)
                    continue
                kept, moved[i], worst = _nearest(
                    c[0] - grid[i], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x, dx, far, step[rows : rows + count, i]
                )  # fmt: skip
                made = min(made, kept)
                error = max(error, worst)
        for i in range(n):
            if i == leader:
                for row in range(rows, rows + made):
                    step[row, i] = sign
                grid[i] += sign * made
            elif made == count:
                grid[i] += moved[i]
            else:
                for row in range(rows, rows + made):
                    grid[i] += step[row, i]
        if made > 0:
            c = poly[leader]
            u = u0 + risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x + (made - 1) * dx)
            c = poly[max(measured, leader)]
            _reaches(
                s0, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x, dx, reach[rows : rows + made]
            )
            rows += made
        if made < count:
            # an axis would make two steps there
            c = poly[leader]
            ub = u0 + risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x + made * dx)
        if made == count and count < lines:
            full = True
        else:
            before = rows
            rows, u, error, done = prepare(
                kind, data, at, u, ub, ub, s0, scale, grid, here, error, rows, step, reach
            )
            if done and made < count and rows == before:
                # there the polynomial and the curve are on two sides of the limit
                rows, u, error, done = round_to(
                    kind, data, at, u, ub, s0, scale, grid, here, error, rows, step, reach
                )
            full = not done
            if made == count and rows == before:
                ua = ub
                lengths[0, 0] = lengths[1, 0]
                ra, rb = rb, ra
            else:
                ua = u if rows > before else ub
                curve_eval(kind, data, at, ua, ra)
                lengths[0, 0] = curve_arclen(kind, data, at, u0, ua)
    return rows, u, error, not full


@njit
def _fastest(r: Floats, scale: Floats) -> int:
    """The axis that moves the most BLU per unit of u."""
    leader = 0
    for i in range(1, len(scale)):
        if abs(r[1, i]) * scale[i] > abs(r[1, leader]) * scale[leader]:
            leader = i
    return leader


@njit
def _lead(r: Floats, leader: int, scale: Floats) -> float:
    """By how much (BLU per unit of u) the leader is faster than the next."""
    next_best = 0.0
    for i in range(len(scale)):
        if i != leader:
            next_best = max(next_best, abs(r[1, i]) * scale[i])
    return abs(r[1, leader]) * scale[leader] - next_best


@njit
def _lead_ends(
    kind: int,
    data: Floats,
    at: int,
    low: float,
    high: float,
    leader: int,
    scale: Floats,
    ra: Floats,
    rb: Floats,
) -> float:
    """Where between low and high (the curve there: ra, rb) the leader is overtaken; rb becomes the
    curve there. Illinois' method.
    """
    close = 1e-7 / (abs(ra[1, leader]) * scale[leader])
    lead = _lead(ra, leader, scale)
    lag = _lead(rb, leader, scale)
    side = 0
    while high - low > close:
        middle = low + (high - low) * (lead / (lead - lag))
        if not low < middle < high:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
        curve_eval(kind, data, at, middle, rb)
        f = _lead(rb, leader, scale)
        if f < 0.0:
            high = middle
            lag = f
            lead *= 0.5 if side < 0 else 1.0
            side = -1
        else:
            low = middle
            lead = f
            lag *= 0.5 if side > 0 else 1.0
            side = 1
    curve_eval(kind, data, at, high, rb)
    return high


@njit
def _fit(
    kind: int, data: Floats, at: int, ua: float, ub: float, leader: int, scale: Floats, ra: Floats, rb: Floats, rc: Floats, lengths: Floats,
    poly: Floats,
) -> float:  # fmt: skip
    """Fit polynomials in the leader's position, 0 at ua and 1 at ub, to the other axes (BLU).

    That in the leader's row is u - u0, and that in the last the arc length from the piece's start
    (mm), where u does not stand for it. ra, rb (4, n): the curve at ua and ub. lengths[0, 0]: arc
    length at ua; lengths[1, 0] becomes that at ub. rc (4, n): scratch. Returns by how many times
    what is allowed a polynomial is off.
    """
    n = len(scale)
    u0, _ = curve_range(kind, data, at)
    measured = data[at + TABLE] != 0.0
    k = scale[leader]
    pa = ra[0, leader] * k
    h = rb[0, leader] * k - pa
    off = 0.0
    if measured:
        lengths[1, 0] = curve_arclen(kind, data, at, u0, ub)
        length_rates(data, at, ra, lengths[0])
        length_rates(data, at, rb, lengths[1])
        a1, a2, a3 = _by_leader(
            lengths[0, 1],
            lengths[0, 2],
            lengths[0, 3],
            ra[1, leader] * k,
            ra[2, leader] * k,
            ra[3, leader] * k,
            h,
        )
        b1, b2, b3 = _by_leader(
            lengths[1, 1],
            lengths[1, 2],
            lengths[1, 3],
            rb[1, leader] * k,
            rb[2, leader] * k,
            rb[3, leader] * k,
            h,
        )
        interpolate(poly, n, lengths[0, 0], a1, a2, a3, lengths[1, 0], b1, b2, b3)
    for i in range(n):
        if i == leader:
            a1, a2, a3 = _by_leader(1.0, 0.0, 0.0, ra[1, i] * k, ra[2, i] * k, ra[3, i] * k, h)
            b1, b2, b3 = _by_leader(1.0, 0.0, 0.0, rb[1, i] * k, rb[2, i] * k, rb[3, i] * k, h)
            interpolate(poly, i, ua - u0, a1, a2, a3, ub - u0, b1, b2, b3)
        else:
            q = scale[i]
            a1, a2, a3 = _by_leader(
                ra[1, i] * q,
                ra[2, i] * q,
                ra[3, i] * q,
                ra[1, leader] * k,
                ra[2, leader] * k,
                ra[3, leader] * k,
                h,
            )
            b1, b2, b3 = _by_leader(
                rb[1, i] * q,
                rb[2, i] * q,
                rb[3, i] * q,
                rb[1, leader] * k,
                rb[2, leader] * k,
                rb[3, leader] * k,
                h,
            )
            interpolate(poly, i, ra[0, i] * q, a1, a2, a3, rb[0, i] * q, b1, b2, b3)
    # a leader that does not move, but for rounding, leads nowhere
    moves = h * ra[1, leader] > 0.0
    for check in range(2 if moves else 0):
        u = ua + CHECKS[check] * (ub - ua)
        curve_eval(kind, data, at, u, rc)
        x = (rc[0, leader] * k - pa) / h
        for i in range(n):
            c = poly[i]
            y = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)
            if i == leader:
                off = max(off, abs(y - (u - u0)) / (EXACT + 1e-15 * u0))
            else:
                p = rc[0, i] * scale[i]
                off = max(off, abs(y - p) / (0.25 * SLACK + SLACK_PER_BLU * abs(p)))
        if measured:
            c = poly[n]
            y = risen(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)
            off = max(off, abs(y - curve_arclen(kind, data, at, u0, u)) / EXACT)
    return off if moves else math.inf


@njit
def _by_leader(
    q1: float, q2: float, q3: float, p1: float, p2: float, p3: float, h: float
) -> tuple[float, float, float]:
    """dq/dp h, half of d2q/dp2 h^2 and a sixth of d3q/dp3 h^3 from the derivatives of q and p
    by u.
    """
    inverse = 1.0 / p1
    y1 = q1 * inverse
    y2 = (q2 - y1 * p2) * inverse * inverse
    y3 = (q3 - 3.0 * y2 * p1 * p2 - y1 * p3) * inverse * inverse * inverse
    return y1 * h, 0.5 * y2 * h * h, y3 * h * h * h / 6.0


@njit
def _nearest(
    c0: float, c1: float, c2: float, c3: float, c4: float, c5: float, c6: float, c7: float, x: float, dx: float, far: float,
    step: NDArray[np.int8],
) -> tuple[int, int, float]:  # fmt: skip
    """One axis of an arc: of the two candidates of each row the nearer one. c0 .. c7: the
    polynomial, less the grid point.

    Returns the number of rows, up to one that would take two steps; the steps made; and the largest
    distance after a row.
    """
    kept = len(step)
    g = 0.0
    worst = 0.0
    for k in range(len(step)):
        y = risen(c0, c1, c2, c3, c4, c5, c6, c7, x + k * dx)
        # the grid points that are near enough: one, or both sides of a tie
        low = np.ceil(y - far)
        high = np.floor(y + far)
        near = low if low > g else g
        near = high if high < near else near
        move = near - g
        if abs(move) > 1.0:
            kept = k
            break
        step[k] = int(move)
        g = near
        worst = max(worst, abs(y - g))
    return kept, int(g), worst


@njit
def _reaches(
    s0: float, c0: float, c1: float, c2: float, c3: float, c4: float, c5: float, c6: float, c7: float, x: float, dx: float, reach: Floats
) -> None:  # fmt: skip
    """The path coordinate of rows at x, x + dx .."""
    for k in range(len(reach)):
        reach[k] = s0 + risen(c0, c1, c2, c3, c4, c5, c6, c7, x + k * dx)


@njit
def _rests(step: NDArray[np.int8]) -> None:
    """One axis that does not move."""
    for k in range(len(step)):
        step[k] = 0
