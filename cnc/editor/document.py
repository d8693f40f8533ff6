"""The text of a program in an editor: lines, edits, places."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable
from functools import cached_property
from io import StringIO
from typing import NamedTuple

_COMMENT = re.compile(r"\([^()]*\)?|;.*")


class Span(NamedTuple):
    """A part of a line: line from 1, begin and end in characters from 0."""

    line: int
    begin: int
    end: int


class TextEdit(NamedTuple):
    """A replacement: from a line and a character to a line and a character, and the new text.

    Lines count from 1, characters from 0.
    """

    line: int
    begin: int
    last: int
    end: int
    text: str


class Document:
    """A version of a text. It never changes: :meth:`edited` returns the next version.

    Attributes:
        name: The file, or another name.
        version: Number of the version.
        pieces: The lines with their ends. The last one has no end; it may be empty.
    """

    def __init__(self, name: str, pieces: list[str], version: int = 0) -> None:
        self.name, self.pieces, self.version = name, pieces, version

    @classmethod
    def of(cls, name: str, text: str, version: int = 0) -> Document:
        """Return the document of a text. Its lines end as those of programs do."""
        return cls(name, _pieces(text), version)

    def edited(self, edits: Iterable[TextEdit], version: int) -> Document:
        """Return the next version, after edits one after the other."""
        pieces = list(self.pieces)
        for edit in edits:
            first, last = min(edit.line, len(pieces)), min(edit.last, len(pieces))
            before, behind = pieces[first - 1][: edit.begin], pieces[last - 1][edit.end :]
            if edit.line > len(pieces):
                before, behind = pieces[-1], ""
            new = _pieces(before + edit.text + behind)
            # The line end that a \n behind a \r belongs to is not divided.
            if new[-1] == "" and last < len(pieces):
                new.pop()
            pieces[first - 1 : last] = new
        return Document(self.name, pieces, version)

    @property
    def count(self) -> int:
        """Number of lines; a line behind the last line end counts."""
        return len(self.pieces)

    def line(self, number: int) -> str:
        """Return a line (from 1) without its end; empty outside of the text."""
        return self.pieces[number - 1].rstrip("\r\n") if 0 < number <= len(self.pieces) else ""

    def code(self, number: int) -> str:
        """Return a line with blanks in place of its comments."""
        return without_comments(self.line(number))

    @cached_property
    def text(self) -> str:
        """The whole text."""
        return "".join(self.pieces)

    @cached_property
    def data(self) -> bytes:
        """The whole text as bytes."""
        return self.text.encode(errors="surrogatepass")

    @cached_property
    def _starts(self) -> list[int]:
        """Place of the first character of each line."""
        starts, at = [], 0
        for piece in self.pieces:
            starts.append(at)
            at += len(piece)
        return starts

    def span(self, begin: int, end: int) -> Span:
        """Return a part of the text, which lies in one line, as a span."""
        line = bisect_right(self._starts, begin)
        start = self._starts[line - 1]
        return Span(line, begin - start, end - start)


def _pieces(text: str) -> list[str]:
    """Return the lines of a text with their ends, and a last one without an end."""
    pieces = StringIO(text, newline="").readlines()
    return pieces if pieces and pieces[-1][-1] not in "\r\n" else [*pieces, ""]


def without_comments(text: str) -> str:
    """Return a line with blanks in place of its comments."""
    if "(" not in text and ";" not in text:
        return text
    return _COMMENT.sub(lambda comment: " " * len(comment[0]), text)


# Editors count places in a line in characters (utf-32), pairs of bytes (utf-16) or bytes (utf-8).


def units(text: str, character: int, encoding: str) -> int:
    """Return the place of a character in the units of an encoding."""
    if encoding == "utf-32" or text.isascii():
        return character
    size = 1 if encoding == "utf-8" else 2
    return len(text[:character].encode(_BYTES[encoding], "surrogatepass")) // size


def characters(text: str, unit: int, encoding: str) -> int:
    """Return the character at a place in the units of an encoding; the end behind it."""
    if encoding == "utf-32" or text.isascii():
        return min(unit, len(text))
    data = text.encode(_BYTES[encoding], "surrogatepass")
    size = 1 if encoding == "utf-8" else 2
    return len(data[: size * unit].decode(_BYTES[encoding], errors="ignore"))


_BYTES = {"utf-8": "utf-8", "utf-16": "utf-16-le"}
