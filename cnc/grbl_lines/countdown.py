"""The time that is left of a program while a GRBL board carries it out."""

from __future__ import annotations

from cnc.grbl_lines.grbl_timing import BoardTime

UNREPORTED_LINES = 2
"""Lines that the board may have carried out since its last report."""


class Countdown:
    """Counts down the time of a program.

    The board reports the line that it is on, but not how far along it is, and the report is as old
    as the interval between two. So the clock runs on between two bounds: the time left after the
    next lines, and the time left before the present line. It stands while the motion is held.
    """

    def __init__(self, time: BoardTime) -> None:
        """``time``: of all the lines of the program."""
        self._time = time
        self._overrides = (100.0, 100.0)
        self._left = time.remaining(0)
        self._at: float | None = None

    def left(
        self,
        now: float,
        done: int,
        *,
        held: bool,
        feed_override: float = 100.0,
        rapid_override: float = 100.0,
    ) -> float:
        """Return the time that is left, s.

        Args:
            now: Present time, s.
            done: Lines that the board has carried out.
            held: Whether the motion is held.
            feed_override: In per cent.
            rapid_override: In per cent.
        """
        overrides = feed_override, rapid_override
        most = self._time.remaining(done, *overrides)
        if overrides != self._overrides:
            before = self._time.remaining(done, *self._overrides)
            self._left *= most / before if before > 0.0 else 1.0
            self._overrides = overrides
        if self._at is not None and not held:
            self._left -= now - self._at
        self._at = now
        least = self._time.remaining(done + UNREPORTED_LINES, *overrides)
        self._left = min(max(self._left, least), most)
        return self._left
