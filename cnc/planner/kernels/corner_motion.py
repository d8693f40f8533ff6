r"""The fastest motion past corners within their tolerance, by an interior-point method.

The control points and the durations of the groups of steps are sought together. All rows of
:mod:`cnc.planner.kernels.corner_rows` have the form |x| <= b. Newton's method lowers

    t T / T0 - sum over the rows of log(1 - x/b) + log(1 + x/b)

for growing t, where T is the duration. T0, its first value, makes t a plain number. At the least
value T exceeds the optimum by about T0 (number of rows) / t.

x is linear in the control points, or convex (feed, tolerance), and there the second derivatives are
exact. By the durations, those of x are left out. They count less and less, because the fastest
motion has nearly as many bounds as unknowns. The matrix is a band, and one column for each group.

The method begins inside all bounds. To get there, (1 + s) b takes the place of each bound, and s is
lowered in the same way until it is negative. The first motion is slow
(:mod:`cnc.planner.kernels.corner_guess`) and often inside already.
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats
from cnc.planner.kernels.corner_along import most_along, tighten
from cnc.planner.kernels.corner_newton import (
    Newton,
    assemble,
    barrier,
    correct,
    duration,
    furthest,
    look_ahead,
    most_used,
    new_newton,
    newton_step,
)
from cnc.planner.kernels.corner_rows import (
    Rows,
    derive_by_groups,
    evaluate,
    set_stencils,
    write_rows,
)
from cnc.planner.kernels.corner_tube import EDGE, FIXED, Tube, durations_of, place_ends, set_knots

GAP = 1e-3
"""The last (number of rows) / t."""

FIRST = 10.0
"""The first t, by the number of rows."""

RAISE = 8.0
"""Factor from one t to the next."""

CLOSE = 3.0
"""Newton's decrement at which a search ends."""

STALLED = 1e-4
"""A search ends at a step that gains less than what this part of the duration counts."""

NEWTON_STEPS = 40
"""Largest number of steps for one t."""

LEAST_STEP = 1e-4

BEFORE_BOUND = 0.8
"""Part of the way to the first bound that a step takes at most."""

LONGEST = 0.15
"""Largest change of the logarithm of a duration in one step. The rows are far from linear in it."""

EVEN = 0.01
"""Below this change of the logarithms of the durations the places are about linear in them."""

GROWTH = 4.0
"""Largest ratio of the parts of two steps that are taken one after the other. A step that is much
longer than the one before mostly fails, and each trial costs half as much as a step.
"""

INSIDE = 0.02
"""The search for a motion inside all bounds begins with bounds that are raised by so much more than
it needs.
"""

LEGAL = -0.25 * EDGE
"""It ends at this s. The rows at both ends may have no more room than EDGE."""

LOWER = 0.99
"""With larger t the search goes on only where the last t lowered s to this part of it."""

TIGHTENED = 3
"""Number of times that bounds of the rates along the path are lowered in a search."""

SLOWER = 0.04
"""Rise of the logarithms of the durations after bounds were lowered, so that there is room."""

WEIGHT = 0.01
"""T / T0 counts so much beside s in that search, so that slower motion is not sought at any price.
"""


@njit
def _place(tube: Tube, rows: Rows, c: Floats, spans: Floats) -> None:
    """Evaluate the rows for these unknowns; the fixed points of ``c`` are written."""
    set_knots(tube, spans, rows.t)
    place_ends(tube, rows.t, c)
    set_stencils(rows)
    evaluate(tube, rows, c)


@njit
def _lowered(
    tube: Tube, rows: Rows, n: Newton, weights: tuple[float, float], s: float, goal: float
) -> float:
    """Lower the sum for one t, and return s.

    Args:
        tube: the legs.
        rows: their limits.
        n: receives the unknowns.
        weights: of T / T0 (as t / T0), and of s. Where one is 0, the durations or s stay.
        s: part by which the bounds are raised.
        goal: s that ends the search.
    """
    groups, durations = len(n.spans), durations_of(tube, n.spans)
    first = 0 if weights[0] > 0.0 else durations
    end = groups + (1 if weights[1] > 0.0 else 0)
    _place(tube, rows, n.c, n.spans)
    value = (
        weights[0] * duration(n.share, n.spans)
        + weights[1] * s
        + barrier(rows, s, n.spans, n.least)
    )
    d = n.c.shape[1]
    held = False
    longest = 1.0
    for _ in range(NEWTON_STEPS):
        if not value < math.inf or s <= goal:
            break
        rows.work[0] += rows.number[1] + rows.along.number[0]
        if (first == 0 and not held) or durations < groups:
            derive_by_groups(tube, rows, n.spans, n.c)
        assemble(tube, rows, s, n)
        for g in range(groups):
            time = weights[0] * n.share[g] * math.exp(n.spans[g])
            rest = 1.0 / (n.spans[g] - n.least[g])
            n.other[g] += time - rest
            n.block[g, g] += time + rest * rest
        n.other[groups] += weights[1]
        decrement = newton_step(n, durations if held else first, end)
        if not CLOSE <= decrement < math.inf:
            if not held:
                break
            held = False
            continue
        look_ahead(rows, n)
        part = min(longest, BEFORE_BOUND * furthest(rows, n, s, n.other[groups]))
        widest = 0.0
        for g in range(groups):
            widest = max(widest, abs(n.other[g]))
        part = min(part, LONGEST / max(widest, LONGEST))
        step_s = n.other[groups]
        better = False
        while part > LEAST_STEP and not better:
            for i in range(len(n.slope)):
                k, q = FIXED + i // d, i % d
                n.tried[k, q] = n.c[k, q] + part * n.slope[i]
            for g in range(groups):
                n.tried_spans[g] = n.spans[g] + part * n.other[g]
            _place(tube, rows, n.tried, n.tried_spans)
            if first == 0 and not held and part * widest > EVEN:
                correct(tube, rows, n, part)
            tried = s + part * step_s
            new = weights[0] * duration(n.share, n.tried_spans) + weights[1] * tried
            new += barrier(rows, tried, n.tried_spans, n.least)
            better = new < value - 0.05 * part * decrement
            if not better:
                part *= 0.5
        if not better:
            if held or first == durations:
                break
            # With the durations as they are, the sum is convex: its least value is a better place
            # to change them.
            held = True
            _place(tube, rows, n.c, n.spans)
            continue
        n.c[:] = n.tried
        n.spans[:] = n.tried_spans
        s += part * step_s
        longest = min(1.0, GROWTH * part)
        gained, value = value - new, new
        if gained < STALLED * weights[0] * duration(n.share, n.spans):
            break
    return s


@njit
def _least_s(rows: Rows) -> float:
    """Return the s with which the search for a motion inside all bounds begins."""
    return (1.0 + INSIDE) * max(most_used(rows), most_along(rows.along)) - 1.0 + INSIDE


@njit
def _inside(tube: Tube, rows: Rows, n: Newton, unit: float) -> bool:
    """Bring a motion inside all limits; return whether it is."""
    _place(tube, rows, n.c, n.spans)
    count = float(rows.number[1] + rows.along.number[0])
    s = math.inf
    # With given durations the problem is nearly convex. If that does not do, they change.
    for weight in (0.0, WEIGHT * unit):
        s = _least_s(rows)
        if not s < math.inf:
            return False
        t = FIRST * count / (1.0 + max(s, 0.0))
        before = math.inf
        while LEGAL < s < LOWER * before and t <= count / GAP:
            before, s = s, _lowered(tube, rows, n, (weight * t, t), s, LEGAL)
            t *= RAISE
        if s <= LEGAL:
            break
        _place(tube, rows, n.c, n.spans)
    if s > LEGAL:
        return False
    # Far from all bounds the durations change more freely.
    _lowered(tube, rows, n, (0.0, 0.0), 0.0, -math.inf)
    return True


@njit
def fastest_motion(tube: Tube, rows: Rows, c: Floats, spans: Floats) -> bool:
    """Make a motion past corners the fastest one.

    Args:
        tube: the legs, and the states at both ends.
        rows: receives their limits.
        c: (steps + 3, d): control points of a motion near it, replaced by those of the result.
        spans: (groups,): logarithms of the durations of the groups there, replaced likewise.

    Returns:
        Whether a motion inside all limits was found.
    """
    write_rows(tube, rows)
    n = new_newton(tube, rows, c, spans)
    rows.group[:] = -1
    unit = 1.0 / duration(n.share, n.spans)
    if not _inside(tube, rows, n, unit):
        return False
    count = float(rows.number[1] + rows.along.number[0])
    return _settled(tube, rows, n, (FIRST * count, count / GAP, unit), c, spans)


@njit
def _settled(
    tube: Tube,
    rows: Rows,
    n: Newton,
    weights: tuple[float, float, float],
    c: Floats,
    spans: Floats,
) -> bool:
    """Write the fastest motion, from one inside all limits; return whether there is one.

    ``weights``: the first and the last t, and 1 / T0.
    """
    t, last, unit = weights
    any_legal = False
    tightened = 0
    earlier_c, earlier_spans = n.c.copy(), n.spans.copy()
    while True:
        _lowered(tube, rows, n, (t * unit, 0.0), 0.0, -math.inf)
        _place(tube, rows, n.c, n.spans)
        legal = barrier(rows, 0.0, n.spans, n.least) < math.inf
        if legal and rows.along.number[0] > 0:
            legal = tighten(rows.along, rows.t, n.c) <= 1.0
            _place(tube, rows, n.c, n.spans)
        if legal:
            c[:], spans[:] = n.c, n.spans
            earlier_c[:], earlier_spans[:] = n.c, n.spans
            any_legal = True
            if t == last:
                return True
            t = min(last, RAISE * t)
            continue
        tightened += 1
        if tightened > TIGHTENED or not _back_inside(tube, rows, n, earlier_c, earlier_spans, unit):
            return any_legal


@njit
def _back_inside(
    tube: Tube, rows: Rows, n: Newton, earlier_c: Floats, earlier_spans: Floats, unit: float
) -> bool:
    """Bring a motion inside all limits after bounds were lowered; return whether it is.

    The earlier motion had more room.
    """
    late_c, late_spans = n.c.copy(), n.spans.copy()
    n.c[:], n.spans[:] = earlier_c, earlier_spans
    _place(tube, rows, n.c, n.spans)
    if barrier(rows, 0.0, n.spans, n.least) < math.inf:
        return True
    n.c[:], n.spans[:] = late_c, late_spans
    n.spans[: durations_of(tube, n.spans)] += SLOWER
    return _inside(tube, rows, n, unit)
