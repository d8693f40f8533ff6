r"""Motion that does not ring: the stage behind the window on a machine whose modes are known.

The motion from rest to rest is shaped as a whole (:mod:`cnc.planner.shaper`): arc length, not the
axes, so the path stays as it is.

       v |     ______ window            The shaped speed at a time is a mean of the speeds of the
         |    /  ,--- \ `. shaped       window at times before. So the motion rests later by the
         |   / ,'     \  `.             length of the shaper.
         |__/,'________\___`.__ t

The mean is also one over path. So the window keeps below the speed of a slow place for as long as
the mean reaches (:func:`cnc.planner.known_path.widened`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.path.kernels.curve import ARC, SPAN, START
from cnc.planner.audit import Audit
from cnc.planner.finished import FinishedPart
from cnc.planner.plan import (
    SAME,
    PlanChunk,
    cut_at_time,
    first_piece,
    joined_plans,
    over_own_pieces,
    part,
)
from cnc.planner.shaper import NO_SHAPER, Mode, Shaper, shortest_shaper

Floats = NDArray[np.float64]

KEPT = 1.0
"""s; so much motion of the window stays known, and the length of a shaper before it. A request
returns less far.
"""
MOVES = 1e-9
"""mm; an axis that moves less on a piece does not move there."""
APART = 1e-11
"""s; ends of phases that are nearer are one: their times are sums of floats."""


def modes_of(machine: Machine) -> dict[str, tuple[Mode, ...]]:
    """Return the modes of a machine by the axis that excites them; the tool's by ``tool``."""
    return {
        name: tuple(Mode(mode.frequency, mode.damping) for mode in modes)
        for name, modes in machine.vibration.items()
    }


def longest_spread(machine: Machine) -> float:
    """Return the longest time between a part of a shaper of a machine and its mean delay, s."""
    modes = modes_of(machine).values()
    return shortest_shaper(tuple(mode for own in modes for mode in own)).reach


@dataclass(frozen=True, slots=True)
class Stretch:
    """Motion of the window from a rest on.

    Attributes:
        plan: the motion up to now; what no later motion needs is left out.
        shaper: of the stretch.
        later: time by which stretches before have become longer, s.
    """

    plan: PlanChunk
    shaper: Shaper
    later: float

    @property
    def end(self) -> float:
        """Time of the window at which the motion so far ends, s."""
        return self.plan.t0 + self.plan.duration

    @property
    def rests(self) -> bool:
        """Whether the motion rests there."""
        return bool(self.plan.phase_v[-1] == 0.0)

    @property
    def later_behind(self) -> float:
        """Time by which the next stretch begins later than in the window, s."""
        return self.later + self.shaper.length


class Shaping:
    """Shapes the motion of the window. Every result is audited.

    Nothing is held back: shaped motion up to a time depends on the window up to that time.

    Attributes:
        active: whether the next stretches are shaped. Motion that follows the spindle is not.
    """

    held_from: None = None

    def __init__(self, modes: Mapping[str, tuple[Mode, ...]], audit: Audit) -> None:
        """Create the stage; ``modes`` by the names of axes, or ``tool`` for all."""
        self._modes, self._audit = modes, audit
        self._stretches: tuple[Stretch, ...] = ()
        """The last ones, in order; the last of them may go on."""
        self.active = True
        self._mixed_until = -math.inf

    def mixes_feeds(self, until: float) -> None:
        """Expect motion of the window that is under other feeds than before, up to a time of it.

        The shaped motion follows later. So it is compared with the higher feeds for a while.
        """
        self._mixed_until = until

    def copy(self, audit: Audit, *, searches: bool = True) -> Shaping:
        """Return a stage that goes on independently from the same state, with another audit."""
        other = copy(self)
        other._audit = audit
        return other

    def drop(self) -> None:
        """Nothing is held back."""

    def go_on(self, time: float, earlier: float, shorter: float, *, shared: bool) -> bool:
        """Go on with another motion of the window from one of its times on.

        Returns:
            Whether what is before that time is known.
        """
        stretches = list(self._stretches)
        while stretches and stretches[-1].plan.t0 > time - SAME:
            stretches.pop()
        if not stretches:
            return not self._stretches
        last = stretches[-1]
        if time < last.end - SAME:
            phase, cut = cut_at_time(last.plan, time - last.plan.t0)
            stretches[-1] = replace(last, plan=part(cut, 0, phase))
        self._stretches = tuple(stretches)
        return True

    def flush(self) -> Iterator[FinishedPart]:
        """Yield nothing: nothing is held back."""
        return iter(())

    def passed(self, plans: Iterable[PlanChunk]) -> Iterator[FinishedPart]:
        """Yield the shaped motion of plans in order; behind a rest the end of the motion, too.

        Raises:
            MotionLimitError: ``plan-illegal`` where the shaped motion breaks a limit.
        """
        parts = [piece for plan in plans for piece in _from_rest_to_rest(plan)]
        for number, plan in enumerate(parts):
            last = self._stretches[-1] if self._stretches else None
            if last is None or last.rests:
                shaper = self._shaper(parts[number:]) if self.active else NO_SHAPER
                stretch = Stretch(plan, shaper, 0.0 if last is None else last.later_behind)
                self._stretches = (*self._stretches, stretch)
            else:
                stretch = replace(last, plan=joined_plans(last.plan, plan))
                self._stretches = (*self._stretches[:-1], stretch)
            end = stretch.end
            yield self._audited(stretch, plan.t0, end, plan.t0)
            if stretch.rests and stretch.shaper.length > 0.0:
                # The window rests already: no request begins in here.
                yield self._audited(stretch, end, end + stretch.shaper.length, math.nan)
            self._forget(stretch.end - KEPT - stretch.shaper.length)

    def _forget(self, time: float) -> None:
        """Leave out what is before a time of the window."""
        stretches = [stretch for stretch in self._stretches if stretch.end > time]
        first = stretches[0]
        if len(first.plan.phase_j) and first.plan.t0 < time:
            k = int(np.searchsorted(first.plan.phase_t, time - first.plan.t0, side="right")) - 1
            stretches[0] = replace(first, plan=part(first.plan, k, len(first.plan.phase_j)))
        self._stretches = tuple(stretches)

    def _audited(self, stretch: Stretch, begin: float, end: float, window: float) -> FinishedPart:
        """Return the shaped motion from one time to another, s.

        ``window``: the time of the window at its start.
        """
        shaped = examined = _shaped(stretch, begin, end)
        if begin < self._mixed_until + stretch.shaper.length:
            path, base = shaped.path, stretch.plan
            oldest = begin - stretch.shaper.length - base.t0
            phase = int(np.searchsorted(base.phase_t[1:-1], oldest, side="right"))
            first = first_piece(base, phase)
            feed = np.full(len(path), base.path.feed[first:].max())
            examined = replace(shaped, path=replace(path, feed=feed))
        broken, before = self._audit.examined(examined)
        if broken:
            raise self._audit.refusal(shaped, broken)
        return FinishedPart(shaped, (), window, False, before)

    def _shaper(self, plans: list[PlanChunk]) -> Shaper:
        """Return the shaper of the stretch that begins with the first of some plans.

        It is for the modes of the axes that move before the next rest. If that is not among the
        plans it is for all.
        """
        moving: set[str] = set()
        for plan in plans:
            moving |= _moving_axes(plan)
            if plan.phase_v[-1] == 0.0:
                names = [name for name in self._modes if name in moving or name == "tool"]
                break
        else:
            names = list(self._modes)
        return shortest_shaper(tuple(mode for name in names for mode in self._modes[name]))


def _moving_axes(plan: PlanChunk) -> set[str]:
    """Return the names of the axes that move on the path of a plan."""
    path = plan.path
    columns = np.arange(len(path.axes))
    start = path.data[path.at[:, None] + START + columns]
    end = path.data[path.at[:, None] + START + len(path.axes) + columns]
    moves = (np.abs(end - start) > MOVES).any(axis=0)
    # A curve may return to where it began.
    arcs = path.at[path.kind == ARC] + START + 2 * len(path.axes)
    for plane in (0, 1):
        moves[np.unique(path.data[arcs + plane]).astype(np.int64)] = True
    moves |= bool((path.kind == SPAN).any())
    return {name for name, moved in zip(path.axes, moves.tolist(), strict=True) if moved}


def _from_rest_to_rest(plan: PlanChunk) -> list[PlanChunk]:
    """Return the parts of a plan between its rests."""
    rests = np.flatnonzero(plan.phase_v[1:-1] == 0.0) + 1
    ends = [0, *rests.tolist(), len(plan.phase_j)]
    return [part(plan, first, end) for first, end in pairwise(ends)]


def _shaped(stretch: Stretch, begin: float, end: float) -> PlanChunk:
    """Return the shaped motion of a stretch from one time of the window to another."""
    plan, (delays, parts) = stretch.plan, stretch.shaper
    origin, whole = plan.t0, plan.duration
    first, last = begin - origin, end - origin
    times = (plan.phase_t[:, None] + delays).ravel()
    times = np.sort(times[(times > first + APART) & (times < last - APART)])
    times = np.concatenate(([first], times, [last]))
    times = times[np.append(np.diff(times) > APART, True)]
    state = np.zeros((4, len(times)))
    middle = 0.5 * (times[:-1] + times[1:])
    for delay, share in zip(delays.tolist(), parts.tolist(), strict=True):
        inside = np.append(middle, middle[-1]) - delay
        rests = (inside <= 0.0) | (inside >= whole)
        k = np.searchsorted(plan.phase_t[1:-1], inside, side="right")
        t = np.clip(times - delay, 0.0, whole) - plan.phase_t[k]
        j, a, v, s = plan.phase_j[k], plan.phase_a[k], plan.phase_v[k], plan.phase_s[k]
        place = s + t * (v + t * (0.5 * a + t * j / 6.0))
        moving = np.where(rests, 0.0, (v + t * (a + 0.5 * t * j), a + t * j, j))
        state += share * np.vstack((place, moving))
    places, speeds, accelerations, jerks = state
    if not len(delays) > 1:
        speeds[-1], accelerations[-1] = plan.phase_v[-1], plan.phase_a[-1]
    if end >= stretch.end + stretch.shaper.length - APART and stretch.rests:
        places[-1], speeds[-1], accelerations[-1] = plan.phase_s[-1], 0.0, 0.0
    return over_own_pieces(
        replace(
            plan,
            t0=begin + stretch.later,
            phase_t=times - first,
            phase_s=places,
            phase_v=speeds,
            phase_a=accelerations,
            phase_j=jerks[:-1],
        )
    )
