"""What drivers accept. Everything carries the source line, so that a fault on the board can name
it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.model.line_effects import LineEffect


@dataclass(frozen=True, slots=True)
class PulseChunk:
    """Grid moves, one a row, in the order in which they happen.

    time_ns int64 (n,): since the start of the program, non-decreasing. step int8 (n, axes): -1, 0
    or +1; axes that step together share a row and no row is all zero. line int32 (n,).
    """

    time_ns: NDArray[np.int64]
    step: NDArray[np.int8]
    line: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class SampleChunk:
    """Positions at a fixed period: row k of the program is at ``(first + k) * period`` seconds.

    position (n, axes) mm; s, feed, accel, jerk (n,): path length from the start of the program and
    its derivatives (tangential); step_deviation (n,): relative difference between the step made and
    the step commanded; line int32 (n,).
    """

    first: int
    period: float
    position: NDArray[np.float64]
    s: NDArray[np.float64]
    feed: NDArray[np.float64]
    accel: NDArray[np.float64]
    jerk: NDArray[np.float64]
    step_deviation: NDArray[np.float64]
    line: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class GcodeLine:
    """A line for a board that plans for itself.

    Attributes:
        text: The line without its line end.
        line: The source line that it comes from.
        effect: The motion of the line; None where the writer of the line does not know it.
    """

    text: str
    line: int
    effect: LineEffect | None = None
