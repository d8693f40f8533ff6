"""Comparison of a refined plan with the path itself, before the plan is accepted.

The refinement reads the path from samples of its intervals. They are close enough up to a speed,
``reliable`` of :class:`cnc.planner.kernels.intervals.Intervals`. Faster phases are examined here as
the audit does it. A plan that exceeds a limit is made again from finer intervals, and in the end
without refinement.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cnc.path.kernels.curve import Pieces
from cnc.planner.audit import TOLERANCE, largest_values, values_allowed
from cnc.planner.kernels.arrays import Phases, PlanArrays, phase_at
from cnc.planner.kernels.audit import audit_phases
from cnc.planner.kernels.intervals import Intervals
from cnc.planner.kernels.lookahead import PLANNED
from cnc.planner.known_path import KnownPath, Section
from cnc.planner.limits import Limits
from cnc.planner.phases import cut_at_length, plan_to_rest
from cnc.planner.work import Work

PLANNED_INTERVAL = 0.2e-6
"""s; computing time of a plan by its intervals."""

ACCEPTED = 0.5 * TOLERANCE
"""Relative; an accepted plan may exceed a limit by this, where the audit allows twice as much."""


def accepted_plan(
    path: KnownPath, start: float, goal: float, v_start: float, work: Work | None
) -> tuple[int, Phases, Intervals]:
    """Plan from ``start`` to rest at ``goal``, with intervals that are fine enough.

    Args:
        path: the known path; sections of it may be cut into finer intervals.
        start: arc length, mm.
        goal: arc length of the rest.
        v_start: speed at the start, mm/s.
        work: computing time for refinements; None for none.

    Returns:
        The status and the phases of :func:`cnc.planner.phases.plan_to_rest`, and the intervals.
    """
    limits = path.limits
    while True:
        intervals = path.intervals(limits, start, goal)
        if v_start == 0.0:
            intervals = open_at_start(intervals)
        if work is not None:
            work.left -= PLANNED_INTERVAL * len(intervals.end)
        status, phases = plan_to_rest(start, intervals, v_start, limits, work=work)
        if status != PLANNED:
            return status, phases, intervals
        exceeding = exceeding_sections(path, phases, intervals)
        if not exceeding:
            return status, phases, intervals
        finer = [section.cut_finer(limits) for section in exceeding]
        if not any(finer):
            status, phases = plan_to_rest(start, intervals, v_start, limits)
            return status, phases, intervals


def open_at_start(intervals: Intervals) -> Intervals:
    """Return intervals that a motion from rest can cross.

    A motion that rested in a stretch of constant speed has to speed up there. It keeps below the
    speed of the stretch, so it jumps by less at the junction.
    """
    level = intervals.flat & (intervals.speed > 0.0)
    if not level[0]:
        return intervals
    lead = len(level) if level.all() else int(np.argmin(level))
    flat, top = intervals.flat.copy(), intervals.top.copy()
    flat[:lead] = False
    top[:lead] = np.minimum(top[:lead], intervals.speed[:lead])
    return intervals._replace(flat=flat, top=top)


def exceeding_sections(path: KnownPath, phases: Phases, intervals: Intervals) -> list[Section]:
    """Return the sections of a path on which a plan over ``intervals`` exceeds a limit."""
    fast = beyond_samples(phases, intervals)
    if not fast.any():
        return []
    start = phases["s"]
    exceeding = []
    for section in path.sections:
        first = max(int(np.searchsorted(start, section.base, side="right")) - 1, 0)
        last = int(np.searchsorted(start, section.end))
        if fast[first:last].any():
            runs = np.flatnonzero(np.diff(fast[first:last], prepend=False, append=False))
            for low, high in (first + runs).reshape(-1, 2).tolist():
                if exceeds_limits(phases[low:high], section, path.limits):
                    exceeding.append(section)
                    break
    return exceeding


def beyond_samples(phases: Phases, intervals: Intervals) -> NDArray[np.bool_]:
    """Return which phases are faster somewhere than the samples of their intervals allow for."""
    duration, s, v, a, j = (phases[name] for name in ("duration", "s", "v", "a", "j"))
    fastest = np.maximum(v, v + duration * (a + 0.5 * duration * j))
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = a * j < 0.0
        fastest = np.where(turns, np.maximum(fastest, v - 0.5 * a * a / j), fastest)
    first = np.searchsorted(intervals.end, s, side="right")
    last = np.append(np.searchsorted(intervals.end, s[1:]), len(intervals.end) - 1)
    ranges = np.stack((first, np.maximum(last, first) + 1), axis=1)
    reliable = np.append(intervals.reliable, (np.inf, np.inf))
    lowest = np.minimum.reduceat(reliable, np.minimum(ranges, len(reliable) - 1).reshape(-1))[::2]
    return np.asarray(fastest > lowest)


def exceeds_limits(phases: Phases, section: Section, limits: Limits) -> bool:
    """Return whether phases that follow each other exceed a limit on a section of the path."""
    part = phases.copy()
    end = min(phase_at(*part[-1].tolist())[0], section.end)
    if part[0]["s"] < section.base:
        part = cut_at_length(part, section.base)[1]
    if len(part):
        part = cut_at_length(part, end)[0]
    if not len(part):
        return False
    _, v, a = phase_at(*part[-1].tolist())
    path = section.stretch.path
    values = np.zeros_like(values_allowed(limits))
    audit_phases(
        Pieces(path.kind, path.at, path.data),
        PlanArrays(
            section.piece_s,
            np.concatenate(([0.0], np.cumsum(part["duration"]))),
            np.append(part["s"], end) - section.base,
            np.append(part["v"], v),
            np.append(part["a"], a),
            part["j"].copy(),
        ),
        np.full(len(path), np.inf),
        limits.period,
        largest_values(values),
    )
    return not bool((values <= values_allowed(limits) * (1.0 + ACCEPTED)).all())
