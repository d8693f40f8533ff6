"""Metric axes, sharp points and turning points of a span in Bernstein form.

Turning points of axis i are the sign changes of N_i' W - N_i W', whose homogeneous form is (N_x W_y
- N_y W_x) / p, of degree 2 p - 2.

A cusp is where all metric axes do that at once. sigma^2 = |dr/dt|^2 = E / W^4 with E the sum of the
squares of those numerators; where E' W - 4 E W' goes from minus to plus, sigma has a minimum. If it
is less than HAIRPIN of the mean the span is cut there,

          ________               ________
         (                      (
          `-------.   ->         `----- x
          ,-------'               ,----' x
         (________              (________

So every sharp or singular place lies at the end of a piece, where the planner and the tables expect
it.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import AXES, MAX_TURNING_POINTS, SPAN_BODY, START, U0, U1, Floats, Ints

# Polynomials in Bernstein form on [0, 1]: values, sub-intervals, and sign changes.
#
# By the variation diminishing property a polynomial changes its sign at most as often as its
# coefficients do. The first and the last coefficient that are not zero give the sign just inside
# the ends. Halving by de Casteljau isolates each change; where only one is left Newton's iteration,
# kept inside its bracket, finds it (Farouki, The Bernstein polynomial basis: a centennial
# retrospective, 2012, sections 5 and 9).
#
# Coefficients lie in flat arrays from an index on: slices of arrays cost more than the arithmetic.

DEPTH = 48
"""Number of halvings after which coefficients that still change sign more than once are taken as
one multiple root.
"""
STRIDE = 64
"""Numbers reserved for one set of coefficients: more than the degree of any polynomial here, 5 p -
5 for a span of degree p <= 9, and two more.
"""


@njit
def unscale(f: Floats, m: int) -> None:
    """Turn the homogeneous form f = sum F_i t^i (1-t)^(m-i) into f_i = F_i / C(m, i), in place.

    In the homogeneous form products are convolutions.
    """
    choose = 1.0
    for i in range(m + 1):
        f[i] /= choose
        choose *= (m - i) / (i + 1.0)


@njit
def split(f: Floats, at: int, m: int, t: float, left: Floats, left_at: int) -> None:
    """Divide f[at : at + m + 1] at t (de Casteljau).

    The coefficients over [0, t] go to ``left``; those over [t, 1] replace f.
    """
    for k in range(m + 1):
        left[left_at + k] = f[at]
        for i in range(at, at + m - k):
            f[i] += t * (f[i + 1] - f[i])


@njit
def value_slope(f: Floats, at: int, m: int, t: float, scratch: Floats) -> tuple[float, float]:
    """Return value and derivative at t of the polynomial f[at : at + m + 1], m >= 1."""
    for i in range(m + 1):
        scratch[i] = f[at + i]
    for k in range(m - 1):
        for i in range(m - k):
            scratch[i] += t * (scratch[i + 1] - scratch[i])
    rise = scratch[1] - scratch[0]
    return scratch[0] + t * rise, m * rise


@njit
def sign_changes(f: Floats, m: int, stack: Floats, scratch: Floats, roots: Floats) -> int:
    """Write the t inside (0, 1) where the polynomial f[: m + 1] changes its sign into ``roots``.

    stack ((DEPTH + 4) STRIDE,) and scratch (STRIDE,) are work space. The stack holds intervals, the
    leftmost on top, with their start and width behind the coefficients. ``before`` is the sign just
    left of the current interval, so that a change between two intervals is not missed.

    Returns:
        Their number.
    """
    for i in range(m + 1):
        stack[i] = f[i]
    stack[STRIDE - 2] = 0.0
    stack[STRIDE - 1] = 1.0
    waiting = 1
    count = 0
    before = 0.0
    while waiting > 0:
        top = (waiting - 1) * STRIDE
        a = stack[top + STRIDE - 2]
        width = stack[top + STRIDE - 1]
        changes = 0
        first = 0.0
        last = 0.0
        for i in range(top, top + m + 1):
            if stack[i] != 0.0:
                sign = 1.0 if stack[i] > 0.0 else -1.0
                if last == 0.0:
                    first = sign
                elif sign != last:
                    changes += 1
                last = sign
        if changes > 1 and width > 0.5**DEPTH:
            width *= 0.5
            split(stack, top, m, 0.5, stack, top + STRIDE)
            stack[top + STRIDE - 2] = a + width
            stack[top + STRIDE - 1] = width
            stack[top + 2 * STRIDE - 2] = a
            stack[top + 2 * STRIDE - 1] = width
            waiting += 1
            continue
        if before * first < 0.0 and count < roots.shape[0]:
            roots[count] = a
            count += 1
        if first != last and count < roots.shape[0]:
            low = 0.0
            high = 1.0
            t = 0.5
            for _ in range(100):
                if changes > 1 or high - low <= 1e-16:
                    break
                value, slope = value_slope(stack, top, m, t, scratch)
                if value * first > 0.0:
                    low = t
                else:
                    high = t
                change = value / slope if slope != 0.0 else 2.0
                if not low < t - change < high:
                    change = t - 0.5 * (low + high)
                t -= change
                if abs(change) <= 1e-16:
                    break
            roots[count] = a + width * t
            count += 1
        if last != 0.0:
            before = last
        waiting -= 1
    return count


NEGLIGIBLE = 1e-9
"""mm. Moves no longer than this are dropped."""
NOTICEABLE = 1e-6
"""mm. Axes that move less than this do not measure the length of a move while others move more."""
HAIRPIN = 1.0 / 32.0
"""Part of the mean |dr/dt| below which a minimum of it is a sharp point."""
MAX_CUTS = 8


@njit
def metric_axes(form: Floats, p: int, classes: Ints, metric: Ints, reach: Floats) -> int:
    """Write the columns of the axes that measure the length of a span into metric (3,).

    They are those of the first class that moves noticeably, or moves at all.

    reach: (3,): takes the largest distance of control points from the start, by class, mm.

    Returns:
        Their number; 0 if nothing moves.
    """
    for c in range(3):
        reach[c] = 0.0
    for c in range(classes.shape[0]):
        for i in range(1, p + 1):
            reach[classes[c]] = max(reach[classes[c]], abs(form[(c + 1) * STRIDE + i] / form[i]))
    chosen = -1
    for c in range(6):
        if chosen < 0 and reach[c % 3] > (NOTICEABLE if c < 3 else NEGLIGIBLE):
            chosen = c % 3
    count = 0
    for c in range(classes.shape[0]):
        if classes[c] == chosen:
            metric[count] = c
            count += 1
    return count


@njit
def _numerator(form: Floats, p: int, at: int, f: Floats) -> int:
    """Write N' W - N W' in homogeneous form into f, for the N that begins at form[at].

    With F = sum C(p, i) F_i x^i y^(p - i) the partial derivatives of F are p C(p-1, i) F_(i+1) and
    p C(p-1, i) F_i.

    Returns:
        Its degree.
    """
    for k in range(2 * p - 1):
        f[k] = 0.0
    ci = float(p)
    for i in range(p):
        cj = ci
        for j in range(p):
            f[i + j] += cj * (form[at + i + 1] * form[j] - form[at + i] * form[j + 1])
            cj *= (p - 1 - j) / (j + 1.0)
        ci *= (p - 1 - i) / (i + 1.0)
    return 2 * p - 2


@njit
def span_speed(
    form: Floats, p: int, metric: Ints, metrics: int, t: float, scratch: Floats
) -> float:
    """Return |dr/dt| at t."""
    w = 1.0
    w1 = 0.0
    square = 0.0
    for k in range(metrics + 1):
        value, slope = value_slope(
            form, (metric[k - 1] + 1) * STRIDE if k > 0 else 0, p, t, scratch
        )
        if k == 0:
            w = value
            w1 = slope
        else:
            slope = (slope - w1 * value / w) / w
            square += slope * slope
    return math.sqrt(square)


@njit
def sharp_points(
    form: Floats,
    p: int,
    metric: Ints,
    metrics: int,
    e: Floats,
    f: Floats,
    h: Floats,
    stack: Floats,
    cuts: Floats,
) -> int:
    """Write the t inside (0, 1) where |dr/dt| has a minimum below HAIRPIN of its mean into cuts.

    e, f, h: (STRIDE,): work space.

    Returns:
        Their number.
    """
    m = 2 * p - 2
    for k in range(5 * p):
        e[k] = 0.0
        h[k] = 0.0
    heaviest = 0.0
    polygon = 0.0
    for i in range(p + 1):
        heaviest = max(heaviest, form[i])
        square = 0.0
        for k in range(metrics):
            at = (metric[k] + 1) * STRIDE + i
            d = form[at] / form[i] - form[at - 1] / form[i - 1] if i > 0 else 0.0
            square += d * d
        polygon += math.sqrt(square)
    for k in range(metrics):
        _numerator(form, p, (metric[k] + 1) * STRIDE, f)
        for i in range(m + 1):
            for j in range(m + 1):
                e[i + j] += f[i] * f[j]
    # The control polygon is no shorter than the curve: its length stands for the mean of |dr/dt|.
    mean = HAIRPIN * polygon
    bound = (mean * heaviest * heaviest) ** 2
    m = 2 * m
    clear = True
    choose = 1.0
    for k in range(m + 1):
        if e[k] <= bound * choose:
            clear = False
        choose *= (m - k) / (k + 1.0)
    kept = 0
    if not clear:
        # E' W - 4 E W': the derivative of F_i t^i (1-t)^(m-i) is F_i (i t^(i-1) (1-t)^(m-i) - (m-i)
        # t^i (1-t)^(m-i-1))
        choose = 1.0
        for j in range(p + 1):
            for i in range(m + 1):
                product = e[i] * choose * form[j]
                if i + j > 0:
                    h[i + j - 1] += (i - 4.0 * j) * product
                if i + j < m + p:
                    h[i + j] -= (m - i - 4.0 * (p - j)) * product
            choose *= (p - j) / (j + 1.0)
        m = m + p - 1
        unscale(h, m)
        largest = 0.0
        for k in range(m + 1):
            largest = max(largest, abs(h[k]))
        for k in range(m + 1):
            if abs(h[k]) <= 1e-15 * largest:
                h[k] = 0.0
        last = 0.0
        for k in range(sign_changes(h, m, stack, f, cuts)):
            t = cuts[k]
            if (
                kept < MAX_CUTS
                and t - last > 1e-6
                and t < 1.0 - 1e-6
                and span_speed(form, p, metric, metrics, t, f) < mean
            ):
                cuts[kept] = t
                kept += 1
                last = t
    return kept


@njit
def turning_points(
    form: Floats,
    p: int,
    data: Floats,
    at: int,
    to: int,
    f: Floats,
    scratch: Floats,
    stack: Floats,
    roots: Floats,
) -> int:
    """Write the number of turning points of each axis, then their u, from data[to] on.

    Returns:
        The index behind them.
    """
    n = int(data[at + AXES])
    ua = data[at + U0]
    extent = data[at + U1] - ua
    heaviest = 0.0
    for i in range(p + 1):
        heaviest = max(heaviest, form[i])
    after = to + n
    for c in range(n):
        reach = 0.0
        for i in range(p + 1):
            reach = max(reach, abs(form[(c + 1) * STRIDE + i]))
        count = 0
        # An axis that moves by its own rounding alone does not turn.
        if reach > 4e-16 * heaviest * max(abs(data[at + START + c]), abs(data[at + START + n + c])):
            m = _numerator(form, p, (c + 1) * STRIDE, f)
            unscale(f, m)
            for k in range(m + 1):
                if abs(f[k]) <= 4e-16 * reach * heaviest:
                    f[k] = 0.0
            for k in range(sign_changes(f, m, stack, scratch, roots)):
                if 1e-12 < roots[k] < 1.0 - 1e-12 and count < MAX_TURNING_POINTS:
                    data[after] = ua + roots[k] * extent
                    after += 1
                    count += 1
        data[to + c] = count
    return after


@njit
def write_polynomial_turns(data: Floats, at: int, to: int, stack: Floats, scratch: Floats) -> int:
    """Write the number of turning points of each axis, then their u, from data[to] on.

    The span has weights of one.

    Args:
        data: the records.
        at: index of the record of the span.
        to: index behind the table of the span.
        stack: work space of :func:`cnc.path.kernels.span_shape.sign_changes`, like scratch.
        scratch: see stack.

    Returns:
        The index behind them.
    """
    n = int(data[at + AXES])
    body = at + START + 2 * n
    degree = int(data[body])
    u0, extent = data[at + U0], data[at + U1] - data[at + U0]
    after = to + n
    for c in range(n):
        k = body + SPAN_BODY + (degree + 1) * (c + 1)
        reach = 0.0
        for j in range(degree + 1):
            reach = max(reach, abs(data[k + j]))
        count = 0
        # An axis that moves by rounding alone does not turn.
        if reach > 4e-15 * max(abs(data[at + START + c]), abs(data[at + START + n + c])):
            for j in range(degree):
                slope = data[k + j + 1] - data[k + j]
                scratch[j] = slope if abs(slope) > 1e-15 * reach else 0.0
            roots = data[after : after + degree]
            for j in range(sign_changes(scratch, degree - 1, stack, scratch[STRIDE // 2 :], roots)):
                if 1e-12 < roots[j] < 1.0 - 1e-12:
                    roots[count] = u0 + roots[j] * extent
                    count += 1
        data[to + c] = count
        after += count
    return after
