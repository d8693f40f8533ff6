r"""Motions past corners in finished plans (:mod:`cnc.kernels.planner.corner_stops`).

A plan may end anywhere, so the part that the next plan may still change is held back: from the
place on at which the motion past a chain of corners may begin, until its end is known.

        v |``\            ,--
          |   \         ,'
          |    `.     ,'             sent on | held back ...
          |______`-.,'______ t
                   |
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import LINE, SPAN
from cnc.kernels.path.pieces import Pieces
from cnc.kernels.planner.corner_known import new_known
from cnc.kernels.planner.corner_places import count_corners, first_undecided, leaves_path, state_at
from cnc.kernels.planner.corner_stops import CORNER_STEPS, corner_size, pass_corners
from cnc.kernels.planner.legs import REST, record_end
from cnc.kernels.planner.plan_arrays import PlanArrays
from cnc.model.motion_commands import joined
from cnc.path.chunk import PathChunk
from cnc.planner.audit import Audit
from cnc.planner.corners import empty_path, new_chunk, numbered, path_arrays
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk

Floats = NDArray[np.float64]

SAME = 1e-9
"""s; there is no rest between plans if their times differ by no more. Times are sums of floats."""


class CornerMotions:
    """Replaces stops on corners by faster motions, in plans in the order in which they run.

    All plans behind a corner begin earlier. Every plan is audited. Corners at which the audit
    refuses such a motion stay stops.
    """

    def __init__(self, limits: Limits, audit: Audit) -> None:
        """Create the stage behind the window; ``audit`` checks its results."""
        self._limits = limits
        self._audit = audit
        self._known = new_known()
        self._held: PlanChunk | None = None
        self._shared = False
        """Whether the next part begins on a leg that begins with a corner that is passed."""
        self._searches = True
        self._earlier = 0.0
        self._shorter = 0.0

    @property
    def held_from(self) -> float | None:
        """Time in the plans from which on their motion is held back, s; None for none."""
        return None if self._held is None else self._held.t0

    def drop(self) -> None:
        """Forget the part that is held back: another one follows in its place."""
        self._held = None

    def copy(self, audit: Audit, *, searches: bool = True) -> CornerMotions:
        """Return a stage that goes on independently from the same state, with another audit.

        ``searches``: whether it searches for motions, or keeps all stops.
        """
        other = copy(self)
        other._audit, other._searches = audit, searches
        return other

    def passed(self, plans: Iterable[PlanChunk]) -> Iterator[PlanChunk]:
        """Yield the parts of the plans that no later plan can change.

        Raises:
            MotionLimitError: ``plan-illegal`` where a plan breaks a limit with stops too.
        """
        for plan in plans:
            held = self._held
            if held is not None and (
                plan.t0 > held.t0 + held.duration + SAME or plan.path.file != held.path.file
            ):
                yield from self.flush()
                held = None
            if held is None and not plan.path.tolerance.any():
                yield self._audited(self._moved(plan))
                continue
            self._held = None
            whole = plan if held is None else _joined(held, plan)
            kept, whole = self._decided(whole)
            if kept < len(whole.phase_j):
                self._held = _part(whole, kept, len(whole.phase_j))
            if kept > 0:
                decided, piece = (
                    self._past_corners(_part(whole, 0, kept)),
                    _first_piece(whole, kept),
                )
                if piece > 0:
                    self._shared = bool(leaves_path(path_arrays(whole.path), piece - 1))
                yield decided

    def flush(self) -> Iterator[PlanChunk]:
        """Yield the part that was held back: the motion rests at its end, or nothing follows."""
        held, self._held = self._held, None
        if held is not None:
            yield self._past_corners(held)
        self._shared = False

    def _moved(self, plan: PlanChunk) -> PlanChunk:
        """Return the plan at its new time."""
        if not self._earlier:
            return plan
        return replace(plan, t0=plan.t0 - self._earlier, s0=plan.s0 - self._shorter)

    def _audited(self, plan: PlanChunk) -> PlanChunk:
        """Return the plan, if it is legal."""
        self._audit.check(plan)
        return plan

    def _decided(self, plan: PlanChunk) -> tuple[int, PlanChunk]:
        """Return the number of phases that no later plan can change, and the plan cut there."""
        path, bound = path_arrays(plan.path), self._limits.feeds(plan.path)
        time = first_undecided(path, plan.arrays, self._shared, bound, self._limits.arrays)
        return _cut(plan, time)

    def _past_corners(self, plan: PlanChunk) -> PlanChunk:
        """Return the plan with motions past its corners, or with stops where those are illegal."""
        while (found := self._without_stops(plan)) is not None:
            cut, origin = found
            if not self._audit.broken(cut):
                self._earlier += plan.duration - cut.duration
                self._shorter += float(plan.phase_s[-1] - cut.phase_s[-1])
                return cut
            stops = self._refused(plan, cut, origin)
            plan = replace(
                plan, path=replace(plan.path, tolerance=np.where(stops, 0.0, plan.path.tolerance))
            )
        return self._audited(self._moved(plan))

    def _refused(
        self, plan: PlanChunk, cut: PlanChunk, origin: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return whether the corner behind each piece of a plan shall stay a stop.

        They are those of the first motion past corners that the audit refuses.

        Args:
            plan: with stops.
            cut: with motions past them, which the audit refuses.
            origin: the piece of ``plan`` of which each piece of ``cut`` was made.
        """
        audit = self._audit.copy()
        timed = (cut.path.kind == SPAN) & (plan.path.kind[origin] == LINE)
        ends = np.flatnonzero(timed & ~np.append(timed[1:], False)) + 1
        stops = np.zeros(len(plan.path), np.bool_)
        first_piece = first_phase = 0
        for end in ends.tolist():
            phase = int(np.searchsorted(cut.phase_s, cut.piece_s[end] - REST)) + 1
            legs = origin[first_piece:end][timed[first_piece:end]]
            if audit.broken(_with_end(_part(cut, first_phase, phase))):
                stops[legs.min() : legs.max()] = True
                return stops
            first_piece, first_phase = end, phase
        stops[:] = True
        return stops

    def _without_stops(self, plan: PlanChunk) -> tuple[PlanChunk, NDArray[np.int32]] | None:
        """Return the plan with motions past its corners, and the piece of which each was made.

        It is None if there are no such motions.
        """
        path, limits = numbered(plan.path), self._limits
        pieces, axes = len(plan.path), len(plan.path.axes)
        corners = count_corners(path, plan.arrays) if self._searches else 0
        if not corners:
            return None
        most, phases = (
            pieces + (CORNER_STEPS + 1) * corners,
            len(plan.phase_j) + (CORNER_STEPS + 2) * corners,
        )
        out = empty_path(most, len(plan.path.data) + (corners + 1) * corner_size(axes))
        out_plan = _empty_plan(most, phases)
        count, spans, numbers, passed = pass_corners(
            path,
            plan.arrays,
            self._shared,
            limits.feeds(plan.path),
            limits.arrays,
            limits.travel,
            self._known,
            out,
            out_plan,
        )
        if not passed:
            return None
        moved = self._moved(plan)
        cut = PlanChunk(
            path=new_chunk(plan.path, out, count, numbers),
            piece_s=out_plan.piece_s[: count + 1],
            t0=moved.t0,
            s0=moved.s0,
            phase_t=out_plan.t[: spans + 1],
            phase_s=out_plan.s[: spans + 1],
            phase_v=out_plan.v[: spans + 1],
            phase_a=out_plan.a[: spans + 1],
            phase_j=out_plan.j[:spans],
        )
        return cut, out.line[:count]


def _empty_plan(pieces: int, phases: int) -> PlanArrays:
    """Return space for a plan over so many pieces, with so many phases."""
    return PlanArrays(
        np.empty(pieces + 1),
        np.empty(phases + 1),
        np.empty(phases + 1),
        np.empty(phases + 1),
        np.empty(phases + 1),
        np.empty(phases),
    )


def _cut(plan: PlanChunk, time: float) -> tuple[int, PlanChunk]:
    """Return the number of phases before a time, and the plan with an end of a phase there."""
    t = plan.phase_t
    k = int(np.searchsorted(t, time - SAME))
    if k >= len(t) or abs(float(t[k]) - time) <= SAME:
        return min(k, len(t) - 1), plan
    s, v, a = state_at(time, k - 1, plan.arrays)
    return k, replace(
        plan,
        phase_t=np.insert(t, k, time),
        phase_s=np.insert(plan.phase_s, k, s),
        phase_v=np.insert(plan.phase_v, k, v),
        phase_a=np.insert(plan.phase_a, k, a),
        phase_j=np.insert(plan.phase_j, k, plan.phase_j[k - 1]),
    )


def _first_piece(plan: PlanChunk, phase: int) -> int:
    """Return the piece on which a phase begins; the number of pieces for the end of the plan."""
    at = plan.phase_s[phase] + REST
    return max(int(np.searchsorted(plan.piece_s, at, side="right")) - 1, 0)


def _part(plan: PlanChunk, first: int, end: int) -> PlanChunk:
    """Return the phases first .. end - 1 of a plan, over the pieces that they touch."""
    if end - first == len(plan.phase_j):
        return plan
    piece_s = plan.piece_s
    begin = _first_piece(plan, first)
    after = max(int(np.searchsorted(piece_s, plan.phase_s[end] - REST, side="left")), begin + 1)
    zero = float(piece_s[begin])
    span = slice(first, end + 1)
    return PlanChunk(
        path=plan.path.part(begin, after),
        piece_s=piece_s[begin : after + 1] - zero,
        t0=plan.t0 + float(plan.phase_t[first]),
        s0=plan.s0 + zero,
        phase_t=plan.phase_t[span] - plan.phase_t[first],
        phase_s=plan.phase_s[span] - zero,
        phase_v=plan.phase_v[span],
        phase_a=plan.phase_a[span],
        phase_j=plan.phase_j[first:end],
    )


def _with_end(plan: PlanChunk) -> PlanChunk:
    """Return a part of a plan that ends with the speed of its own last phase.

    Where a timed piece follows, the coordinate of the plan has another speed there.
    """
    last = len(plan.phase_j) - 1
    _, v, a = state_at(float(plan.phase_t[-1]), last, plan.arrays)
    return replace(
        plan, phase_v=np.append(plan.phase_v[:-1], v), phase_a=np.append(plan.phase_a[:-1], a)
    )


def _joined(before: PlanChunk, after: PlanChunk) -> PlanChunk:
    """Return two plans that follow each other as one.

    A phase or a piece that continues from one to the other becomes one. Where the operator has
    changed the feed within a piece, the higher one counts for all of it.
    """
    a, b = before.path, after.path
    pieces = slice(0, len(a) - 1 if after.phase_s[0] > REST else len(a))
    data, at = _records(a)
    more, at_more = _records(b)
    s = after.s0 - before.s0
    t = after.t0 - before.t0
    same = (
        before.phase_j[-1] == after.phase_j[0]
        and abs(before.phase_a[-1] - after.phase_a[0]) <= REST
        and after.phase_v[0] > 0.0
    )
    feed = np.concatenate((a.feed[pieces], b.feed))
    if len(feed) < len(a) + len(b):
        feed[len(a) - 1] = max(a.feed[-1], b.feed[0])
    phases = slice(0, len(before.phase_j) - 1 if same else len(before.phase_j))
    rest = slice(1 if same else 0, None)
    return PlanChunk(
        path=PathChunk(
            a.axes,
            b.file,
            np.concatenate((a.kind[pieces], b.kind)),
            np.concatenate((at[pieces], at_more + len(data))),
            np.concatenate((data, more)),
            np.concatenate((a.length[pieces], b.length)),
            feed,
            np.concatenate((a.line[pieces], b.line)),
            np.concatenate((a.stop_after[pieces], b.stop_after)),
            np.concatenate((a.tolerance[pieces], b.tolerance)),
            joined(
                (
                    (None if a.commands is None else a.commands[pieces], len(a.kind[pieces])),
                    (b.commands, len(b)),
                )
            ),
            b.timed,
        ),
        piece_s=np.concatenate((before.piece_s[pieces], after.piece_s + s)),
        t0=before.t0,
        s0=before.s0,
        phase_t=np.concatenate((before.phase_t[:-1], after.phase_t[rest] + t)),
        phase_s=np.concatenate((before.phase_s[:-1], after.phase_s[rest] + s)),
        phase_v=np.concatenate((before.phase_v[:-1], after.phase_v[rest])),
        phase_a=np.concatenate((before.phase_a[:-1], after.phase_a[rest])),
        phase_j=np.concatenate((before.phase_j[phases], after.phase_j)),
    )


def _records(path: PathChunk) -> tuple[Floats, NDArray[np.int64]]:
    """Return the records of these pieces alone, and the index of each."""
    pieces = Pieces(path.kind, path.at, path.data)
    lowest = int(path.at.min())
    end = max(record_end(pieces, k) for k in {len(path) - 1, int(np.argmax(path.at))})
    return path.data[lowest:end], path.at - lowest
