r"""Ends of NURBS spans at which the tool tip stands while other axes move on.

The tip measures the length s of a path. Near a cusp of the tip, or near a doubled control point,
the tip goes like t^k while an axis that rides along goes like t^j with j < k. Its slope dq/ds grows
like s^(j/k - 1), without bound: no speed of the tip above zero keeps the axis within its limits.

The end of such a span is cut off, and the axes that ride along measure the length of the part:

    tip measures       axes that ride along measure       tip measures
    ────────────────|──────────────── cusp ────────────|──────────────
                  RATIO                               RATIO

There the tip is a smooth function of the length. Motion stops where the measure changes. The feed
of the part is scaled, so that the tip does not exceed the feed of the program.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from cnc.kernels.path.curve import METRIC, METRICS, SPAN_BODY, START, U0, U1
from cnc.path.records import Floats, Ints, Records, spline_records

ZERO = 1e-7
"""Part of the extent below which a control point is on the end of the span."""
RATIO = 0.125
"""The part ends where the tip has this share of its mean speed, against that of the other axes."""
STEEPEST = 1.0
"""mm a degree, the largest ratio at the end of a part: the tip goes no farther than the length."""
ROUNDING = 1e-9
"""mm or degrees; a control point nearer than this to the end is on it, too."""
SHARES = 2.0 ** np.arange(-20.0, 0.0)
"""Shares of the span at which the part may end."""
SAMPLES = np.linspace(0.0, 1.0, 33)


class _Span(NamedTuple):
    """A span in Bernstein form, measured from its start.

    Attributes:
        weight: (p + 1,).
        points: (n, p + 1): control points, mm or degrees.
        start: (n,).
        end: (n,).
        metric: columns that measure the length.
        low: parameter at the start.
        high: parameter at the end.
    """

    weight: Floats
    points: Floats
    start: Floats
    end: Floats
    metric: Ints
    low: float
    high: float


class _Cut(NamedTuple):
    """A part of a span.

    Attributes:
        first: share of the span at its start.
        last: share at its end.
        measure: class of the axes that measure its length.
    """

    first: float
    last: float
    measure: int


def with_standing_tip(
    runs: Iterable[Records], classes: Ints, accuracy: float
) -> Iterator[tuple[Records, float]]:
    """Yield the records of a NURBS, cut where the tip stands, and a factor of the feed of each.

    Args:
        runs: records of its spans.
        classes: (n,): class of each axis.
        accuracy: largest error of the inverse arc length, mm.
    """
    for records in runs:
        cuts = [_cuts(_span(records, at, len(classes)), classes) for at in records.at.tolist()]
        if not any(cuts):
            yield records, 1.0
            continue
        for place, cut in enumerate(cuts):
            if cut:
                span = _span(records, int(records.at[place]), len(classes))
                yield from _parts(span, cut, classes, accuracy)
            else:
                yield _one(records, place), 1.0


def _span(records: Records, at: int, n: int) -> _Span:
    data = records.data
    first = at + START + 2 * n
    p = int(data[first])
    first += SPAN_BODY
    rows = data[first : first + (n + 1) * (p + 1)].reshape(n + 1, p + 1)
    metric = data[at + METRIC : at + METRIC + int(data[at + METRICS])].astype(np.int64)
    start, end = data[at + START : at + START + n], data[at + START + n : at + START + 2 * n]
    return _Span(rows[0], rows[1:] / rows[0], start, end, metric, data[at + U0], data[at + U1])


def _one(records: Records, place: int) -> Records:
    """Return one of the pieces."""
    at = int(records.at[place])
    end = int(records.at[place + 1]) if place + 1 < len(records.at) else len(records.data)
    length = records.length[place : place + 1]
    return Records(records.kind, np.zeros(1, np.int64), records.data[at:end].copy(), length.copy())


def _cuts(span: _Span, classes: Ints) -> list[_Cut]:
    """Return the parts at the ends at which the tip stands."""
    found = []
    extent = np.abs(span.points - span.points[:, :1]).max(axis=1)
    least = np.maximum(ZERO * extent, ROUNDING)[:, None]
    for at_end in (False, True):
        away = np.abs(span.points - span.points[:, -1 if at_end else 0, None])
        leaves = (away[:, ::-1] if at_end else away) > least
        order = np.where(leaves.any(axis=1), leaves.argmax(axis=1), leaves.shape[1])
        earlier = np.flatnonzero(order < int(order[span.metric].min()))
        if len(earlier) == 0:
            continue
        measure = int(classes[earlier[np.argmin(order[earlier])]])
        riders = np.flatnonzero(classes == measure)
        speeds = _speed(span, span.metric, SAMPLES), _speed(span, riders, SAMPLES)
        wanted = min(RATIO * speeds[0].mean() / speeds[1].mean(), STEEPEST)
        place = 1.0 - SHARES if at_end else SHARES
        far = _speed(span, span.metric, place) >= wanted * _speed(span, riders, place)
        width = float(SHARES[max(int(np.argmax(far)) - 1, 0)]) if far.any() else 0.5
        first, last = (1.0 - width, 1.0) if at_end else (0.0, width)
        found.append(_Cut(first, last, measure))
    if len(found) == 2 and found[0].last >= found[1].first:
        return [_Cut(0.0, 1.0, found[0].measure)]
    return found


def _parts(
    span: _Span, cuts: list[_Cut], classes: Ints, accuracy: float
) -> Iterator[tuple[Records, float]]:
    """Yield the records of a span that is cut, and the factors of the feed."""
    tip = int(classes[span.metric[0]])
    between = [0.0, *(place for cut in cuts for place in (cut.first, cut.last)), 1.0]
    each = [*cuts, *(_Cut(a, b, tip) for a, b in zip(between[::2], between[1::2], strict=True))]
    position = span.start
    for cut in sorted(cut for cut in each if cut.first < cut.last):
        part = _part(span, cut)
        swapped, factor = classes, 1.0
        if cut.measure != tip:
            swapped = np.where(classes == tip, cut.measure, classes)
            swapped[classes == cut.measure] = tip
            places = cut.first + SAMPLES * (cut.last - cut.first)
            riders = _speed(span, np.flatnonzero(classes == cut.measure), places)
            moves = riders > 0.0
            ratio = _speed(span, span.metric, places[moves]) / riders[moves]
            factor = 1.0 / float(ratio.max())
        points = (part[1:] / part[0]).T + span.start
        points[0] = position
        if cut.last == 1.0:
            points[-1] = span.end
        position = points[-1]
        degree = len(part[0]) - 1
        u = span.low + np.array([cut.first, cut.last]) * (span.high - span.low)
        knots = np.repeat(u, degree + 1)
        for records in spline_records(degree, knots, points, part[0], swapped, accuracy):
            yield records, factor


def _part(span: _Span, cut: _Cut) -> Floats:
    """Return the homogeneous Bernstein coefficients (n + 1, p + 1) of a part of a span."""
    rows = np.concatenate((span.weight[None], span.points * span.weight))
    rest, left, right = rows, [], []
    for _ in range(rows.shape[1]):
        left.append(rest[:, 0])
        rest = rest[:, :-1] + cut.last * np.diff(rest, axis=1)
    rest = np.stack(left, axis=1)
    for _ in range(rows.shape[1]):
        right.append(rest[:, -1])
        rest = rest[:, :-1] + cut.first / cut.last * np.diff(rest, axis=1)
    return np.stack(right[::-1], axis=1)


def _speed(span: _Span, columns: Ints, t: Floats) -> Floats:
    """Return the speed (m,) of some columns by the share of the span, at shares t (m,)."""
    rows = np.concatenate((span.weight[None], span.points[columns] * span.weight))[..., None]
    degree = rows.shape[1] - 1
    while rows.shape[1] > 2:
        rows = rows[:, :-1] + t * np.diff(rows, axis=1)
    value, slope = rows[:, 0] + t * (rows[:, 1] - rows[:, 0]), degree * (rows[:, 1] - rows[:, 0])
    found = (slope[1:] - slope[0] * value[1:] / value[0]) / value[0]
    speed: Floats = np.sqrt(np.sum(np.square(found), axis=0))
    return speed
