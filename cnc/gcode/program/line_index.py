"""An index of a program's text: its control lines, subroutines, programs and N numbers.

A control line is found by the first letter of the line. No other line is parsed before it is
executed. The index grows with the number of control lines, not with the length of the text.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.reader.lines import MAX_LINE
from cnc.gcode.syntax.mending import inner_slash
from cnc.gcode.syntax.parser import Syntax, parse_line
from cnc.gcode.syntax.source_text import Text, Window
from cnc.gcode.syntax.statement import Control, Statement
from cnc.gcode.syntax.words import Word, fault
from cnc.kernels.gcode.statements import Names
from cnc.model.diagnostics import CncError, GcodeError

_CONTROL_LETTERS = {"ngc": "O", "macro-b": "OWDE", "siemens": "", "klartext": "", "none": ""}
"""First letters of lines that may begin or end a block, a subroutine or a program, by flavour."""
_END_OF_TEXT = 1 << 62
"""A line number beyond that of any line."""
_ALL_SWITCHES = frozenset(range(1, 10))
"""Switches of block delete; ``/`` alone is that of ``/1``."""
_SLASH = re.compile(r"[ \t]*/[ \t]*([1-9](?![0-9.]))?")
_COMMENTS_AND_BLANKS = re.compile(r"\([^)]*\)|;.*|[ \t]")
_PERCENT = re.compile(rb"(?<![^\r\n])[ \t]*%")
_SUB = re.compile(r"/?(?:n[0-9]+)?o(?:[0-9]+|<[^>]*>)sub")
PROGRAM = re.compile(r"/?(?:n[0-9]+)?o(?:([0-9]+)|<[^>]*>)")
"""The O number of a program, alone in its line, as ``bare_text`` gives it."""


def bare_text(text: str) -> str:
    """Return a line without comments and blanks, in lower case."""
    return _COMMENTS_AND_BLANKS.sub("", text).lower()


class Place(NamedTuple):
    """A place in a text: line and column (both from 1) and length."""

    line: int
    column: int = 0
    length: int = 1


@dataclass(slots=True)
class Definitions:
    """The lines of a text at which subroutines and programs begin.

    Attributes:
        subs: Line of each ``o1 sub``, by label.
        programs: Line of each ``O100`` alone, by number.
        borders: Lines at which a program begins, ascending.
        repeated_subs: Line at which a label is defined for the second time.
        repeated_programs: Line at which a program number stands for the second time.
        behind: Line of the ``%`` that ends the text, by the numbers of the programs behind it.
    """

    subs: dict[str, int] = field(default_factory=dict)
    programs: dict[int, int] = field(default_factory=dict)
    borders: list[int] = field(default_factory=list)
    repeated_subs: dict[str, int] = field(default_factory=dict)
    repeated_programs: dict[int, int] = field(default_factory=dict)
    behind: dict[int, int] = field(default_factory=dict)

    def add(self, line: int, control: Control) -> None:
        """Add a control line, if it begins a subroutine or a program."""
        assert isinstance(control.label, str), "the search takes written labels only"
        if control.keyword == "program":
            self.borders.append(line)
            if not control.label.isdigit():
                return
            number = int(control.label)
            if self.programs.setdefault(number, line) != line:
                self.repeated_programs.setdefault(number, line)
        elif control.keyword == "sub" and self.subs.setdefault(control.label, line) != line:
            self.repeated_subs.setdefault(control.label, line)


class LineIndex:
    """Gives access to the lines of a text by number, and finds lines by their content."""

    def __init__(
        self, text: Text, syntax: Syntax, *, block_delete: frozenset[int] | bool = False
    ) -> None:
        self.name = text.name
        self._text = text
        self._syntax = syntax
        text.language = syntax.language
        self._block_delete = _ALL_SWITCHES if block_delete is True else block_delete or frozenset()
        self._definitions: Definitions | None = None
        self._is_control_letter = np.zeros(256, np.bool_)
        self._is_control_letter[[ord(letter) for letter in _CONTROL_LETTERS[syntax.flavour]]] = True

    def window(self, line: int) -> Window | None:
        """Return the window of the text that holds a line (from 1); None past the end."""
        window = self._text.window(line)
        if window is not None and self._syntax.dialect == "fagor":
            window.leave_to_parser()
        return window

    def source(self, line: int) -> str:
        """Return the text of a line; empty past the end or if the line is too long to show."""
        window = self._text.window(line)
        text = "" if window is None else window.text(line - window.first)
        return text if len(text) <= MAX_LINE else ""

    def words(self, line: int) -> tuple[Word, ...]:
        """Return the words of a line; none past the end."""
        window = self._text.window(line)
        statement = None if window is None else self.statement(window, line - window.first)
        if statement is None:
            return ()
        then = statement.control.then if statement.control else None
        return then.words if then else statement.words

    def statement(self, window: Window, index: int) -> Statement | None:
        """Return the parsed line at ``index`` of a window; None if block delete skips it.

        Raises:
            GcodeError: A syntax error, with file and line.
        """
        if self._block_delete and (slash := _SLASH.match(window.text(index))):
            switch = int(slash[1] or 1)
            if switch in self._block_delete:
                return None
        try:
            if 1 in self._block_delete and self._syntax.skips_inside:
                text = window.text(index)
                if (inner := inner_slash(text)) is not None:
                    return parse_line(text[:inner], self._syntax)
            return window.statement(index, self._syntax)
        except GcodeError as error:
            raise self.placed(error, window.first + index) from None

    def names(self, window: Window) -> tuple[bytes, Names, list[bool] | None]:
        """Return a text with the names of parameters, their places, and which are left alone.

        Compiled code must not set the latter; None for none.
        """
        found = window.code().names
        if self._syntax.flavour != "siemens":
            return window.data, found, None
        names = list(map(self._syntax.names.in_compiled_code, window.names(found)))
        sizes = np.array([len(name) for name, _ in names], np.int32)
        ends = np.cumsum(sizes, dtype=np.int32)
        text = "".join(name for name, _ in names).encode("ascii")
        return text, found._replace(begin=ends - sizes, end=ends), [not free for _, free in names]

    def placed(self, error: GcodeError, line: int) -> CncError:
        """Return the error with file, line and text added where it lacks them."""
        known = error.diagnostic
        if known.file:
            return error
        line = known.line or line
        return error.at(file=self.name, line=line, text=known.text or self.source(line))

    def control_fault(
        self, line: int, control: Control, code: str, message: str, hint: str = ""
    ) -> CncError:
        """Return an error at a control line."""
        return self.fault(Place(line, control.column, control.length), code, message, hint)

    def fault(self, at: Place, code: str, message: str, hint: str = "") -> CncError:
        """Return an error at a place of this text."""
        return self.placed(
            fault(code, message, hint=hint, column=at.column, length=at.length), at.line
        )

    def control(self, line: int) -> Control:
        """Return the control at a line that is known to have one."""
        return next(self.control_lines(line))[1]

    def control_lines(self, line: int) -> Iterator[tuple[int, Control]]:
        """Yield the control lines from ``line`` on with their numbers.

        Lines that begin or end a block are complete; only some calls and jumps are among them.
        """
        for number, window, index in self._candidates(line):
            statement = self.statement(window, index)
            if statement is not None and statement.control is not None:
                yield number, statement.control

    def definitions(self) -> Definitions:
        """Return the beginnings of subroutines and programs.

        The whole text is searched once; only their first lines are parsed.
        """
        if self._definitions is None:
            self._definitions = Definitions()
            end = self._end_of_tape()
            for number, window, index in self._candidates(1):
                text = bare_text(window.text(index))
                if number > end:
                    if (found := PROGRAM.fullmatch(text)) and found[1]:
                        self._definitions.behind[int(found[1])] = end
                    continue
                if not (_SUB.match(text) or PROGRAM.fullmatch(text)):
                    continue
                statement = self.statement(window, index)
                if statement is not None and statement.control is not None:
                    self._definitions.add(number, statement.control)
        return self._definitions

    def _end_of_tape(self) -> int:
        """Return the line of the % that ends the text; a very large number if there is none.

        It is the second one, or the first that has code before it.
        """
        line, opened, code = 1, False, False
        while (window := self._text.window(line)) is not None:
            index = 0
            while index < window.count:
                found = window.find(_PERCENT, index, window.count)
                words = window.sorted.lines.first
                code = code or bool(words[found] > words[index])
                if found < window.count:
                    if opened or code:
                        return window.first + found
                    opened = True
                index = found + 1
            line = window.first + window.count
        return _END_OF_TEXT

    def program_around(self, line: int) -> tuple[int, int]:
        """Return the first line of the program around a line, and the first line after it.

        The latter is a very large number if the program is the last of the text.
        """
        borders = self.definitions().borders
        index = bisect_right(borders, line)
        return (
            borders[index - 1] if index else 1,
            borders[index] if index < len(borders) else _END_OF_TEXT,
        )

    def numbered(self, number: int, begin: int, end: int) -> int | None:
        """Return the first line from ``begin`` to before ``end`` with this N number, or None."""
        line = begin
        while line < end and (window := self._text.window(line)) is not None:
            offset = line - window.first
            for index in (np.flatnonzero(window.label[offset:] == number) + offset).tolist():
                if window.first + index < end and self.statement(window, index) is not None:
                    return window.first + index
            line = window.first + window.count
        return None

    def _candidates(self, line: int) -> Iterator[tuple[int, Window, int]]:
        """Yield lines that begin like a control line: number, window, index in the window."""
        while (window := self._text.window(line)) is not None:
            offset = line - window.first
            found: NDArray[np.intp] = (
                np.flatnonzero(self._is_control_letter[window.head[offset:]]) + offset
            )
            for index in found.tolist():
                yield window.first + index, window, index
            line = window.first + window.count
