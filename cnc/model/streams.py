"""Chunks and lines for boards, each with its source lines, so that faults can name them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.model.line_effects import LineEffect, rows_of


@dataclass(frozen=True, slots=True)
class PulseChunk:
    """Grid moves, one per row, in order of time.

    Attributes:
        time_ns: Time since the start of the program (n,), ns, non-decreasing.
        step: Steps of each axis (n, axes): -1, 0 or +1. Axes that step together share a row, and no
            row is all zero.
        line: Source line (n,).
    """

    time_ns: NDArray[np.int64]
    step: NDArray[np.int8]
    line: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class SampleChunk:
    """Positions at a fixed period: row k of the chunk is at ``(first + k) * period`` seconds.

    Attributes:
        first: Number of the first sample in the program.
        period: Sampling period, s.
        position: Positions (n, axes), mm.
        s: Path length since the start of the program (n,), mm.
        feed: First derivative of the path length (n,), mm/s.
        accel: Second derivative of the path length (n,), mm/s^2.
        jerk: Third derivative of the path length (n,), mm/s^3.
        step_deviation: Relative difference between actual and commanded step (n,).
        line: Source line (n,).
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


class LinesSent(NamedTuple):
    """The lines of a run that a board has been sent. Times are those of its clock, s.

    Attributes:
        number: Number of lines.
        began: Time of the first line that does more than change modes; None without one.
        rested_at: Time of the report that last showed the machine at rest with nothing to do.
    """

    number: int = 0
    began: float | None = None
    rested_at: float = 0.0


class GcodeLine(NamedTuple):
    """A line of G-code for a board that plans its own motion.

    Attributes:
        text: The line without its line end.
        line: The source line that it comes from.
        effect: The motion of the line; None where the writer of the line does not know it.
    """

    text: str
    line: int
    effect: LineEffect | None = None


new_line: Callable[[tuple[str, int, LineEffect | None]], GcodeLine] = partial(
    tuple.__new__, GcodeLine
)
"""Make a line of all its fields. A call of the type would take a function of Python."""


# Lines for a board, packed so that a long program fits in memory.


@dataclass(frozen=True, slots=True)
class PackedLines:
    """A sequence of lines.

    Attributes:
        text: The lines, each with its line end.
        rows: Source line and effect of each line (n,), see
            :func:`~cnc.model.line_effects.row_type`.
    """

    text: str
    rows: NDArray[np.void]

    @classmethod
    def of(cls, lines: Sequence[GcodeLine]) -> PackedLines:
        """Pack lines."""
        text = "".join([line.text + "\n" for line in lines])
        rows = rows_of([line.line for line in lines], [line.effect for line in lines])
        return cls(text, rows)

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Bytes of each line with its end (n,)."""
        ends = np.flatnonzero(np.frombuffer(self.text.encode(), np.uint8) == ord("\n"))
        return np.diff(ends, prepend=-1)

    @property
    def size(self) -> int:
        """Bytes of memory."""
        return len(self.text) + self.rows.nbytes

    def __len__(self) -> int:
        return len(self.rows)
