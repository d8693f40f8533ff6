"""Straight stretches of a chain, and the first knots.

Knots are laid on vertices, WIDEST moves apart or less. A stretch is a move, or several on one line.
Its middle becomes a straight line where it is long beside what follows: a curve leaves its line by
AWAY tolerances within a distance s, and a stretch longer than SPARE BENDS s keeps its middle.
BENDS s at each end is left to the spline:

            s                           4 spans        straight        4 spans
         .--'                         |-|-|-|-|----------------------|-|-|-|-|
    ----'                          curve    t_k                    t_k+1      curve

A stretch at a corner is straight beside it as far as a blend of the corner needs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.path.kernels.fit_spline import (
    KNOT,
    LEAST,
    ON_LINE,
    Chain,
    Flags,
    Knots,
    distance,
    measured,
    place_of,
)

WIDEST = 64
"""Most moves in a span."""
BESIDE = 4.2
"""A blend that turns by theta within eps of the corner begins 4 eps / sin(theta / 2) before it:
that much stays straight.
"""
AWAY, BENDS, SPARE = 4.0, 4.0, 3.0
TRANSITIONS = 4
"""Spans between a straight stretch and the curve."""


class Stretch(NamedTuple):
    """Moves on one line.

    Attributes:
        first: its first vertex.
        last: its last vertex.
        low: where its straight middle begins, mm from its start.
        high: where it ends; nothing is straight unless it is larger than ``low``.
    """

    first: int
    last: int
    low: float
    high: float


@njit
def _stretch_end(x: Floats, metric: Ints, corner: Flags, counted: Ints, a: int) -> int:
    """Return the place in ``counted`` where the stretch from place ``a`` ends."""
    b = a + 1
    first = counted[a]
    while b + 1 < counted.shape[0] and not corner[counted[b]]:
        here, after = counted[b], counted[b + 1]
        whole = distance(x, metric, first, after)
        part = distance(x, metric, first, here) / whole if whole > 0.0 else 2.0
        off = 0.0
        for c in range(x.shape[1]):
            off = max(off, abs(x[here, c] - x[first, c] - part * (x[after, c] - x[first, c])))
        if part >= 1.0 or off > ON_LINE:
            break
        b += 1
    return b


@njit
def _bend(
    chain: Chain, corner: Flags, counted: Ints, a: int, way: int, unit: Floats, tolerance: float
) -> float:
    """Return the distance behind place ``a`` at which the chain leaves a line by AWAY tolerances.

    Args:
        chain: the chain.
        corner: (m,): whether each vertex is a corner.
        counted: vertices that count.
        a: where the line ends.
        way: 1 or -1: direction along the chain.
        unit: (n,): direction of the line over the metric axes, with a length of how far to search.
        tolerance: mm.

    Returns:
        The distance in mm, that to the next corner or end if it is nearer, or infinity.
    """
    x, along, metric, _ = chain
    far = 0.0
    for c in metric:
        far += unit[c] * unit[c]
    far = math.sqrt(far)
    origin = counted[a]
    before = 0.0
    b = a
    while True:
        b += way
        here = counted[b]
        s = abs(along[here] - along[origin])
        dot = square = 0.0
        for c in metric:
            step = x[here, c] - x[origin, c]
            dot += step * unit[c] / far
            square += step * step
        off = math.sqrt(max(square - dot * dot, 0.0))
        if off >= AWAY * tolerance:
            last = abs(along[counted[b - way]] - along[origin])
            return last + (AWAY * tolerance - before) / (off - before) * (s - last)
        if s > far:
            return math.inf
        if b == 0 or b == counted.shape[0] - 1 or corner[here]:
            return s
        before = off


@njit
def _half_sine(x: Floats, metric: Ints, i: int) -> float:
    """Return the sine of half the turn at vertex i."""
    aa = distance(x, metric, i - 1, i)
    bb = distance(x, metric, i, i + 1)
    turn = 0.0
    for c in metric:
        turn += ((x[i + 1, c] - x[i, c]) / bb - (x[i, c] - x[i - 1, c]) / aa) ** 2
    return 0.5 * math.sqrt(turn)


@njit
def _beside(chain: Chain, i: int, size: float, tolerance: float) -> float:
    """Return the length of a stretch of ``size`` mm that stays straight at the corner i."""
    length = 0.0
    if size > 4.0 * LEAST * tolerance:
        length = 0.5 * size
        if 0 < i < chain.x.shape[0] - 1:
            length = min(length, BESIDE * tolerance / _half_sine(chain.x, chain.metric, i))
    return length


@njit
def _stretch(
    chain: Chain, corner: Flags, counted: Ints, a: int, b: int, tolerance: float, unit: Floats
) -> Stretch:
    """Return the stretch between two places in ``counted``; ``unit`` (n,) is work space."""
    x, along, metric, _ = chain
    first, last = counted[a], counted[b]
    size = along[last] - along[first]
    left_hard = a == 0 or corner[first]
    right_hard = b == counted.shape[0] - 1 or corner[last]
    low = 0.0
    high = size
    if not (left_hard and right_hard):
        for c in metric:
            unit[c] = (x[last, c] - x[first, c]) / (SPARE * BENDS)
        left = right = 0.0
        if not left_hard:
            left = BENDS * _bend(chain, corner, counted, a, -1, unit, tolerance)
        if not right_hard and left < size:
            right = BENDS * _bend(chain, corner, counted, b, 1, unit, tolerance)
        if SPARE * (left + right) < size:
            low = left
            high = size - right
        elif left_hard:
            high = _beside(chain, first, size, tolerance) if corner[first] else 0.0
        elif right_hard and corner[last]:
            low = size - _beside(chain, last, size, tolerance)
        else:
            high = 0.0
    return Stretch(first, last, low, high)


@njit
def _put(knots: Knots, count: int, t: float, vertex: int, on: bool) -> int:
    """Append a knot unless the last one is there.

    Returns:
        The number of knots.
    """
    if count == 0 or t > knots[count - 1]["t"]:
        _set(knots, count, t, vertex, on)
        count += 1
    return count


@njit
def _set(knots: Knots, k: int, t: float, vertex: int, on: bool) -> None:
    """Write knot k, without a mark."""
    knots[k]["t"] = t
    knots[k]["vertex"] = vertex
    knots[k]["on"] = on
    knots[k]["ends"] = False
    knots[k]["straight"] = False
    knots[k]["polyline"] = False
    knots[k]["refused"] = False


@njit
def _put_stretch(chain: Chain, counted: Ints, found: Stretch, knots: Knots, count: int) -> int:
    """Append the knots of a stretch with a straight middle; all but that at its end.

    Returns:
        The number of knots.
    """
    along = chain.along
    first, last, low, high = found
    start = along[first]
    count = _put(knots, count, start, first, True)
    if low > 0.0:
        for j in range(1, TRANSITIONS + 1):
            count = _put_inside(along, counted, start + low * j / TRANSITIONS, first, knots, count)
    knots[count - 1]["straight"] = True
    at = place_of(counted, first)
    since = 0
    while counted[at] < last:
        since += 1
        at += 1
        t = along[counted[at]]
        if since >= WIDEST and t > start + low and t < start + high and counted[at] < last:
            count = _put(knots, count, t, counted[at], True)
            knots[count - 1]["straight"] = True
            since = 0
    rest = along[last] - start - high
    if rest > 0.0:
        for j in range(TRANSITIONS):
            t = start + high + rest * j / TRANSITIONS
            count = _put_inside(along, counted, t, first, knots, count)
    return count


@njit
def _put_inside(
    along: Floats, counted: Ints, t: float, first: int, knots: Knots, count: int
) -> int:
    """Append a knot at t, behind vertex ``first``.

    Returns:
        The number of knots.
    """
    at = place_of(counted, first)
    while at + 1 < counted.shape[0] and along[counted[at + 1]] <= t:
        at += 1
    vertex = counted[at]
    on = along[vertex] == t
    if not on and at + 1 < counted.shape[0]:
        # The vertices between two that count have the parameter of the first.
        vertex = counted[at + 1] - 1
    return _put(knots, count, t, vertex, on)


@njit
def first_knots(chain: Chain, corner: Flags, tolerance: float, carried: Knots) -> Knots:
    """Return the first knots, as widely spaced as possible, and fill ``chain.along``.

    carried: knots of the last window that are kept, with t counted from their vertex.
    """
    along = chain.along
    counted = measured(chain, corner, tolerance)
    # Room for all that there might be: only what is used of it is touched.
    knots = np.empty(carried.shape[0] + (2 * TRANSITIONS + 2) * counted.shape[0] + 1, KNOT)
    count = _put(knots, 0, 0.0, 0, True)
    a = 0
    for k in range(carried.shape[0]):
        vertex = carried[k]["vertex"]
        count = _put(knots, count, along[vertex] + carried[k]["t"], vertex, carried[k]["on"])
        while counted[a] < vertex:
            a += 1
    knots[0]["ends"] = True
    unit = np.zeros(chain.x.shape[1])
    since = 0
    while a < counted.shape[0] - 1:
        b = _stretch_end(chain.x, chain.metric, corner, counted, a)
        found = _stretch(chain, corner, counted, a, b, tolerance, unit)
        edge = b == counted.shape[0] - 1 or corner[counted[b]]
        straight = found.high > found.low
        if straight:
            count = _put_stretch(chain, counted, found, knots, count)
        since = 0 if straight else since + 1
        if straight or edge or since >= WIDEST:
            before = count
            count = _put(knots, count, along[counted[b]], counted[b], True)
            if edge and count == before:
                # The chain ends where it began, and is nowhere farther than LEAST from there.
                _set(knots, count, knots[count - 1]["t"], counted[b], True)
                count += 1
            knots[count - 1]["ends"] = edge
            since = 0
        a = b
    return knots[:count]
