"""Plans of a window as arrays of phases (:data:`cnc.planner.kernels.arrays.PHASE`)."""

from __future__ import annotations

import numpy as np

from cnc.planner.kernels.arrays import PHASE, Phases, phase_at
from cnc.planner.kernels.intervals import Intervals
from cnc.planner.kernels.lookahead import PLANNED, START_TOO_FAST, plan_window
from cnc.planner.kernels.refine import refine
from cnc.planner.kernels.scurve import phase_time
from cnc.planner.known_path import between, lowered, rounding_of
from cnc.planner.limits import Limits
from cnc.planner.work import Work

TOUCHING = 1e-6
"""Relative: a speed this little below its bound counts as at the bound."""

ROUGHLY = 1.4
"""A plan that will be refined may be this much faster than the usual bounds allow."""

BEFORE = 0.8
"""Part of the computing time that a motion allows which its refinement may use. The rest is for its
corners.
"""

INSTANT = 1e-7
"""s; a cut in time leaves no shorter part of a phase."""

NO_PHASES: Phases = np.empty(0, PHASE)


def plan_to_rest(
    start: float,
    intervals: Intervals,
    v_start: float,
    limits: Limits,
    lead: Phases = NO_PHASES,
    *,
    work: Work | None = None,
) -> tuple[int, Phases]:
    """Plan from ``start`` to rest at the end of ``intervals``.

    Where the path bends or its speed bounds change, the plan is refined. From a speed that the
    refinement has reached, or with an illegal lead, there may be no plan under the usual bounds.
    Then the refinement starts with a plan that exceeds them a little.

    Args:
        start: arc length, mm.
        intervals: the intervals.
        v_start: speed at the start, mm/s.
        limits: of the machine.
        lead: phases to the start, over the first of the intervals; they become part of the plan.
        work: computing time for a refinement; None for none. Then there is no plan behind a lead.

    Returns:
        The status of :func:`cnc.planner.kernels.lookahead.plan_window`, and the phases.
    """
    whole = intervals
    if len(lead):
        intervals = between(intervals, start, float(intervals.end[-1]))
    status, phases = _planned(start, intervals, v_start)
    rough = status == START_TOO_FAST
    if not (rough or status == PLANNED):
        return status, phases
    if work is None:
        return (START_TOO_FAST, phases[:0]) if rough or len(lead) else (status, phases)
    if rough:
        freer = intervals._replace(
            speed=np.where(
                intervals.flat,
                intervals.speed,
                np.minimum(intervals.top, ROUGHLY * intervals.speed),
            ),
            accel=np.maximum(intervals.accel, 0.5 * intervals.accel[:, -1:]),
            jerk=np.maximum(intervals.jerk, 0.5 * intervals.jerk[:, -1:]),
        )
        status, phases = _planned(start, freer, v_start)
        if status != PLANNED:
            return status, phases
    phases = np.concatenate((lead, phases))
    with work.ahead(BEFORE * float(phases["duration"].sum())):
        legal, phases = refine(
            phases, lowered(whole), limits.arrays, rough or len(lead) > 0, work.left
        )
    return (PLANNED, phases) if legal else (START_TOO_FAST, phases[:0])


def _planned(start: float, intervals: Intervals, v_start: float) -> tuple[int, Phases]:
    """Plan under bounds that are constant on each interval."""
    phases = np.empty(8 * len(intervals.end) + 16, PHASE)
    status, written = plan_window(start, intervals, v_start, phases)
    phases = phases[:written]
    return status, phases[phases["duration"] > 0.0]


def first_steady(phases: Phases) -> int:
    """Return the number of phases up to the first point without acceleration after the start.

    It is the number of all phases if that point is the rest behind them.
    """
    steady = np.flatnonzero(phases["a"][1:] == 0.0)
    return int(steady[0]) + 1 if len(steady) else len(phases)


def steady_from(phases: Phases, first: int) -> int:
    """Return the number of phases before the first point without acceleration from one on."""
    if first == len(phases) or phases[first]["a"] == 0.0:
        return first
    return first + first_steady(phases[first:])


def first_rest(phases: Phases) -> int:
    """Return the number of phases up to the first rest after the start."""
    rests = np.flatnonzero((phases["v"][1:] == 0.0) & (phases["a"][1:] == 0.0))
    return int(rests[0]) + 1 if len(rests) else len(phases)


def last_bound(phases: Phases, intervals: Intervals) -> float:
    """Return the arc length of the last place at which the plan is as fast as the path allows.

    Behind it the plan slows for its end. It is the start if there is no such place.
    """
    place, v = phases["s"], phases["v"] * (1.0 + TOUCHING)
    last = len(intervals.end) - 1
    before = np.minimum(np.searchsorted(intervals.end, place, side="left"), last)
    after = np.minimum(np.searchsorted(intervals.end, place, side="right"), last)
    touching = np.flatnonzero(
        (phases["a"] == 0.0) & (v >= np.minimum(intervals.speed[before], intervals.speed[after]))
    )
    if not len(touching):
        return float(place[0])
    k = int(touching[-1])
    cruises = phases[k]["j"] == 0.0 and k + 1 < len(phases)
    return float(place[k + 1] if cruises else place[k])


def cut_steady(phases: Phases, limit: float) -> tuple[Phases, int]:
    """Find the last point without acceleration at or before arc length ``limit``.

    Returns:
        The phases, and the number of them before that point. A cruise that passes ``limit`` is cut
        there.
    """
    k = int(np.searchsorted(phases["s"], limit, side="right")) - 1
    if k >= 0:
        duration, s, v, a, j = phases[k].tolist()
        if a == 0.0 and j == 0.0 and v > 0.0:
            t = (limit - s) / v
            if INSTANT < t < duration - INSTANT:
                head, tail = cut_inside(phases, k, t)
                tail[0]["s"] = limit
                return np.concatenate((head, tail)), k + 1
    steady = np.flatnonzero(phases["a"][: max(k, 0) + 1] == 0.0)
    return phases, int(steady[-1]) if len(steady) else 0


def cut_inside(phases: Phases, k: int, t: float) -> tuple[Phases, Phases]:
    """Return the phases up to ``t`` seconds into phase ``k``, and those behind.

    The second result is a view of ``phases``, which changes.
    """
    head = phases[: k + 1].copy()
    head[k]["duration"] = t
    duration, s, v, a, j = phases[k].tolist()
    phases[k] = (
        duration - t,
        s + t * (v + t * (0.5 * a + t * j / 6.0)),
        v + t * (a + 0.5 * t * j),
        a + t * j,
        j,
    )
    return head, phases[k:]


def cut_at_length(phases: Phases, s: float) -> tuple[Phases, Phases]:
    """Return the phases before and behind arc length ``s``; ``phases`` itself changes.

    A phase that starts or ends at ``s`` but for rounding stays whole.
    """
    k = int(np.searchsorted(phases["s"], s, side="right")) - 1
    duration, start, v, a, j = phases[k].tolist()
    near = rounding_of(s)
    if s - start <= near:
        return phases[:k], phases[k:]
    t = phase_time(v, a, j, duration, s - start)
    if t >= duration or phase_at(duration, start, v, a, j)[0] <= s + near:
        return phases[: k + 1], phases[k + 1 :]
    head, tail = cut_inside(phases, k, t)
    tail[0]["s"] = s
    return head, tail


def slice_end(phases: Phases, seconds: float, length: float) -> tuple[int, float]:
    """Find the end of a slice that takes at least ``seconds`` and covers at least ``length`` mm.

    Returns:
        The number of whole phases, and the time in the phase behind them, s.
    """
    rows = 64
    while True:
        part = phases[:rows]
        elapsed = np.cumsum(part["duration"])
        covered = np.append(part["s"][1:], np.inf) - part[0]["s"]
        k = int(np.count_nonzero((elapsed < seconds) | (covered < length)))
        if k < len(part) - 1 or len(part) == len(phases):
            break
        rows *= 4
    if k == len(phases):
        return k, 0.0
    duration, s, v, a, j = part[k].tolist()
    t = seconds - (float(elapsed[k]) - duration)
    left = float(part[0]["s"]) + length - s
    if left > 0.0:
        t = max(t, phase_time(v, a, j, duration, left))
    # What covers no length behind or before a joint of two pieces would count to the other piece.
    here = phase_at(t, s, v, a, j)[0]
    near, end = rounding_of(s), phase_at(duration, s, v, a, j)[0]
    if (t < INSTANT or here - s <= near) and k > 0:
        return k, 0.0
    return (k, t) if INSTANT <= t < duration - INSTANT and end - here > near else (k + 1, 0.0)


def release(phases: Phases, least: float) -> Phases | None:
    """Return the phase that ends the acceleration at the start of ``phases``.

    Its jerk is that with which their own ramp ends, and ``least`` at least. It is None if there is
    no such jerk, or if the motion would rest before.
    """
    _, s, v, a, _ = phases[0].tolist()
    ending = np.flatnonzero(phases["j"] * a < 0.0)
    own = abs(float(phases[ending[0]]["j"])) if len(ending) else 0.0
    jerk = max(own, least)
    if jerk == 0.0 or (a < 0.0 and v <= 0.5 * a * a / jerk):
        return None
    return np.array([(abs(a) / jerk, s, v, a, -jerk if a > 0.0 else jerk)], PHASE)


def end_of(phases: Phases) -> tuple[float, float]:
    """Return arc length and speed at the end of the phases."""
    t, s, v, a, j = phases[-1].tolist()
    return s + t * (v + t * (0.5 * a + t * j / 6.0)), v + t * (a + 0.5 * t * j)
