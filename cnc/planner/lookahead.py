"""Look-ahead: a stream of path in, a stream of plans out, in one pass and with a window of bounded
length.

path ──► corners: blends ──► Window: plans ahead, hands out slices ──► corners: overlaps ──► audit ──► plans
                                ^
                             Control: hold, override, between two slices
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held, Message, Overrides, Probe, SpindleSync
from cnc.model.operator_control import Control
from cnc.path.chunk import PathChunk
from cnc.planner.audit import Audit
from cnc.planner.corners import Overlaps, Rounding
from cnc.planner.limits import Limits
from cnc.planner.plan import PlanChunk
from cnc.planner.window import LONG, SLICE, STOPS_KNOWN, Window


class LookAhead:
    """Plans a stream of path at a machine's limits.

    control: what the operator wants; it is looked at between slices of ``slice_s`` seconds. Without
    one all goes as programmed, in long slices. stops_known: stopping distances that the window
    holds when it is planned.

    Every plan has passed :attr:`audit`, which keeps the largest values seen. judged: whether a plan
    that breaks a limit is a fault; it is none where the speeds alone are wanted, because the board
    plans for itself.
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
        self.limits = Limits.of(machine)
        self.audit = Audit(self.limits, judges=judged)
        self._window = Window(self.limits, stops_known)
        self._rounding = Rounding(self.limits)
        self._overlaps = Overlaps(self.limits)
        self._control = control
        self._slice_s = LONG if control is None else slice_s
        self._finished: deque[PlanChunk] = deque()
        self._allowed = Overrides(
            "", 0, feed=True, spindle=True, adaptive_feed=False, feed_stop=True
        )
        self._follows_spindle = False

    def plan(self, stream: Iterable[PathChunk | Block]) -> Iterator[PlanChunk | Block]:
        """Yield plans for the path; blocks that aren't motion pass through in order, the motion
        before them at rest.

        A stretch of path that ends at rest is planned to its end before more of the stream is asked
        for: what follows a probe isn't known before it has been made. Where the operator holds the
        motion, :class:`Held` comes again and again until it goes on.

        Raises:
            MotionLimitError: ``plan-illegal`` where a plan breaks a limit; it is not handed on.
        """
        window = self._window
        previous: PathChunk | None = None
        pending: PathChunk | None = None
        probe: Probe | None = None
        for item in self._rounding.rounded(stream):
            if isinstance(item, PathChunk):
                if pending is not None:
                    window.add(pending, previous, item)
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
            window.clock.add(item)
            if isinstance(item, Overrides):
                self._allowed = item
            elif isinstance(item, SpindleSync):
                self._follows_spindle = item.pitch > 0.0
            probe = item if isinstance(item, Probe) else None
            yield item
        if pending is not None:
            yield from self._motion_to_rest(pending, previous)

    def ramp_down(self) -> Iterator[PlanChunk]:
        """Come to rest on the path, soon after the last plan that was handed out; nothing can be
        planned after that.
        """
        yield from self._taken()
        window = self._window
        if window.moving:
            window.stop()
            while window.moving:
                self._finish(window.take(LONG))
        self._finish_at_rest()
        yield from self._taken()

    def _motion_to_rest(
        self, last: PathChunk, previous: PathChunk | None
    ) -> Iterator[PlanChunk | Block]:
        """The last chunk before a rest of the path."""
        self._window.add(last, previous, None)
        yield from self._motion()
        self._finish_at_rest()
        yield from self._taken()

    def _motion(self) -> Iterator[PlanChunk | Block]:
        """What of the window can be handed out, as the operator wants it."""
        window = self._window
        while True:
            factor = self._wanted()
            if factor > 0.0:
                window.override(factor)
            else:
                window.stop(resumes=True)
            if not window.prepared():
                return
            if factor == 0.0 and not window.moving and not window.goes_round:
                window.rest()
                self._finish_at_rest()
                yield from self._taken()
                yield Held(*window.place)
                continue
            # Round a corner that is gone round before a hold: no further than its ramp belongs to
            # it.
            self._finish(window.take(0.0 if factor == 0.0 and not window.moving else self._slice_s))
            yield from self._taken()

    def _wanted(self) -> float:
        """The factor of the programmed feeds that the operator wants and the program allows; 0 for
        a hold.

        As LinuxCNC has it, motion that follows the spindle is neither held nor overridden, M49 and
        M50 P0 leave the feeds as programmed, and M53 P0 takes no hold.
        """
        control = self._control
        if control is None or self._follows_spindle:
            return 1.0
        if control.held and self._allowed.feed_stop:
            return 0.0
        return control.feed_override / 100.0 if self._allowed.feed else 1.0

    def _finish(self, plans: Iterable[PlanChunk]) -> None:
        """The one way out of the window: corners are cut, then every plan is audited."""
        self._finished.extend(self.audit.passed(self._overlaps.passed(plans)))

    def _finish_at_rest(self) -> None:
        """No motion follows at once on what was finished last."""
        self._finished.extend(self.audit.passed(self._overlaps.flush()))

    def _taken(self) -> Iterator[PlanChunk]:
        """Hand out what is finished."""
        while self._finished:
            yield self._finished.popleft()
