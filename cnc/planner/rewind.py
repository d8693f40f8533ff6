"""Earlier states of the window, for a part of the plan that is held back.

Corners hold back what a later plan may change (:mod:`cnc.planner.corner_motions`). Nothing of it
was sent, so a hold or an override may begin where it begins. The window has left that place, but a
copy of it has not.

    sent │ held back, in slices  │ window
         |     ^           ^     ^
         |    copy        copy   now
       hold
"""

from __future__ import annotations

from cnc.path.chunk import PathChunk
from cnc.planner.window import Window

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
        other = Rewind()
        other._copies = [each for each in self._copies if each[0] < time - SAME]
        other._added = self._added[:]
        return other

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
        earlier = [each for each in self._copies if each[0] <= time + ROUNDING]
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
