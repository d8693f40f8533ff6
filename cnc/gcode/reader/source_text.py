"""The text of a program: lines by number, in any order, in bounded memory.

A file is read in windows of some thousand lines. Loops and calls lead to lines outside of the
current window. So the last few windows are kept, and the position of each window in the file.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import weakref
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.kernels.statements import Coded, Names
from cnc.gcode.reader.lines import KLARTEXT, MAX_LINE, NGC, Language, Positions, Sorted, read_lines
from cnc.gcode.reader.parser import MEMO, Syntax, inner_slash, parse_line, siemens_lines
from cnc.gcode.reader.statements import Control, Statement, squeezed
from cnc.gcode.reader.words import Word, fault
from cnc.model.diagnostics import CncError, Diagnostic, Fix, GcodeError, UsageError

WINDOW_BYTES = 1 << 18
KEPT_WINDOWS = 4

_LF, _CR = 10, 13
BOM = b"\xef\xbb\xbf"
_NOT_UTF8 = "latin-1"
_NOT_BYTES = b"\0"
"""Ends the bytes of a line that cannot be bytes, or not one line. No plain line has it."""
_FIRST_LINES, _MOST_LINES = 64, 8192
"""Lines of the first and of the largest window over lines in memory. The first is short, so that a
program starts soon.
"""


class Splits(NamedTuple):
    """The lines of some bytes.

    Attributes:
        begin: (lines,) position of the first byte of each line.
        end: (lines,) position after the last byte.
        size: Number of bytes, line ends included.
    """

    begin: Positions
    end: Positions
    size: int


def split(data: bytes, *, whole: bool) -> Splits:
    r"""Return the lines of some bytes. They end in ``\n``, ``\r\n`` or ``\r``.

    Args:
        data: The bytes.
        whole: Whether they end the text. If not, a last line without an end is left out, and one
            that ends in a ``\r`` at the end of the bytes: a ``\n`` may follow.
    """
    chars = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(chars == _LF)
    after = ends + 1
    if b"\r" in data:
        returns = np.flatnonzero(chars == _CR)
        # A \n behind a \r belongs to it.
        second = (chars[ends - 1] == _CR) & (ends > 0)
        joined = ends[second] - 1
        ends = np.sort(np.concatenate((ends[~second], returns)))
        after = ends + 1
        after[np.searchsorted(ends, joined)] += 1
    if not whole and len(ends) and ends[-1] + 1 == len(data) and chars[-1] == _CR:
        ends, after = ends[:-1], after[:-1]
    if whole and (not len(after) or after[-1] < len(data)) and len(data):
        ends, after = np.append(ends, len(data)), np.append(after, len(data))
    begins = np.concatenate([[0], after[:-1]]) if len(after) else after
    size = int(after[-1]) if len(after) else 0
    return Splits(begins.astype(np.int32), ends.astype(np.int32), size)


class Window:
    """Consecutive lines of a text. Methods take the index of a line in the window, from 0.

    Attributes:
        first: Number of the first line, from 1.
        count: Number of lines.
        data: The bytes of the lines.
        language: The language in which the lines are read.
        has_expressions: Whether a line may have parameters or expressions.
    """

    def __init__(
        self,
        first: int,
        data: bytes,
        lines: Splits,
        texts: dict[int, str] | None = None,
    ) -> None:
        """Create a window.

        Args:
            first: Number of the first line.
            data: The bytes of the lines.
            lines: Places of the lines in them.
            texts: Text by index of the lines whose bytes differ from the text.
        """
        self.first, self.count = first, len(lines.begin)
        self.language = NGC
        self.data, self._begin, self._end = data, lines.begin, lines.end
        self._texts = texts or {}
        self.has_expressions = b"#" in data or b"[" in data or b"=" in data

    def read_as(self, language: Language) -> Window:
        """Read the lines in a language."""
        if language != self.language:
            self.language = language
            self.__dict__.pop("sorted", None)
        return self

    @cached_property
    def sorted(self) -> Sorted:
        """The lines as words and items."""
        return read_lines(self.data, self._begin, self._end, self.language)

    @property
    def head(self) -> NDArray[np.uint8]:
        """See :class:`cnc.gcode.kernels.statements.Lines`, as for the next three."""
        return self.sorted.lines.head

    @property
    def label(self) -> NDArray[np.int64]:
        """N numbers."""
        return self.sorted.lines.label

    @property
    def plain(self) -> NDArray[np.int32]:
        """Numbers of consecutive plain lines."""
        return self.sorted.lines.plain

    @property
    def simple(self) -> NDArray[np.int32]:
        """Numbers of consecutive lines in which no word is repeated."""
        return self.sorted.lines.simple

    @property
    def places(self) -> tuple[Positions, Positions]:
        """Begin and end of each line in the bytes."""
        return self._begin, self._end

    def line_words(self, index: int) -> tuple[list[int], list[float]]:
        """Return the codes of the letters and the numbers of the words of a plain line."""
        lines, words, *_ = self.sorted
        begin, end = lines.first[index : index + 2].tolist()
        return words.letter[begin:end].tolist(), words.number[begin:end].tolist()

    def code(self) -> Coded:
        """Return the lines as instructions."""
        return self.sorted.coded

    def leave_to_parser(self) -> None:
        """Take no line for plain: words and comments have a meaning of their own."""
        self.plain[:] = 0
        self.simple[:] = 0

    def names(self, names_of_lines: Names) -> list[str]:
        """Return different names in the lines, in small letters. All are ASCII."""
        spans = map(slice, names_of_lines.begin.tolist(), names_of_lines.end.tolist())
        return [self.data[span].decode().lower() for span in spans]

    def text(self, index: int) -> str:
        """Return a line without its end. It is read as Latin-1 if it is not UTF-8."""
        if index in self._texts:
            return self._texts[index]
        line = self.data[self._begin[index] : self._end[index]]
        try:
            return line.decode()
        except UnicodeDecodeError:
            return line.decode(_NOT_UTF8)

    def find(self, pattern: re.Pattern[bytes], index: int, end: int) -> int:
        """Return the first line from ``index`` to before ``end`` that has a pattern.

        Returns ``end`` if there is none. The pattern must not match across lines.
        """
        match = pattern.search(self.data, int(self._begin[index]), int(self._end[end - 1]))
        return (
            end
            if match is None
            else int(np.searchsorted(self._begin[index:end], match.start(), side="right"))
            + index
            - 1
        )

    def statement(self, index: int, syntax: Syntax) -> Statement:
        """Return the parsed line; equal lines share one. Errors are those of ``parse_line``."""
        text = self.text(index)
        is_siemens = syntax.flavour == "siemens"
        by_interpreter = self.language == KLARTEXT
        if is_siemens:
            by_interpreter = self.head[index] in _SIEMENS_CONTROL
        if self.plain[index] and not by_interpreter:
            return self._plain(index, text)
        reading = self.sorted.reading
        if (
            reading is not None
            and is_siemens
            and text.isascii()
            and not reading.results.status[index]
        ):
            return siemens_lines(text, syntax, int(self._begin[index])).statement(reading, index)
        return parse_line(text, syntax)

    def _plain(self, index: int, text: str) -> Statement:
        plain = _memo.get(text)
        if plain is None:
            lines, words, *_ = self.sorted
            span = slice(lines.first[index], lines.first[index + 1])
            plain = Statement(
                tuple(
                    Word(
                        chr(letter), number, squeezed(text[column - 1 : column - 1 + length]),
                        column, length,
                    )
                    for letter, number, column, length in zip(
                        *(values[span].tolist() for values in words), strict=True
                    )
                )
            )  # fmt: skip
            if len(_memo) >= MEMO:
                _memo.clear()
            _memo[text] = plain
        return plain


_SIEMENS_CONTROL = frozenset(b"LMOP")
"""First letters of plain lines that may be a call, an end, or the number of a program."""
_memo: dict[str, Statement] = {}
"""Plain lines by their text."""


class Text:
    """The text of a program.

    Attributes:
        name: The text as messages call it.
        lines: Number of lines read so far.
        language: The language in which its lines are read.
    """

    def __init__(
        self, name: str, windows: Iterator[Window], again: Callable[[int], Window]
    ) -> None:
        """Create a text.

        Args:
            name: The text as messages call it.
            windows: All windows in order.
            again: Returns an earlier window by its index.
        """
        self.name = name
        self.lines = 0
        self.language = NGC
        self._firsts: list[int] = []
        self._kept: OrderedDict[int, Window] = OrderedDict()
        self._windows, self._again = windows, again

    @classmethod
    def of_file(cls, path: str | os.PathLike[str], name: str | None = None) -> Text:
        r"""Return the text of a file.

        It is UTF-8, with or without a byte order mark. Lines end in ``\r\n``, ``\n`` or ``\r``. A
        line that is longer than a window is cut; the parser refuses it.

        Raises:
            UsageError: ``no-such-file``, ``unreadable-file``, here or when a window is read.
        """
        file = _File(path)
        return cls(os.fspath(path) if name is None else name, file.windows(), file.again)

    @classmethod
    def of_lines(cls, lines: Iterable[str], name: str) -> Text:
        """Return a text of lines in memory, with or without line ends.

        Lines are taken from the iterable when they are needed, and kept.
        """
        kept: Kept = []
        return cls(
            name, _windows_of_lines(iter(lines), kept), lambda index: _window_of_lines(*kept[index])
        )

    def window(self, line: int) -> Window | None:
        """Return the window that holds a line (from 1); None past the end."""
        if line < 1:
            return None
        while line > self.lines:
            following = next(self._windows, None)
            if following is None:
                return None
            self._keep(len(self._firsts), following)
            self._firsts.append(following.first)
            self.lines += following.count
        index = bisect_right(self._firsts, line) - 1
        kept = self._kept.get(index)
        if kept is None:
            kept = self._again(index)
        self._keep(index, kept)
        return kept.read_as(self.language)

    def all_lines(self) -> Iterator[str]:
        """Yield all lines."""
        for _, text in lines_from(self):
            yield text

    def first_lines(self) -> Iterator[str]:
        """Yield the lines of the first window."""
        window = self.window(1)
        if window is not None:
            yield from map(window.text, range(window.count))

    def first_lines_with(self, pattern: re.Pattern[bytes]) -> Iterator[str]:
        """Yield the lines of the first window that have a pattern."""
        if (window := self.window(1)) is not None:
            for _, index in lines_with(self, pattern, end=window.first + window.count):
                yield window.text(index)

    def _keep(self, index: int, window: Window) -> None:
        self._kept[index] = window
        self._kept.move_to_end(index)
        if len(self._kept) > KEPT_WINDOWS:
            self._kept.popitem(last=False)


def windows_from(text: Text | LineIndex, line: int = 1) -> Iterator[tuple[Window, int]]:
    """Yield the windows from that of a line on, each with the index at which to begin."""
    while (window := text.window(line)) is not None:
        yield window, line - window.first
        line = window.first + window.count


def lines_from(text: Text | LineIndex, line: int = 1) -> Iterator[tuple[int, str]]:
    """Yield the lines from a number on, with their numbers."""
    for window, begin in windows_from(text, line):
        for index in range(begin, window.count):
            yield window.first + index, window.text(index)


def lines_with(
    text: Text | LineIndex, pattern: re.Pattern[bytes], line: int = 1, end: int = 1 << 62
) -> Iterator[tuple[Window, int]]:
    """Yield the lines from ``line`` to before ``end`` that have a pattern: window and index."""
    for window, index in windows_from(text, line):
        last = min(window.count, end - window.first)
        while index < last and (index := window.find(pattern, index, last)) < last:
            yield window, index
            index += 1
        if window.first + last >= end:
            return


class _File:
    """The windows of a file.

    The file is opened for each window. A program may run for hours, and some systems cannot replace
    an open file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = os.fspath(path)
        self._copy: IO[bytes] | None = None
        self._begins: list[tuple[int, int]] = []
        with self._opened() as file:
            if not file.seekable():  # a pipe
                self._copy = tempfile.TemporaryFile()  # noqa: SIM115 lives as long as this object
                weakref.finalize(self, self._copy.close)
                shutil.copyfileobj(file, self._copy)

    @contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        if self._copy is not None:
            yield self._copy
            return
        path = self._path
        try:
            with open(path, "rb") as file:
                yield file
        except FileNotFoundError:
            raise UsageError(
                Diagnostic("no-such-file", f"there is no file {path}", file=path)
            ) from None
        except OSError as error:
            raise UsageError(
                Diagnostic("unreadable-file", f"cannot read {path}: {error.strerror}", file=path)
            ) from None

    def _read(self, offset: int) -> bytes:
        with self._opened() as file:
            file.seek(offset)
            return file.read(WINDOW_BYTES)

    def windows(self) -> Iterator[Window]:
        """Yield all windows in order."""
        line, offset = 1, len(BOM) if self._read(0).startswith(BOM) else 0
        while data := self._read(offset):
            self._begins.append((line, offset))
            window, size = self._window(line, data)
            yield window
            line += window.count
            offset = offset + size if size else self._end_of_line(offset + len(data) - 1)

    def again(self, index: int) -> Window:
        """Return an earlier window."""
        line, offset = self._begins[index]
        return self._window(line, self._read(offset))[0]

    def _window(self, line: int, data: bytes) -> tuple[Window, int]:
        """Return the first window of some bytes, and its size in bytes.

        The size is 0 if its only line continues after the bytes.
        """
        lines = split(data, whole=len(data) < WINDOW_BYTES)
        if lines.size:
            return Window(line, data[: lines.size], lines), lines.size
        return Window(line, data, split(data, whole=True)), 0

    def _end_of_line(self, offset: int) -> int:
        """Return the position of the line after the one at ``offset``."""
        while data := self._read(offset):
            ends = [at for at in (data.find(b"\n"), data.find(b"\r")) if at >= 0]
            if ends:
                offset += min(ends)
                return offset + (2 if self._read(offset)[:2] == b"\r\n" else 1)
            offset += len(data)
        return offset


Kept = list[tuple[int, list[str]]]
"""Windows of lines in memory: number of the first line, and lines."""


def _windows_of_lines(lines: Iterator[str], kept: Kept) -> Iterator[Window]:
    """Yield windows over lines in memory, and append their lines to ``kept``."""
    first, size = 1, _FIRST_LINES
    while part := [line.removesuffix("\n").removesuffix("\r") for line in islice(lines, size)]:
        kept.append((first, part))
        yield _window_of_lines(first, part)
        first, size = first + len(part), min(2 * size, _MOST_LINES)


def _window_of_lines(first: int, lines: list[str]) -> Window:
    texts: dict[int, str] = {}
    pieces: list[bytes] = []
    for index, line in enumerate(lines):
        piece = line.encode(errors="replace")
        if "\n" in line or "\r" in line or b"?" in piece:
            texts[index] = line
            piece = piece.replace(b"\n", b" ").replace(b"\r", b" ") + _NOT_BYTES
        pieces.append(piece + b"\n")
    data = b"".join(pieces)
    return Window(first, data, split(data, whole=True), texts)


# An index of a program's text: its control lines, subroutines, programs and N numbers.
#
# A control line is found by the first letter of the line. No other line is parsed before it is
# executed. The index grows with the number of control lines, not with the length of the text.

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
        if (statement := self.statement_at(line)) is None:
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

    def statement_at(self, line: int) -> Statement | None:
        """Return a parsed line by its number; None past the end, or if block delete skips it."""
        window = self.window(line)
        return None if window is None else self.statement(window, line - window.first)

    def names(self, window: Window) -> tuple[bytes, Names, list[bool] | None]:
        """Return a text with the names of parameters, their places, and which are left alone.

        Compiled code must not set the latter; None for none.
        """
        names_of_lines = window.code().names
        if self._syntax.flavour != "siemens":
            return window.data, names_of_lines, None
        names = list(map(self._syntax.names.in_compiled_code, window.names(names_of_lines)))
        sizes = np.array([len(name) for name, _ in names], np.int32)
        ends = np.cumsum(sizes, dtype=np.int32)
        text = "".join(name for name, _ in names).encode("ascii")
        return (
            text,
            names_of_lines._replace(begin=ends - sizes, end=ends),
            [not free for _, free in names],
        )

    def placed(self, error: GcodeError, line: int) -> CncError:
        """Return the error with file, line and text added where it lacks them."""
        diagnostic = error.diagnostic
        if diagnostic.file:
            return error
        line = diagnostic.line or line
        return error.at(file=self.name, line=line, text=diagnostic.text or self.source(line))

    def control_fault(
        self, line: int, control: Control, code: str, message: str, hint: str = ""
    ) -> CncError:
        """Return an error at a control line."""
        return self.fault(Place(line, control.column, control.length), code, message, hint)

    def fault(
        self, at: Place, code: str, message: str, hint: str = "", fix: Fix | None = None
    ) -> CncError:
        """Return an error at a place of this text, with its repair."""
        return self.placed(
            fault(code, message, hint=hint, column=at.column, length=at.length, fix=fix), at.line
        )

    def control(self, line: int) -> Control:
        """Return the control at a line that is known to have one."""
        return next(self.control_lines(line))[1]

    def control_lines(self, line: int) -> Iterator[tuple[int, Control]]:
        """Yield the control lines from ``line`` on with their numbers.

        Lines that begin or end a block are complete; only some calls and jumps are among them.
        """
        # Plain lines of SINUMERIK are no blocks, and others begin with any letter.
        any_letter = self._syntax.flavour == "siemens"
        for number, window, index in self._candidates(line, any_letter=any_letter):
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
                    if (match := PROGRAM.fullmatch(text)) and match[1]:
                        self._definitions.behind[int(match[1])] = end
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
        opened = code = False
        for window, index in windows_from(self._text):
            while index < window.count:
                percent = window.find(_PERCENT, index, window.count)
                words = window.sorted.lines.first
                code = code or bool(words[percent] > words[index])
                if percent < window.count:
                    if opened or code:
                        return window.first + percent
                    opened = True
                index = percent + 1
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
        for window, offset in windows_from(self._text, begin):
            if window.first + offset >= end:
                break
            for index in (np.flatnonzero(window.label[offset:] == number) + offset).tolist():
                if window.first + index < end and self.statement(window, index) is not None:
                    return window.first + index
        return None

    def _candidates(
        self, line: int, *, any_letter: bool = False
    ) -> Iterator[tuple[int, Window, int]]:
        """Yield lines that begin like a control line: number, window, index in the window.

        With ``any_letter`` yield all lines that are not plain.
        """
        for window, offset in windows_from(self._text, line):
            wanted: NDArray[np.bool_] = (
                window.plain == 0 if any_letter else self._is_control_letter[window.head]
            )
            for index in (np.flatnonzero(wanted[offset:]) + offset).tolist():
                yield window.first + index, window, index
