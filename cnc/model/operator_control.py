"""Operator requests during a run: hold, resume, feed override, stop."""

from __future__ import annotations

from contextlib import suppress
from queue import Empty, SimpleQueue

from cnc.model.diagnostics import Diagnostic, UsageError

MIN_FEED_OVERRIDE, MAX_FEED_OVERRIDE = 1.0, 200.0
"""Limits of the feed override, per cent of the programmed feeds."""

MIN_FEED_OVERRIDE_OF_BOARD = 10.0
"""Lowest feed override of a board that carries overrides out itself, per cent: that of GRBL."""

RAPID_OVERRIDES = (25, 50, 100)
"""Overrides of traverses, per cent: those of GRBL."""
MIN_SPINDLE_OVERRIDE, MAX_SPINDLE_OVERRIDE = 10.0, 200.0
"""Limits of the spindle override, per cent: those of GRBL."""


class StoppedAtOnce(KeyboardInterrupt):
    """The operator stopped a run a second time, before the machine was at rest."""


class HomingStopped(Exception):
    """The operator stopped a homing cycle.

    The machine is at rest. The position of the axis that was homing is not known.
    """

    def __init__(self) -> None:
        super().__init__(
            "stopped by the operator; the position of the axis that was homing is not known"
        )


class Control:
    """Requests of the operator.

    A request takes effect at the end of the motion already sent to the board, at most one slice
    later. Any thread and any signal handler may call the methods: a request is a single store, and
    a reentrant queue wakes a waiting thread.

    Args:
        feed_override: Per cent of the programmed feeds, 1 to 200. The limits of the machine still
            hold, and traverses are not scaled.

    Attributes:
        feed_only: Whether the board has no override of traverses and of the spindle.
        lowest_feed: The lowest feed override, per cent.
    """

    def __init__(self, feed_override: float = 100.0) -> None:
        self._wake_ups: SimpleQueue[None] = SimpleQueue()
        self._held = False
        self._stopped = False
        self._rapid_override = 100
        self._spindle_override = 100.0
        self.feed_only = False
        self.lowest_feed = MIN_FEED_OVERRIDE
        self.override(feed_override)

    @property
    def feed_override(self) -> float:
        """Feed override, per cent of the programmed feeds."""
        return self._feed_override

    @property
    def rapid_override(self) -> int:
        """Override of traverses, per cent: 25, 50 or 100. Only GRBL boards have it."""
        return self._rapid_override

    @property
    def spindle_override(self) -> float:
        """Override of the spindle speed, per cent. Only GRBL boards have it."""
        return self._spindle_override

    @property
    def requested(self) -> tuple[bool, float, int, float]:
        """Hold and overrides together: to see whether any has changed."""
        return self._held, self._feed_override, self._rapid_override, self._spindle_override

    @property
    def held(self) -> bool:
        """Whether motion is held until :meth:`resume`."""
        return self._held

    @property
    def stopped(self) -> bool:
        """Whether a stop is requested."""
        return self._stopped

    def override(self, percent: float) -> None:
        """Scale the programmed feeds.

        Raises:
            UsageError: ``feed-override``, outside 1 to 200 per cent, or lower than the board has.
        """
        if not self.lowest_feed <= percent <= MAX_FEED_OVERRIDE:
            limits = f"{self.lowest_feed:g} to {MAX_FEED_OVERRIDE:g}"
            raise UsageError(
                Diagnostic(
                    "feed-override",
                    f"a feed override of {percent:g} % is not possible",
                    hint=f"give {limits} per cent of the programmed feeds",
                )
            )
        self._feed_override = percent
        self._wake_ups.put(None)

    def override_rapids(self, percent: int) -> None:
        """Scale traverses.

        Raises:
            UsageError: ``rapid-override``, for another value than 25, 50 or 100 per cent, or if
                the board has no such override.
        """
        if percent not in RAPID_OVERRIDES:
            message = f"an override of traverses of {percent:g} % is not possible"
            hint = f"give {', '.join(map(str, RAPID_OVERRIDES[:-1]))} or {RAPID_OVERRIDES[-1]}"
            raise UsageError(Diagnostic("rapid-override", message, hint=hint))
        self._refuse("rapid-override", "traverses", percent)
        self._rapid_override = percent
        self._wake_ups.put(None)

    def override_spindle(self, percent: float) -> None:
        """Scale the programmed spindle speeds.

        Raises:
            UsageError: ``spindle-override``, outside 10 to 200 per cent, or if the board has no
                such override.
        """
        if not MIN_SPINDLE_OVERRIDE <= percent <= MAX_SPINDLE_OVERRIDE:
            message = f"a spindle override of {percent:g} % is not possible"
            hint = f"give {MIN_SPINDLE_OVERRIDE:g} to {MAX_SPINDLE_OVERRIDE:g} per cent"
            raise UsageError(Diagnostic("spindle-override", message, hint=hint))
        self._refuse("spindle-override", "the spindle", percent)
        self._spindle_override = percent
        self._wake_ups.put(None)

    def take_board(self, *, overrides: bool) -> None:
        """Refuse overrides that the board does not have, from now on.

        Args:
            overrides: Whether the board carries overrides out itself, as GRBL boards do.

        Raises:
            UsageError: ``rapid-override``, ``spindle-override``, if one is in effect.
        """
        self.feed_only = not overrides
        self.lowest_feed = MIN_FEED_OVERRIDE_OF_BOARD if overrides else MIN_FEED_OVERRIDE
        self._refuse("rapid-override", "traverses", self._rapid_override)
        self._refuse("spindle-override", "the spindle", self._spindle_override)

    def _refuse(self, code: str, name: str, percent: float) -> None:
        if self.feed_only and percent != 100:
            message = f"this board has no override of {name}"
            raise UsageError(Diagnostic(code, message, hint="leave it out; GRBL boards have it"))

    def hold(self) -> None:
        """Request a stop on the path, and wait there."""
        self._held = True
        self._wake_ups.put(None)

    def resume(self) -> None:
        """Continue after a hold."""
        self._held = False
        self._wake_ups.put(None)

    def stop(self) -> None:
        """Request a stop on the path and the end of the run."""
        self._stopped = True
        self._wake_ups.put(None)

    def wait(self, seconds: float | None = None) -> bool:
        """Block until motion is not held or a stop is requested, or for a time, s.

        Returns:
            Whether motion is held still.
        """
        with suppress(Empty):
            while self._held and not self._stopped:
                self._wake_ups.get(timeout=seconds)
        return self._held and not self._stopped
