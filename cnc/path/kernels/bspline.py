"""Records of the spans of a NURBS: Bernstein form, cuts at cusps, arc length, turning points.

One span [a, b] of degree p takes the control points d_0..d_p that touch it. Its Bernstein
coefficients are values of the span's polar form, F(a, .., a, b, .., b), each by de Boor's recursion
with its own argument in every round (Piegl & Tiller, The NURBS Book, A5.6 does the same by
inserting knots). Every round is a convex combination, so nothing is lost. Control points are first
measured from the span's first one: an axis that stands still gives zeros, and a part far from the
machine's origin keeps its digits.

The span is cut at its sharp points (:mod:`cnc.path.kernels.span_shape`). Where |dr/dt| is as good
as zero, the two control points beside the cut are put on it: it then is zero exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.arclength import MAX_ROWS, measure
from cnc.path.kernels.curve import (
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
from cnc.path.kernels.span_shape import (
    DEPTH,
    MAX_CUTS,
    NEGLIGIBLE,
    STRIDE,
    metric_axes,
    sharp_points,
    span_speed,
    split,
    turning_points,
)

MAX_DEGREE = 9
CUSP = 1e-7
"""Parts of the mean |dr/du|."""
TINY = 1e-7
"""mm. A part in which no axis moves by more becomes straight. Its bends may be smaller than the
shortest interval that the planner examines, and positions are not exact enough to show them.
"""
INSIDE = (0.25, 0.5, 0.75)
"""Parts of a chord's parameters at which its distance from the curve is measured."""
MOST_PARTS = 64
"""Most parts into which a chord is divided at once."""
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
        stack: for :func:`cnc.path.kernels.span_shape.sign_changes`.
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
def _straighten_tiny(part: Floats, p: int, n: int) -> None:
    """Make a part of a span straight where all ``n`` axes move by less than TINY in it.

    Parts that end where they begin stay as they are.
    """
    reach = 0.0
    moved = 0.0
    for c in range(1, n + 1):
        for i in range(1, p + 1):
            reach = max(reach, abs(part[c * STRIDE + i] / part[i]))
        moved = max(moved, abs(part[c * STRIDE + p] / part[p]))
    if reach < TINY and moved > NEGLIGIBLE:
        for c in range(1, n + 1):
            end = part[c * STRIDE + p] / part[p]
            for i in range(p + 1):
                part[c * STRIDE + i] = end * i / p
        for i in range(p + 1):
            part[i] = 1.0


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
        and span_speed(form, p, metric, metrics, t, work.e) < CUSP * work.reach[classes[metric[0]]]
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
    _straighten_tiny(part, p, n)
    for c in range(n + 1):
        for i in range(p + 1):
            data[to] = part[c * STRIDE + i]
            to += 1
    kind = SPAN  # a variable: numba compiles a kernel anew for a constant
    to = measure(kind, data, at, to, accuracy, work.derivatives)
    data[at + START + 2 * n + 1] = to - at
    return turning_points(part, p, data, at, to, work.f, work.e, work.stack, work.h)


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
            metrics = metric_axes(form, p, classes, work.metric, work.reach)
            if metrics > 0:
                count = sharp_points(
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


@njit
def _write_point(
    degree: int, knots: Floats, weighted: Floats, span: int, u: float, d: Floats, to: Floats
) -> None:
    """Write the point of a NURBS at ``u`` by de Boor's algorithm.

    Args:
        degree: its degree.
        knots: its knots.
        weighted: (k, n + 1): control points times weight, and weight.
        span: the knot span of ``u``.
        u: the parameter.
        d: (degree + 1, n + 1): scratch.
        to: (n,): receives the point.
    """
    d[:] = weighted[span - degree : span + 1]
    for r in range(1, degree + 1):
        for i in range(degree, r - 1, -1):
            low, high = knots[span - degree + i], knots[span + i + 1 - r]
            share = (u - low) / (high - low)
            for q in range(d.shape[1]):
                d[i, q] = (1.0 - share) * d[i - 1, q] + share * d[i, q]
    n = len(to)
    for q in range(n):
        to[q] = d[degree, q] / d[degree, n]


@njit
def _sagitta(
    degree: int, knots: Floats, weighted: Floats, u: float, v: float, scratch: Floats, end: Floats
) -> tuple[float, float]:
    """Measure the chord of a NURBS from ``u`` to ``v``, which lies in one span.

    Args:
        degree: its degree.
        knots: its knots.
        weighted: (k, n + 1): control points times weight, and weight.
        u: parameter at the start of the chord.
        v: at its end.
        scratch: (degree + 3, n + 1).
        end: (n,): receives its end.

    Returns:
        Its length, and the largest distance at INSIDE, mm.
    """
    n = len(end)
    d, start, here = scratch[: degree + 1], scratch[degree + 1, :n], scratch[degree + 2, :n]
    span = int(np.searchsorted(knots, 0.5 * (v + u), side="right")) - 1
    _write_point(degree, knots, weighted, span, u, d, start)
    _write_point(degree, knots, weighted, span, v, d, end)
    square = off = 0.0
    for q in range(n):
        square += (end[q] - start[q]) * (end[q] - start[q])
    for part in INSIDE:
        _write_point(degree, knots, weighted, span, u + part * (v - u), d, here)
        along = away = 0.0
        for q in range(n):
            along += (here[q] - start[q]) * (end[q] - start[q])
        at = min(max(along / max(square, 1e-300), 0.0), 1.0)
        for q in range(n):
            away += (here[q] - start[q] - at * (end[q] - start[q])) ** 2
        off = max(off, math.sqrt(away))
    return math.sqrt(square), off


@njit
def nurbs_chord_ends(
    degree: int, knots: Floats, weighted: Floats, u: Floats, sagitta: float, steepest: float
) -> Floats:
    """Return the ends (m, n) of chords of a NURBS, without the start.

    Args:
        degree: its degree.
        knots: its knots.
        weighted: (k, n + 1): control points times weight, and weight.
        u: ends of spans of it, which ascend.
        sagitta: largest distance of a chord from the curve, mm.
        steepest: largest angle of a chord. A chord that is within a tenth of ``sagitta`` may have
            any.
    """
    n = weighted.shape[1] - 1
    ends = np.empty((4 * degree * len(u) + 64, n))
    scratch = np.empty((degree + 3, n + 1))
    # Ends of the intervals that are not done, the nearest one last.
    later = np.empty(MOST_PARTS + degree + 1)
    count = 0
    for k in range(len(u) - 1):
        before = u[k]
        waiting = degree + 1
        for part in range(waiting):
            later[part] = u[k] + (waiting - part) / waiting * (u[k + 1] - u[k])
        later[0] = u[k + 1]
        while waiting > 0:
            after = later[waiting - 1]
            if count == len(ends):
                ends = np.concatenate((ends, np.empty_like(ends)))
            size, off = _sagitta(degree, knots, weighted, before, after, scratch, ends[count])
            # A chord over an angle h has a sagitta of h / 8 of its length.
            allowed = min(sagitta, max(steepest / 8.0 * size, 0.1 * sagitta))
            if off <= allowed:
                count += 1
                before = after
                waiting -= 1
                continue
            parts = min(max(math.ceil(math.sqrt(1.1 * off / allowed)), 2), MOST_PARTS)
            if waiting + parts > len(later):
                later = np.concatenate((later, np.empty_like(later)))
            for part in range(1, parts):
                later[waiting + part - 1] = before + (parts - part) / parts * (after - before)
            waiting += parts - 1
    return ends[:count]
