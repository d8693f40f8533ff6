"""Look-ahead: plans for a stream of path, in one pass and with a window of bounded length.

    path ──► blends ──► window ──► motions past corners, audit ──► plans
           (corners.py)   ^      (corner_motions.py, audit.py)
                          |
                       control: hold, override, between two slices

- The window (window.py) makes plans with the kernels of :mod:`cnc.kernels.planner.lookahead`, under
  bounds that are constant on short intervals of the path (intervals.py, phases.py).
- Where limits for each axis bind on a curve, :mod:`cnc.kernels.planner.refine` makes them faster.
- For a hold or a lower feed it replaces its plan by one that slows (slowing.py).
- Where the audit refuses what the window has settled, the planner returns to the state before. It
  makes the plan again more slowly, or follows the plan before for longer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from cnc.machine.models import Machine
from cnc.model.blocks import Block, BoardCommand, Held, Message, Overrides, Probe, SpindleSync
from cnc.model.diagnostics import MotionLimitError
from cnc.model.operator_control import Control
from cnc.path.chunk import PathChunk
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.corners import CornerBlending
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk
from cnc.planner.rewind import Rewind
from cnc.planner.window import LONG, SLICE, STOPS_KNOWN, Window

MOST_CAUTION = 12
"""Number of times that a plan is made again more slowly."""


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
        self.limits = Limits.of(machine)
        self.audit = Audit(self.limits, judges=judged)
        self._window = Window(self.limits, stops_known)
        self._blending = CornerBlending(self.limits)
        self._corners = CornerMotions(self.limits, self.audit)
        self._rewind = Rewind()
        self._factor = 1.0
        """The factor of the feeds that was requested last."""
        self._control = control
        self._slice_s = LONG if control is None else slice_s
        self._finished: deque[PlanChunk] = deque()
        self._allowed = Overrides(
            "", 0, feed=True, spindle=True, adaptive_feed=False, feed_stop=True
        )
        self._follows_spindle = False

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
                    yield from self._motion()
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
            probe = item if isinstance(item, Probe) else None
            yield item
            if isinstance(item, BoardCommand) and item.answer.values is not None:
                self.audit.jump()
        if pending is not None:
            yield from self._motion_to_rest(pending, previous)

    def ramp_down(self) -> Iterator[PlanChunk]:
        """Yield plans that come to rest soon after the last plan; then nothing can be planned."""
        yield from self._taken()
        self._go_back()
        if self._window.moving:
            before = self._window.copy()
            self._window.stop()
            if self._refusal() is not None:
                self._window = before
                before.follow_to_rest()
            while self._window.moving:
                self._finish(self._window.take(LONG))
        self._finish_at_rest()
        yield from self._taken()

    def _motion_to_rest(
        self, last: PathChunk, previous: PathChunk | None
    ) -> Iterator[PlanChunk | Block]:
        """Plan the last chunk before a rest of the path."""
        self._add(last, previous, None)
        yield from self._motion()
        self._finish_at_rest()
        yield from self._taken()

    def _motion(self) -> Iterator[PlanChunk | Block]:
        """Yield the plans that are settled, as the operator requests the motion."""
        waits = False
        while True:
            factor = self._requested_factor()
            if not waits and not self._requested(factor):
                # The request has to wait for another slice.
                waits = True
            if not self._prepared():
                return
            window = self._window
            if factor == 0.0 and not window.moving:
                self._finish_at_rest()
                yield from self._taken()
                yield Held(*window.place)
                waits = False
                continue
            if window.settled:
                self._take_slice()
            yield from self._taken()
            waits = False

    def _requested(self, factor: float) -> bool:
        """Plan for a factor of the feeds; return False if the audit refuses that plan."""
        if self._window.runs_at(factor):
            return True
        before = self._window.copy(), self._corners, self._rewind
        if factor != self._factor:
            self._factor = factor
            self._go_back()
        if factor > 0.0:
            self._window.override(factor)
        else:
            self._window.stop()
        if self._refusal() is None:
            return True
        self._window, self._corners, self._rewind = before
        return False

    def _prepared(self) -> bool:
        """Return whether there is something to send on, which the audit accepts.

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
        plans: list[PlanChunk] = []
        try:
            while trial.settled:
                plans.extend(corners.passed(trial.take(LONG)))
            # What is held back may become the end of the motion.
            deque(corners.copy(audit.copy()).flush(), maxlen=0)
        except MotionLimitError as error:
            return error
        window.unproved = trial.unproved = False
        if taken:
            self._window, self._corners = trial, corners.copy(self.audit)
            self.audit.adopt(audit)
            self._finished.extend(plans)
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

    def _take_slice(self) -> None:
        """Take a slice from the window, and finish what can be."""
        if self._control is not None:
            self._rewind.keep(self._window)
        self._finish(self._window.take(self._slice_s))
        self._rewind.leave_out(self._corners.held_from)

    def _go_back(self) -> None:
        """Return to where the part begins that is held back, so that it can still change."""
        window = self._rewind.window_at(self._corners.held_from)
        if window is not None:
            self._window, self._rewind = window, Rewind()
            self._corners = self._corners.copy(self.audit)
            self._corners.drop()

    def _finish(self, plans: Iterable[PlanChunk]) -> None:
        """Pass stops on corners in plans of the window, and audit them."""
        self._finished.extend(self._corners.passed(plans))

    def _finish_at_rest(self) -> None:
        """Finish the part of a plan that is held back; the motion rests at its end."""
        self._finished.extend(self._corners.flush())
        self._rewind = Rewind()

    def _taken(self) -> Iterator[PlanChunk]:
        """Yield the finished plans."""
        while self._finished:
            yield self._finished.popleft()
