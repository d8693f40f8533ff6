"""Text to statements: the Lark grammars, one line at a time.

The grammars' tables are cached in the user's cache folder, which saves their construction at every
start; where that folder can't be written, they are built anew. Parsed lines are memoised by their
text, for programs that repeat themselves.
"""

from __future__ import annotations

import os
import re
import string
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cnc import __version__
from cnc.gcode.syntax import line_templates
from cnc.gcode.syntax.expressions import Builder
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.syntax_errors import describe
from cnc.gcode.syntax.words import fault

if TYPE_CHECKING:
    from lark import Lark

MAX_LINE = 4096
"""Characters of a line. RS274 allows 256; what is longer than this is no program."""
MEMO = 4096
"""Distinct lines whose parse is kept."""

_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_PIECE = re.compile(r"\([^()]*\)|[(;].*|[ \t]+|[^ \t(;]+", re.DOTALL)
_CAPITALS = str.maketrans(string.ascii_lowercase, string.ascii_uppercase)
_FOREIGN = re.compile(r"\([^()]*\)|[(;].*|([\[#O])", re.DOTALL)
_FOREIGN_NAMES = {
    "[": "expressions are",
    "#": "parameters are",
    "O": "O-words (subprograms and control flow) are",
}

Flavour = Literal["ngc", "macro-b", "none"]


@dataclass(frozen=True, slots=True)
class Syntax:
    """What a line of a dialect may look like.

    ``flavour``: parameters, expressions and control flow as RS274/NGC or FANUC's macro B has them,
    or none at all. ``siemens``: BSPLINE, SD=, PL=, PW=. ``dollar``: lines that begin with $ are for
    the board. ``dialect`` is the name that messages show.
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


@lru_cache(maxsize=2)
def _grammar(name: str) -> Lark:
    """A grammar, from the cache where there is one.

    Lark tells a stale, damaged or half-written cache from a good one, and goes on without one that
    can't be written.
    """
    import lark

    folder = cache_folder()
    cache: str | bool = str(
        folder
        / f"{name}-{__version__}-lark{lark.__version__}-py{sys.version_info[0]}{sys.version_info[1]}.bin"
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        cache = False
    return lark.Lark.open_from_package(
        "cnc",
        f"{name}.lark",
        ("grammars", "../grammars"),
        parser="lalr",
        maybe_placeholders=False,
        cache=cache,
    )


@lru_cache(maxsize=MEMO)
def parse_line(text: str, syntax: Syntax = AUTO) -> Statement:
    """Parse one line, given without its line end.

    Errors name the column (from 1) and say in plain words what is wrong; line and file are the
    caller's to add. So do the errors that computed values raise when they are asked for.
    """
    if len(text) > MAX_LINE:
        raise fault(
            "line-too-long", f"the line has more than {MAX_LINE} characters", column=MAX_LINE + 1
        )
    if control := _CONTROL.search(text):
        what = f"control character U+{ord(control[0]):04X}"
        raise fault(
            "control-character", what, column=control.start() + 1, hint="is this a text file?"
        )
    if not text or text.isspace():
        return Statement()
    if text.lstrip(" \t").startswith("$"):
        return _board_line(text, syntax)
    flavour = f"{syntax.flavour} {syntax.siemens} {syntax.dialect}"
    return line_templates.statement(
        text, flavour, lambda open_numbers: _parse(text, syntax, open_numbers)
    )


def _parse(text: str, syntax: Syntax, open_numbers: dict[int, int] | None) -> Statement:
    """Parse a line by the grammar; see :mod:`cnc.gcode.syntax.line_templates` for
    ``open_numbers``.
    """
    squeezed, columns = squeeze(text)
    if syntax.flavour == "none":
        _refuse_foreign(squeezed, columns, syntax)
    from lark.exceptions import UnexpectedInput, VisitError

    from cnc.gcode.syntax.tree_to_statement import Translator, mark_rounding

    macro = syntax.flavour == "macro-b"
    try:
        tree = _grammar("macro" if macro else "ngc").parse(squeezed)
    except UnexpectedInput as error:
        raise describe(squeezed, columns, error, macro=macro) from None
    if macro and "R" in squeezed:
        mark_rounding(tree)
    build = Builder(columns, macro=macro)
    try:
        statement: Statement = Translator(
            squeezed, build, open_numbers, siemens=syntax.siemens, dialect=syntax.dialect
        ).transform(tree)
    except VisitError as error:
        raise error.orig_exc from None
    return statement


def squeeze(text: str) -> tuple[str, list[int]]:
    """The text without blanks and in capitals, but for comments; and the place of every character
    in the line, with that of its end.
    """
    kept: list[str] = []
    columns: list[int] = []
    for piece in _PIECE.finditer(text):
        part = piece[0]
        if part[0] in " \t":
            continue
        kept.append(part if part[0] in "(;" else part.translate(_CAPITALS))
        columns.extend(range(*piece.span()))
    columns.append(columns[-1] + 1)
    return "".join(kept), columns


def _board_line(text: str, syntax: Syntax) -> Statement:
    if not syntax.dollar:
        hint = "it is a command of a GRBL board: use --dialect grbl"
        raise fault(
            "syntax-not-in-dialect",
            f"$ lines are not in the {syntax.dialect} dialect",
            column=text.index("$") + 1,
            hint=hint,
        )
    return Statement(board=text.strip(" \t"))


def _refuse_foreign(squeezed: str, columns: list[int], syntax: Syntax) -> None:
    """Refuse parameters, expressions and O-words by name, in a dialect that has none of them."""
    for found in _FOREIGN.finditer(squeezed):
        if found[1]:
            message = f"{_FOREIGN_NAMES[found[1]]} not in the {syntax.dialect} dialect"
            column = columns[found.start()] + 1
            raise fault(
                "syntax-not-in-dialect",
                message,
                column=column,
                hint="use --dialect linuxcnc, or auto",
            )
