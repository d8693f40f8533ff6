"""Where a request of the operator may begin.

handed out │ finished, in slices │ held back │ window
           ^                     ^           ^
  INSIDE_CHAIN, FINISHED     HELD_BACK     WINDOW
"""

from __future__ import annotations

from enum import Enum


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
