"""What the operator wants of a run: hold, resume, override, stop."""

from __future__ import annotations

from queue import SimpleQueue

from cnc.model.diagnostics import Diagnostic, UsageError

MIN_FEED_OVERRIDE, MAX_FEED_OVERRIDE = 1.0, 200.0
"""Per cent of the programmed feeds."""


class HomingStopped(Exception):
    """The operator has stopped a machine on its way home: it rests, and the axis that was under way
    does not know where.
    """

    def __init__(self) -> None:
        super().__init__(
            "stopped by the operator; the axis that was under way does not know where it stands"
        )


class Control:
    """The operator's wishes, which take effect at the end of what has been handed to the board: a
    slice of motion later at most.

    Any thread may call, and a signal handler: wishes are single stores, and who waits is woken by a
    queue that may be entered anew. feed_override: per cent of the programmed feeds, 1 to 200; never
    more than the machine's limits allow, and traverses are not scaled.
    """

    def __init__(self, feed_override: float = 100.0) -> None:
        self._news: SimpleQueue[None] = SimpleQueue()
        self._held = False
        self._stopped = False
        self.override(feed_override)

    @property
    def feed_override(self) -> float:
        """Per cent of the programmed feeds."""
        return self._feed_override

    @property
    def held(self) -> bool:
        """Whether the motion is to rest until :meth:`resume`."""
        return self._held

    @property
    def stopped(self) -> bool:
        """Whether the run is to end."""
        return self._stopped

    def override(self, percent: float) -> None:
        """Scale the programmed feeds. UsageError ``feed-override`` outside 1 to 200 per cent."""
        if not MIN_FEED_OVERRIDE <= percent <= MAX_FEED_OVERRIDE:
            limits = f"{MIN_FEED_OVERRIDE:g} to {MAX_FEED_OVERRIDE:g}"
            raise UsageError(
                Diagnostic(
                    "feed-override",
                    f"a feed override of {percent:g} %",
                    hint=f"give {limits}, per cent of the programmed feeds",
                )
            )
        self._feed_override = percent
        self._news.put(None)

    def hold(self) -> None:
        """Come to rest on the path and wait there."""
        self._held = True
        self._news.put(None)

    def resume(self) -> None:
        """Go on after a hold."""
        self._held = False
        self._news.put(None)

    def stop(self) -> None:
        """Come to rest on the path and end the run."""
        self._stopped = True
        self._news.put(None)

    def wait(self) -> None:
        """Return when the motion is not held, or the run is to end."""
        while self._held and not self._stopped:
            self._news.get()
