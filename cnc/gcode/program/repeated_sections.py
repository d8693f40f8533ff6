"""Sections of a text that SINUMERIK's REPEAT is executing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cnc.gcode.program.call_stack import Listing


@dataclass(slots=True, eq=False)
class Section:
    """Lines that REPEAT executes again.

    Attributes:
        listing: Their text.
        depth: Number of calls around them.
        first: The first of them.
        last: The last of them.
        after: The line after REPEAT.
        repeats_left: Number of executions to come after this one.
    """

    listing: Listing
    depth: int
    first: int
    last: int
    after: int
    repeats_left: int


class Sections:
    """The sections that are being executed, outermost first."""

    __slots__ = ("_open",)

    def __init__(self) -> None:
        self._open: list[Section] = []

    def begin(self, section: Section) -> None:
        """Begin to execute a section."""
        self._open.append(section)

    def state(self) -> list[tuple[int, int]]:
        """Return the first line and the repeats left of each section."""
        return [(section.first, section.repeats_left) for section in self._open]

    def leave(self, depth: int, target: int) -> None:
        """End the sections of a call that a jump to a line leaves."""
        while self._open:
            section = self._open[-1]
            if section.depth != depth or section.first <= target <= section.last + 1:
                return
            self._open.pop()

    def after(self, listing: Listing, depth: int, line: int) -> int:
        """Return the line to continue at behind a section; 0 if none ends before this line."""
        section = self._open[-1] if self._open else None
        if (
            section is None
            or section.last + 1 != line
            or section.listing is not listing
            or section.depth != depth
        ):
            return 0
        if section.repeats_left:
            section.repeats_left -= 1
            return section.first
        self._open.pop()
        return section.after
