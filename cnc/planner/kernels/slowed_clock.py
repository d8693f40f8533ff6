r"""A ramp to rest, or to a slower copy of the plan, that follows the plan ever more slowly.

At l times the speed of the plan, the accelerations and jerks of all axes fall to l^2 and l^3 of
theirs. So a motion at the limits may be made a little slower, then leaves its limits some space,
and may be slowed faster:

      v |----.___           the plan
        |        `--.__.----
        |   `-._
        |       `.          each step takes the lowest jerk from which the motion recovers
        |         \
        +----------`------- s

A step is chosen so that a motion recovers behind it: with the largest jerk, it comes back to a
slowed copy of the plan before it exceeds a limit. The end is one phase of constant jerk to rest, or
a recovery to the copy at a given part of the plan's speed. No other search is needed, so this works
at states that have only one legal motion for a while.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.compiled.jit import njit
from cnc.planner.kernels.arrays import PHASE, LimitArrays, Phases, phase_at, write_phase
from cnc.planner.kernels.intervals import (
    SAMPLES,
    SCRATCH,
    TOUCH,
    Intervals,
    SumLimits,
    derivatives,
    interval_at,
    largest_shares,
)
from cnc.planner.kernels.refine import sum_limits
from cnc.planner.kernels.scurve import phase_time

Floats = NDArray[np.float64]

MOST = 2000
"""Largest number of phases of a ramp."""

RECOVERY = 8
"""A recovery takes at least so many steps, and at most twice as many."""

BISECTIONS = 7
"""Number of jerks that are tried for one step."""

SPARE, SPARE_MORE = 0.05, 0.5
"""A recovery uses less of the limits than the ramp, by this part, and by this part of the rest;
near to rest by nothing.
"""

LAST, LATEST = 0.96, 1.02
"""The last phase begins where it needs from the first to the second of these parts of the jerk that
is left. Farther away it would need more than any at first: the speed is too high.
"""

PLACES = 40
"""Places in the last phase at which the jerk that is left is known."""

NEAR, FINER = 0.98, 0.25
"""Above this part of the plan's speed there is little space: steps are this much shorter."""

LITTLE = 0.99
"""A copy above this part of the plan's speed is not worth another ramp."""

FALL = 0.02
"""Largest part of the speed that one step takes: so no step passes the start of the last phase."""

MEETING = 48
"""Largest number of phases with which the motion comes back to a slowed copy of the plan."""

HALVINGS = 50
"""Number of times that the moment is halved at which it meets the copy."""

SLOWER, MUCH_SLOWER = 0.01, 0.5
"""The search ends when the copy is slower than wanted by less than the first part. A copy at less
than the second part of the wanted speed is refused.
"""

ABRUPT = 1e-3
"""Part of a limit of jerk by which it may change abruptly inside a step."""

BEFORE = 1.0 - 1e-9
"""Part of a step that ends at an abrupt change: it is before that change."""

ROUNDING = 1e-5
"""Relative; bounds that cross by less count as equal."""


class Surroundings(NamedTuple):
    """What a ramp depends on.

    Attributes:
        plan: the plan, from the start of the ramp on.
        known: the intervals of the path.
        limits: for the sums.
        q: (3, axes + 1): scratch.
    """

    plan: Phases
    known: Intervals
    limits: SumLimits
    q: Floats


class State(NamedTuple):
    """A state of the motion, and where it is.

    Attributes:
        s: arc length, mm.
        v: speed, mm/s.
        a: acceleration, mm/s^2.
        row: a row of the plan at or before ``s``.
        k: an interval near ``s``.
    """

    s: float
    v: float
    a: float
    row: int
    k: int


@njit
def after(state: State, dt: float, j: float) -> State:
    """Return the state after ``dt`` seconds at the jerk ``j``."""
    s, v, a = phase_at(dt, state.s, state.v, state.a, j)
    return State(s, v, a, state.row, state.k)


@njit
def pace(state: State, about: Surroundings) -> tuple[float, float, State]:
    """Return the speed as a part of the plan's, the plan's acceleration, and the state placed."""
    plan = about.plan
    row = state.row
    while row + 1 < len(plan) and plan[row + 1]["s"] <= state.s:
        row += 1
    s, v, a, j = plan[row]["s"], plan[row]["v"], plan[row]["a"], plan[row]["j"]
    t = phase_time(v, a, j, plan[row]["duration"], max(state.s - s, 0.0))
    _, v, a = phase_at(t, s, v, a, j)
    k = interval_at(state.s, state.k, about.known.end)
    part = min(state.v / v, 1.0) if v > 0.0 else 1.0
    return part, a, State(state.s, state.v, state.a, row, k)


@njit
def bounds(state: State, share: float, about: Surroundings) -> tuple[float, float, float]:
    """Return the lowest and the largest jerk, and the lowest acceleration, along the path.

    Args:
        state: of the motion.
        share: of the limits.
        about: plan, path and limits.
    """
    q, limits = about.q, about.limits
    v, a = max(state.v, 0.0), state.a
    k = interval_at(state.s, state.k, about.known.end)
    derivatives(k, state.s, about.known, q)
    least, most, slowest = -math.inf, math.inf, -math.inf
    for i in range(q.shape[1]):
        q1 = abs(q[0, i])
        if q1 == 0.0:
            continue
        sign = 1.0 if q[0, i] > 0.0 else -1.0
        taken = sign * v * (3.0 * q[1, i] * a + q[2, i] * v * v)
        least = max(least, (-share * limits.j[i] - taken) / q1)
        most = min(most, (share * limits.j[i] - taken) / q1)
        slowest = max(slowest, (-share * limits.a[i] - sign * q[1, i] * v * v) / q1)
    return least, most, slowest


@njit
def allowed(part: float, use: float) -> float:
    """Return the share of the limits that a motion at ``part`` of the plan's speed may use."""
    return use + (1.0 - use) * part * part * part


@njit
def recovers(state: State, dt: float, use: float, about: Surroundings) -> bool:
    """Return whether the motion comes back to a slowed copy of the plan within the limits.

    Args:
        state: of the motion.
        dt: least duration of a step, s.
        use: share of the limits that a slow motion may use.
        about: plan, path and limits.
    """
    for m in range(2 * RECOVERY + 1):
        if state.v <= 0.0:
            return state.a >= 0.0
        part, wanted, state = pace(state, about)
        wanted *= part * part
        least, most, slowest = bounds(state, allowed(part, use), about)
        if state.a < slowest - ROUNDING * abs(slowest):
            return False
        if least > most + ROUNDING * (abs(least) + abs(most)):
            return False
        if state.a >= wanted:
            return True
        if m == 0 and most > 0.0:
            dt = max(dt, (wanted - state.a) / most / RECOVERY)
        state = after(state, dt, most)
    return False


@njit
def ends(state: State, most: float, use: float, about: Surroundings) -> bool:
    """Return whether one phase of constant jerk to rest needs about the jerk that is left.

    Args:
        state: of the motion.
        most: largest jerk there.
        use: share of the limits that the phase may use.
        about: plan, path and limits.
    """
    if state.a >= 0.0:
        return False
    jerk = 0.5 * state.a * state.a / state.v
    if jerk > LATEST * most:
        return False
    for m in range(1, PLACES + 1):
        later = after(state, -state.a / jerk * m / PLACES, jerk)
        most = min(most, bounds(later, use, about)[1])
    return LAST * most <= jerk <= LATEST * most


@njit
def lowest_jerk(state: State, dt: float, part: float, use: float, about: Surroundings) -> float:
    """Return the lowest jerk for one step from which the motion recovers.

    Args:
        state: of the motion.
        dt: duration of the step, s.
        part: the speed as a part of the plan's.
        use: share of the limits that a slow motion may use.
        about: plan, path and limits.
    """
    share = allowed(part, use)
    least, most, _ = bounds(state, share, about)
    low, high = least, most
    trial = least
    for _ in range(2):
        behind = after(state, dt, trial)
        lower, upper, slowest = bounds(behind, share, about)
        low, high = max(least, lower, (slowest - state.a) / dt), min(most, upper)
        trial = min(low, high)
    found = math.inf
    careful = use - part * (SPARE + SPARE_MORE * (1.0 - use))
    for k in range(BISECTIONS):
        if recovers(after(state, dt, trial), dt, careful, about):
            found = high = trial
            if k == 0:
                break
        else:
            low = trial
        trial = 0.5 * (low + high)
    if found < math.inf:
        return found
    # Near to the plan itself there may be no other motion: follow the slowed copy.
    _, wanted, _ = pace(after(state, dt, 0.0), about)
    return max(least, min(most, (part * part * wanted - state.a) / dt))


@njit
def abrupt(k: int, v: float, about: Surroundings) -> bool:
    """Return whether the third derivative of the path jumps at the end of interval ``k``.

    ``v``: the speed at which that counts.
    """
    known, limits = about.known, about.limits
    if k + 1 >= len(known.end):
        return False
    for i in range(known.samples.shape[3]):
        before = known.samples[k, SAMPLES - 1, 2, i] / known.share[k]
        behind = known.samples[k + 1, 0, 2, i] / known.share[k + 1]
        if abs(behind - before) * v * v * v * limits.per_j[i] > ABRUPT:
            return True
    return False


@njit
def next_change(state: State, h: float, about: Surroundings) -> float:
    """Return the place of the first abrupt change within a step of ``h`` seconds; else infinity."""
    end = about.known.end
    k = interval_at(state.s, state.k, end)
    farthest = state.s + h * (state.v + 0.5 * h * max(state.a, 0.0))
    while k < len(end) and end[k] < farthest:
        if abrupt(k, state.v, about):
            return float(end[k])
        k += 1
    return math.inf


@njit
def pace_wanted(plan: Phases, known: Intervals) -> float:
    """Return the part of its speed at which a plan keeps the speed bounds; at most 1."""
    end, top = known.end, known.top
    most = 1.0
    k = 0
    for r in range(len(plan)):
        duration, s, v = plan[r]["duration"], plan[r]["s"], plan[r]["v"]
        a, j = plan[r]["a"], plan[r]["j"]
        finish = plan[r + 1]["s"] if r + 1 < len(plan) else end[-1]
        turn = -a / j if a * j < 0.0 else math.inf
        k = interval_at(s, k, end)
        t = 0.0
        while True:
            last = not (k + 1 < len(end) and end[k] < finish)
            t_next = duration if last else phase_time(v, a, j, duration, end[k] - s)
            for moment in (t, min(max(turn, t), t_next), t_next):
                speed = v + moment * (a + 0.5 * moment * j)
                if speed > most * top[k]:
                    most = speed / top[k]
            if last:
                break
            t = t_next
            k += 1
    return 1.0 / most


@njit
def meeting(
    state: State, dt: float, use: float, about: Surroundings, out: Phases
) -> tuple[int, State]:
    """Write the phases with which the motion comes back to a slowed copy of the plan.

    Args:
        state: of the motion.
        dt: least duration of a step, s.
        use: share of the limits that a slow motion may use.
        about: plan, path and limits.
        out: (MEETING,): receives the phases.

    Returns:
        Their number, -1 if there are none; and the state at their end.
    """
    count = 0
    while count < MEETING and state.v > 0.0 and state.s < about.known.end[-1]:
        part, wanted, state = pace(state, about)
        wanted *= part * part
        if state.a >= wanted:
            return count, state
        most = bounds(state, allowed(part, use), about)[1]
        if count == 0 and most > 0.0:
            dt = max(dt, (wanted - state.a) / most / RECOVERY)
        h = dt
        change = next_change(state, h, about)
        if after(state, 2.0 * h, most).s > change:
            h = phase_time(state.v, state.a, most, 2.0 * h, change - state.s)
        behind = placed(after(state, h, most), change)
        part, wanted, _ = pace(behind, about)
        meets = behind.a >= part * part * wanted
        if meets:
            low = 0.0
            for _ in range(HALVINGS):
                middle = 0.5 * (low + h)
                part, wanted, _ = pace(after(state, middle, most), about)
                if state.a + middle * most >= part * part * wanted:
                    h = middle
                else:
                    low = middle
            behind = after(state, h, most)
        write_phase(out, count, h, state.s, state.v, state.a, most)
        count += 1
        state = behind
        if meets:
            return count, state
    return -1, state


@njit
def placed(state: State, change: float) -> State:
    """Return the state at an abrupt change, if it is there but for rounding."""
    if change < math.inf and abs(state.s - change) <= 1e-12 * change:
        return State(change, state.v, state.a, state.row, state.k)
    return state


@njit
def next_step(
    state: State, dt: float, part: float, use: float, about: Surroundings
) -> tuple[float, float, State]:
    """Return duration and jerk of one step of a ramp, and the state behind it.

    Args:
        state: of the motion.
        dt: duration of a step, s.
        part: the speed as a part of the plan's.
        use: share of the limits that a slow motion may use.
        about: plan, path and limits.
    """
    h = dt * FINER if part > NEAR else dt
    if state.a < 0.0:
        h = min(h, -FALL * state.v / state.a)
    change = next_change(state, h, about)
    if change < math.inf:
        h = BEFORE * phase_time(state.v, state.a, 0.0, h, change - state.s)
    j = lowest_jerk(state, h, part, use, about)
    if after(state, 2.0 * h, j).s > change:
        h = phase_time(state.v, state.a, j, 2.0 * h, change - state.s)
    return h, j, placed(after(state, h, j), change)


ROUNDED = 1e-3
"""Relative difference of two times of a phase that rounding explains."""

ROUNDED_LENGTH = 1e-15
"""The same of two arc lengths. At the end of a plan the whole phase may be so short."""


@njit
def write_copy(state: State, part: float, plan: Phases, out: Phases, count: int) -> int:
    """Append the plan at ``part`` of its speed, from a state on it on; return the new count."""
    row = plan[state.row]
    t = phase_time(row["v"], row["a"], row["j"], row["duration"], max(state.s - row["s"], 0.0))
    square, cube = part * part, part * part * part
    if t < row["duration"]:
        left, j = (row["duration"] - t) / part, row["j"] * cube
        # Near the end of the phase, the time by the arc length has the rounding of the latter. The
        # jerk to the speed and the acceleration there has not.
        _, v, a = phase_at(row["duration"], row["s"], row["v"], row["a"], row["j"])
        v, a = v * part, a * square
        if (v - state.v) * (a + state.a) > 0.0:
            exact = 2.0 * (v - state.v) / (a + state.a)
            apart = abs(exact - left)
            if apart <= ROUNDED * left or apart * max(state.v, v) <= ROUNDED_LENGTH * state.s:
                left, j = exact, (a - state.a) / exact
        write_phase(out, count, left, state.s, state.v, state.a, j)
        count += 1
    for r in range(state.row + 1, len(plan)):
        row = plan[r]
        v, a, j = row["v"] * part, row["a"] * square, row["j"] * cube
        write_phase(out, count, row["duration"] / part, row["s"], v, a, j)
        count += 1
    return count


@njit
def place_before_end(plan: Phases, left: float) -> float:
    """Return the arc length at which a plan has ``left`` seconds left, or that of its start."""
    for r in range(len(plan) - 1, -1, -1):
        row = plan[r]
        if row["duration"] >= left:
            s, _, _ = phase_at(row["duration"] - left, row["s"], row["v"], row["a"], row["j"])
            return float(s)
        left -= row["duration"]
    return float(plan[0]["s"])


@njit
def slower_copy(
    plan: Phases, known: Intervals, machine: LimitArrays, dt: float, use: float, wanted: float
) -> tuple[int, Phases, float]:
    """Return a ramp from the start of a plan to a copy of it at a part of its speed, and that copy.

    Args:
        plan: (p,): the plan from the start of the ramp on; it starts at speed.
        known: the intervals from there on, about as far as the ramp goes.
        machine: the limits.
        dt: duration of a step, s.
        use: share of the limits that a slow motion may use.
        wanted: part of the plan's speed; the copy may be slower by SLOWER of it.

    Returns:
        The number of phases of the ramp, all phases, and the part of the plan's speed; 0 and none
        if there is no legal ramp. Where a ramp to the wanted part would break a limit, the copy is
        faster, see :func:`copy_sooner`.
    """
    limits = sum_limits(machine)
    about = Surroundings(plan, known, limits, np.empty((3, len(limits.a))))
    out = np.empty(MOST + MEETING + len(plan) + 1, PHASE)
    scratch = np.empty((SCRATCH, len(limits.a)))
    state = State(plan[0]["s"], plan[0]["v"], plan[0]["a"], 0, 0)
    count = 0
    # Near its end a plan to rest has steps without end.
    last = min(place_before_end(plan, dt), known.end[-1])
    while count < MOST and state.v > 0.0 and state.s < last:
        part, _, state = pace(state, about)
        h, j, behind = next_step(state, dt, part, use, about)
        careful = use - part * (SPARE + SPARE_MORE * (1.0 - use))
        meets, there = meeting(behind, h, careful, about, out[count + 1 :])
        slow, _, _ = pace(there, about)
        met = meets >= 0 and there.v > 0.0 and slow <= wanted
        if met:
            low, high = 0.0, h
            for _ in range(HALVINGS):
                if slow >= wanted * (1.0 - SLOWER):
                    break
                middle = 0.5 * (low + high)
                tried = meeting(after(state, middle, j), h, careful, about, out[count + 1 :])
                slower, _, _ = pace(tried[1], about)
                if tried[0] >= 0 and tried[1].v > 0.0 and slower <= wanted:
                    high, slow = middle, slower
                else:
                    low = middle
            if slow < wanted * MUCH_SLOWER:
                return 0, out[:0], 1.0
            if high < h:
                behind = after(state, high, j)
            meets, there = meeting(behind, h, careful, about, out[count + 1 :])
            h = high
        write_phase(out, count, h, state.s, state.v, state.a, j)
        stop = count + 1 + (meets if met else 0)
        end = there if met else behind
        if not keeps_limits(out[count:stop], end.s, state.k, about, scratch):
            return copy_sooner(out, count, dt, use, wanted, about)
        if met:
            part, _, end = pace(end, about)
            return stop, out[: write_copy(end, part, plan, out, stop)], part
        count, state = stop, behind
    return copy_sooner(out, count, dt, use, wanted, about)


@njit
def keeps_limits(
    phases: Phases, s_end: float, k: int, about: Surroundings, scratch: Floats
) -> bool:
    """Return whether phases that end at ``s_end`` keep all limits.

    Args:
        phases: the phases.
        s_end: arc length at their end, mm.
        k: an interval at or before their start.
        about: plan, path and limits.
        scratch: (SCRATCH, axes).
    """
    for m in range(len(phases)):
        row = phases[m]
        end = phases[m + 1]["s"] if m + 1 < len(phases) else s_end
        worst, fastest, _ = largest_shares(
            row["duration"],
            row["s"],
            row["v"],
            row["a"],
            row["j"],
            end,
            k,
            about.known,
            about.limits,
            scratch,
        )
        if end <= row["s"] or end > about.known.end[-1] or max(worst, fastest) > 1.0 + TOUCH:
            return False
    return True


@njit
def copy_sooner(
    out: Phases, count: int, dt: float, use: float, wanted: float, about: Surroundings
) -> tuple[int, Phases, float]:
    """Return the part of a ramp from which the motion comes back to a copy, and that copy.

    Where a ramp breaks a limit, the motion may be slower by a little before. A ramp from that copy
    has more space.

    Args:
        out: the ramp; the copy is written to it.
        count: number of its legal phases.
        dt: duration of a step, s.
        use: share of the limits that a slow motion may use.
        wanted: part of the plan's speed; at less than MUCH_SLOWER of it there is no copy.
        about: plan, path and limits.

    Returns:
        The number of phases of the ramp, all phases, and the part of the plan's speed; 0 and none
        if there is no copy that is slower.
    """
    scratch = np.empty((SCRATCH, len(about.limits.a)))
    back = 1
    while back < count:
        first = count - back
        row = out[first]
        part, _, state = pace(State(row["s"], row["v"], row["a"], 0, 0), about)
        if part > LITTLE:
            break
        careful = use - part * (SPARE + SPARE_MORE * (1.0 - use))
        meets, there = meeting(state, dt, careful, about, out[first:])
        stop = first + meets
        part, _, there = pace(there, about)
        slower = meets > 0 and there.v > 0.0 and part >= wanted * MUCH_SLOWER
        if slower and keeps_limits(out[first:stop], there.s, state.k, about, scratch):
            return stop, out[: write_copy(there, part, about.plan, out, stop)], part
        back *= 2
    return 0, out[:0], 1.0


@njit
def slowed_clock(
    plan: Phases, known: Intervals, machine: LimitArrays, dt: float, use: float
) -> tuple[bool, Phases, float]:
    """Return a ramp to rest from the start of a plan, by slowing its clock.

    Args:
        plan: (p,): the plan from the start of the ramp on; it starts at speed.
        known: the intervals from there on.
        machine: the limits.
        dt: duration of a step, s.
        use: share of the limits that a slow motion may use.

    Returns:
        Whether the ramp is legal and ends inside ``known``, its phases, and where it rests, mm.
    """
    limits = sum_limits(machine)
    about = Surroundings(plan, known, limits, np.empty((3, len(limits.a))))
    out = np.empty(MOST, PHASE)
    scratch = np.empty((SCRATCH, len(limits.a)))
    state = State(plan[0]["s"], plan[0]["v"], plan[0]["a"], 0, 0)
    count = 0
    while count < MOST and state.v > 0.0 and state.s < known.end[-1]:
        part, _, state = pace(state, about)
        j = bounds(state, allowed(part, use), about)[1]
        ending = ends(state, j, use, about)
        if ending:
            j = 0.5 * state.a * state.a / state.v
            h = -state.a / j
            behind = after(state, h, j)
        else:
            h, j, behind = next_step(state, dt, part, use, about)
        write_phase(out, count, h, state.s, state.v, state.a, j)
        count += 1
        if behind.s > known.end[-1]:
            break
        worst, fastest, _ = largest_shares(
            h, state.s, state.v, state.a, j, behind.s, state.k, known, limits, scratch
        )
        state = behind
        if max(worst, fastest) > 1.0 + TOUCH:
            break
        if ending:
            return True, out[:count], state.s
    return False, out[:0], state.s
