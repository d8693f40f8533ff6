"""Where a request of the operator may begin.

handed out │ finished, in slices │ held back │ window
           ^                     ^           ^
  INSIDE_CHAIN, FINISHED     HELD_BACK     WINDOW
"""

from __future__ import annotations

from enum import Enum

PARTS = (0.0, 0.5)
"""Parts of a slice by which a hold inside of a motion past corners may begin later: near to the
limits, there may be no other motion for a while.
"""

LEAST_LATER = 0.02
"""s; a hold does not begin by less than this later: the next slice comes as soon."""

SEARCH_AGAIN = 0.1
"""s; after a search inside of a motion past corners that finds no stop, so much is handed out
before the next one. A search takes computing time, in which the board plays the last slice.
"""


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
