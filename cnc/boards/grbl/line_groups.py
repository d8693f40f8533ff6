"""Groups of lines that are sent to a GRBL board one after the other.

A line for each motion would cost a dozen calls for each of them. So motions that follow each other
are one group: sending takes a slice of its text. Any other line is a group of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cnc.boards.grbl.line_kinds import MOST_CHARACTERS, Kind, kind_of, seconds_of
from cnc.model.line_effects import MOTIONS, LineKind, row_type
from cnc.model.packed_lines import PackedLines

MOST_LINES = 128
"""Lines of a group. More would take a noticeable time before the first of them is sent."""
TIMED = ("dwell", "system", "writer")
"""Kinds of lines whose text tells how long they take."""
FOLLOWING = sorted(MOTIONS - {LineKind.PROBE})
"""Effects of lines that follow each other in a group."""
NO_ROWS = np.empty(0, row_type(3))


@dataclass(frozen=True, slots=True, eq=False)
class LineGroup:
    """Lines of one kind. A group of several lines is ``plain``.

    Attributes:
        kind: Their kind.
        text: Their text, each with its line end.
        ends: Bytes before the first line, and up to the end of each (n + 1,).
        lines: Source line of each (n,).
        rows: Source line and effect of each (n,), see :func:`cnc.model.line_effects.row_type`;
            empty for a line that the driver itself sends at rest.
        seconds: Longest time without motion, s.
    """

    kind: Kind
    text: str
    ends: list[int]
    lines: list[int]
    rows: NDArray[np.void] = field(default_factory=lambda: NO_ROWS)
    seconds: float = 0.0

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def acts(self) -> bool:
        """Whether the lines do more than change modes, and are no command of the board."""
        return self.kind != "system" and bool(self.rows["kind"][0] != LineKind.MODES)

    def part(self, first: int, end: int) -> str:
        """Return the text of some of the lines."""
        return self.text[self.ends[first] : self.ends[end]]


def single(
    text: str, line: int, kind: Kind | None = None, rows: NDArray[np.void] = NO_ROWS
) -> LineGroup:
    """Return a group of one line.

    Args:
        text: The line without its end.
        line: Its source line.
        kind: Its kind, where it is known.
        rows: Its effect.
    """
    kind = kind or kind_of(text)
    seconds = seconds_of(text) if kind in TIMED else 0.0
    return LineGroup(kind, text + "\n", [0, len(text) + 1], [line], rows, seconds)


def groups_of(lines: PackedLines) -> Iterator[LineGroup]:
    """Yield lines in groups. A line that is too long for the board is alone."""
    sizes, rows, text = lines.sizes, lines.rows, lines.text
    follows = np.isin(rows["kind"], FOLLOWING) & (sizes <= MOST_CHARACTERS + 1)
    breaks = np.append(np.flatnonzero(~follows), len(rows)).tolist()
    ends = np.cumsum(np.append(0, sizes))
    first = at = 0
    while first < len(rows):
        if breaks[at] == first:
            end, at = first + 1, at + 1
        else:
            end = min(breaks[at], first + MOST_LINES)
        some, part = rows[first:end], text[ends[first] : ends[end]]
        numbers = some["line"].tolist()
        kind = int(some["kind"][0])
        if kind in FOLLOWING:
            yield LineGroup(
                "plain", part, (ends[first : end + 1] - ends[first]).tolist(), numbers, some
            )
        else:
            known: Kind | None = "probe" if kind == LineKind.PROBE else None
            yield single(part[:-1], numbers[0], known, some)
        first = end
