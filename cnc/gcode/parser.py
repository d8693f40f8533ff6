"""Text to words: the Lark grammar, one line at a time, and the lines of a file.

The grammar's tables are cached in the user's cache folder, which saves their construction at every start; where that folder can't be
written, they are built anew. Parsed lines are memoised by their text, for programs that repeat themselves.
"""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from cnc import __version__
from cnc.errors import Diagnostic, UsageError
from cnc.gcode.statement import Remark, Statement
from cnc.gcode.syntax import describe
from cnc.gcode.words import Word, fault

if TYPE_CHECKING:
    from lark import Lark, Token

MAX_LINE = 4096
"""Characters of a line. RS274 allows 256; what is longer than this is no program."""
MAX_NUMBER = 1e9
"""Largest magnitude of a number: a thousand kilometres, or a slip."""
MEMO = 4096
"""Distinct lines whose parse is kept."""
_CHUNK = 1 << 16
_NOT_UTF8 = "latin-1"

_REMARK = re.compile(
    r"\([ \t]*(msg|debug|print|log|logopen|logappend|logclose|probeopen|probeclose|py)[ \t]*(?:,(.*))?\)", re.IGNORECASE | re.ASCII
)
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_BLANKS = re.compile(r"[ \t]+")


Flavour = Literal["ngc", "macro-b", "none"]


@dataclass(frozen=True, slots=True)
class Syntax:
    """What a line of a dialect may look like.

    ``flavour``: parameters, expressions and control flow as RS274/NGC or FANUC's macro B has them, or none at all. ``siemens``: BSPLINE,
    SD=, PL=, PW=. ``dollar``: lines that begin with $ are for the board. ``dialect`` is the name that messages show.
    """

    flavour: Flavour = "ngc"
    siemens: bool = False
    dollar: bool = False
    dialect: str = "auto"


AUTO = Syntax(siemens=True)


def cache_folder() -> Path:
    """Where this user's caches live: ``XDG_CACHE_HOME``, or the platform's usual place."""
    if named := os.environ.get("XDG_CACHE_HOME"):
        return Path(named) / "cnc"
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "cnc" / "cache"
    return Path(os.path.expanduser("~")) / ".cache" / "cnc"


@lru_cache(maxsize=1)
def _grammar() -> Lark:
    """The grammar, from the cache where there is one.

    Lark tells a stale, damaged or half-written cache from a good one, and goes on without one that can't be written.
    """
    import lark

    folder = cache_folder()
    cache: str | bool = str(folder / f"line-{__version__}-lark{lark.__version__}-py{sys.version_info[0]}{sys.version_info[1]}.bin")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        cache = False
    return lark.Lark.open_from_package("cnc", "line.lark", ("grammars",), parser="lalr", maybe_placeholders=False, cache=cache)


@lru_cache(maxsize=MEMO)
def parse_line(text: str, syntax: Syntax = AUTO) -> Statement:
    """Parse one line, given without its line end.

    Errors name the column (from 1) and say in plain words what is wrong; line and file are the caller's to add.
    """
    if len(text) > MAX_LINE:
        raise fault("line-too-long", f"the line has more than {MAX_LINE} characters", column=MAX_LINE + 1)
    if control := _CONTROL.search(text):
        what = f"control character U+{ord(control[0]):04X}"
        raise fault("control-character", what, column=control.start() + 1, hint="is this a text file?")
    if not text or text.isspace():
        return Statement()
    from lark.exceptions import UnexpectedInput

    try:
        tree = _grammar().parse(text)
    except UnexpectedInput as error:
        raise describe(text, error.pos_in_stream or 0) from None
    words: list[Word] = []
    remarks: list[Remark] = []
    deletable = False
    for token in cast("list[Token]", tree.children):
        if token.type == "WORD":
            words.append(_word(token))
        elif token.type == "DELETE":
            deletable = True
        elif remark := _REMARK.fullmatch(token):
            remarks.append(Remark(remark[1].lower(), (remark[2] or "").strip(), (token.start_pos or 0) + 1))
    return Statement(tuple(words), remarks=tuple(remarks), percent=tree.data == "percent", deletable=deletable)


def _word(token: Token) -> Word:
    """A word token as a word. The number is what ``float`` makes of its digits."""
    text = str(token)
    written = _BLANKS.sub("", text).upper()
    number = float(written[1:])
    column = (token.start_pos or 0) + 1
    if not math.isfinite(number) or abs(number) > MAX_NUMBER:
        raise fault("number-too-large", f"the number after {written[0]} is larger than {MAX_NUMBER:.0f}", column=column, length=len(text))
    return Word(written[0], number, written, column, len(text))


def read_lines(path: str | os.PathLike[str]) -> Iterator[str]:
    r"""The lines of a file without their ends (``\r\n``, ``\n`` or ``\r``), as they are read.

    UTF-8, with or without a byte order mark; a line that is not UTF-8 is taken as Latin-1, in which no byte is wrong. A line without end
    is cut at a length that the language refuses. Raises UsageError ``no-such-file`` or ``unreadable-file`` before the first line.
    """
    try:
        file = open(path, "rb")  # noqa: SIM115 closed below, by the generator
    except FileNotFoundError:
        raise UsageError(Diagnostic("no-such-file", f"there is no file {os.fspath(path)}", file=os.fspath(path))) from None
    except OSError as error:
        raise UsageError(Diagnostic("unreadable-file", f"can't read {os.fspath(path)}: {error.strerror}", file=os.fspath(path))) from None
    with file:
        rest = file.read(3)
        if rest == b"\xef\xbb\xbf":
            rest = b""
        while chunk := file.read(_CHUNK):
            lines = (rest + chunk).splitlines(keepends=True)
            # The last line may go on in the next chunk; a \r at its end may be the first half of \r\n.
            rest = lines.pop() if lines and not lines[-1].endswith(b"\n") else b""
            yield from map(_decode, lines)
            if len(rest) > _CHUNK:
                yield _decode(rest)
                rest = b""
        yield from map(_decode, rest.splitlines())


def _decode(line: bytes) -> str:
    try:
        return line.rstrip(b"\r\n").decode()
    except UnicodeDecodeError:
        return line.rstrip(b"\r\n").decode(_NOT_UTF8)
