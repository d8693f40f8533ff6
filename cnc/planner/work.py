"""Computing time that the motion allows for searches.

A search is given up where it would take longer: the simpler plan stays. The time is counted by the
steps of each search, at the seconds that a step takes on a quiet machine. A count does not depend
on the machine or on the number of its cores, as a clock would. So the motion does not either.

    left = FIRST at first,  + RATE * time of the run,  - steps of searches

A plan may use a part of what its own motion will allow, before that motion is under way. Where
less is used, no more than ``first`` is kept: in a run in real time a plan must not take longer.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

FIRST = 0.65
"""s; computing time of a planner that needs no motion. Short programs live by it: with half of it a
NURBS of 0.91 s takes 1.4 s.
"""

RATE = 0.08
"""Computing time of a planner by the time of the run."""

FIRST_OF_TRIALS, RATE_OF_TRIALS = 0.25, 0.02
"""Those of the trials of two paths along the same moves, by the time of their motion."""


INTERVAL = 4e-6
"""s; computing time of an interval: of the path, and of the samples of it."""


class Work:
    """The computing time that is left.

    Attributes:
        left: (1,): s; searches lower it.
        rate: computing time by the time of the motion.
    """

    def __init__(self, first: float = FIRST, rate: float = RATE) -> None:
        self.left = np.full(1, first)
        self.rate = rate
        self._first = first
        self._time = 0.0

    def reach(self, time: float) -> None:
        """Allow computing for the run up to ``time``, s; none for a time before the last one."""
        self.earn(time - self._time)
        self._time = max(time, self._time)

    def earn(self, duration: float) -> None:
        """Allow computing for so many seconds of motion."""
        if duration > 0.0:
            left = self.left[0]
            self.left[0] = max(left, min(left + self.rate * duration, self._first))

    def begin_again(self) -> None:
        """Allow what is allowed at first: a request has made the work on a plan useless."""
        self.left[0] = max(self.left[0], self._first)

    @contextmanager
    def ahead(self, duration: float) -> Iterator[None]:
        """Allow computing for motion that is not under way, as a loan."""
        self.left += self.rate * duration
        yield
        self.left -= self.rate * duration
