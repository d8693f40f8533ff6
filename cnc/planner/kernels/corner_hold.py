r"""The fastest motion to rest from inside a motion past corners, for a hold.

At a corner several axes are at their limits, so the motion can slow little on its curve. But within
the tolerance there are other curves. The stop is sought there as motions past corners are
(:mod:`cnc.planner.kernels.corner_motion`), with its end at rest on a leg, at a place that is sought
too:

        here
     ----o.            as planned: - -
           `.' -
            |   `
            |     `
            o       -  - -
          at rest on the leg

The search begins with the motion as planned under a clock that slows: with u = t / T its rate is
1 - 3 u^2 + 2 u^3. So it ends at half of T. Behind its end the motion goes on along its last leg.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import LENGTH, LINE, METRIC, METRICS, START, U1, Floats, curve_eval
from cnc.planner.kernels.arrays import LimitArrays, PathArrays, PlanArrays
from cnc.planner.kernels.corner_legs import (
    GROUPS,
    LEG_STEPS,
    MOST_DIRECTIONS,
    MOST_STEPS,
    STEPS,
    WITHIN,
    basis_of,
    steps_of_legs,
    tube_of,
)
from cnc.planner.kernels.corner_motion import fastest_motion
from cnc.planner.kernels.corner_pieces import (
    NUMBERS,
    PIECES,
    Progress,
    TimedSteps,
    begun,
    write_steps,
)
from cnc.planner.kernels.corner_places import MOST_CORNERS, Chain, state_at
from cnc.planner.kernels.corner_places import time_of as time_at
from cnc.planner.kernels.corner_rows import Rows, new_rows
from cnc.planner.kernels.corner_tube import Tube, place_ends, set_knots
from cnc.planner.kernels.legs import REST, line_bounds
from cnc.planner.kernels.scurve import ramp_time

HALVINGS = 60


class Planned(NamedTuple):
    """The rest of a motion past corners, in the directions of its legs.

    Attributes:
        path: timed pieces.
        plan: the phases.
        basis: (d, axes): the directions.
        origin: (axes,): the place of the first corner, mm.
    """

    path: PathArrays
    plan: PlanArrays
    basis: Floats
    origin: Floats


@njit
def planned_state(planned: Planned, t: float, r: Floats) -> None:
    """Write position, velocity and acceleration (3, d) at time ``t`` from the start."""
    path, plan = planned.path, planned.plan
    d, n = planned.basis.shape
    here = plan.t[0] + t
    end = plan.t[len(plan.j)]
    k = min(max(int(np.searchsorted(plan.t, here, side="right")) - 1, 0), len(plan.j) - 1)
    s, rate, change = state_at(min(here, end), k, plan)
    k = min(max(int(np.searchsorted(plan.piece_s, s, side="right")) - 1, 0), len(path.length) - 1)
    q = np.empty((4, n))
    at = path.pieces.at[k]
    u = min(max(s - plan.piece_s[k], 0.0), path.length[k])
    curve_eval(path.pieces.kind[k], path.pieces.data, at, u, q)
    for o in range(d):
        for order in range(3):
            r[order, o] = 0.0
        for m in range(int(path.pieces.data[at + METRICS])):
            i = int(path.pieces.data[at + METRIC + m])
            r[0, o] += planned.basis[o, i] * (q[0, i] - planned.origin[i])
            r[1, o] += planned.basis[o, i] * q[1, i] * rate
            r[2, o] += planned.basis[o, i] * (q[2, i] * rate * rate + q[1, i] * change)
    if here > end:
        for o in range(d):
            r[0, o] += r[1, o] * (here - end)
            r[2, o] = 0.0


@njit
def slowed(t: float, whole: float) -> tuple[float, float, float]:
    """Return the slowed clock at time ``t``, its rate and the change of that."""
    u = min(max(t / whole, 0.0), 1.0)
    return (
        whole * u * (1.0 - u * u * (1.0 - 0.5 * u)),
        1.0 - u * u * (3.0 - 2.0 * u),
        -6.0 * u * (1.0 - u) / whole,
    )


@njit
def time_of(clock: float, whole: float) -> float:
    """Return the time at which the slowed clock shows ``clock``."""
    low, high = 0.0, whole
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if slowed(middle, whole)[0] < clock:
            low = middle
        else:
            high = middle
    return high


LONGER = (1.5, 2.0, 1.0, 3.5)
"""T of the searches, by the time of a straight ramp to rest. What a search ends with depends on the
legs over which it begins.
"""

NEAR = 1.05
"""A motion that takes no longer than so many straight ramps is the last one sought."""

SIDE = 0.3
"""Part of the time on a leg that its outer groups take."""

FIRST_STEP = 0.5
"""The first step takes at most this part of the rest of the step that is under way. Within that
step, its Bezier points keep to the bounds.
"""

WITHIN_STOP = 1.0 - 1e-6
"""Part of the tolerance that is used: more than where the motion comes from."""


class Chained(NamedTuple):
    """A motion past a chain of corners that is under way.

    Attributes:
        path: the legs of the chain, whole.
        bound: (legs,): largest feeds, mm/s.
        limits: of the machine.
        travel: (2, axes): lowest and highest positions, mm.
        left: the timed pieces of the motion from here on.
        plan: their phases.
        first: the leg that is under way.
    """

    path: PathArrays
    bound: Floats
    limits: LimitArrays
    travel: Floats
    left: PathArrays
    plan: PlanArrays
    first: int


class Rest(NamedTuple):
    """A motion to rest.

    Attributes:
        leg: the leg on which it rests; -1 if there is none.
        place: from the start of that leg, mm.
        duration: s; infinite if there is none.
        ramp: the time of a straight ramp to rest, s.
        steps: the motion.
    """

    leg: int
    place: float
    duration: float
    ramp: float
    steps: TimedSteps


@njit
def _ramp(planned: Planned, limits: LimitArrays) -> float:
    """Return the time of a straight ramp to rest from the start, s."""
    d, n = planned.basis.shape
    r = np.empty((3, d))
    planned_state(planned, 0.0, r)
    speed, along = 0.0, 0.0
    for o in range(d):
        speed += r[1, o] ** 2
        along += r[1, o] * r[2, o]
    speed = math.sqrt(speed)
    if not speed > 0.0:
        return 0.0
    u = np.zeros(n)
    for i in range(n):
        for o in range(d):
            u[i] += planned.basis[o, i] * r[1, o] / speed
    line = line_bounds(u, speed, limits)
    return float(ramp_time(0.0, speed, line.a, line.j) + abs(along / speed) / line.j)


@njit
def _legs_to(
    tube: Tube, path: PathArrays, first: int, last: int, state: Floats, unit: float
) -> Tube:
    """Return the legs ``first`` to ``last`` of a tube, for a motion that ends on the last one.

    ``state`` (3, d): position, velocity and acceleration at its start. ``unit``: see :class:`Tube`.
    """
    legs, d = last - first + 1, tube.axes.shape[1]
    start, reach = tube.start[first : last + 1].copy(), tube.reach[first : last + 1].copy()
    if first == 0:
        # Its first leg is measured from the corner at its end.
        for q in range(d):
            start[0, q] -= path.length[0] * tube.along[0, q]
        reach[0, 1] = path.length[0]
    reach[legs - 1, 1] = path.length[last]
    leg, group, part = steps_of_legs(legs)
    ends = np.zeros((2, 3, d))
    ends[0] = state
    return Tube(
        tube.axes,
        tube.velocity,
        tube.acceleration,
        tube.jerk,
        tube.travel,
        tube.feed[first : last + 1].copy(),
        tube.along_pull,
        tube.across_pull,
        tube.along_jerk,
        tube.tolerance / WITHIN * WITHIN_STOP,
        start,
        tube.along[first : last + 1].copy(),
        reach,
        leg,
        group,
        part,
        ends,
        unit,
    )


@njit
def _find_stop(chained: Chained, longer: float, rows: Rows) -> Rest:
    """Return the fastest motion to rest that one search finds.

    Args:
        chained: the motion that is under way.
        longer: see LONGER.
        rows: space for the limits.
    """
    path, bound, limits, travel, left, plan, first = chained
    legs, n = len(path.length), len(limits.axis_jerk)
    along = np.zeros((MOST_CORNERS + 1, MOST_DIRECTIONS))
    basis = basis_of(path, 0, legs - 2, along)
    d = len(basis)
    chain = Chain(0, legs - 2, 0.0, 0.0, True)
    tube = tube_of(path, chain, bound, limits, travel, basis, along)
    none = Rest(-1, 0.0, math.inf, 0.0, TimedSteps(0.0, basis, tube.leg, rows.t, np.empty((0, 0))))
    if d == 0:
        return none
    at = path.pieces.at[1] + START
    planned = Planned(left, plan, basis, path.pieces.data[at : at + n].copy())
    ramp = _ramp(planned, limits)
    whole = longer * ramp
    if not whole > 0.0:
        return none
    # The times at which the planned motion enters the legs behind the first one.
    pieces = len(left.length)
    enters = np.empty(legs + 1)
    enters[first] = 0.0
    last = first
    for leg in range(first + 1, legs):
        enters[leg] = time_at(plan.piece_s[pieces - LEG_STEPS * (legs - leg)], plan) - plan.t[0]
        if enters[leg] < 0.5 * whole:
            last = leg
    state, r = np.empty((3, d)), np.empty((3, d))
    planned_state(planned, 0.0, state)
    planned_state(planned, 0.5 * whole, r)
    speed = 0.0
    for q in range(d):
        speed += state[1, q] ** 2
    # A step of the search changes the place by a part of the way to rest.
    tube = _legs_to(tube, path, first, last, state, 0.5 * whole * math.sqrt(speed))
    place = 0.0
    for q in range(d):
        place += (r[0, q] - tube.start[last - first, q]) * tube.along[last - first, q]
    if not 0.0 < place < path.length[last]:
        return none
    spans = np.empty(GROUPS * (last - first + 1) + 1)
    begin = 0.0
    for leg in range(first, last + 1):
        end = whole if leg == last else time_of(enters[leg + 1], whole)
        side = SIDE * (end - begin)
        before = side
        if leg == first:
            step = time_at(plan.piece_s[1], plan) - plan.t[0]
            before = min(side, FIRST_STEP * step * STEPS[0])
        g = GROUPS * (leg - first)
        spans[g] = math.log(before)
        spans[g + 1] = math.log(end - begin - before - side)
        spans[g + 2] = math.log(side)
        begin = end
    spans[-1] = place / tube.unit
    c = _first_points(planned, tube, whole, spans, rows)
    if not fastest_motion(tube, rows, c, spans):
        return none
    place = spans[-1] * tube.unit
    if not REST < place < path.length[last] - REST:
        # Such a short rest of a leg would be one of rounding.
        return none
    steps = len(tube.leg)
    set_knots(tube, spans, rows.t)
    place_ends(tube, rows.t, c)
    knots = rows.t[: steps + 5].copy()
    return Rest(last, place, knots[steps + 2], ramp, TimedSteps(0.0, basis, tube.leg, knots, c))


@njit
def _first_points(planned: Planned, tube: Tube, whole: float, spans: Floats, rows: Rows) -> Floats:
    """Return control points of a motion near the planned one under the slowed clock."""
    steps, d = len(tube.leg), tube.axes.shape[1]
    set_knots(tube, spans, rows.t)
    c, r = np.empty((steps + 3, d)), np.empty((3, d))
    for k in range(steps + 3):
        # The polar form of a parabola at three parameters, from their mean.
        mean = (rows.t[k] + rows.t[k + 1] + rows.t[k + 2]) / 3.0
        x, y, z = rows.t[k] - mean, rows.t[k + 1] - mean, rows.t[k + 2] - mean
        clock, rate, change = slowed(mean, whole)
        planned_state(planned, clock, r)
        for q in range(d):
            a = r[2, q] * rate * rate + r[1, q] * change
            c[k, q] = r[0, q] + a * (x * y + y * z + z * x) / 6.0
    return c


@njit
def _write_last_line(
    steps: TimedSteps, like: int, out: PathArrays, out_plan: PlanArrays, progress: Progress
) -> None:
    """Write the last step again, as a line: constant jerk to rest.

    At rest speed and acceleration are 0, so behind it everything is along one jerk.
    """
    data, k = out.pieces.data, progress.counts[PIECES] - 1
    n, at, at_k = int(data[like]), progress.counts[NUMBERS], out.pieces.at[k]
    for i in range(START):
        data[at + i] = data[like + i]
    for i in range(2 * n):
        data[at + START + i] = data[at_k + START + i]
    square = 0.0
    for m in range(int(data[like + METRICS])):
        i = at + START + int(data[like + METRIC + m])
        square += (data[i + n] - data[i]) ** 2
    length = math.sqrt(square)
    data[at + LENGTH] = data[at + U1] = length
    progress.counts[NUMBERS] = at + START + 2 * n
    out.pieces.kind[k], out.pieces.at[k], out.length[k] = LINE, at, length
    last = len(steps.leg) - 1
    h = steps.t[last + 3] - steps.t[last + 2]
    out_plan.v[k] = 3.0 * length / h
    out_plan.a[k] = -6.0 * length / h**2
    out_plan.j[k] = 6.0 * length / h**3
    end = out_plan.piece_s[k] + length
    out_plan.piece_s[k + 1] = out_plan.s[k + 1] = end
    out_plan.t[k + 1] = steps.t[last + 3]
    out_plan.v[k + 1] = out_plan.a[k + 1] = 0.0


@njit
def stop_within(
    chained: Chained, out: PathArrays, out_plan: PlanArrays
) -> tuple[int, int, int, float]:
    """Write the fastest motion to rest that is found from inside a motion past corners.

    Args:
        chained: the motion that is under way.
        out: space for MOST_STEPS pieces. The data needs the size of all records of ``path``, and
            :func:`cnc.planner.kernels.corner_pieces.steps_size`.
        out_plan: space for so many phases.

    Returns:
        The numbers of pieces and of numbers in their records; the leg on which it rests, -1 if no
        motion is found; the place from the start of that leg, mm.
    """
    path, _, limits, _, left, plan, first = chained
    rows = new_rows(MOST_STEPS, len(limits.axis_jerk), MOST_DIRECTIONS)
    rest = _find_stop(chained, LONGER[0], rows)
    for longer in LONGER[1:]:
        if rest.duration <= NEAR * rest.ramp:
            break
        other = _find_stop(chained, longer, rows)
        if other.duration < rest.duration:
            rest = other
    if rest.leg < 0:
        return 0, 0, -1, 0.0
    progress, lowest = begun(path, out)
    n = len(limits.axis_jerk)
    q, given = np.empty((4, n)), np.empty((2, n))
    at, corner = left.pieces.at[0], path.pieces.at[1] + START
    u = plan.s[0] - plan.piece_s[0]
    curve_eval(left.pieces.kind[0], left.pieces.data, at, u, q)
    given[0] = q[0]
    for i in range(n):
        given[1, i] = path.pieces.data[corner + i]
    like = path.pieces.at[first] - lowest
    write_steps(path, first, like, given, rest.steps, out, out_plan, progress)
    _write_last_line(rest.steps, like, out, out_plan, progress)
    return progress.counts[PIECES], progress.counts[NUMBERS], rest.leg, rest.place
