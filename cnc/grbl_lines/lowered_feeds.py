"""Feeds that lines lower, because of small arcs or the rate at which the board takes lines."""

from __future__ import annotations

from typing import Literal

from cnc.model.diagnostics import Diagnostic

Cause = Literal["small arcs", "short lines"]

MARKED = 0.95
"""Part of the programmed feed below which it counts as lowered."""
WORTH_A_NOTE = 0.005
"""Part of the feed time from which on lowered feeds are reported."""
ADVICE = {
    "small arcs": "the acceleration of the axes limits the speed on an arc",
    "short lines": (
        "the board takes no more lines a second: use a coarser tolerance in the CAM system"
    ),
}


class LoweredFeeds:
    """Adds up the time of the moves with a lowered feed."""

    def __init__(self) -> None:
        self._total = 0.0
        self._seconds: dict[Cause, float] = {}
        self._first: dict[Cause, int] = {}

    def moved(self, length: float, speed: float) -> None:
        """Note a feed move: its length in mm and its speed in mm/s."""
        self._total += length / max(speed, 1e-6)

    def lowered(self, cause: Cause, line: int, length: float, speed: float, feed: float) -> None:
        """Note a cause that limits a move to a speed, mm/s, of the programmed feed, mm/s."""
        if speed < MARKED * feed:
            self._seconds[cause] = self._seconds.get(cause, 0.0) + length / max(speed, 1e-6)
            self._first.setdefault(cause, line)

    def findings(self) -> list[Diagnostic]:
        """Return a note for each cause, at its first line."""
        return [
            Diagnostic(
                "feed-lowered",
                f"{cause} lower the feed from here on, in {100.0 * share:.0f} % of the feed time",
                line=self._first[cause],
                hint=ADVICE[cause],
                severity="note",
            )
            for cause, seconds in self._seconds.items()
            if (share := min(seconds / max(self._total, 1e-9), 1.0)) >= WORTH_A_NOTE
        ]
