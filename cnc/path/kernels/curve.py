"""Curves as records in flat arrays: position, derivatives, arc length, turning points.

A path is made of pieces, each smooth inside. A piece is a record in a float64 array ``data`` that
starts at index ``at``:

    0       number of axes n
    1, 2    range of the parameter, u0 < u1
    3       arc length in mm
    4..7    number of metric axes (1 to 3) and their columns
    8       index of the table of the arc length, counted from ``at``; 0 where u - u0 is itself the
            arc length, or stands for it (:mod:`cnc.planner.kernels.timed`)
    9       start point (n), end point (n): exact, and equal to the last bit where two pieces meet
    then    LINE: nothing more
            ARC:  first and second column of the plane, radius at the start, growth of the radius,
                  sweep (rad, signed), angle of the start, unit vector from the centre to the start
                  (2), closing vector (2)
            SPAN: degree p (3..9), index of the turning points (from ``at``), then p + 1 Bernstein
                  coefficients of the weight function W and of each axis of N, the numerator
                  measured from the start point

Arc length is measured over the metric axes (x y z if they move, else u v w, else a b c). The others
move along with them.

LINE. u is the arc length. Each half is measured from its own end, so that both ends are exact and
an axis that stands still keeps its position.

ARC. u is proportional to the angle phi. It is the arc length unless the radius changes (a spiral,
because programs give the centre with few digits). With w = (u - u0) / (u1 - u0), rho = r0 + w dr, e
the unit vector to the start and f the one 90 degrees further,

                 ,-- end      r(u) = start + (rho (cos phi - 1) + w dr) e + rho sin phi f + w c
               ,'  rho
      start --e--> centre     c, about 1e-16 of the radius, removes the rounding error at the end.
                              cos phi - 1 = -2 sin^2(phi / 2) keeps its digits on a short arc of a
                              large circle.

SPAN. One knot span of a NURBS (equation 1 of Hui, Wei, Gao 2013) on [u0, u1], r(u) = start + N(t) /
W(t) with t = (u - u0) / (u1 - u0). N and W are kept in Bernstein form, where de Boor's recursion
turns into de Casteljau's (Piegl & Tiller, The NURBS Book, A1.5 and section 5.3), and the quotient
is differentiated as in A4.2. Degrees 1 and 2 are raised to 3 when the record is made.

Table: count k, then k rows (s, u, c1..c7) and a last (s, u). In a row u = u_row + c1 x + .. + c7
x^7 with x the part of the row's length up to the place: the Hermite interpolant of u(s) through u,
du/ds, d2u/ds2 and d3u/ds3 at both ends (see :mod:`cnc.path.kernels.arclength`).

All kernels take ``kind`` and ``at`` as int (int64: numba compiles anew for an int8, and for a
constant) and u as float.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LINE, ARC, SPAN = 0, 1, 2
MAX_TURNING_POINTS = 16
"""Most turning points of a piece in an axis: 2 p - 2 for a span of degree 9. An arc piece is at
most one turn.
"""

AXES, U0, U1, LENGTH, METRICS, METRIC, TABLE, START = 0, 1, 2, 3, 4, 5, 8, 9
"""Offsets in the head of a record."""
ARC_BODY = 10
SPAN_BODY = 2
ROW = 9
"""Numbers in a row of the arc length table."""
SINGULAR = 1e-9
"""|dr/du| below this part of its mean counts as zero."""


@njit
def curve_range(kind: int, data: Floats, at: int) -> tuple[float, float]:
    """Return the range (u0, u1) of the parameter of a piece."""
    return data[at + U0], data[at + U1]


@njit
def is_one(data: Floats, first: int, count: int) -> bool:
    """Return whether so many numbers from ``first`` on are 1."""
    one = True
    for k in range(first, first + count):
        one = one and data[k] == 1.0
    return one


@njit
def is_plain_quintic(data: Floats, at: int) -> bool:
    """Return whether a span is of degree 5 and its weight function is 1.

    By far the most are: those of fitted paths. What is done for each point of a path does it for
    them without arrays and loops.
    """
    body = at + START + 2 * int(data[at + AXES])
    return data[body] == 5.0 and is_one(data, body + SPAN_BODY, 6)


@njit
def curve_eval(kind: int, data: Floats, at: int, u: float, out: Floats) -> None:
    """Write position and first three derivatives by u (mm, mm per unit of u) into out (4, n).

    They are exact at u0 and u1, and continue smoothly beyond them.
    """
    n = out.shape[1]
    u0, u1 = data[at + U0], data[at + U1]
    start, end = at + START, at + START + n
    per_u = 1.0 / (u1 - u0)
    body = end + n
    done, left = u - u0, u1 - u
    if kind == SPAN:
        # The four points of de Casteljau's triangle three rows above its tip are sums of the
        # coefficients, weighted with the Bernstein polynomials of degree p - 3. The sum runs from
        # the nearer end, so that each weight follows from the one before without loss.
        p = int(data[body])
        body += SPAN_BODY
        m, p2 = p - 3, p * (p - 1.0)
        t = done * per_u
        near = t <= 0.5
        base = 1.0 - t if near else t
        ratio = (t if near else 1.0 - t) / base
        step = 1 if near else -1
        inverse, w1, w2, w3 = 1.0, 0.0, 0.0, 0.0
        # Of degree 5 are the spans of fitted paths, by far the most: their weights are not worked
        # out anew for each axis. Most weight functions are 1.
        g0, g1, g2 = (1.0 - t) * (1.0 - t), 2.0 * t * (1.0 - t), t * t
        for c in range(1 if is_one(data, body, p + 1) else 0, n + 1):
            k = body + c * (p + 1)
            c0, c1, c2, c3 = data[k], data[k + 1], data[k + 2], data[k + 3]
            if m == 2:
                c0, c1 = g0 * c0 + g1 * c1 + g2 * c2, g0 * c1 + g1 * c2 + g2 * c3
                c2 = g0 * c2 + g1 * c3 + g2 * data[k + 4]
                c3 = g0 * c3 + g1 * data[k + 4] + g2 * data[k + 5]
            elif m > 0:
                weight = base
                for _ in range(m - 1):
                    weight *= base
                if not near:
                    k += m
                c0 = c1 = c2 = c3 = 0.0
                for j in range(m + 1):
                    c0 += weight * data[k]
                    c1 += weight * data[k + 1]
                    c2 += weight * data[k + 2]
                    c3 += weight * data[k + 3]
                    weight *= ratio * (m - j) / (j + 1)
                    k += step
            b0, b1, b2 = c0 + t * (c1 - c0), c1 + t * (c2 - c1), c2 + t * (c3 - c2)
            a0, a1 = b0 + t * (b1 - b0), b1 + t * (b2 - b1)
            f0 = (a0 + t * (a1 - a0)) * inverse
            f1 = p * (a1 - a0) * inverse - w1 * f0
            f2 = p2 * ((b2 - b1) - (b1 - b0)) * inverse - 2.0 * w1 * f1 - w2 * f0
            f3 = (
                p2 * (p - 2.0) * ((c3 - c0) - 3.0 * (c2 - c1)) * inverse
                - 3.0 * (w1 * f2 + w2 * f1)
                - w3 * f0
            )
            if c == 0:
                # The weight function comes first: all others are divided by it.
                inverse = 1.0 / f0
                w1, w2, w3 = f1 * inverse, f2 * inverse, f3 * inverse
            else:
                i = c - 1
                out[0, i] = data[start + i] + f0
                out[1, i], out[2, i] = f1 * per_u, f2 * per_u * per_u
                out[3, i] = f3 * per_u * per_u * per_u
    else:
        for i in range(n):
            a, b = data[start + i], data[end + i]
            rate = (b - a) * per_u
            out[0, i] = a + done * rate if done <= left else b - left * rate
            out[1, i] = rate
            out[2, i] = out[3, i] = 0.0
    if kind == ARC:
        i, j = int(data[body]), int(data[body + 1])
        w = done * per_u
        grown = w * data[body + 3]
        rho = data[body + 2] + grown
        growth = data[body + 3] * per_u
        turn = data[body + 4] * per_u
        half = 0.5 * (w * data[body + 4])
        sin_half, cos_half = math.sin(half), math.cos(half)
        sin = 2.0 * sin_half * cos_half
        versed = 2.0 * sin_half * sin_half
        cos = 1.0 - versed
        ex, ey = data[body + 6], data[body + 7]
        # along e, along f: the position, then its derivatives
        a, b = grown - rho * versed, rho * sin
        out[0, i] = data[start + i] + (a * ex - b * ey) + w * data[body + 8]
        out[0, j] = data[start + j] + (a * ey + b * ex) + w * data[body + 9]
        a, b = growth * cos - rho * turn * sin, growth * sin + rho * turn * cos
        out[1, i] = a * ex - b * ey + per_u * data[body + 8]
        out[1, j] = a * ey + b * ex + per_u * data[body + 9]
        a = -turn * (2.0 * growth * sin + rho * turn * cos)
        b = turn * (2.0 * growth * cos - rho * turn * sin)
        out[2, i] = a * ex - b * ey
        out[2, j] = a * ey + b * ex
        a = turn * turn * (rho * turn * sin - 3.0 * growth * cos)
        b = -turn * turn * (rho * turn * cos + 3.0 * growth * sin)
        out[3, i] = a * ex - b * ey
        out[3, j] = a * ey + b * ex
    if left == 0.0:
        for i in range(n):
            out[0, i] = data[end + i]


@njit
def curve_speed(kind: int, data: Floats, at: int, u: float) -> float:
    """Return |dr/du| over the metric axes."""
    extent = data[at + U1] - data[at + U0]
    square = extent * extent
    if data[at + TABLE] != 0.0:
        start = at + START
        n = int(data[at + AXES])
        body = start + 2 * n
        t = (u - data[at + U0]) / extent
        square = 0.0
        if kind == SPAN:
            p = int(data[body])
            body += SPAN_BODY
            # Value and slope of W, then of the numerators, from the four points three rows above
            # the tip (see curve_eval).
            m = p - 3
            near = t <= 0.5
            base = 1.0 - t if near else t
            ratio = (t if near else 1.0 - t) / base
            step = 1 if near else -1
            inverse = 1.0
            pull = 0.0
            for c in range(int(data[at + METRICS]) + 1):
                k = body + (int(data[at + METRIC + c - 1]) + 1) * (p + 1) if c > 0 else body
                c0 = data[k]
                c1 = data[k + 1]
                c2 = data[k + 2]
                c3 = data[k + 3]
                if m > 0:
                    weight = base
                    for _ in range(m - 1):
                        weight *= base
                    if not near:
                        k += m
                    c0 = 0.0
                    c1 = 0.0
                    c2 = 0.0
                    c3 = 0.0
                    for j in range(m + 1):
                        c0 += weight * data[k]
                        c1 += weight * data[k + 1]
                        c2 += weight * data[k + 2]
                        c3 += weight * data[k + 3]
                        weight *= ratio * (m - j) / (j + 1)
                        k += step
                b0 = c0 + t * (c1 - c0)
                b1 = c1 + t * (c2 - c1)
                b2 = c2 + t * (c3 - c2)
                a0 = b0 + t * (b1 - b0)
                rise = b1 + t * (b2 - b1) - a0
                f0 = a0 + t * rise
                if c == 0:
                    inverse = 1.0 / f0
                    pull = rise * inverse
                else:
                    f1 = (rise - pull * f0) * inverse
                    square += f1 * f1
            square *= p * p
        else:
            rho = data[body + 2] + t * data[body + 3]
            square = rho * rho * data[body + 4] * data[body + 4] + data[body + 3] * data[body + 3]
            for k in range(int(data[at + METRICS])):
                column = int(data[at + METRIC + k])
                if column != int(data[body]) and column != int(data[body + 1]):
                    f1 = data[start + n + column] - data[start + column]
                    square += f1 * f1
    return math.sqrt(square) / (data[at + U1] - data[at + U0])


@njit
def curve_eval_s(kind: int, data: Floats, at: int, u: float, out: Floats) -> int:
    """Write position and first three derivatives by arc length q, q', q'', q''' into out (4, n).

    With r' = dr/du and sigma = |r'| over the metric axes, the chain rule gives q' = r' u', q'' =
    r'' u'^2 + r' u'', q''' = r''' u'^3 + 3 r'' u' u'' + r' u''' where u' = 1 / sigma, u'' = -sigma'
    / sigma^3, u''' = (3 sigma'^2 - sigma sigma'') / sigma^5 and sigma sigma'' = r''.r'' + r'.r''' -
    sigma'^2.

    Returns:
        0, or 1 where sigma vanishes (an end with repeated control points, a cusp). There q' is the
        limit of the direction, towards the first control point that differs from the end, and q'' =
        q''' = 0.
    """
    curve_eval(kind, data, at, u, out)
    n = out.shape[1]
    singular = False
    if data[at + TABLE] != 0.0:
        d11 = 0.0
        d12 = 0.0
        d22_13 = 0.0
        for k in range(int(data[at + METRICS])):
            i = int(data[at + METRIC + k])
            d11 += out[1, i] * out[1, i]
            d12 += out[1, i] * out[2, i]
            d22_13 += out[2, i] * out[2, i] + out[1, i] * out[3, i]
        sigma = math.sqrt(d11)
        singular = sigma * (data[at + U1] - data[at + U0]) <= SINGULAR * data[at + LENGTH]
        if not singular:
            u_s = 1.0 / sigma
            sigma1 = d12 * u_s
            u_ss = -sigma1 * u_s * u_s * u_s
            u_sss = (4.0 * sigma1 * sigma1 - d22_13) * (u_s * u_s) * (u_s * u_s * u_s)
            for i in range(n):
                r1 = out[1, i]
                r2 = out[2, i]
                out[1, i] = r1 * u_s
                out[2, i] = r2 * u_s * u_s + r1 * u_ss
                out[3, i] = out[3, i] * u_s * u_s * u_s + 3.0 * r2 * u_s * u_ss + r1 * u_sss
    if singular:
        body = at + START + 2 * n
        p = int(data[body]) if kind == SPAN else 0
        weight = body + SPAN_BODY
        at_start = u - data[at + U0] < data[at + U1] - u
        pole = 0 if at_start else p
        scale = 0.0
        far = pole
        for k in range(1, p + 1):
            # The first control point that is not at the end.
            j = k if at_start else p - k
            square = 0.0
            for c in range(int(data[at + METRICS])):
                column = weight + (int(data[at + METRIC + c]) + 1) * (p + 1)
                d = data[column + j] / data[weight + j] - data[column + pole] / data[weight + pole]
                square += d * d
            length = math.sqrt(square)
            if scale == 0.0 and length > SINGULAR * data[at + LENGTH]:
                scale = 1.0 / length if at_start else -1.0 / length
                far = j
        for i in range(n):
            column = weight + (i + 1) * (p + 1)
            d = (
                scale
                * (
                    data[column + far] / data[weight + far]
                    - data[column + pole] / data[weight + pole]
                )
                if scale != 0.0
                else 0.0
            )
            out[1, i] = d
            out[2, i] = 0.0
            out[3, i] = 0.0
    return 1 if singular else 0


# Turning points of pieces in each axis, and the boxes around pieces.


@njit
def curve_turning_points(kind: int, data: Floats, at: int, axis: int, out: Floats) -> int:
    """Write the u inside a piece where the derivative of ``axis`` changes sign, in order, into out.

    ``out`` takes MAX_TURNING_POINTS numbers.

    Returns:
        Their number.
    """
    if kind == LINE:
        return 0
    n = int(data[at + AXES])
    body = at + START + 2 * n
    if kind == SPAN:
        r = at + int(data[body + 1])
        first = r + n
        for i in range(axis):
            first += int(data[r + i])
        count = int(data[r + axis])
        for k in range(count):
            out[k] = data[first + k]
        return count
    if axis != int(data[body]) and axis != int(data[body + 1]):
        return 0
    # Along the first axis rho cos(theta) turns where tan(theta) = g / rho, g = d rho / d theta,
    # that is where h(theta) = theta - atan(g / rho) is a multiple of pi. h rises with a slope
    # between 1 and 2 whatever the spiral, so each multiple is met once and Newton finds it. The
    # second axis is the first, turned by 90 degrees.
    sweep = data[body + 4]
    radius = data[body + 2]
    g = data[body + 3] / sweep
    theta = data[body + 5] - (0.5 * math.pi if axis == int(data[body + 1]) else 0.0)
    h0 = theta - math.atan2(g, radius)
    h1 = theta + sweep - math.atan2(g, radius + data[body + 3])
    step = 1 if sweep > 0.0 else -1
    multiple = math.floor(h0 / math.pi) if sweep > 0.0 else math.ceil(h0 / math.pi)
    last = math.ceil(h1 / math.pi) if sweep > 0.0 else math.floor(h1 / math.pi)
    u0 = data[at + U0]
    u1 = data[at + U1]
    count = 0
    while (last - multiple) * step >= 0 and count < MAX_TURNING_POINTS:
        target = multiple * math.pi - theta
        phi = min(max(target, min(0.0, sweep)), max(0.0, sweep))
        if g == 0.0:
            phi = target
        else:
            for _ in range(30):
                rho = radius + g * phi
                change = (target - phi + math.atan2(g, rho)) / (1.0 + g * g / (rho * rho + g * g))
                phi += change
                if abs(change) < 1e-15 * (1.0 + abs(phi)):
                    break
        part = phi / sweep
        if abs(phi) > 1e-14 and abs(sweep - phi) > 1e-14 and 0.0 < part < 1.0:
            out[count] = u0 + part * (u1 - u0)
            count += 1
        multiple += step
    return count


@njit
def piece_boxes(kind: Ints, at: Ints, data: Floats, low: Floats, high: Floats) -> None:
    """Write the smallest and the largest coordinate of each piece into low and high (m, n), mm."""
    n = low.shape[1]
    turning = np.empty(MAX_TURNING_POINTS)
    point = np.empty((4, n))
    for m in range(at.shape[0]):
        a = at[m]
        start = a + START
        for i in range(n):
            low[m, i] = min(data[start + i], data[start + n + i])
            high[m, i] = max(data[start + i], data[start + n + i])
        k = kind[m]
        if k == LINE:
            continue
        for i in range(n):
            for j in range(curve_turning_points(k, data, a, i, turning)):
                curve_eval(k, data, a, turning[j], point)
                low[m, i] = min(low[m, i], point[0, i])
                high[m, i] = max(high[m, i], point[0, i])


# Pieces of a path as kernels take them: one record of numbers for each curve.


class Pieces(NamedTuple):
    """The curves of a path in order. Their records are laid out in :mod:`cnc.path.kernels.curve`.

    Attributes:
        kind: (n,) int64: LINE, ARC or SPAN.
        at: (n,) int64: the index in ``data`` at which the record of each piece begins.
        data: float64: the records, one behind the other.
    """

    kind: NDArray[np.int64]
    at: NDArray[np.int64]
    data: NDArray[np.float64]
