"""The lines that a GRBL board has not answered yet, in the order in which they were sent."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from cnc.boards.grbl.events import SentLine
from cnc.boards.grbl.line_groups import LineGroup
from cnc.boards.grbl.line_kinds import ALONE


@dataclass(slots=True)
class _Part:
    """Unanswered lines of one group: from number ``first`` up to, but not including, ``end``."""

    group: LineGroup
    first: int
    end: int
    expected: Mapping[str, float] | None = None
    """Of a mark: feed and speed by the lines before it."""

    @property
    def oldest(self) -> SentLine:
        group, first = self.group, self.first
        return SentLine(
            group.part(first, first + 1).rstrip("\n"),
            group.lines[first],
            group.kind,
            group.seconds,
        )


class UnansweredLines:
    """A queue of lines, which are kept as parts of their groups.

    Attributes:
        count: Number of lines.
        bytes: Their size.
        alone: Whether it is a line beside which no other may be unanswered.
    """

    def __init__(self) -> None:
        self._parts: deque[_Part] = deque()
        self.count = self.bytes = 0
        self.alone = False

    @property
    def oldest(self) -> SentLine | None:
        """The line that is answered next."""
        return self._parts[0].oldest if self._parts else None

    @property
    def oldest_group(self) -> LineGroup | None:
        """Its group."""
        return self._parts[0].group if self._parts else None

    @property
    def expected(self) -> Mapping[str, float] | None:
        """Feed and speed at the mark, if that is answered next; else None."""
        return self._parts[0].expected if self._parts else None

    @property
    def newest_line(self) -> int:
        """The source line of the line that was sent last; 0 without an unanswered line."""
        return self._parts[-1].group.lines[self._parts[-1].end - 1] if self._parts else 0

    @property
    def marked_line(self) -> int:
        """The source line of the oldest mark; 0 without a mark."""
        marks = (part.group.lines[0] for part in self._parts if part.expected is not None)
        return next(marks, 0)

    def append(
        self,
        group: LineGroup,
        first: int,
        end: int,
        expected: Mapping[str, float] | None = None,
    ) -> None:
        """Append lines of a group, from ``first`` up to ``end``; ``expected`` is for a mark."""
        self.count += end - first
        self.alone = group.kind in ALONE
        self.bytes += group.ends[end] - group.ends[first]
        last = self._parts[-1] if self._parts else None
        if last is not None and last.group is group:
            last.end = end
        else:
            self._parts.append(_Part(group, first, end, expected))

    def pop(self) -> SentLine:
        """Remove and return the oldest line."""
        sent = self._parts[0].oldest
        self.drop(1)
        return sent

    def drop(self, count: int) -> int:
        """Remove the oldest ``count`` lines; return the source line of the last, or 0."""
        self.count -= count
        line = 0
        while count:
            part = self._parts[0]
            first, end = part.first, min(part.first + count, part.end)
            ends = part.group.ends
            self.bytes -= ends[end] - ends[first]
            count -= end - first
            line = part.group.lines[end - 1] or line
            part.first = end
            if end == part.end:
                self._parts.popleft()
                self.alone = False
        return line

    def clear(self) -> None:
        """Forget all lines."""
        self._parts.clear()
        self.count = self.bytes = 0
        self.alone = False
