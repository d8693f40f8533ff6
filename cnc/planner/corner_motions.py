r"""Motions past corners in finished plans (:mod:`cnc.planner.kernels.corner_stops`).

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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.path.kernels.curve import LINE, SPAN
from cnc.planner.audit import Audit
from cnc.planner.corners import empty_path, new_chunk, numbered, path_arrays
from cnc.planner.finished import FinishedPart, PassedChain
from cnc.planner.kernels.corner_places import count_corners, first_undecided, leaves_path
from cnc.planner.kernels.corner_search import Solutions, new_solutions
from cnc.planner.kernels.corner_stops import (
    CORNER_STEPS,
    Before,
    PassedChains,
    corner_size,
    pass_corners,
)
from cnc.planner.kernels.legs import REST
from cnc.planner.limits import Limits
from cnc.planner.plan import (
    SAME,
    PlanChunk,
    cut_at_time,
    empty_plan,
    first_piece,
    joined_plans,
    part,
    with_own_end,
)
from cnc.planner.work import Work


class CornerMotions:
    """Replaces stops on corners by faster motions, in plans in the order in which they run.

    All plans behind a corner begin earlier. Every plan is audited. Corners at which the audit
    refuses such a motion stay stops.
    """

    def __init__(
        self,
        limits: Limits,
        audit: Audit,
        work: Work | None = None,
        solutions: Solutions | None = None,
    ) -> None:
        """Create the stage behind the window.

        ``audit`` checks its results. ``work``: computing time for searches. ``solutions``: of
        searches with the same limits and the same ``work``.
        """
        self._work = Work() if work is None else work
        self._limits = limits
        self._audit = audit
        self._solutions = new_solutions(self._work.left) if solutions is None else solutions
        self._held: PlanChunk | None = None
        self._shared = False
        """Whether the next part begins on a leg that begins with a corner that is passed."""
        self._chains_until = 0.0
        """Time in the plans at which the last chain of corners ends, s."""
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

    def go_on(self, time: float, earlier: float, shorter: float, *, shared: bool) -> bool:
        """Go on with another plan instead of the motion behind a place.

        Args:
            time: of the plans at which that one begins, s.
            earlier: time by which that plan begins earlier, s.
            shorter: length by which its coordinates are smaller, mm.
            shared: whether its first leg begins with a corner that is passed.

        Returns:
            True: it needs no motion before that time.
        """
        self._held = None
        self._earlier, self._shorter, self._shared = earlier, shorter, shared
        return True

    def copy(self, audit: Audit, *, searches: bool = True) -> CornerMotions:
        """Return a stage that goes on independently from the same state, with another audit.

        ``searches``: whether it searches for motions, or keeps all stops.
        """
        other = copy(self)
        other._audit, other._searches = audit, searches
        return other

    def passed(self, plans: Iterable[PlanChunk]) -> Iterator[FinishedPart]:
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
                yield self._as_planned(plan)
                continue
            self._held = None
            whole = plan if held is None else joined_plans(held, plan)
            kept, whole = self._decided(whole)
            if kept < len(whole.phase_j):
                self._held = part(whole, kept, len(whole.phase_j))
            if kept > 0:
                decided = self._past_corners(part(whole, 0, kept))
                piece = first_piece(whole, kept)
                if piece > 0:
                    self._shared = bool(leaves_path(path_arrays(whole.path), piece - 1))
                yield decided

    def flush(self) -> Iterator[FinishedPart]:
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

    def _as_planned(self, plan: PlanChunk) -> FinishedPart:
        """Return a part of the plan with its stops."""
        moved = self._moved(plan)
        broken, before = self._audit.examined(moved)
        if broken:
            raise self._audit.refusal(moved, broken)
        return FinishedPart(moved, (), plan.t0, self._shared, before)

    def _decided(self, plan: PlanChunk) -> tuple[int, PlanChunk]:
        """Return the number of phases that no later plan can change, and the plan cut there."""
        path, bound = path_arrays(plan.path), self._limits.feeds(plan.path)
        time = first_undecided(path, plan.arrays, self._shared, bound, self._limits.arrays)
        return cut_at_time(plan, time)

    def _past_corners(self, plan: PlanChunk) -> FinishedPart:
        """Return the plan with motions past its corners, or with stops where those are illegal."""
        while (without := self._without_stops(plan)) is not None:
            cut = without.plan
            broken, before = self._audit.examined(cut)
            if not broken:
                self._chains_until = plan.t0 + plan.duration - without.alone
                self._earlier += plan.duration - cut.duration
                self._shorter += float(plan.phase_s[-1] - cut.phase_s[-1])
                return FinishedPart(cut, without.chains, plan.t0, self._shared, before)
            stops = self._refused(plan, cut, without.origin)
            plan = replace(
                plan, path=replace(plan.path, tolerance=np.where(stops, 0.0, plan.path.tolerance))
            )
        return self._as_planned(plan)

    def _refused(
        self, plan: PlanChunk, cut: PlanChunk, origin: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return whether the corner behind each piece of a plan shall stay a stop.

        They are those of the motions past corners that the audit refuses.

        Args:
            plan: with stops.
            cut: with motions past them, which the audit refuses.
            origin: the piece of ``plan`` of which each piece of ``cut`` was made.
        """
        audit = self._audit.copy()
        timed = (cut.path.kind == SPAN) & (plan.path.kind[origin] == LINE)
        ends = np.flatnonzero(timed & ~np.append(timed[1:], False)) + 1
        stops = np.zeros(len(plan.path), np.bool_)
        begin_piece = first_phase = 0
        for end in ends.tolist():
            phase = int(np.searchsorted(cut.phase_s, cut.piece_s[end] - REST)) + 1
            legs = origin[begin_piece:end][timed[begin_piece:end]]
            own = with_own_end(part(cut, first_phase, phase))
            if audit.examined(own)[0]:
                stops[legs.min() : legs.max()] = True
                audit.leave_out(own)
            begin_piece, first_phase = end, phase
        return stops if stops.any() else ~stops

    def _without_stops(self, plan: PlanChunk) -> _Passing | None:
        """Return the plan with motions past its corners; None if there are none."""
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
        out_plan = empty_plan(most, phases)
        chains = PassedChains(np.empty(corners), np.empty(corners), np.empty(corners))
        with self._work.ahead(plan.duration):
            count, spans, numbers, passed, alone = pass_corners(
                path,
                plan.arrays,
                Before(self._shared, max(plan.t0 - self._chains_until, 0.0)),
                limits.feeds(plan.path),
                limits.arrays,
                limits.travel,
                self._solutions,
                out,
                out_plan,
                chains,
            )
        if not passed:
            self._chains_until = plan.t0 + plan.duration - alone
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
        begin, end, earlier = (times[:passed] for times in chains)
        before = np.concatenate(([0.0], earlier[:-1]))
        in_stops = (plan.t0 + begin, plan.t0 + end)
        motions = zip(begin - before, end - earlier, *in_stops, strict=True)
        passed_chains = tuple(PassedChain(*map(float, m)) for m in motions)
        return _Passing(cut, out.line[:count], passed_chains, alone)


class _Passing(NamedTuple):
    """A plan with motions past its corners.

    Attributes:
        plan: the plan.
        origin: the piece of the plan with stops of which each piece was made.
        chains: the motions past corners.
        alone: time from the end of the last chain of corners to the end of the plan, s.
    """

    plan: PlanChunk
    origin: NDArray[np.int32]
    chains: tuple[PassedChain, ...]
    alone: float
