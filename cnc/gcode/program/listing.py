"""A text as the flow of control sees it: pages of steps, its control lines, its subroutines and its
line numbers.

Only control lines are ever looked for, and they are told by the first letter of a line; all other
lines are parsed when they are executed. What is kept grows with the number of control lines, not
with the length of the text.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.syntax.parser import MAX_LINE, Syntax
from cnc.gcode.syntax.source_text import Text, Window
from cnc.gcode.syntax.statement import Control, Statement
from cnc.gcode.syntax.words import Word, fault
from cnc.model.diagnostics import CncError, GcodeError

if TYPE_CHECKING:
    from cnc.gcode.program.call_stack import Flow
    from cnc.gcode.program.subprograms import Definition

KEPT_PAGES = 4

_HEADS = {"ngc": "O", "macro-b": "OWDE", "none": ""}
"""First letters of the lines that begin or end something, by the flavour of the language."""
_NO_MEANING = re.compile(r"\([^)]*\)|;.*|[ \t]")
_SUB = re.compile(r"/?(?:n[0-9]+)?o(?:[0-9]+|<[^>]*>)sub")
_PROGRAM = re.compile(r"/?(?:n[0-9]+)?o[0-9]+")


class Step(Protocol):
    """What a line does to the flow of control."""

    def run(self, flow: Flow, line: int) -> int:
        """Carry out the step that stands at ``line``; the number of the line to go on at."""


class Mark(NamedTuple):
    """A place in a listing: line, column (both from 1), length."""

    line: int
    column: int = 0
    length: int = 1


@dataclass(slots=True, eq=False)
class Loop:
    """Lines that may be executed again, ``first`` to ``last``.

    ``at`` is where the loop is named, ``since`` the number of lines that had been executed when it
    was entered.
    """

    name: str
    at: Mark
    first: int
    last: int
    since: int = 0


class Nothing:
    """An empty line, a deleted one, or one that only marks an end."""

    __slots__ = ()

    def run(self, flow: Flow, line: int) -> int:
        """Go on."""
        return line + 1


NOTHING = Nothing()


class Page:
    """A window and what each of its lines does: a step, a statement to execute, or None where that
    has still to be found out.
    """

    __slots__ = ("count", "first", "steps", "window")

    def __init__(self, window: Window) -> None:
        self.window = window
        self.first, self.count = window.first, window.count
        self.steps: list[Step | Statement | None] = [None] * window.count


@dataclass(slots=True)
class Places:
    """Where subroutines (by label) and programs (``O100`` alone, by number) begin, and the lines
    where a name is given again.
    """

    subs: dict[str, int] = field(default_factory=dict)
    programs: dict[int, int] = field(default_factory=dict)
    borders: list[int] = field(default_factory=list)
    subs_again: dict[str, int] = field(default_factory=dict)
    programs_again: dict[int, int] = field(default_factory=dict)


class Listing:
    """A text and what is known of it. ``high``: the last line that was ever executed."""

    def __init__(self, text: Text, syntax: Syntax, *, block_delete: bool = False) -> None:
        self.name = text.name
        self.steps: dict[int, Step] = {}
        self.labels: dict[tuple[int, str], int] = {}
        self.loops: list[Loop] = []
        self.subs: dict[str, Definition] = {}
        self.high = 0
        self._text = text
        self._syntax = syntax
        self._block_delete = block_delete
        self._pages: OrderedDict[int, Page] = OrderedDict()
        self._places: Places | None = None
        self._heads = np.zeros(256, np.bool_)
        self._heads[[ord(letter) for letter in _HEADS[syntax.flavour]]] = True

    def page(self, line: int) -> Page | None:
        """The page that holds a line (from 1); None past the end."""
        window = self._text.window(line)
        if window is None:
            return None
        page = self._pages.get(window.first)
        if page is None:
            page = self._pages[window.first] = Page(window)
            if len(self._pages) > KEPT_PAGES:
                self._pages.popitem(last=False)
        self._pages.move_to_end(window.first)
        return page

    def source(self, line: int) -> str:
        """The text of a line; empty where it is too long to be shown, or past the end."""
        window = self._text.window(line)
        text = "" if window is None else window.text(line - window.first)
        return text if len(text) <= MAX_LINE else ""

    def words(self, line: int) -> tuple[Word, ...]:
        """The words of a line; none past the end."""
        window = self._text.window(line)
        statement = None if window is None else self.statement(window, line - window.first)
        if statement is None:
            return ()
        then = statement.control.then if statement.control else None
        return then.words if then else statement.words

    def statement(self, window: Window, index: int) -> Statement | None:
        """The parsed line; None for a line that block delete skips unread. Errors have their
        place.
        """
        if self._block_delete and window.text(index).lstrip(" \t").startswith("/"):
            return None
        try:
            return window.statement(index, self._syntax)
        except GcodeError as error:
            raise self.placed(error, window.first + index) from None

    def placed(self, error: GcodeError, line: int) -> CncError:
        """The error with file, line and text, as far as it does not name them itself."""
        known = error.diagnostic
        if known.file:
            return error
        line = known.line or line
        return error.at(file=self.name, line=line, text=known.text or self.source(line))

    def wrong(
        self, line: int, control: Control, code: str, message: str, hint: str = ""
    ) -> CncError:
        """An error at a control line."""
        return self.fault(Mark(line, control.column, control.length), code, message, hint)

    def fault(self, at: Mark, code: str, message: str, hint: str = "") -> CncError:
        """An error at a place of this listing."""
        return self.placed(
            fault(code, message, hint=hint, column=at.column, length=at.length), at.line
        )

    def control(self, line: int) -> Control:
        """The control line that stands at a line where one is known to be."""
        return next(self.control_lines(line))[1]

    def control_lines(self, line: int) -> Iterator[tuple[int, Control]]:
        """The lines from ``line`` on that begin or end something; calls and jumps may be among
        them.
        """
        for number, window, index in self._candidates(line):
            statement = self.statement(window, index)
            if statement is not None and statement.control is not None:
                yield number, statement.control

    def places(self) -> Places:
        """Where subroutines and programs begin. The whole text is looked through once, nothing but
        their first lines is parsed.
        """
        if self._places is None:
            self._places = Places()
            for number, window, index in self._candidates(1):
                text = _NO_MEANING.sub("", window.text(index)).lower()
                if not (_SUB.match(text) or _PROGRAM.fullmatch(text)):
                    continue
                statement = self.statement(window, index)
                if statement is not None and statement.control is not None:
                    _note(self._places, number, statement.control)
        return self._places

    def program_around(self, line: int) -> tuple[int, int]:
        """First line of the program that a line belongs to, and the first line behind it (a large
        number for the end of the text).
        """
        borders = self.places().borders
        index = bisect_right(borders, line)
        return borders[index - 1] if index else 1, borders[index] if index < len(
            borders
        ) else 1 << 62

    def numbered(self, number: int, begin: int, end: int) -> int | None:
        """The first line from ``begin`` on, before ``end``, whose N word has the number."""
        line = begin
        while line < end and (window := self._text.window(line)) is not None:
            offset = line - window.first
            for index in (np.flatnonzero(window.label[offset:] == number) + offset).tolist():
                if window.first + index < end and self.statement(window, index) is not None:
                    return window.first + index
            line = window.first + window.count
        return None

    def _candidates(self, line: int) -> Iterator[tuple[int, Window, int]]:
        """Lines whose first letter may belong to a control line: number, window, index in it."""
        while (window := self._text.window(line)) is not None:
            offset = line - window.first
            found: NDArray[np.intp] = np.flatnonzero(self._heads[window.head[offset:]]) + offset
            for index in found.tolist():
                yield window.first + index, window, index
            line = window.first + window.count


def _note(places: Places, line: int, control: Control) -> None:
    assert isinstance(control.label, str), "only written labels are looked for"
    if control.keyword == "program":
        places.borders.append(line)
        number = int(control.label)
        if places.programs.setdefault(number, line) != line:
            places.programs_again.setdefault(number, line)
    elif control.keyword == "sub" and places.subs.setdefault(control.label, line) != line:
        places.subs_again.setdefault(control.label, line)
