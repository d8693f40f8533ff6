"""From a NURBS to span records: Bernstein form, cusps cut out, arc length measured, turning points found.

One span [a, b] of degree p takes the control points d_0..d_p that touch it. Its Bernstein coefficients are values of the span's polar form,
F(a, .., a, b, .., b), each by de Boor's recursion with its own argument in every round (Piegl & Tiller, The NURBS Book, A5.6 does the same by
inserting knots). Every round is a convex combination, so nothing is lost. Control points are first measured from the span's first one: an axis
that stands still gives zeros, and a part far from the machine's origin keeps its digits.

Turning points of axis i are the sign changes of N_i' W - N_i W', whose homogeneous form is (N_x W_y - N_y W_x) / p, of degree 2 p - 2.

A cusp is where all metric axes do that at once. sigma^2 = |dr/dt|^2 = E / W^4 with E the sum of the squares of those numerators; where
E' W - 4 E W' goes from minus to plus, sigma has a minimum. If it is less than HAIRPIN of the mean the span is cut there,

          ________               ________
         (                      (                 so that whatever is sharp, or singular, lies at the end of a piece, where
          `-------.   ->         `----- x         the planner and the tables look. Where sigma is as good as zero, the two control
          ,-------'               ,----' x        points beside the cut are put on it: it then is zero exactly.
         (________              (________
"""

from __future__ import annotations

import numpy as np

from cnc.kernels.arclength import MAX_ROWS, measure
from cnc.kernels.bernstein import DEPTH, from_homogeneous, sign_changes, split, to_homogeneous
from cnc.kernels.curve import (
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
from cnc.kernels.jit import njit

MAX_DEGREE = 9
NEGLIGIBLE = 1e-9
"""mm. Moves no longer than this vanish."""
NOTICEABLE = 1e-6
"""mm. Axes that move less than this don't set the length of a move while others move more."""
HAIRPIN = 1.0 / 32.0
CUSP = 1e-7
"""Parts of the mean |dr/du|."""
MAX_CUTS = 8
WORK = 6 * MAX_DEGREE
"""More than the degree of any polynomial here, 5 p - 5."""


@njit
def metric_class(reach: Floats) -> int:
    """Which axes measure the length: 0 for x y z, 1 for u v w, 2 for a b c, -1 if nothing moves. reach (3,): how far each class moves."""
    for k in range(3):
        if reach[k] > NOTICEABLE:
            return k
    for k in range(3):
        if reach[k] > NEGLIGIBLE:
            return k
    return -1


@njit
def _columns_of(classes: Ints, kind: int, columns: Ints) -> int:
    """The columns of one class into columns (3,); returns how many."""
    count = 0
    for c in range(classes.shape[0]):
        if classes[c] == kind:
            columns[count] = c
            count += 1
    return count


@njit
def record_room(n: int) -> int:
    """Numbers that the longest span record of n axes can take."""
    return START + 2 * n + SPAN_BODY + (n + 1) * (MAX_DEGREE + 1) + 2 + ROW * (MAX_ROWS + 1) + n * (1 + MAX_TURNING_POINTS)


@njit
def _bezier(degree: int, knots: Floats, points: Floats, weights: Floats, k: int, bezier: Floats, d: Floats) -> int:
    """Bernstein coefficients of span k, [knots[k], knots[k + 1]]: row 0 of bezier the weights, row 1 + i axis i of the numerator, measured
    from points[k - degree]. Returns the degree, raised to 3 at least (A5.9). d: scratch (degree + 1,)."""
    n = points.shape[1]
    base = k - degree
    a = knots[k]
    b = knots[k + 1]
    for c in range(n + 1):
        for j in range(degree + 1):
            for i in range(degree + 1):
                w = weights[base + i]
                d[i] = w if c == 0 else w * (points[base + i, c - 1] - points[base, c - 1])
            for r in range(1, degree + 1):
                x = a if r <= degree - j else b
                for i in range(degree, r - 1, -1):
                    low = knots[base + i]
                    d[i] = d[i - 1] + (x - low) / (knots[k + 1 + i - r] - low) * (d[i] - d[i - 1])
            bezier[c, j] = d[degree]
        for p in range(degree + 1, 4):
            bezier[c, p] = bezier[c, p - 1]
            for i in range(p - 1, 0, -1):
                bezier[c, i] += i / p * (bezier[c, i - 1] - bezier[c, i])
    return max(degree, 3)


@njit
def _numerator(bezier: Floats, p: int, row: int, f: Floats) -> int:
    """Homogeneous coefficients of (N' W - N W') / p for row ``row`` of ``bezier`` (in homogeneous form) into f; returns the degree."""
    for k in range(2 * p - 1):
        f[k] = 0.0
    for i in range(p):
        for j in range(p):
            f[i + j] += ((i + 1) * bezier[row, i + 1] * (p - j) * bezier[0, j] - (p - i) * bezier[row, i] * (j + 1) * bezier[0, j + 1]) / p
    return 2 * p - 2


@njit
def _drop_noise(f: Floats, m: int, floor: float) -> float:
    """Coefficients within ``floor`` of zero become zero; returns the largest."""
    largest = 0.0
    for k in range(m + 1):
        if abs(f[k]) <= floor:
            f[k] = 0.0
        largest = max(largest, abs(f[k]))
    return largest


@njit
def _sharp_points(bezier: Floats, p: int, metric: Ints, metrics: int, poly: Floats, stack: Floats, cuts: Floats) -> int:
    """The t inside (0, 1) where |dr/dt| has a minimum below HAIRPIN of its mean, into cuts; returns how many. poly: scratch (5, WORK)."""
    e = poly[0]
    f = poly[1]
    h = poly[2]
    homogeneous = poly[3:]
    m = 2 * p - 2
    for k in range(2 * m + 1):
        e[k] = 0.0
    heaviest = 0.0
    for i in range(p + 1):
        homogeneous[0, i] = bezier[0, i]
        heaviest = max(heaviest, bezier[0, i])
    to_homogeneous(homogeneous[0], p)
    polygon = 0.0
    for i in range(p):
        square = 0.0
        for k in range(metrics):
            row = 1 + metric[k]
            d = bezier[row, i + 1] / bezier[0, i + 1] - bezier[row, i] / bezier[0, i]
            square += d * d
        polygon += np.sqrt(square)
    for k in range(metrics):
        for i in range(p + 1):
            homogeneous[1, i] = bezier[1 + metric[k], i]
        to_homogeneous(homogeneous[1], p)
        _numerator(homogeneous, p, 1, f)
        for i in range(m + 1):
            for j in range(m + 1):
                e[i + j] += f[i] * f[j]
    # the control polygon is no shorter than the curve: its length stands for the mean of |dr/dt|
    bound = (HAIRPIN * polygon * heaviest * heaviest) ** 2
    m = 2 * m
    clear = True
    from_homogeneous(e, m)
    for k in range(m + 1):
        if e[k] <= bound:
            clear = False
    if clear:
        return 0
    to_homogeneous(e, m)
    w = homogeneous[0]
    for k in range(m + p):
        h[k] = 0.0
    for i in range(m + 1):
        for j in range(p + 1):
            # the derivative of F_i t^i (1-t)^(m-i) is F_i (i t^(i-1) (1-t)^(m-i) - (m-i) t^i (1-t)^(m-i-1))
            product = e[i] * w[j]
            if i + j > 0:
                h[i + j - 1] += (i - 4.0 * j) * product
            if i + j < m + p:
                h[i + j] -= (m - i - 4.0 * (p - j)) * product
    m = m + p - 1
    from_homogeneous(h, m)
    largest = 0.0
    for k in range(m + 1):
        largest = max(largest, abs(h[k]))
    _drop_noise(h, m, 1e-15 * largest)
    found = sign_changes(h, m, stack, f, cuts)
    kept = 0
    for k in range(found):
        t = cuts[k]
        if 1e-6 < t < 1.0 - 1e-6 and _sigma(bezier, p, metric, metrics, t, f) < HAIRPIN * polygon and (kept == 0 or t - cuts[kept - 1] > 1e-6):
            cuts[kept] = t
            kept += 1
    return kept


@njit
def _sigma(bezier: Floats, p: int, metric: Ints, metrics: int, t: float, scratch: Floats) -> float:
    """|dr/dt| at t."""
    w = 0.0
    w1 = 0.0
    square = 0.0
    for k in range(metrics + 1):
        row = 0 if k == 0 else 1 + metric[k - 1]
        for i in range(p + 1):
            scratch[i] = bezier[row, i]
        for r in range(p - 1):
            for i in range(p - r):
                scratch[i] += t * (scratch[i + 1] - scratch[i])
        slope = p * (scratch[1] - scratch[0])
        value = scratch[0] + t * (scratch[1] - scratch[0])
        if k == 0:
            w = value
            w1 = slope
        else:
            slope = (slope - w1 * value / w) / w
            square += slope * slope
    return np.sqrt(square)


@njit
def _write_span(
    bezier: Floats,
    p: int,
    ua: float,
    ub: float,
    metric: Ints,
    metrics: int,
    position: Floats,
    end: Floats,
    accuracy: float,
    data: Floats,
    at: int,
    work: Floats,
    poly: Floats,
    stack: Floats,
    roots: Floats,
) -> int:
    """A whole span record from its Bernstein coefficients, whose numerators start at zero; returns the index behind it."""
    n = position.shape[0]
    data[at + AXES] = n
    data[at + U0] = ua
    data[at + U1] = ub
    data[at + METRICS] = metrics
    for k in range(3):
        data[at + METRIC + k] = metric[k] if k < metrics else -1.0
    for i in range(n):
        data[at + START + i] = position[i]
        data[at + START + n + i] = end[i]
    body = at + START + 2 * n
    data[body] = p
    first = body + SPAN_BODY
    for c in range(n + 1):
        for i in range(p + 1):
            data[first + c * (p + 1) + i] = bezier[c, i]
    after = measure(np.int64(SPAN), data, at, first + (n + 1) * (p + 1), accuracy, work)
    data[body + 1] = after - at
    heaviest = 0.0
    for i in range(p + 1):
        heaviest = max(heaviest, bezier[0, i])
    f = poly[0]
    homogeneous = poly[3:]
    for i in range(p + 1):
        homogeneous[0, i] = bezier[0, i]
    to_homogeneous(homogeneous[0], p)
    to = after + n
    for c in range(n):
        reach = 0.0
        for i in range(p + 1):
            homogeneous[1, i] = bezier[1 + c, i]
            reach = max(reach, abs(bezier[1 + c, i]))
        count = 0
        if reach > 4e-16 * heaviest * max(abs(position[c]), abs(end[c])):
            to_homogeneous(homogeneous[1], p)
            m = _numerator(homogeneous, p, 1, f)
            from_homogeneous(f, m)
            _drop_noise(f, m, 4e-16 * reach * heaviest)
            found = sign_changes(f, m, stack, poly[1], roots)
            for k in range(found):
                if 1e-12 < roots[k] < 1.0 - 1e-12 and count < MAX_TURNING_POINTS:
                    data[to + count] = ua + roots[k] * (ub - ua)
                    count += 1
        data[after + c] = count
        to += count
    return to


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
    """Records of the spans of a NURBS from span ``first`` (degree to begin with) on, as many as there is room for.

    points (m, n) and weights (m,) over all axes; classes (n,): class of each axis as in :func:`metric_class`; position (n,): where the curve
    starts, moved along to where it has got; accuracy: of the inverse arc length in mm. Records go into ``data`` from index ``used`` on, their
    places into at_out, their lengths into length_out. Returns (next span, pieces, used); the curve is through when the next span is m.
    """
    n = points.shape[1]
    m = points.shape[0]
    bezier = np.zeros((n + 1, MAX_DEGREE + 1))
    part = np.zeros((n + 1, MAX_DEGREE + 1))
    d = np.empty(MAX_DEGREE + 1)
    work = np.empty((4, n))
    poly = np.empty((5, WORK))
    stack = np.empty((DEPTH + 4, WORK + 2))
    roots = np.empty(WORK)
    cuts = np.empty(WORK)
    end = np.empty(n)
    metric = np.empty(3, np.int64)
    reach = np.empty(3)
    room = record_room(n)
    pieces = 0
    k = first
    while k < m and pieces + MAX_CUTS + 1 <= at_out.shape[0] and used + (MAX_CUTS + 1) * room <= data.shape[0]:
        if not knots[k + 1] > knots[k]:
            k += 1
            continue
        p = _bezier(degree, knots, points, weights, k, bezier, d)
        # from the start of the span, which is exact in the control points where the knots are full
        for c in range(1, n + 1):
            shift = bezier[c, 0] / bezier[0, 0]
            if shift != 0.0:
                for i in range(p + 1):
                    bezier[c, i] -= bezier[0, i] * shift
                bezier[c, 0] = 0.0
            end[c - 1] = points[k - degree, c - 1] + (shift + bezier[c, p] / bezier[0, p])
            if knots[k + 1] == knots[k + degree]:
                end[c - 1] = points[k, c - 1]
        for i in range(3):
            reach[i] = 0.0
        for c in range(n):
            for i in range(1, p + 1):
                reach[classes[c]] = max(reach[classes[c]], abs(bezier[1 + c, i] / bezier[0, i]))
        kind = metric_class(reach)
        if kind < 0:
            k += 1
            continue
        metrics = _columns_of(classes, kind, metric)
        count = min(_sharp_points(bezier, p, metric, metrics, poly, stack, cuts), MAX_CUTS)
        before = 0.0
        ua = knots[k]
        for cut in range(count + 1):
            t = cuts[cut] if cut < count else 1.0
            ub = knots[k] + t * (knots[k + 1] - knots[k])
            target = end
            if cut < count:
                at = (t - before) / (1.0 - before)
                singular = _sigma(bezier, p, metric, metrics, at, d) < CUSP * reach[kind]
                for c in range(n + 1):
                    split(bezier[c], p, at, part[c], bezier[c])
                target = work[0].copy()
                for c in range(n):
                    shift = part[1 + c, p] / part[0, p]
                    target[c] = position[c] + shift
                    for i in range(p + 1):
                        bezier[1 + c, i] -= bezier[0, i] * shift
                    bezier[1 + c, 0] = 0.0
                    if singular and classes[c] == kind:
                        part[1 + c, p - 1] = part[0, p - 1] * shift
                        bezier[1 + c, 1] = 0.0
                before = t
            else:
                ub = knots[k + 1]
                for c in range(n + 1):
                    for i in range(p + 1):
                        part[c, i] = bezier[c, i]
            at_out[pieces] = used
            used = _write_span(part, p, ua, ub, metric, metrics, position, target, accuracy, data, used, work, poly, stack, roots)
            length_out[pieces] = data[at_out[pieces] + LENGTH]
            pieces += 1
            for c in range(n):
                position[c] = target[c]
            ua = ub
        k += 1
    return k, pieces, used
