"""Records of the spans of a NURBS: Bernstein form, cuts at cusps, arc length, turning points.

One span [a, b] of degree p takes the control points d_0..d_p that touch it. Its Bernstein
coefficients are values of the span's polar form, F(a, .., a, b, .., b), each by de Boor's recursion
with its own argument in every round (Piegl & Tiller, The NURBS Book, A5.6 does the same by
inserting knots). Every round is a convex combination, so nothing is lost. Control points are first
measured from the span's first one: an axis that stands still gives zeros, and a part far from the
machine's origin keeps its digits.

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
it. Where sigma is as good as zero, the two control points beside the cut are put on it: it then
is zero exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.kernels.jit import njit
from cnc.kernels.path.arclength import MAX_ROWS, measure
from cnc.kernels.path.bernstein import DEPTH, STRIDE, sign_changes, split, unscale, value_slope
from cnc.kernels.path.curve import (
    AXES,
    LENGTH,
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
"""mm. Moves no longer than this are dropped."""
NOTICEABLE = 1e-6
"""mm. Axes that move less than this do not measure the length of a move while others move more."""
HAIRPIN = 1.0 / 32.0
CUSP = 1e-7
"""Parts of the mean |dr/du|."""
MAX_CUTS = 8
NUMBERS_PER_AXIS = 2 + MAX_DEGREE + 1 + 1 + MAX_TURNING_POINTS
RECORD_NUMBERS = START + SPAN_BODY + MAX_DEGREE + 1 + 3 + ROW * (MAX_ROWS + 1)
"""The longest span record of n axes has RECORD_NUMBERS + n NUMBERS_PER_AXIS numbers."""


class Nurbs(NamedTuple):
    """A NURBS.

    Attributes:
        degree: 1 to MAX_DEGREE.
        knots: (m + degree + 1,).
        points: (m, n): control points, mm.
        weights: (m,): > 0.
    """

    degree: int
    knots: Floats
    points: Floats
    weights: Floats


class Span(NamedTuple):
    """A span in Bernstein form.

    Attributes:
        low: knot at its start.
        high: knot at its end.
        degree: degree of the form.
        metrics: number of its metric axes.
        cuts: number of places where it is cut.
    """

    low: float
    high: float
    degree: int
    metrics: int
    cuts: int


class Work(NamedTuple):
    """Work space for one span.

    Attributes:
        form: coefficients of W and of N in each axis, STRIDE apart.
        part: the same of a part of the span.
        e: coefficients (STRIDE,), like f and h.
        f: see e.
        h: see e.
        stack: for :func:`cnc.kernels.path.bernstein.sign_changes`.
        cuts: places where the span is cut, from 0 to 1.
        end: (n,): end of the span, mm.
        reach: (3,): largest distance of control points from the start, by class of axis, mm.
        metric: (3,): columns of the metric axes.
        derivatives: (4, n).
    """

    form: Floats
    part: Floats
    e: Floats
    f: Floats
    h: Floats
    stack: Floats
    cuts: Floats
    end: Floats
    reach: Floats
    metric: Ints
    derivatives: Floats


@njit
def _new_work(n: int) -> Work:
    """Return work space for n axes."""
    return Work(
        np.zeros((n + 1) * STRIDE),
        np.zeros((n + 1) * STRIDE),
        np.empty(STRIDE),
        np.empty(STRIDE),
        np.empty(STRIDE),
        np.empty((DEPTH + 4) * STRIDE),
        np.empty(STRIDE),
        np.empty(n),
        np.empty(3),
        np.empty(3, np.int64),
        np.empty((4, n)),
    )


@njit
def _bezier(
    degree: int, knots: Floats, points: Floats, weights: Floats, k: int, form: Floats, d: Floats
) -> int:
    """Write the Bernstein coefficients of span k, of degree 3 at least (A5.9), into ``form``.

    Those of the weights come first, from 0 on. Those of axis i of the numerator, measured from
    points[k - degree], come from (i + 1) STRIDE on. d: (STRIDE,): work space.

    Returns:
        The degree.
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
def _speed(form: Floats, p: int, metric: Ints, metrics: int, t: float, scratch: Floats) -> float:
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
def _measure_from_start(curve: Nurbs, k: int, p: int, work: Work) -> None:
    """Measure the numerator of span k from the start of the span, and write its end into ``work``.

    The end is exact in the control points where the knots are full.
    """
    degree, knots, points, _ = curve
    form = work.form
    for c in range(points.shape[1]):
        at = (c + 1) * STRIDE
        shift = form[at] / form[0]
        form[at] = 0.0
        for i in range(1, p + 1):
            form[at + i] -= form[i] * shift
        full = knots[k + 1] == knots[k + degree]
        work.end[c] = (
            points[k, c] if full else points[k - degree, c] + (shift + form[at + p] / form[p])
        )


@njit
def _write_part(
    span: Span,
    cut: int,
    classes: Ints,
    position: Floats,
    accuracy: float,
    data: Floats,
    at: int,
    work: Work,
) -> int:
    """Write the part of a span up to cut number ``cut``, or to its end, as a record at ``at``.

    The part before the cut goes into ``work.part``; ``work.form`` goes on behind it.

    Returns:
        The index behind the record.
    """
    low, high, p, metrics, count = span
    form, part, cuts, metric, end = work.form, work.part, work.cuts, work.metric, work.end
    n = position.shape[0]
    before = cuts[cut - 1] if cut > 0 else 0.0
    data[at + U0] = low + cuts[cut - 1] * (high - low) if cut > 0 else low
    data[at + U1] = low + cuts[cut] * (high - low) if cut < count else high
    t = (cuts[cut] - before) / (1.0 - before) if cut < count else 1.0
    singular = (
        cut < count
        and _speed(form, p, metric, metrics, t, work.e) < CUSP * work.reach[classes[metric[0]]]
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
    kind = SPAN  # a variable: numba compiles a kernel anew for a constant
    to = measure(kind, data, at, to, accuracy, work.derivatives)
    data[at + START + 2 * n + 1] = to - at
    return _turning_points(part, p, data, at, to, work.f, work.e, work.stack, work.h)


@njit
def nurbs_records(
    curve: Nurbs,
    classes: Ints,
    first: int,
    position: Floats,
    accuracy: float,
    data: Floats,
    at_out: Ints,
    length_out: Floats,
) -> tuple[int, int, int]:
    """Write the spans of a NURBS as records, until the arrays are full.

    Args:
        curve: the NURBS.
        classes: (n,): class of each axis: 0 for x y z, 1 for u v w, 2 for a b c.
        first: first span to be written; the degree to begin with.
        position: (n,): start of that span, mm; moved along.
        accuracy: largest error of the inverse arc length, mm.
        data: takes the records.
        at_out: takes the index of each record in ``data``.
        length_out: takes the length of each piece, mm.

    Returns:
        The next span, the number of pieces, and the numbers used of ``data``. The curve is done
        when the next span is the number of control points.
    """
    degree, knots, points, weights = curve
    n = points.shape[1]
    work = _new_work(n)
    form = work.form
    longest = (MAX_CUTS + 1) * (RECORD_NUMBERS + n * NUMBERS_PER_AXIS)
    pieces = 0
    used = 0
    k = first
    while (
        k < points.shape[0]
        and pieces + MAX_CUTS < at_out.shape[0]
        and used + longest <= data.shape[0]
    ):
        if knots[k + 1] > knots[k]:
            p = _bezier(degree, knots, points, weights, k, form, work.e)
            _measure_from_start(curve, k, p, work)
            metrics = _metric_axes(form, p, classes, work.metric, work.reach)
            if metrics > 0:
                count = _sharp_points(
                    form, p, work.metric, metrics, work.e, work.f, work.h, work.stack, work.cuts
                )
                for cut in range(count + 1):
                    at_out[pieces] = used
                    span = Span(knots[k], knots[k + 1], p, metrics, count)
                    used = _write_part(span, cut, classes, position, accuracy, data, used, work)
                    length_out[pieces] = data[at_out[pieces] + LENGTH]
                    pieces += 1
        k += 1
    return k, pieces, used
