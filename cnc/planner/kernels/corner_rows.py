"""The limits of a motion past corners, as rows of one inequality each.

A row bounds a value at a place of the spline (:mod:`cnc.planner.kernels.corner_tube`):

- a difference: jerk of a step, acceleration at its start, control points of the velocity. Speed and
  acceleration are convex combinations of these, so the rows hold everywhere;
- the length of a difference: the feed, and the acceleration where it is limited along the path;
- the distance of the second and the third Bezier point of a step from its leg, and of the point
  between two legs from their corner: the tolerance. The points within a distance of a leg form a
  convex set. The first point of a step lies between the third of the step before and the second of
  its own. So the whole spline lies within the tolerance. It crosses the plane at right angles to a
  leg through each of its points between those nearest to the points where the spline enters and
  leaves the leg. What is left of the leg is no farther from these than its corners are. So no point
  of the legs lies farther from the spline;
- a control point, where the travel of an axis ends close to the corners.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats, Ints
from cnc.planner.kernels.corner_along import (
    MOST_GROUPS,
    SMALL,
    AlongRows,
    derive_along,
    evaluate_along,
    new_along,
    write_along,
)
from cnc.planner.kernels.corner_tube import (
    ACCELERATION,
    CORNER,
    EARLY,
    EDGE,
    FIXED,
    JERK,
    LAST_VELOCITY,
    LATE,
    POINT,
    VELOCITY,
    Tube,
    place_ends,
    set_knots,
    steps_of,
    write_stencil,
)

AXIS, TRAVEL, LENGTH, LEG = range(4)
"""Kinds of rows: a component in an axis, that in one direction, a length, a distance from a leg."""

ROOM = 4.0
"""An axis counts as close to the end of its travel within so many tolerances."""

NEGLIGIBLE = 1e-9
"""A length that is so small a part of its bound counts as 0."""


class Rows(NamedTuple):
    """The rows, by the places that they bound, in the order of the steps.

    Attributes:
        number: (2,): of places and of rows.
        kind: (places,): JERK ... POINT.
        step: (places,): its step.
        first: (places + 1,): first row of each place.
        stencil: (places, 4): weights of control points step .. step + 3.
        x: (places, d): the value that is bounded.
        group: (places, MOST_GROUPS): groups whose duration changes it; -1 for none.
        by_group: (places, MOST_GROUPS, d): derivative by the logarithm of that duration.
        row: (rows,): AXIS ... LEG.
        scale: (rows,): 1 / bound.
        offset: (rows,): constant part, of TRAVEL rows.
        value: (rows,): the bounded value.
        gradient: (rows, d): its derivative by x.
        bend: (rows,): its curvature across the gradient; 0 for AXIS and TRAVEL.
        beside: (rows,): 1 where the nearest point of the leg is none of its ends.
        t: (steps + 5,): t_-2 ... t_steps+2.
        along: the rows of the jerk along the path.
        work: (1,): the rows of all steps of Newton's method, added up.
    """

    number: Ints
    kind: Ints
    step: Ints
    first: Ints
    stencil: Floats
    x: Floats
    group: Ints
    by_group: Floats
    row: Ints
    scale: Floats
    offset: Floats
    value: Floats
    gradient: Floats
    bend: Floats
    beside: Floats
    t: Floats
    along: AlongRows
    work: Ints


@njit
def new_rows(steps: int, axes: int, directions: int) -> Rows:
    """Return space for the rows of so many steps."""
    places, rows = 7 * steps + 1, steps * (5 * axes + 5) + axes + 1
    return Rows(
        np.zeros(2, np.int64),
        np.zeros(places, np.int64),
        np.zeros(places, np.int64),
        np.zeros(places + 1, np.int64),
        np.zeros((places, 4)),
        np.zeros((places, directions)),
        np.zeros((places, MOST_GROUPS), np.int64),
        np.zeros((places, MOST_GROUPS, directions)),
        np.zeros(rows, np.int64),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros((rows, directions)),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(steps + 5),
        new_along(steps, directions),
        np.zeros(1, np.int64),
    )


@njit
def _add_place(rows: Rows, kind: int, step: int) -> None:
    """Append a place without rows."""
    i = rows.number[0]
    rows.number[0] += 1
    rows.kind[i] = kind
    rows.step[i] = step
    rows.first[i + 1] = rows.first[i] = rows.number[1]


@njit
def _add_row(rows: Rows, kind: int, bound: float) -> int:
    """Append a row to the last place, and return its index."""
    m = rows.number[1]
    rows.number[1] += 1
    rows.row[m] = kind
    rows.scale[m] = 1.0 / bound
    rows.offset[m] = rows.bend[m] = rows.beside[m] = 0.0
    rows.first[rows.number[0]] = rows.number[1]
    return m


@njit
def _add_axes(rows: Rows, tube: Tube, bounds: Floats, least: float) -> None:
    """Append the rows of the axes; none where a vector of length ``least`` keeps to the bound."""
    n, d = tube.axes.shape
    for i in range(n):
        wide = 0.0
        for q in range(d):
            wide += tube.axes[i, q] ** 2
        if wide > 0.0 and bounds[i] < least * math.sqrt(wide):
            m = _add_row(rows, AXIS, bounds[i])
            for q in range(d):
                rows.gradient[m, q] = tube.axes[i, q]


@njit
def _add_edge(rows: Rows, tube: Tube, kind: int, step: int, v: Floats) -> None:
    """Append the first or the last control point of the velocity; ``v`` (d,) is that beside."""
    n, d = tube.axes.shape
    _add_place(rows, kind, step)
    square = 0.0
    for q in range(d):
        square += v[q] * v[q]
    feed = tube.feed[tube.leg[step]]
    if feed < math.inf:
        _add_row(rows, LENGTH, max(feed, (1.0 + EDGE) * math.sqrt(square)))
    for i in range(n):
        along = 0.0
        for q in range(d):
            along += tube.axes[i, q] * v[q]
        if tube.velocity[i] < math.inf:
            m = _add_row(rows, AXIS, max(tube.velocity[i], (1.0 + EDGE) * abs(along)))
            for q in range(d):
                rows.gradient[m, q] = tube.axes[i, q]


@njit
def write_rows(tube: Tube, rows: Rows) -> None:
    """Write the rows of a tube."""
    rows.number[:] = 0
    write_along(tube, rows.along)
    eps = tube.tolerance
    near = _close_to_travel(tube)
    steps = len(tube.leg)
    for k in range(steps):
        leg = tube.leg[k]
        # A control point of the velocity counts for the two steps before, too.
        feed = tube.feed[leg]
        for before in range(max(k - 2, 0), k):
            feed = min(feed, tube.feed[tube.leg[before]])
        _add_place(rows, JERK, k)
        _add_axes(rows, tube, tube.jerk, math.inf)
        if k > 0:
            _add_place(rows, ACCELERATION, k)
            _add_axes(rows, tube, tube.acceleration, math.inf)
        if k == 1:
            _add_edge(rows, tube, VELOCITY, k, tube.ends[0, 1])
        elif k > 1:
            _add_place(rows, VELOCITY, k)
            _add_axes(rows, tube, tube.velocity, feed)
            if feed < math.inf:
                _add_row(rows, LENGTH, feed)
        if k == steps - 1:
            _add_edge(rows, tube, LAST_VELOCITY, k, tube.ends[1, 1])
        _add_place(rows, EARLY, k)
        _add_row(rows, LEG, eps)
        _add_place(rows, LATE, k)
        _add_row(rows, LEG, eps)
        if k > 0 and leg != tube.leg[k - 1]:
            _add_place(rows, CORNER, k)
            _add_row(rows, LENGTH, eps)
        if near and k >= FIXED:
            _add_place(rows, POINT, k)
            _add_travel(rows, tube)


@njit
def _close_to_travel(tube: Tube) -> bool:
    """Return whether the travel of an axis ends close to the legs."""
    for i in range(tube.axes.shape[0]):
        for side in range(2):
            if _room(tube, i, side) < math.inf:
                return True
    return False


@njit
def _room(tube: Tube, i: int, side: int) -> float:
    """Return the distance of an end of the travel from the origin; infinity where it is far."""
    end = tube.travel[1, i] if side else -tube.travel[0, i]
    sign = 1.0 if side else -1.0
    d = tube.axes.shape[1]
    wide, farthest = 0.0, 0.0
    for q in range(d):
        wide += tube.axes[i, q] ** 2
    for leg in range(len(tube.feed)):
        for place in tube.reach[leg]:
            if math.isfinite(place):
                at = 0.0
                for q in range(d):
                    on = tube.start[leg, q] + place * tube.along[leg, q]
                    at += sign * tube.axes[i, q] * on
                farthest = max(farthest, at)
    if wide == 0.0 or end - farthest >= ROOM * tube.tolerance * math.sqrt(wide):
        return math.inf
    return max(end, farthest)


@njit
def _add_travel(rows: Rows, tube: Tube) -> None:
    """Append the rows of a control point where the travel ends close to the legs."""
    for i in range(tube.axes.shape[0]):
        for side in range(2):
            room = _room(tube, i, side)
            if room == math.inf:
                continue
            m = _add_row(rows, TRAVEL, tube.tolerance + room)
            rows.offset[m] = tube.tolerance
            sign = 1.0 if side else -1.0
            for q in range(tube.axes.shape[1]):
                rows.gradient[m, q] = sign * tube.axes[i, q]


@njit
def set_stencils(rows: Rows) -> None:
    """Write the weights of all places."""
    for i in range(rows.number[0]):
        write_stencil(rows.kind[i], rows.step[i], rows.t, rows.stencil[i])


@njit
def evaluate(tube: Tube, rows: Rows, c: Floats) -> None:
    """Write values, gradients and bends of the rows for control points ``c`` (steps + 3, d)."""
    d = c.shape[1]
    for i in range(rows.number[0]):
        k = rows.step[i]
        for q in range(d):
            x = 0.0
            for j in range(4):
                x += rows.stencil[i, j] * c[k + j, q]
            rows.x[i, q] = x
        leg = tube.leg[k]
        for m in range(rows.first[i], rows.first[i + 1]):
            if rows.row[m] <= TRAVEL:
                value = rows.offset[m]
                for q in range(d):
                    value += rows.gradient[m, q] * rows.x[i, q]
                rows.value[m] = value
                continue
            for q in range(d):
                rows.gradient[m, q] = rows.x[i, q]
            if rows.kind[i] >= EARLY:
                on = 0.0
                for q in range(d):
                    rows.gradient[m, q] -= tube.start[leg, q]
                    on += rows.gradient[m, q] * tube.along[leg, q]
                if rows.row[m] == LEG:
                    nearest = min(max(on, tube.reach[leg, 0]), tube.reach[leg, 1])
                    rows.beside[m] = 1.0 if nearest == on else 0.0
                    for q in range(d):
                        rows.gradient[m, q] -= nearest * tube.along[leg, q]
            length = 0.0
            for q in range(d):
                length += rows.gradient[m, q] ** 2
            length = math.sqrt(length)
            rows.value[m] = length
            # The direction of a rounding error says nothing.
            rows.bend[m] = 1.0 / length if length * rows.scale[m] > NEGLIGIBLE else 0.0
            for q in range(d):
                rows.gradient[m, q] *= rows.bend[m]
    evaluate_along(rows.along, rows.t, c)


@njit
def derive_by_groups(tube: Tube, rows: Rows, spans: Floats, c: Floats) -> None:
    """Write the derivatives of all places by the unknowns ``spans``."""
    places, d = rows.number[0], c.shape[1]
    other, moved, stencil = spans.copy(), c.copy(), np.empty(4)
    for i in range(places):
        rows.group[i, :] = -1
    at = 0
    begin = 0
    for group in range(len(spans)):
        first, end = steps_of(tube, group, begin)
        other[group] = spans[group] + SMALL
        set_knots(tube, other, rows.t)
        place_ends(tube, rows.t, moved)
        while at < places and rows.step[at] < first - 2:
            at += 1
        i = at
        while i < places and rows.step[i] < end + 2:
            k = rows.step[i]
            write_stencil(rows.kind[i], k, rows.t, stencil)
            slot = 0 if rows.group[i, 0] < 0 else 1
            rows.group[i, slot] = group
            for q in range(d):
                x = 0.0
                for j in range(4):
                    x += stencil[j] * moved[k + j, q]
                rows.by_group[i, slot, q] = (x - rows.x[i, q]) / SMALL
            i += 1
        other[group] = spans[group]
        begin = end
    derive_along(tube, rows.along, spans, rows.t, c)
