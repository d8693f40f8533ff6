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
from functools import cached_property
from itertools import islice
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.reader.lines import KLARTEXT, NGC, Language, Positions, Sorted, read_lines
from cnc.gcode.reader.statements import squeezed
from cnc.gcode.syntax.parser import MEMO, Syntax, parse_line
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import Word
from cnc.kernels.gcode.statements import Coded, Names
from cnc.model.diagnostics import Diagnostic, UsageError

WINDOW_BYTES = 1 << 18
KEPT_WINDOWS = 4

_LF, _CR = 10, 13
_BOM = b"\xef\xbb\xbf"
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
        """See :class:`cnc.kernels.gcode.statements.Lines`, as for the next three."""
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

    def names(self, found: Names) -> list[str]:
        """Return different names in the lines, in small letters. All are ASCII."""
        spans = map(slice, found.begin.tolist(), found.end.tolist())
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
        found = pattern.search(self.data, int(self._begin[index]), int(self._end[end - 1]))
        return (
            end
            if found is None
            else int(np.searchsorted(self._begin[index:end], found.start(), side="right"))
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
            # Most programs are in another language.
            from cnc.gcode.sinumerik.statements import Lines

            lines = Lines(text, syntax.names, int(self._begin[index]))
            return lines.statement(reading, index)
        return parse_line(text, syntax)

    def _plain(self, index: int, text: str) -> Statement:
        found = _memo.get(text)
        if found is None:
            lines, words, *_ = self.sorted
            span = slice(lines.first[index], lines.first[index + 1])
            found = Statement(
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
            _memo[text] = found
        return found


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
        found = self._kept.get(index)
        if found is None:
            found = self._again(index)
        self._keep(index, found)
        return found.read_as(self.language)

    def all_lines(self) -> Iterator[str]:
        """Yield all lines."""
        line = 1
        while (window := self.window(line)) is not None:
            yield from map(window.text, range(window.count))
            line += window.count

    def first_lines(self) -> Iterator[str]:
        """Yield the lines of the first window."""
        window = self.window(1)
        if window is not None:
            yield from map(window.text, range(window.count))

    def first_lines_with(self, pattern: re.Pattern[bytes]) -> Iterator[str]:
        """Yield the lines of the first window that have a pattern."""
        window = self.window(1)
        index = 0
        while window is not None and index < window.count:
            index = window.find(pattern, index, window.count)
            if index < window.count:
                yield window.text(index)
            index += 1

    def _keep(self, index: int, window: Window) -> None:
        self._kept[index] = window
        self._kept.move_to_end(index)
        if len(self._kept) > KEPT_WINDOWS:
            self._kept.popitem(last=False)


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
        line, offset = 1, len(_BOM) if self._read(0).startswith(_BOM) else 0
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
