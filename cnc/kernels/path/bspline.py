"""From a NURBS to span records: Bernstein form, cusps cut out, arc length measured, turning points
found.

One span [a, b] of degree p takes the control points d_0..d_p that touch it. Its Bernstein
coefficients are values of the span's polar form, F(a, .., a, b, .., b), each by de Boor's recursion
with its own argument in every round (Piegl & Tiller, The NURBS Book, A5.6 does the same by
inserting knots). Every round is a convex combination, so nothing is lost. Control points are first
measured from the span's first one: an axis that stands still gives zeros, and a part far from the
machine's origin keeps its digits.

Turning points of axis i are the sign changes of N_i' W - N_i W', whose homogeneous form is (N_x W_y
- N_y W_x) / p, of degree 2 p - 2.

A cusp is where all metric axes do that at once. sigma^2 = |dr/dt|^2 = E / W^4 with E the sum of the squares of those numerators; where
E' W - 4 E W' goes from minus to plus, sigma has a minimum. If it is less than HAIRPIN of the mean the span is cut there,

          ________               ________
         (                      (                 so that whatever is sharp, or singular, lies at the end of a piece, where
          `-------.   ->         `----- x         the planner and the tables look. Where sigma is as good as zero, the two control
          ,-------'               ,----' x        points beside the cut are put on it: it then is zero exactly.
         (________              (________
"""

from __future__ import annotations

import math

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import MAX_ROWS, measure
from cnc.kernels.path.bernstein import DEPTH, STRIDE, sign_changes, split, unscale, value_slope
from cnc.kernels.path.curve import (
    AXES,
    LENGTH,
    LINE,
    MAX_TURNING_POINTS,
    METRIC,
    METRICS,
    ROW,
    SPAN,
    SPAN_BODY,
    START,
    U0,
    U1,
    Floats,
    Ints,
)

MAX_DEGREE = 9
NEGLIGIBLE = 1e-9
"""mm. Moves no longer than this vanish."""
NOTICEABLE = 1e-6
"""mm. Axes that move less than this don't set the length of a move while others move more."""
HAIRPIN = 1.0 / 32.0
CUSP = 1e-7
"""Parts of the mean |dr/du|."""
MAX_CUTS = 8
ROOM_PER_AXIS = 2 + MAX_DEGREE + 1 + 1 + MAX_TURNING_POINTS
RECORD_ROOM = START + SPAN_BODY + MAX_DEGREE + 1 + 3 + ROW * (MAX_ROWS + 1)
"""The longest span record of n axes takes RECORD_ROOM + n ROOM_PER_AXIS numbers."""


@njit
def _bezier(
    degree: int, knots: Floats, points: Floats, weights: Floats, k: int, form: Floats, d: Floats
) -> int:
    """Bernstein coefficients of span k, [knots[k], knots[k + 1]], of degree 3 at least (A5.9);
    returns the degree.

    form: the weights' from 0 on, those of axis i of the numerator, measured from points[k -
    degree], from (i + 1) STRIDE on. d: scratch.
    """
    base = k - degree
    a = knots[k]
    b = knots[k + 1]
    for c in range(points.shape[1] + 1):
        at = c * STRIDE
        for j in range(degree + 1):
            for i in range(degree + 1):
                d[i] = weights[base + i]
                if c > 0:
                    d[i] *= points[base + i, c - 1] - points[base, c - 1]
            for r in range(1, degree + 1):
                x = a if r <= degree - j else b
                for i in range(degree, r - 1, -1):
                    low = knots[base + i]
                    d[i] = d[i - 1] + (x - low) / (knots[k + 1 + i - r] - low) * (d[i] - d[i - 1])
            form[at + j] = d[degree]
        for p in range(degree + 1, 4):
            form[at + p] = form[at + p - 1]
            for i in range(at + p - 1, at, -1):
                form[i] += (i - at) / p * (form[i - 1] - form[i])
    return max(degree, 3)


@njit
def _metric_axes(form: Floats, p: int, classes: Ints, metric: Ints, reach: Floats) -> int:
    """The columns that measure the length into metric (3,); returns how many, 0 if nothing moves.

    reach (3,): how far the control points of each class lie from the start; the first class that
    moves noticeably counts, or moves at all.
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
    """N' W - N W' of the N whose coefficients begin at form[at], in homogeneous form, into f;
    returns its degree.

    With F = sum C(p, i) F_i x^i y^(p - i) the partial derivatives of F are p C(p-1, i) F_(i+1) and
    p C(p-1, i) F_i.
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
def _speed(form: Floats, p: int, metric: Ints, metrics: int, t: float, scratch: Floats) -> float:
    """|dr/dt| at t."""
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
def _sharp_points(
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
    """The t inside (0, 1) where |dr/dt| has a minimum below HAIRPIN of its mean, into cuts; returns
    how many. e, f, h: scratch.
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
    # the control polygon is no shorter than the curve: its length stands for the mean of |dr/dt|
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
                and _speed(form, p, metric, metrics, t, f) < mean
            ):
                cuts[kept] = t
                kept += 1
                last = t
    return kept


@njit
def _turning_points(
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
    """Count of turning points of each axis, then their u, from data[to] on; returns the index
    behind them.
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
        # an axis that moves by its own rounding alone doesn't turn
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
def nurbs_records(
    degree: int,
    knots: Floats,
    points: Floats,
    weights: Floats,
    classes: Ints,
    first: int,
    position: Floats,
    accuracy: float,
    data: Floats,
    used: int,
    at_out: Ints,
    length_out: Floats,
) -> tuple[int, int, int]:
    """Records of the spans of a NURBS from span ``first`` (degree to begin with) on, as many as
    there is room for.

    points (m, n) and weights (m,) over all axes; classes (n,): 0 for x y z, 1 for u v w, 2 for a b
    c; position (n,): where the curve starts, moved along to where it has got; accuracy: of the
    inverse arc length in mm. Records go into ``data`` from index ``used`` on, their places into
    at_out, their lengths into length_out. Returns (next span, pieces, used); the curve is through
    when the next span is m.
    """
    n = points.shape[1]
    form = np.zeros((n + 1) * STRIDE)
    part = np.zeros((n + 1) * STRIDE)
    work = np.empty((4, n))
    e = np.empty(STRIDE)
    f = np.empty(STRIDE)
    h = np.empty(STRIDE)
    stack = np.empty((DEPTH + 4) * STRIDE)
    cuts = np.empty(STRIDE)
    end = np.empty(n)
    reach = np.empty(3)
    metric = np.empty(3, np.int64)
    room = (MAX_CUTS + 1) * (RECORD_ROOM + n * ROOM_PER_AXIS)
    pieces = 0
    k = first
    while (
        k < points.shape[0] and pieces + MAX_CUTS < at_out.shape[0] and used + room <= data.shape[0]
    ):
        ua = knots[k]
        ub = knots[k + 1]
        p = 0
        kind = LINE  # a variable: numba compiles the kernels below once more for a constant
        metrics = 0
        cut = 0
        count = -1
        if ub > ua:
            p = _bezier(degree, knots, points, weights, k, form, e)
            kind = SPAN
            # from the start of the span on, which is exact in the control points where the knots
            # are full
            for c in range(n):
                at = (c + 1) * STRIDE
                shift = form[at] / form[0]
                form[at] = 0.0
                for i in range(1, p + 1):
                    form[at + i] -= form[i] * shift
                full = knots[k + 1] == knots[k + degree]
                end[c] = (
                    points[k, c]
                    if full
                    else points[k - degree, c] + (shift + form[at + p] / form[p])
                )
            metrics = _metric_axes(form, p, classes, metric, reach)
            if metrics > 0:
                count = _sharp_points(form, p, metric, metrics, e, f, h, stack, cuts)
        before = 0.0
        while cut <= count:
            # what lies before the cut goes into part, and form goes on behind it
            at = used
            data[at + U0] = ua
            t = 1.0
            if cut < count:
                t = (cuts[cut] - before) / (1.0 - before)
                ua = knots[k] + cuts[cut] * (ub - knots[k])
                before = cuts[cut]
            data[at + U1] = ua if cut < count else ub
            singular = (
                cut < count
                and _speed(form, p, metric, metrics, t, e) < CUSP * reach[classes[metric[0]]]
            )
            for c in range(n + 1):
                split(form, c * STRIDE, p, t, part, c * STRIDE)
            data[at + AXES] = n
            data[at + METRICS] = metrics
            for c in range(3):
                data[at + METRIC + c] = metric[c] if c < metrics else -1
            to = at + START + 2 * n
            data[to] = p
            to += SPAN_BODY
            for c in range(n):
                row = (c + 1) * STRIDE
                data[at + START + c] = position[c]
                if cut < count:
                    shift = part[row + p] / part[p]
                    position[c] += shift
                    form[row] = 0.0
                    for i in range(1, p + 1):
                        form[row + i] -= form[i] * shift
                    if singular and classes[c] == classes[metric[0]]:
                        part[row + p - 1] = part[p - 1] * shift
                        form[row + 1] = 0.0
                else:
                    position[c] = end[c]
                data[at + START + n + c] = position[c]
            for c in range(n + 1):
                for i in range(p + 1):
                    data[to] = part[c * STRIDE + i]
                    to += 1
            to = measure(kind, data, at, to, accuracy, work)
            data[at + START + 2 * n + 1] = to - at
            used = _turning_points(part, p, data, at, to, f, e, stack, h)
            at_out[pieces] = at
            length_out[pieces] = data[at + LENGTH]
            pieces += 1
            cut += 1
        k += 1
    return k, pieces, used
