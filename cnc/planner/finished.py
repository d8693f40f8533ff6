"""Finished parts of a plan, which are handed out in slices.

      handed out │ finished, in slices │ held back by corners │ window
                 │<-- part -->|<- part ->│
                 │  chain
               here

A part is a plan with motions past its corners, in which nothing changes by itself any more. But a
hold or an override may begin where the next slice does. If a motion past a chain of corners is
under way there, they change it, or begin at its end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import interpreted
from cnc.planner.audit import Audit
from cnc.planner.corners import path_arrays
from cnc.planner.kernels.corner_legs import LEG_STEPS
from cnc.planner.kernels.corner_places import leaves_path
from cnc.planner.kernels.timed import is_timed
from cnc.planner.phases import INSTANT
from cnc.planner.plan import (
    SAME,
    PlanChunk,
    cut_at_time,
    first_piece,
    joined_plans,
    part,
    with_own_end,
)

_is_timed = interpreted(is_timed)

BESIDE = 4.0 * INSTANT
"""s; a slice does not end so near to the end of a phase, but at it."""


SHORT = 1e-3
"""s; inside of a chain, a stop does not begin so close to the end of a step, but at it."""


class PassedChain(NamedTuple):
    """The motion past a chain of corners in a part.

    Attributes:
        begin: its time in the part, s.
        end: the time of its end in the part.
        stops_begin: the time of its begin in the plan with stops, s since the start of the program.
        stops_end: the time of its end in the plan with stops.
    """

    begin: float
    end: float
    stops_begin: float
    stops_end: float


class ChainLeft(NamedTuple):
    """The rest of a motion past a chain of corners.

    Attributes:
        plan: the motion from here on, over timed pieces.
        legs: the number of legs of the whole chain.
        leg: the leg that is under way.
    """

    plan: PlanChunk
    legs: int
    leg: int


@dataclass(frozen=True, slots=True)
class FinishedPart:
    """A part of the plan, with motions past corners.

    Attributes:
        plan: the part.
        chains: the motions past corners in it.
        stops_from: the time of its start in the plan with stops, s since the start of the program.
        shared: whether its first leg begins with a corner that is passed.
        audit: the audit as it was before the part.
    """

    plan: PlanChunk
    chains: tuple[PassedChain, ...]
    stops_from: float
    shared: bool
    audit: Audit


@dataclass(frozen=True, slots=True)
class Return:
    """A place in the finished motion from which on it may change.

    Attributes:
        stops_time: its time in the plan with stops, s since the start of the program. For a place
            inside a chain, that of the chain's begin.
        time: its time in the finished plan, s since the start of the program.
        length: path length there, mm.
        shared: whether the leg there begins with a corner that is passed.
        audit: the audit as it is there.
        left: the motion past corners that is left from there on; None outside of a chain.
    """

    stops_time: float
    time: float
    length: float
    shared: bool
    audit: Audit
    left: ChainLeft | None


class Finished:
    """The finished parts that are not handed out."""

    def __init__(self) -> None:
        self._parts: deque[FinishedPart] = deque()
        self._done = 0.0
        """Time of the first part that is handed out, s."""

    def __bool__(self) -> bool:
        return len(self._parts) > 0

    def add(self, parts: Iterable[FinishedPart]) -> None:
        """Append parts."""
        self._parts.extend(parts)

    def take(self, seconds: float) -> PlanChunk:
        """Return the next slice, of about ``seconds`` and within one part."""
        first = self._parts[0]
        begin, end = self._done, min(self._done + seconds, first.plan.duration)
        if end < first.plan.duration:
            # The window can return to an end of a phase, but not to a time just beside it.
            t = first.plan.phase_t
            nearest = float(t[np.argmin(np.abs(t - end))])
            end = nearest if nearest > begin and abs(nearest - end) < BESIDE else end
        self._done = end
        if end > first.plan.duration - SAME:
            self._parts.popleft()
            self._done = 0.0
        return _between(first.plan, begin, end)

    @property
    def chain_left(self) -> float:
        """Time from here to the end of the chain of corners that is under way, s; 0 for none."""
        chain = self._chain_under_way() if self._parts else None
        return 0.0 if chain is None else chain.end - self._done

    @property
    def stops_time(self) -> float | None:
        """The earliest time of :meth:`back` in the plan with stops; None if nothing is left."""
        if not self._parts:
            return None
        chain = self._chain_under_way()
        return self._stops_time(self._done) if chain is None else chain.stops_begin

    def back(self, *, inside: bool) -> tuple[Return, Finished] | None:
        """Return the place from which on the motion may change, and the parts up to there.

        Args:
            inside: whether it may lie inside of a chain of corners. Otherwise it is its end.

        Returns:
            None if that is beyond the end of the chain. There is no return into the parts up to
            there: the window is behind them.
        """
        first, chain = self._parts[0], self._chain_under_way()
        plan, time, left = first.plan, self._done, None
        if chain is not None and inside:
            t = plan.phase_t
            here = int(np.searchsorted(t, time + SAME, side="right"))
            if t[here] - time < SHORT:
                time = float(t[here])
            if time > chain.end - SAME:
                return None
            left = _chain_left(plan, chain, time)
        elif chain is not None:
            time = chain.end
        kept = Finished()
        if time > self._done + SAME:
            kept._done = self._done
            kept._parts.append(
                replace(
                    first,
                    plan=_between(plan, 0.0, time),
                    chains=tuple(past for past in first.chains if past.end <= time),
                )
            )
        audit = first.audit.copy()
        if time > SAME and audit.examined(_between(plan, 0.0, time))[0]:
            return None
        phase, cut = cut_at_time(plan, time)
        back = Return(
            stops_time=chain.stops_begin if chain and left else self._stops_time(time),
            time=plan.t0 + time,
            length=plan.s0 + float(cut.phase_s[phase]),
            shared=left is None and self._shared(first, first_piece(cut, phase)),
            audit=audit,
            left=left,
        )
        return back, kept

    def with_rest(self, rest: PlanChunk) -> Finished:
        """Return the parts up to the end of the chain under way, which ends with another motion.

        ``rest``: the motion over the same pieces, from the place that :meth:`back` returned.
        """
        first, chain = self._parts[0], self._chain_under_way()
        plan = joined_plans(_between(first.plan, 0.0, rest.t0 - first.plan.t0), rest)
        chains = tuple(
            past._replace(end=plan.duration) if past == chain else past
            for past in first.chains
            if chain is None or past.end <= chain.end
        )
        kept = Finished()
        kept._done = self._done
        kept._parts.append(replace(first, plan=plan, chains=chains))
        return kept

    def _chain_under_way(self) -> PassedChain | None:
        """Return the motion past corners in which the next slice begins."""
        for chain in self._parts[0].chains:
            if chain.begin + SAME < self._done < chain.end - SAME:
                return chain
        return None

    def _stops_time(self, time: float) -> float:
        """Return the time in the plan with stops for a place in the first part outside chains."""
        first = self._parts[0]
        begin, stops = 0.0, first.stops_from
        for chain in first.chains:
            if time >= chain.end - SAME:
                begin, stops = chain.end, chain.stops_end
        return stops + (time - begin)

    @staticmethod
    def _shared(whole: FinishedPart, piece: int) -> bool:
        """Return whether a piece of a part begins with a corner that is passed."""
        path = whole.plan.path
        if piece == 0:
            return whole.shared
        timed = _is_timed(int(path.kind[piece - 1]), path.data, int(path.at[piece - 1]))
        return timed or bool(leaves_path(path_arrays(path), piece - 1))


def _chain_left(plan: PlanChunk, chain: PassedChain, time: float) -> ChainLeft:
    """Return the rest of a chain from a time on."""
    left = _between(plan, time, chain.end)
    legs = round(len(_between(plan, chain.begin, chain.end).path) / LEG_STEPS)
    return ChainLeft(left, legs, legs - -(-len(left.path) // LEG_STEPS))


def _between(plan: PlanChunk, begin: float, end: float) -> PlanChunk:
    """Return a plan from one time to another, s."""
    if begin <= SAME and end >= plan.duration - SAME:
        return plan
    first, plan = cut_at_time(plan, begin)
    last, plan = cut_at_time(plan, end)
    return with_own_end(part(plan, first, last))
