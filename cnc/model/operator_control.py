"""Operator requests during a run: hold, resume, feed override, stop."""

from __future__ import annotations

from queue import SimpleQueue

from cnc.model.diagnostics import Diagnostic, UsageError

MIN_FEED_OVERRIDE, MAX_FEED_OVERRIDE = 1.0, 200.0
"""Limits of the feed override, per cent of the programmed feeds."""


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
    """

    def __init__(self, feed_override: float = 100.0) -> None:
        self._wake_ups: SimpleQueue[None] = SimpleQueue()
        self._held = False
        self._stopped = False
        self.override(feed_override)

    @property
    def feed_override(self) -> float:
        """Feed override, per cent of the programmed feeds."""
        return self._feed_override

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
            UsageError: ``feed-override``, outside 1 to 200 per cent.
        """
        if not MIN_FEED_OVERRIDE <= percent <= MAX_FEED_OVERRIDE:
            limits = f"{MIN_FEED_OVERRIDE:g} to {MAX_FEED_OVERRIDE:g}"
            raise UsageError(
                Diagnostic(
                    "feed-override",
                    f"a feed override of {percent:g} % is not possible",
                    hint=f"give {limits} per cent of the programmed feeds",
                )
            )
        self._feed_override = percent
        self._wake_ups.put(None)

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

    def wait(self) -> None:
        """Block until motion is not held or a stop is requested."""
        while self._held and not self._stopped:
            self._wake_ups.get()
