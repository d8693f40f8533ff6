"""Look-ahead: a stream of path in, a stream of plans out, in one pass and with a window of bounded length.

The window holds the path that is known but not yet committed to. It is always planned to rest at its end, so whatever is committed can be
stopped within what is known. A stretch is committed once more path could hardly change it: when at least two stopping distances lie between
it and the window's end, or when the path comes to rest by itself.

      committed ─┤ window ├──────────────────────┤ not read yet
                 |  commit up to here |  >= 2 d   |            d = v/2 (v/A + A/J): stopping distance from the window's top speed
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from cnc.canon import Block, Dwell, Message, Probe
from cnc.errors import Diagnostic, MotionLimitError
from cnc.kernels.limits import LEVELS
from cnc.kernels.lookahead import PLANNED, START_TOO_FAST, plan_window
from cnc.kernels.scurve import phase_time
from cnc.machine.models import Machine
from cnc.path.chunk import PathChunk
from cnc.planner.audit import Audit
from cnc.planner.corners import Overlaps
from cnc.planner.limits import STANDSTILL, Intervals, Junction, Limits, intervals, junction_between
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

STOPS_KEPT = 2.0
"""Stopping distances left between what is committed and the end of what is known."""

SLICE = 0.5
"""s; motion is handed out in slices of about this, each ending without acceleration, so that a stop can be planned after any of them."""

SLICE_LENGTH = 0.01
"""mm; a crawl is not sliced finer than this."""

DURATION, S, V, A, J = range(5)
"""Columns of an array of phases."""


class LookAhead:
    """Plans a stream of path at a machine's limits.

    Every plan has passed :attr:`audit`, which keeps the largest values seen.
    """

    def __init__(self, machine: Machine) -> None:
        self.limits = Limits.of(machine)
        self.audit = Audit(self.limits)
        self._window = _Window(self.limits)
        self._overlaps = Overlaps(self.limits)

    def plan(self, stream: Iterable[PathChunk | Block]) -> Iterator[PlanChunk | Block]:
        """Yield plans for the path; blocks that aren't motion pass through in order, the motion before them at rest.

        A stretch of path that ends at rest is planned to its end before more of the stream is asked for: what follows a probe isn't known
        before it has been made.

        Raises:
            MotionLimitError: ``plan-illegal`` where a plan breaks a limit; it is not handed on.
        """
        window = self._window
        pending: PathChunk | None = None
        before = STANDSTILL
        probe: Probe | None = None
        for item in stream:
            if isinstance(item, PathChunk):
                if pending is not None:
                    junction = junction_between(pending, item, self.limits)
                    yield from self._finished(window.add(pending, before, junction))
                    before = junction
                pending = item
                if item.stop_after[-1]:
                    yield from self._finished(window.add(pending, before, STANDSTILL), at_rest=True)
                    pending, before = None, STANDSTILL
                    if probe is not None and probe.answer.values is not None:
                        self.audit.jump()
                    probe = None
                continue
            if pending is not None and not isinstance(item, Message):
                yield from self._finished(window.add(pending, before, STANDSTILL), at_rest=True)
                pending, before = None, STANDSTILL
            if isinstance(item, Dwell):
                window.clock += item.seconds
            probe = item if isinstance(item, Probe) else None
            yield item
        if pending is not None:
            yield from self._finished(window.add(pending, before, STANDSTILL), at_rest=True)

    def ramp_down(self) -> Iterator[PlanChunk]:
        """Come to rest on the path, soon after the last plan that was handed out; nothing can be planned after that."""
        yield from self._finished(self._window.ramp_down(), at_rest=True)

    def _finished(self, plans: Iterable[PlanChunk], *, at_rest: bool = False) -> Iterator[PlanChunk]:
        """Plans with their corners cut, audited. ``at_rest``: no motion follows on theirs."""
        yield from self.audit.passed(self._overlaps.passed(plans))
        if at_rest:
            yield from self.audit.passed(self._overlaps.flush())


NOTHING = Intervals(np.empty(0), np.empty(0), np.empty((0, LEVELS)), np.empty((0, LEVELS)), np.empty(0, np.bool_))


@dataclass(slots=True)
class _Section:
    """A chunk of path in the window: ``base`` is the window's arc length at its start, ``travelled`` the path length before it."""

    path: PathChunk
    piece_s: Floats
    intervals: Intervals
    base: float
    travelled: float

    @property
    def end(self) -> float:
        return self.base + float(self.piece_s[-1])


class _Window:
    """Path that is known and not committed to, from ``start`` on, where the motion has speed ``v_start`` and no acceleration.

    ``plan`` holds phases that are legal from there to rest at ``rest_at``; ``committed`` what is decided and not yet taken.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.clock = 0.0
        self.sections: deque[_Section] = deque()
        self.start = 0.0
        self.v_start = 0.0
        self.travelled = 0.0
        self.plan = np.empty((0, 5))
        self.rest_at = 0.0
        self.committed: deque[PlanChunk] = deque()

    def add(self, path: PathChunk, before: Junction, after: Junction) -> Iterator[PlanChunk]:
        """Take a chunk into the window and yield what can be committed."""
        piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
        base = self.sections[-1].end if self.sections else 0.0
        if not self.sections:
            self.start = 0.0
        self.sections.append(_Section(path, piece_s, intervals(path, self.limits, before, after), base, self.travelled))
        self.travelled += float(piece_s[-1])
        known = self._known()
        stops = np.flatnonzero(known.flat & (known.speed == 0.0))
        beyond = len(known.end) - 1 - int(stops[-1]) if len(stops) else len(known.end)
        if len(stops):
            yield from self._plan_and_commit(beyond, at_rest=True)
        # The motion can't come to rest on a stretch that asks for constant speed.
        steady = np.flatnonzero(~known.flat[len(known.end) - beyond :])
        if len(steady):
            yield from self._plan_and_commit(beyond - 1 - int(steady[-1]), at_rest=False)

    def ramp_down(self) -> Iterator[PlanChunk]:
        """What was committed and not yet taken, then a plan to rest within little more than the stopping distance."""
        yield from self._taken()
        known = self._known()
        if self.v_start == 0.0 or not len(known.end):
            return
        distance = _stopping_distance(known)
        while (stop := self.start + distance) < self.rest_at:
            count = int(np.searchsorted(known.end, stop)) + 1
            cut = Intervals(
                np.append(known.end[: count - 1], stop), known.speed[:count], known.accel[:count], known.jerk[:count], known.flat[:count]
            )
            status, phases = _phases(self.start, cut, self.v_start)
            if status == PLANNED and not known.flat[count - 1]:
                self.plan, self.rest_at = phases, stop
                break
            distance *= 1.5
        self._commit(len(self.plan))
        yield from self._taken()

    def _known(self, beyond: int = 0) -> Intervals:
        """The intervals not yet committed to but for the last ``beyond``, in the window's arc length."""
        if not self.sections:
            return NOTHING
        parts = [section.intervals for section in self.sections]
        end = np.concatenate([section.intervals.end + section.base for section in self.sections])
        first = int(np.searchsorted(end, self.start + _rounding(self.start), side="right"))
        wanted = slice(first, max(first, len(end) - beyond))
        return Intervals(
            end[wanted],
            np.concatenate([part.speed for part in parts])[wanted],
            np.concatenate([part.accel for part in parts])[wanted],
            np.concatenate([part.jerk for part in parts])[wanted],
            np.concatenate([part.flat for part in parts])[wanted],
        )

    def _plan_and_commit(self, beyond: int, *, at_rest: bool) -> Iterator[PlanChunk]:
        """Plan all but the last ``beyond`` known intervals to rest and commit: all where the path itself rests there, else what is safe."""
        known = self._known(beyond)
        if not len(known.end):
            return
        end = float(known.end[-1])
        commit_to = end
        if not at_rest:
            stopping = STOPS_KEPT * _stopping_distance(known)
            if end - self.start < 2.0 * stopping:
                return
            commit_to = end - stopping
        status, phases = _phases(self.start, known, self.v_start)
        if status == START_TOO_FAST and len(self.plan):
            # The plan made before the window grew is legal to its end: follow it to its next point without acceleration, and try again.
            self._commit(_first_steady(self.plan))
            yield from self._taken()
            yield from self._plan_and_commit(beyond, at_rest=at_rest)
            return
        if status != PLANNED:
            path = self.sections[0].path
            raise MotionLimitError(
                Diagnostic("plan-failed", "no motion within the machine's limits was found from here on", path.file, int(path.line[0]))
            )
        count = len(phases)
        if not at_rest:
            phases, count = _cut_steady(phases, commit_to)
        self.plan, self.rest_at = phases, end
        while count > 0:
            before = len(self.plan)
            self.plan, step = _slice(self.plan)
            count += len(self.plan) - before
            step = min(step, count)
            self._commit(step)
            count -= step
            yield from self._taken()

    def _commit(self, count: int) -> None:
        """Turn the first ``count`` phases of the plan into chunks, one a chunk of path; the others remain the plan."""
        reached, speed = (float(self.plan[count, S]), float(self.plan[count, V])) if count < len(self.plan) else (self.rest_at, 0.0)
        at_rest = count == len(self.plan)
        left = self.plan[:count]
        while len(left):
            section = self.sections[0]
            goal = section.end if section.end < reached - _rounding(reached) else reached
            here, left = _split(left, goal) if goal < reached else (left, left[:0])
            v_end, a_end = (float(left[0, V]), float(left[0, A])) if len(left) else (speed, 0.0)
            if len(here):
                self.committed.append(self._plan_chunk(section, here, goal, v_end, a_end))
            if goal >= section.end - _rounding(goal) and (at_rest or self.rest_at > section.end + _rounding(goal)):
                self.sections.popleft()
        self.start, self.v_start, self.plan = reached, speed, self.plan[count:]
        if self.sections:
            shift = self.sections[0].base
            for section in self.sections:
                section.base -= shift
            self.start -= shift
            self.rest_at -= shift
            self.plan[:, S] -= shift

    def _taken(self) -> Iterator[PlanChunk]:
        """Hand out what is committed."""
        while self.committed:
            yield self.committed.popleft()

    def _plan_chunk(self, section: _Section, phases: Floats, end: float, v_end: float, a_end: float) -> PlanChunk:
        """Phases over one section as a plan in that section's own arc length, over the pieces that it touches."""
        piece_s = section.piece_s
        local = phases[:, S] - section.base
        local_end = min(end - section.base, float(piece_s[-1]))
        first = max(int(np.searchsorted(piece_s, local[0], side="right")) - 1, 0)
        last = max(int(np.searchsorted(piece_s, local_end, side="left")), first + 1)
        zero = float(piece_s[first])
        path, touched = section.path, slice(first, last)
        t = np.concatenate(([0.0], np.cumsum(phases[:, DURATION])))
        chunk = PlanChunk(
            path=PathChunk(
                path.axes, path.file, path.kind[touched], path.at[touched], path.data,
                path.length[touched], path.feed[touched], path.line[touched], path.stop_after[touched],
                path.tolerance[touched],
            ),
            piece_s=piece_s[first : last + 1] - zero,
            t0=self.clock,
            s0=section.travelled + zero,
            phase_t=t,
            phase_s=np.append(local, local_end) - zero,
            phase_v=np.append(phases[:, V], v_end),
            phase_a=np.append(phases[:, A], a_end),
            phase_j=phases[:, J].copy(),
        )  # fmt: skip
        self.clock += float(t[-1])
        return chunk


def _phases(start: float, known: Intervals, v_start: float) -> tuple[int, Floats]:
    """Plan intervals to rest at their end: the kernel's status and the phases."""
    phases = np.empty((8 * len(known.end) + 16, 5))
    bound_s = np.concatenate(([start], known.end))
    status, written = plan_window(bound_s, known.speed, known.accel, known.jerk, known.flat, v_start, phases)
    phases = phases[:written]
    return status, phases[phases[:, DURATION] > 0.0]


def _rounding(s: float) -> float:
    """What rounding may do to an arc length in the window: it is rounded anew whenever the window moves on."""
    return 1e-12 + 8.0 * float(np.spacing(s))


def _stopping_distance(known: Intervals) -> float:
    """Length within which motion at the largest speed of these intervals comes to rest at the least of their bounds."""
    moving = known.speed > 0.0
    v, a, j = float(known.speed.max()), float(known.accel[moving, 0].min()), float(known.jerk[moving, 0].min())
    return 0.5 * v * (v / a + a / j) if v * j >= a * a else v * sqrt(v / j)


def _first_steady(phases: Floats) -> int:
    """Number of phases up to the first point without acceleration after the start (or all: at rest)."""
    steady = np.flatnonzero(phases[1:, A] == 0.0)
    return int(steady[0]) + 1 if len(steady) else len(phases)


def _slice(phases: Floats) -> tuple[Floats, int]:
    """The phases, and how many make a slice: up to the first point without acceleration after SLICE seconds; a cruise is cut there."""
    elapsed = np.cumsum(phases[:, DURATION])
    steady = (phases[:, A] == 0.0) & (elapsed >= SLICE)
    cruise = np.flatnonzero(steady & (phases[:, J] == 0.0))
    ends = np.flatnonzero(steady[1:] & (elapsed[:-1] >= SLICE))
    k = int(cruise[0]) if len(cruise) else len(phases)
    step = int(ends[0]) + 1 if len(ends) else len(phases)
    if k >= step:
        return phases, step
    cut = max(SLICE - (float(elapsed[k]) - float(phases[k, DURATION])), SLICE_LENGTH / float(phases[k, V]))
    if phases[k, DURATION] - cut < SLICE:
        return phases, step
    tail = phases[k:].copy()
    tail[0, DURATION] -= cut
    tail[0, S] += cut * tail[0, V]
    head = phases[: k + 1].copy()
    head[k, DURATION] = cut
    return np.concatenate((head, tail)), k + 1


def _cut_steady(phases: Floats, limit: float) -> tuple[Floats, int]:
    """The phases, and how many of them to commit: up to the last point without acceleration at or before ``limit``.

    A cruise that passes ``limit`` is cut there.
    """
    k = int(np.searchsorted(phases[:, S], limit, side="right")) - 1
    if k >= 0 and phases[k, A] == 0.0 and phases[k, J] == 0.0 and phases[k, V] > 0.0:
        covered = limit - phases[k, S]
        if covered <= 0.0:
            return phases, k
        cut = covered / phases[k, V]
        tail = phases[k].copy()
        tail[DURATION] -= cut
        tail[S] = limit
        head = phases[: k + 1].copy()
        head[k, DURATION] = cut
        return np.concatenate((head, tail[None], phases[k + 1 :])), k + 1
    steady = np.flatnonzero(phases[: k + 1, A] == 0.0)
    return phases, int(steady[-1]) if len(steady) else 0


def _split(phases: Floats, s: float) -> tuple[Floats, Floats]:
    """Phases before and after arc length ``s``, the one that passes it cut in two."""
    k = int(np.searchsorted(phases[:, S], s, side="right")) - 1
    duration, start, v, a, j = phases[k]
    dt = phase_time(v, a, j, duration, s - start)
    head = phases[: k + 1].copy()
    head[k, DURATION] = dt
    if dt <= 0.0:
        return phases[:k], phases[k:]
    tail = phases[k:].copy()
    tail[0] = (duration - dt, s, v + dt * (a + 0.5 * dt * j), a + dt * j, j)
    return head, tail if duration > dt else tail[1:]
