"""Look-ahead: plans for a stream of path, in one pass and with a window of bounded length.

The faster of two paths along the same moves is chosen before (corner_choice.py).

    path ──► blends ──► window ──► motions past corners, audit ──► plans
           (corners.py)   ^      (corner_motions.py, audit.py)
                          |
                       control: hold, override, between two slices

- The window (window.py) makes plans with the kernels of :mod:`cnc.planner.kernels.lookahead`, under
  bounds that are constant on short intervals of the path (intervals.py, phases.py).
- Where limits for each axis bind on a curve, :mod:`cnc.planner.kernels.refine` makes them faster.
- For a hold or a lower feed it replaces its plan by one that slows (slowing.py).
- Where the audit refuses what the window has settled, the planner returns to the state before. It
  makes the plan again more slowly, or follows the plan before for longer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from enum import Enum
from math import inf
from typing import NamedTuple

from cnc.machine.models import Machine
from cnc.model.blocks import Block, BoardCommand, Held, Message, Overrides, Probe, SpindleSync
from cnc.model.diagnostics import MotionLimitError
from cnc.model.operator_control import Control
from cnc.path.chunk import PathChunk
from cnc.planner.audit import Audit
from cnc.planner.corner_choice import Trials
from cnc.planner.corner_hold import stop_inside, under_clock
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.corners import CornerBlending
from cnc.planner.finished import Finished, FinishedPart
from cnc.planner.known_path import with_feeds_in_effect
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk
from cnc.planner.shaping import Shaping, longest_spread, modes_of
from cnc.planner.window import LONG, SLICE, SLICE_LENGTH, STOPS_KNOWN, Window
from cnc.planner.work import Work

# Where a request of the operator may begin.
#
# handed out │ finished, in slices │ held back │ window
#            ^                     ^           ^
#   INSIDE_CHAIN, FINISHED     HELD_BACK     WINDOW


class Beginning(Enum):
    """Places at which a request of the operator may begin."""

    INSIDE_CHAIN = 1
    """Where the next slice of the finished motion begins, if that is inside a chain of corners."""
    FINISHED = 2
    """Where that slice begins, or at the end of the chain."""
    HELD_BACK = 3
    """At the start of what corners hold back."""
    WINDOW = 4
    """At the start of the window."""


# Earlier states of the window, for a part of the plan that is held back.
#
# Corners hold back what a later plan may change (:mod:`cnc.planner.corner_motions`). Nothing of it
# was sent, so a hold or an override may begin where it begins. The window has left that place, but
# a copy of it has not.
#
#     sent │ held back, in slices  │ window
#          |     ^           ^     ^
#          |    copy        copy   now
#        hold

ROUNDING = 1e-12
"""s; rounding error of a time. A slice of no length would be a whole phase."""

SAME = 1e-10
"""s; the window is at a time that differs by no more."""

Added = tuple[PathChunk, PathChunk | None, PathChunk | None]


class Rewind:
    """Copies of the window before each slice of which a part is held back."""

    def __init__(self) -> None:
        self._copies: list[tuple[float, Window, int]] = []
        """Time in the plan, the window there, and the number of chunks noted before."""
        self._added: list[Added] = []

    def note(self, path: PathChunk, previous: PathChunk | None, item: PathChunk | None) -> None:
        """Note a chunk that was added to the window, with its neighbours."""
        if self._copies:
            self._added.append((path, previous, item))

    def keep(self, window: Window) -> None:
        """Keep a copy of the window before a slice is taken."""
        self._copies.append((window.clock.seconds, window.copy(), len(self._added)))

    def up_to(self, time: float) -> Rewind:
        """Return the copies before a time: behind it another plan follows."""
        before = Rewind()
        before._copies = [kept for kept in self._copies if kept[0] < time - SAME]
        before._added = self._added[:]
        return before

    def leave_out(self, time: float | None) -> None:
        """Leave out the copies that a return to ``time`` does not need; None for no return."""
        if time is None:
            self._copies.clear()
            self._added.clear()
            return
        while len(self._copies) > 1 and self._copies[1][0] <= time:
            self._copies.pop(0)
        first = self._copies[0][2] if self._copies else len(self._added)
        del self._added[:first]
        self._copies = [(begin, window, number - first) for begin, window, number in self._copies]

    def window_at(self, time: float | None) -> Window | None:
        """Return the window as it was at ``time`` in the plan; None if it is not known.

        A time just beside the end of a phase is none at which the window can be. The window goes on
        from the last copy before that time: a request may have changed the plan of earlier ones.
        """
        if time is None:
            return None
        earlier = [entry for entry in self._copies if entry[0] <= time + ROUNDING]
        if not earlier:
            return None
        _, kept, number = earlier[-1]
        window = kept.copy()
        for added in self._added[number:]:
            window.add(*added)
        while window.clock.seconds < time - ROUNDING and window.settled:
            before = window.clock.seconds
            window.take(time - before, 0.0)
            if window.clock.seconds <= before:
                break
        return window if abs(window.clock.seconds - time) <= SAME else None


SOONER = 0.5
"""Part of the length of a slice that one has for whose end a request waits."""

SETTLED = 1.0
"""s; so much of a plan for a request is settled where the motion is shaped."""

FOLLOWED = 0.5
"""s; so much of a plan is followed where no other one is found."""

MOST_CAUTION = 12
"""Number of times that a plan is made again more slowly."""


class State(NamedTuple):
    """What a request changes; see :class:`LookAhead`."""

    window: Window
    corners: CornerMotions | Shaping
    rewind: Rewind
    finished: Finished
    audit: Audit


class LookAhead:
    """Plans a stream of path at a machine's limits.

    Attributes:
        limits: of the machine.
        audit: every plan has passed it; it keeps the largest values.
    """

    def __init__(
        self,
        machine: Machine,
        control: Control | None = None,
        *,
        slice_s: float = SLICE,
        stops_known: float = STOPS_KNOWN,
        judged: bool = True,
    ) -> None:
        """Create a planner.

        Args:
            machine: its limits.
            control: requests of the operator, read between slices. Without it the motion is as
                programmed, in long slices.
            slice_s: length of a slice, s.
            stops_known: stopping distances that the window holds when it is planned.
            judged: whether a plan that breaks a limit is a fault. It is none where only the speeds
                are needed, because the board plans for itself.
        """
        shapes = judged and bool(machine.vibration)
        self.limits = Limits.of(machine)
        if shapes:
            self.limits = replace(self.limits, spread=longest_spread(machine))
        self.audit = Audit(self.limits, judges=judged)
        work = Work()
        self._window = Window(self.limits, stops_known, work)
        trials = Trials(self.limits, work)
        # What passes a corner rings: the axes change their speeds in an instant.
        self._blending = CornerBlending(
            self.limits, where=lambda: not shapes, together=trials.passed_together
        )
        self._corners = (
            Shaping(modes_of(machine), self.audit)
            if shapes
            else CornerMotions(self.limits, self.audit, work, trials.solutions)
        )
        self._rewind = Rewind()
        self._factor = 1.0
        """The factor of the feeds for which the plan was made that counts."""
        self._control = control
        self._slice_s = LONG if control is None else slice_s
        self._finished = Finished()
        always = {"feed": True, "spindle": True, "adaptive_feed": False, "feed_stop": True}
        self._allowed = Overrides("", 0, **always)
        self._follows_spindle = False

    @property
    def feed_factor(self) -> float:
        """The factor of the feeds for which the motion from here on is planned; 0 for a hold.

        It differs from the request of the operator as long as that has to wait.
        """
        return self._factor

    @property
    def chain_left(self) -> float:
        """Time until the motion past corners ends that is under way, s; 0 for none."""
        return self._finished.chain_left

    @property
    def pending(self) -> float:
        """Time after which a requested override begins at the latest, s; 0 if it has begun.

        It waits for the end of a motion past corners, or for another slice.
        """
        factor = self._requested_factor()
        waits = bool(self._finished) and factor not in (0.0, self._factor)
        return max(self.chain_left, self._slice_s) if waits else 0.0

    def plan(self, stream: Iterable[PathChunk | Block]) -> Iterator[PlanChunk | Block]:
        """Yield plans for the path, and the blocks that are not motion, in order.

        The motion rests before such a block. A stretch of path that ends at rest is planned to its
        end before more of the stream is read: the path behind a probe depends on the probe. While
        the operator holds the motion, :class:`Held` is yielded again and again.

        Raises:
            MotionLimitError: ``plan-illegal`` where a plan breaks a limit; it is not yielded.
        """
        previous: PathChunk | None = None
        pending: PathChunk | None = None
        probe: Probe | None = None
        for item in self._blending.blended(stream):
            if isinstance(item, PathChunk):
                if pending is not None:
                    self._add(pending, previous, item)
                    yield from self._motion(at_rest=False)
                    previous = pending
                pending = item
                if item.stop_after[-1]:
                    yield from self._motion_to_rest(pending, previous)
                    previous = pending = None
                    if probe is not None and probe.answer.values is not None:
                        self.audit.jump()
                    probe = None
                continue
            if pending is not None and not isinstance(item, Message):
                yield from self._motion_to_rest(pending, previous)
                previous = pending = None
            self._window.clock.add(item)
            if isinstance(item, Overrides):
                self._allowed = item
            elif isinstance(item, SpindleSync):
                self._follows_spindle = item.pitch > 0.0
                if isinstance(self._corners, Shaping):
                    self._corners.active = not self._follows_spindle
            probe = item if isinstance(item, Probe) else None
            yield item
            if isinstance(item, BoardCommand) and item.answer.values is not None:
                self.audit.jump()
        if pending is not None:
            yield from self._motion_to_rest(pending, previous)

    def ramp_down(self) -> Iterator[PlanChunk]:
        """Yield plans that come to rest soon after the last plan; then nothing can be planned."""
        stops = self._requested(0.0)
        while self._finished and not stops:
            yield self._next_slice()
            stops = self._requested(0.0)
        if not stops:
            self._window.follow_to_rest()
        while self._window.moving:
            # A motion that can't stop yet is tried again with each slice, as for a hold.
            late = stops and self._window.stops_late
            self._finish(self._window.take(self._slice_s if late else LONG, 0.0))
            if late and self._window.moving:
                self._requested(0.0)
        self._finish_at_rest()
        yield from self._handed_out()

    def _motion_to_rest(
        self, last: PathChunk, previous: PathChunk | None
    ) -> Iterator[PlanChunk | Block]:
        """Plan the last chunk before a rest of the path."""
        self._add(last, previous, None)
        yield from self._motion(at_rest=True)

    def _motion(self, *, at_rest: bool) -> Iterator[PlanChunk | Block]:
        """Yield the plans that are settled, as the operator requests the motion.

        ``at_rest``: whether the motion rests at the end of the path so far. Then all of it is.
        """
        waits = False
        while True:
            factor = self._requested_factor()
            if not waits and not self._requested(factor):
                # The request has to wait for another slice.
                waits = True
            if self._finished:
                yield self._next_slice()
                waits = False
                continue
            if not self._prepared():
                if not at_rest:
                    return
                self._finish_at_rest()
                if not self._finished:
                    return
                continue
            window = self._window
            if factor == 0.0 and not window.moving:
                self._finish_at_rest()
                yield from self._handed_out()
                yield Held(*window.place)
                waits = False
                continue
            if window.settled:
                self._take_slice(short=waits or window.stops_late)
            waits = False

    def _requested(self, factor: float) -> bool:
        """Plan for a factor of the feeds; return False if that has to wait for another slice.

        It does where the audit refuses the plan. A hold inside of a long motion past corners waits
        where no stop is found.
        """
        if self._window.runs_at(factor):
            return True
        before = self._state()
        for begin in self._beginnings(factor):
            if self._gone_back(begin, factor) and self._accepted(factor):
                self._factor = factor
                return True
            self._set_state(before)
        return False

    def _accepted(self, factor: float) -> bool:
        """Plan for a factor of the feeds from here on; return whether the audit accepts it."""
        if factor > 0.0:
            if not self._window.override(factor):
                return False
        else:
            self._window.stop()
        if isinstance(self._corners, Shaping):
            self._corners = self._corners.copy(self.audit)
            self._corners.mixes_feeds(self._window.slows_until)
            # The rest is planned again, with caution where a bend needs it.
            self._window.settle_until(SETTLED)
        return self._refusal() is None

    def _state(self) -> State:
        """Return a copy of the state that a request changes."""
        return State(
            self._window.copy(), self._corners, self._rewind, self._finished, self.audit.copy()
        )

    def _set_state(self, state: State) -> None:
        """Go on from a state. It stays as it is."""
        self._window, self._corners = state.window.copy(), state.corners
        self._rewind, self._finished = state.rewind, state.finished
        self.audit.adopt(state.audit)

    def _prepared(self) -> bool:
        """Return whether there is something to send on, which the audit accepts.

        A shaped motion comes to rest where no other one is accepted, and goes on from there.

        Raises:
            MotionLimitError: ``plan-illegal`` where it refuses the slowest plan too.
        """
        while True:
            if self._window.settled and not self._window.unproved:
                return True
            before = self._window.copy()
            if not self._window.prepared():
                return False
            refusal = self._refusal()
            if refusal is None:
                self._window.caution = 0
                return True
            if before.caution == MOST_CAUTION:
                if not (before.moving and isinstance(self._corners, Shaping)):
                    raise refusal
                before.stop()
            elif before.caution > MOST_CAUTION:
                raise refusal
            self._window = before
            before.caution += 1

    def _refusal(self) -> MotionLimitError | None:
        """Return the error of the audit for what the window has settled; None if it accepts.

        Where the motion is not handed out in slices, what is accepted is taken at once.
        """
        window = self._window
        if not (window.unproved and window.settled and self.audit.judges):
            return None
        audit, trial = self.audit.copy(), window.copy()
        taken = self._slice_s == LONG and self._requested_factor() > 0.0
        # Where slices follow, each has its own search, and stops are what remains in any case.
        corners = self._corners.copy(audit, searches=taken)
        parts: list[FinishedPart] = []
        try:
            while trial.settled:
                parts.extend(corners.passed(trial.take(LONG)))
            # What is held back may become the end of the motion.
            deque(corners.copy(audit.copy(), searches=taken).flush(), maxlen=0)
            if isinstance(corners, Shaping):
                # The bounds in bends are estimates: what may be followed behind is examined, too.
                rest = trial.copy()
                rest.follow_to_rest()
                if rest.settled:
                    deque(corners.copy(audit.copy()).passed(rest.take(FOLLOWED)), maxlen=0)
        except MotionLimitError as error:
            return error
        window.unproved = trial.unproved = False
        if taken:
            self._window, self._corners = trial, corners.copy(self.audit)
            self.audit.adopt(audit)
            self._finished.add(parts)
        return None

    def _requested_factor(self) -> float:
        """Return the factor of the programmed feeds that is requested and allowed; 0 for a hold.

        As in LinuxCNC, motion that follows the spindle is neither held nor overridden, M49 and
        M50 P0 leave the feeds as programmed, and with M53 P0 there is no hold.
        """
        control = self._control
        if control is None or self._follows_spindle:
            return 1.0
        if control.held and self._allowed.feed_stop:
            return 0.0
        return control.feed_override / 100.0 if self._allowed.feed else 1.0

    def _add(self, path: PathChunk, previous: PathChunk | None, item: PathChunk | None) -> None:
        """Add a chunk of path to the window."""
        self._window.add(path, previous, item)
        self._rewind.note(path, previous, item)

    def _take_slice(self, *, short: bool) -> None:
        """Take a slice from the window, and finish what can be.

        ``short``: a request waits for its end, so it is shorter, and slow motion has no longer one.
        """
        if self._control is not None:
            self._rewind.keep(self._window)
        seconds, length = self._slice_s, SLICE_LENGTH
        if short:
            seconds, length = SOONER * seconds, 0.0
        self._finish(self._window.take(seconds, length))
        self._leave_out()

    def _beginnings(self, factor: float) -> list[Beginning]:
        """Return the places at which a request may begin, the first one first."""
        if factor == self._factor:
            return [Beginning.WINDOW]
        if self._finished:
            left = self._finished.chain_left
            # Behind a long motion past corners it would be late: the next slice may show a place.
            inside = [Beginning.INSIDE_CHAIN] * (left > 0.0)
            return [*inside, *[Beginning.FINISHED] * (left <= self._slice_s)]
        held = [Beginning.HELD_BACK] * (self._corners.held_from is not None)
        return [*held, Beginning.WINDOW]

    def _gone_back(self, begin: Beginning, factor: float) -> bool:
        """Return to a place at which a request begins; return False if that is not possible."""
        if begin is Beginning.WINDOW:
            return True
        if begin is Beginning.INSIDE_CHAIN:
            return self._clock_changed(factor) if factor > 0.0 else self._stopped_inside()
        if begin is Beginning.HELD_BACK:
            window = self._rewind.window_at(self._corners.held_from)
            if window is None:
                return False
            self._corners = self._corners.copy(self.audit)
            self._corners.drop()
        else:
            goes_back = self._finished.back(inside=False)
            if goes_back is None:
                return False
            back, kept = goes_back
            window = self._rewind.window_at(back.stops_time)
            if window is None:
                return False
            if not self._go_on(window, back.time, back.length, shared=back.shared):
                return False
            self._finished = kept
            self.audit.adopt(back.audit)
        self._window, self._rewind = window, Rewind()
        return True

    def _stopped_inside(self) -> bool:
        """Come to rest inside of a motion past corners; return False if no stop is found."""
        goes_back = self._finished.back(inside=True)
        window = self._rewind.window_at(goes_back[0].stops_time) if goes_back else None
        if goes_back is None or window is None:
            return False
        back, kept = goes_back
        legs = window.pieces_from_here(back.left.legs) if back.left else None
        if back.left is None or legs is None:
            return False
        stop = stop_inside(back.left, with_feeds_in_effect(legs, window.limits), self.limits)
        if stop is None:
            return False
        plan = stop.plan
        broken, audit = back.audit.examined(plan)
        if broken:
            return False
        window.rest_on(stop.leg, stop.place)
        kept.add([FinishedPart(plan, (), window.clock.seconds, False, audit)])
        end = plan.s0 + float(plan.phase_s[-1])
        self._go_on(window, plan.t0 + plan.duration, end, shared=False)
        self._finished = kept
        self.audit.adopt(back.audit)
        self._window, self._rewind = window, Rewind()
        return True

    def _clock_changed(self, factor: float) -> bool:
        """Change the clock of a motion past corners; return False if that does not help."""
        inside, end = self._finished.back(inside=True), self._finished.back(inside=False)
        if inside is None or end is None or inside[0].left is None:
            return False
        back, behind = inside[0], end[0]
        begin = self._rewind.window_at(back.stops_time)
        window = self._rewind.window_at(behind.stops_time)
        legs = begin.pieces_from_here(inside[0].left.legs) if begin else None
        if window is None or legs is None:
            return False
        clocked = under_clock(inside[0].left, legs, replace(self.limits, feed_factor=factor))
        if clocked is None:
            return False
        plan = clocked.plan
        broken, _ = back.audit.examined(plan)
        if broken:
            return False
        window.follow_slower(clocked.pace)
        self._finished = self._finished.with_rest(plan)
        self._go_on(window, plan.t0 + plan.duration, behind.length, shared=behind.shared)
        self.audit.adopt(back.audit)
        self._window, self._rewind = window, self._rewind.up_to(behind.stops_time)
        # A further request may come before the end of the chain.
        self._rewind.keep(window)
        return True

    def _go_on(self, window: Window, time: float, length: float, *, shared: bool) -> bool:
        """Pass corners from a state of the window on, which follows so much finished motion.

        Return whether enough of that motion is known.
        """
        self._corners = self._corners.copy(self.audit)
        now = window.clock.seconds
        return self._corners.go_on(now, now - time, window.length - length, shared=shared)

    def _finish(self, plans: Iterable[PlanChunk]) -> None:
        """Pass stops on corners in plans of the window, and audit them."""
        self._finished.add(self._corners.passed(plans))

    def _finish_at_rest(self) -> None:
        """Finish the part of a plan that is held back; the motion rests at its end."""
        self._finished.add(self._corners.flush())
        self._leave_out()

    def _leave_out(self) -> None:
        """Leave out the earlier states of the window that no request needs."""
        held_from = self._finished.stops_time if self._finished else self._corners.held_from
        self._rewind.leave_out(held_from)

    def _next_slice(self) -> PlanChunk:
        """Return the next slice of the finished motion."""
        plan = self._finished.take(self._slice_s if self._slice_s < LONG else inf)
        self._leave_out()
        return plan

    def _handed_out(self) -> Iterator[PlanChunk]:
        """Yield all of the finished motion, which no request changes."""
        while self._finished:
            yield self._finished.take(inf)
        self._leave_out()
