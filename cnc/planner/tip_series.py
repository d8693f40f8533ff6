"""Taylor series of the tool tip along pieces of a path, by the parameter of the pieces.

The kinds of pieces and their records are those of :mod:`cnc.path.kernels.curve`. A series is taken
at a place of a piece, or over a part of it: then its terms are intervals that hold the term of
every place in the part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.interval import Interval, cosine
from cnc.kinematics.series import Series, Term
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE, SPAN, SPAN_BODY, START, U0, U1

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

OF_LINE, OF_ARC = -1, -2


class Parts(NamedTuple):
    """Parts of pieces.

    Attributes:
        piece: (m,): index of the piece.
        first: (m,): parameter at the start of the part.
        last: (m,): parameter at its end; equal to ``first`` for a place.
    """

    piece: Ints
    first: Floats
    last: Floats

    def of(self, which: NDArray[np.bool_] | Ints) -> Parts:
        """Return some of the parts."""
        return Parts(self.piece[which], self.first[which], self.last[which])

    @property
    def in_order(self) -> Parts:
        """The parts in the order of the path."""
        return self.of(np.lexsort((self.first, self.piece)))

    @property
    def middles(self) -> Parts:
        """The places in the middle of each part."""
        middle = 0.5 * (self.first + self.last)
        return Parts(self.piece, middle, middle)

    @property
    def starts(self) -> Parts:
        """The places at the start of each part."""
        return Parts(self.piece, self.first, self.first)

    @property
    def ends(self) -> Parts:
        """The places at the end of each part."""
        return Parts(self.piece, self.last, self.last)


def joined(*several: Parts) -> Parts:
    """Return several parts as one."""
    piece, first, last = (np.concatenate(column) for column in zip(*several, strict=True))
    return Parts(piece, first, last)


def tip_series(path: PathChunk, parts: Parts, order: int, *, bounds: bool) -> list[Series]:
    """Return the series of each axis over parts of a path.

    Args:
        path: the pieces.
        parts: where the series are taken, m of them.
        order: of the last term.
        bounds: whether the terms are intervals; otherwise they are those at the start of the parts.

    Returns:
        A series with terms (m,) for each axis of the path. In bounds, a term behind the first that
        is 0 everywhere is the number 0.0.
    """
    n = len(path.axes)
    low = np.zeros((order + 1, n, len(parts.piece)))
    high = np.zeros_like(low) if bounds else low
    degrees = _degrees(path)[parts.piece]
    for degree in np.unique(degrees).tolist():
        mine = np.flatnonzero(degrees == degree)
        some = parts.of(mine)
        if degree == OF_LINE:
            terms = _linear(path, some, order, bounds=bounds)
        elif degree == OF_ARC:
            terms = _arc(path, some, order, bounds=bounds)
        else:
            terms = _span(path, some, degree, order, bounds=bounds)
        for c, series in enumerate(terms):
            for k, term in enumerate(series.terms):
                if isinstance(term, Interval):
                    low[k, c, mine], high[k, c, mine] = term.lo, term.hi
                else:
                    low[k, c, mine] = high[k, c, mine] = term
    if not bounds:
        return [Series(list(low[:, c])) for c in range(n)]
    axes: list[Series] = []
    for c in range(n):
        rest = [
            Interval(low[k, c], high[k, c]) if low[k, c].any() or high[k, c].any() else 0.0
            for k in range(1, order + 1)
        ]
        axes.append(Series([Interval(low[0, c], high[0, c]), *rest]))
    return axes


def _degrees(path: PathChunk) -> Ints:
    """Return the degree of each span of a path (m,); OF_LINE and OF_ARC for the other pieces."""
    degrees = np.where(path.kind == LINE, OF_LINE, OF_ARC)
    spans = np.flatnonzero(path.kind == SPAN)
    degrees[spans] = path.data[path.at[spans] + START + 2 * len(path.axes)]
    return degrees


def _columns(path: PathChunk, parts: Parts, first: int, count: int) -> Floats:
    """Return ``count`` numbers of the record of each part, (count, m)."""
    at = path.at[parts.piece]
    columns: Floats = path.data[at[None] + np.arange(first, first + count)[:, None]]
    return columns


def _shares(path: PathChunk, parts: Parts) -> tuple[Floats, Floats, Floats]:
    """Return the range of the parameter of the pieces, and the shares at which the parts lie."""
    u0, u1 = _columns(path, parts, U0, 1)[0], _columns(path, parts, U1, 1)[0]
    extent = u1 - u0
    return extent, (parts.first - u0) / extent, (parts.last - u0) / extent


def _linear(path: PathChunk, parts: Parts, order: int, *, bounds: bool) -> list[Series]:
    """Return series that go straight from the start of the pieces to their end."""
    n = len(path.axes)
    extent, first, last = _shares(path, parts)
    start, end = _columns(path, parts, START, n), _columns(path, parts, START + n, n)
    axes = []
    for a, b in zip(start, end, strict=True):
        here, there = a + first * (b - a), a + last * (b - a)
        position: Term = here
        if bounds:
            position = Interval(np.minimum(here, there), np.maximum(here, there))
        rest: list[Term] = [np.zeros(len(a))] * (order - 1)
        axes.append(Series([position, (b - a) / extent, *rest][: order + 1]))
    return axes


def _arc(path: PathChunk, parts: Parts, order: int, *, bounds: bool) -> list[Series]:
    """Return the series of arcs, helices and spirals."""
    n = len(path.axes)
    axes = _linear(path, parts, order, bounds=bounds)
    extent, first, last = _shares(path, parts)
    body = _columns(path, parts, START + 2 * n, 10)
    radius, growth, sweep, _, ex, ey, close_x, close_y = body[2:]
    turn, grown = sweep / extent, growth / extent
    waves = []
    for quarter in (0.0, 0.5 * np.pi):
        terms: list[Term] = []
        for k in range(order + 1):
            # The k-th derivative of the cosine is the cosine, k quarters of a turn further. The
            # sine is the cosine a quarter earlier.
            ahead = k * 0.5 * np.pi - quarter
            here, there = first * sweep + ahead, last * sweep + ahead
            scale = turn**k / math.factorial(k)
            if bounds:
                angle = Interval(np.minimum(here, there), np.maximum(here, there))
                terms.append(cosine(angle) * scale)
            else:
                terms.append(np.cos(here) * scale)
        waves.append(Series(terms))
    share: Term = Interval(first, last) if bounds else first
    rest: list[Term] = [np.zeros(len(radius))] * (order - 1)
    rho = Series([share * growth + radius, grown, *rest][: order + 1])
    along, across = rho * waves[0], rho * waves[1]
    line = Series([share, 1.0 / extent, *rest][: order + 1])
    planes = body[:2].astype(np.int64)
    start = _columns(path, parts, START, n)
    # The columns of the plane may differ from part to part.
    for c in range(n):
        for position, (a, b, close) in enumerate(((ex, -ey, close_x), (ey, ex, close_y))):
            mine = planes[position] == c
            if not mine.any():
                continue
            value = along * a + across * b + line * close
            value = value + (start[c] - radius * a)
            axes[c] = _chosen(mine, value, axes[c])
    return axes


def _chosen(mine: NDArray[np.bool_], value: Series, other: Series) -> Series:
    """Return the terms of ``value`` where ``mine`` holds, and those of ``other`` elsewhere."""
    terms: list[Term] = []
    for a, b in zip(value.terms, other.terms, strict=True):
        if isinstance(a, Interval) or isinstance(b, Interval):
            x = a if isinstance(a, Interval) else Interval(a, a)
            y = b if isinstance(b, Interval) else Interval(b, b)
            terms.append(Interval(np.where(mine, x.lo, y.lo), np.where(mine, x.hi, y.hi)))
        else:
            terms.append(np.where(mine, a, b))
    return Series(terms)


def _span(path: PathChunk, parts: Parts, degree: int, order: int, *, bounds: bool) -> list[Series]:
    """Return the series of spans of one degree."""
    n = len(path.axes)
    extent, first, last = _shares(path, parts)
    numbers = _columns(path, parts, START + 2 * n + SPAN_BODY, (n + 1) * (degree + 1)).reshape(
        n + 1, degree + 1, -1
    )
    start = _columns(path, parts, START, n)
    weight = _polynomial(numbers[0], first, last, extent, order, bounds=bounds)
    rational = bool((numbers[0] != 1.0).any())
    axes = []
    for c in range(n):
        value = _polynomial(numbers[c + 1], first, last, extent, order, bounds=bounds)
        if rational:
            value = value / weight
        axes.append(value + start[c])
    return axes


def _polynomial(
    form: Floats, first: Floats, last: Floats, extent: Floats, order: int, *, bounds: bool
) -> Series:
    """Return the series of polynomials in Bernstein form.

    Args:
        form: (degree + 1, m): coefficients over the piece.
        first: (m,): share of the piece at which the part begins.
        last: (m,): share at which it ends.
        extent: (m,): range of the parameter of the piece.
        order: of the last term.
        bounds: whether the terms are intervals.
    """
    degree = len(form) - 1
    terms: list[Term] = []
    # Over the part the coefficients bound the polynomial: it lies in their hull.
    part = _restricted(form, first, last) if bounds else form
    width = (last - first) * extent if bounds else extent
    for k in range(order + 1):
        if k > degree:
            terms.append(np.zeros(form.shape[1]))
            continue
        slopes = np.diff(part, n=k, axis=0) * math.comb(degree, k)
        scale = width ** -float(k)
        if bounds:
            hull = Interval(slopes.min(axis=0), slopes.max(axis=0))
            terms.append(hull * scale)
        else:
            terms.append(_value(slopes, first) * scale)
    return Series(terms)


def _value(form: Floats, t: Floats) -> Floats:
    """Return the values at t by de Casteljau's recursion."""
    while len(form) > 1:
        form = form[:-1] + t * np.diff(form, axis=0)
    value: Floats = form[0]
    return value


def _restricted(form: Floats, first: Floats, last: Floats) -> Floats:
    """Return the coefficients over [first, last] of polynomials over [0, 1]."""
    left = []
    rest = form
    for _ in range(len(form)):
        left.append(rest[0])
        rest = rest[:-1] + last * np.diff(rest, axis=0)
    rest = np.stack(left)
    right = []
    share = first / np.where(last > 0.0, last, 1.0)
    for _ in range(len(form)):
        right.append(rest[-1])
        rest = rest[:-1] + share * np.diff(rest, axis=0)
    return np.stack(right[::-1])
