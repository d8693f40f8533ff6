"""Plans of a window as arrays of phases: rows of duration, arc length, speed, acceleration and jerk
at the start of each.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.planner.lookahead import PLANNED, START_TOO_FAST, plan_window
from cnc.kernels.planner.refine import refine
from cnc.kernels.planner.scurve import phase_time
from cnc.planner.limits import Intervals, Limits

Floats = NDArray[np.float64]

DURATION, S, V, A, J = range(5)
"""Columns of an array of phases."""

TOUCHING = 1e-6
"""Relative: a speed this little below its bound is at it."""

ROUGHLY = 1.4
"""How much faster than usual a plan may be that is to be refined in any case."""

INSTANT = 1e-7
"""s; what would be left of a phase beside a cut at a time is not shorter."""


NO_PHASES: Floats = np.empty((0, 5))


def plan_to_rest(
    start: float, known: Intervals, v_start: float, limits: Limits, lead: Floats = NO_PHASES
) -> tuple[int, Floats]:
    """Plan from ``start``, where the motion has speed ``v_start``, to rest at the end of ``known``:
    the kernel's status and the phases.

    lead: phases that lead to the start, over the first of the intervals known, and become part of
    the plan. Where limits for each axis bind on a curve, the plan is refined. From a speed that the
    refinement has led to, or where the lead isn't legal, a plan may have to begin with one that
    only nearly keeps to the limits.
    """
    whole = known
    if len(lead):
        known = known.between(start, float(known.end[-1]))
    status, phases = _planned(start, known, v_start)
    rough = status == START_TOO_FAST
    if not limits.per_axis or not (rough or status == PLANNED):
        return (START_TOO_FAST if rises_above(lead, whole) else status), np.concatenate(
            (lead, phases)
        )
    if rough:
        freer = replace(
            known,
            speed=np.where(known.flat, known.speed, np.minimum(known.top, ROUGHLY * known.speed)),
            accel=np.maximum(known.accel, 0.5 * known.accel[:, -1:]),
            jerk=np.maximum(known.jerk, 0.5 * known.jerk[:, -1:]),
        )
        status, phases = _planned(start, freer, v_start)
        if status != PLANNED:
            return status, phases
    legal, phases = refine(
        np.concatenate((lead, phases)), whole.end, whole.top, whole.flat, whole.sampled, whole.samples,
        limits.axis_acceleration, limits.axis_jerk, limits.tangential_acceleration, limits.tangential_jerk, rough or len(lead) > 0,
    )  # fmt: skip
    return (PLANNED, phases) if legal else (START_TOO_FAST, phases[:0])


def _planned(start: float, known: Intervals, v_start: float) -> tuple[int, Floats]:
    """A plan from bounds that are constant on each interval."""
    phases = np.empty((8 * len(known) + 16, 5))
    bound_s = np.concatenate(([start], known.end))
    status, written = plan_window(
        bound_s, known.speed, known.accel, known.jerk, known.flat, v_start, phases
    )
    phases = phases[:written]
    return status, phases[phases[:, DURATION] > 0.0]


def rises_above(phases: Floats, known: Intervals) -> bool:
    """Whether the speed at the end of a phase is above the bounds of the intervals that the phase
    touches.
    """
    if not len(phases):
        return False
    s, v = np.append(phases[1:, S], end_of(phases)[0]), np.append(phases[1:, V], end_of(phases)[1])
    first = np.searchsorted(known.end, phases[:, S], side="right")
    last = np.minimum(np.searchsorted(known.end, s, side="left"), len(known) - 1)
    return any(
        v[k] > known.speed[first[k] : last[k] + 1].min(initial=np.inf) * (1.0 + TOUCHING)
        for k in range(len(phases))
    )


def first_steady(phases: Floats) -> int:
    """Number of phases up to the first point without acceleration after the start (or all: at
    rest).
    """
    steady = np.flatnonzero(phases[1:, A] == 0.0)
    return int(steady[0]) + 1 if len(steady) else len(phases)


def first_rest(phases: Floats) -> int:
    """Number of phases up to the first rest after the start."""
    rests = np.flatnonzero((phases[1:, V] == 0.0) & (phases[1:, A] == 0.0))
    return int(rests[0]) + 1 if len(rests) else len(phases)


def last_bound(phases: Floats, known: Intervals) -> float:
    """Arc length of the last place, from the plan's start on, where it is as fast as the path
    allows: behind it the coming rest shows.
    """
    place, v = phases[:, S], phases[:, V] * (1.0 + TOUCHING)
    before = np.minimum(np.searchsorted(known.end, place, side="left"), len(known) - 1)
    after = np.minimum(np.searchsorted(known.end, place, side="right"), len(known) - 1)
    touching = np.flatnonzero(
        (phases[:, A] == 0.0) & (v >= np.minimum(known.speed[before], known.speed[after]))
    )
    if not len(touching):
        return float(place[0])
    k = int(touching[-1])
    cruises = phases[k, J] == 0.0 and k + 1 < len(phases)
    return float(place[k + 1] if cruises else place[k])


def cut_steady(phases: Floats, limit: float) -> tuple[Floats, int]:
    """The phases, and how many of them lead to the last point without acceleration at or before arc
    length ``limit``.

    A cruise that passes ``limit`` is cut there.
    """
    k = int(np.searchsorted(phases[:, S], limit, side="right")) - 1
    if k >= 0 and phases[k, A] == 0.0 and phases[k, J] == 0.0 and phases[k, V] > 0.0:
        t = (limit - float(phases[k, S])) / float(phases[k, V])
        if INSTANT < t < phases[k, DURATION] - INSTANT:
            head, tail = cut_inside(phases, k, t)
            tail[0, S] = limit
            return np.concatenate((head, tail)), k + 1
    steady = np.flatnonzero(phases[: max(k, 0) + 1, A] == 0.0)
    return phases, int(steady[-1]) if len(steady) else 0


def cut_inside(phases: Floats, k: int, t: float) -> tuple[Floats, Floats]:
    """Phases up to ``t`` seconds into phase ``k`` and those after it; the array itself becomes the
    latter.
    """
    head = phases[: k + 1].copy()
    head[k, DURATION] = t
    s, v, a, j = head[k, S:].tolist()
    left = float(phases[k, DURATION]) - t
    phases[k] = (
        left,
        s + t * (v + t * (0.5 * a + t * j / 6.0)),
        v + t * (a + 0.5 * t * j),
        a + t * j,
        j,
    )
    return head, phases[k:]


def cut_at_length(phases: Floats, s: float) -> tuple[Floats, Floats]:
    """Phases before and after arc length ``s``; the array itself becomes the latter."""
    k = int(np.searchsorted(phases[:, S], s, side="right")) - 1
    duration, start, v, a, j = phases[k].tolist()
    t = phase_time(v, a, j, duration, s - start)
    if t <= 0.0:
        return phases[:k], phases[k:]
    if t >= duration:
        return phases[: k + 1], phases[k + 1 :]
    head, tail = cut_inside(phases, k, t)
    tail[0, S] = s
    return head, tail


def slice_end(phases: Floats, seconds: float, length: float) -> tuple[int, float]:
    """Where a slice ends that takes at least ``seconds`` and covers at least ``length``: whole
    phases, and seconds of the one after them.

    The first phase out of rest and the last one into it are left whole: with them moves may be
    overlapped at a corner.
    """
    rows = 64
    while True:
        part = phases[:rows]
        elapsed = np.cumsum(part[:, DURATION])
        near = (elapsed < seconds) | (np.append(part[1:, S], np.inf) - part[0, S] < length)
        k = int(np.count_nonzero(near))
        if k < len(part) - 1 or len(part) == len(phases):
            break
        rows *= 4
    if k >= len(phases) - 1:
        return len(phases), 0.0
    duration, s, v, a, j = part[k].tolist()
    if v == 0.0 or part[k + 1, V] == 0.0:
        return k + 1, 0.0
    t = seconds - (float(elapsed[k]) - duration)
    covered = float(part[0, S]) + length - s
    if covered > 0.0:
        t = max(t, phase_time(v, a, j, duration, covered))
    if t < INSTANT and k > 0:
        return k, 0.0
    return (k, t) if INSTANT <= t < duration - INSTANT else (k + 1, 0.0)


def release(phases: Floats) -> Floats | None:
    """The phase that lets go of the acceleration (> 0) at the start of ``phases``, at the jerk at
    which their ramp does so in the end.
    """
    falling = np.flatnonzero(phases[:, J] < 0.0)
    if not len(falling):
        return None
    _, s, v, a, _ = phases[0].tolist()
    j = float(phases[falling[0], J])
    return np.array([[-a / j, s, v, a, j]])


def end_of(phases: Floats) -> tuple[float, float]:
    """Arc length and speed at the end of the phases."""
    t, s, v, a, j = phases[-1].tolist()
    return s + t * (v + t * (0.5 * a + t * j / 6.0)), v + t * (a + 0.5 * t * j)
