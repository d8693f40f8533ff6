"""Subprograms, labels and variables of a program: their places, outline and new names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

from cnc.checks.tool_list import ToolList
from cnc.editor.document import Document, Span, TextEdit, without_comments
from cnc.gcode.core.subprograms import file_names
from cnc.gcode.reader.parser import Flavour

Kind = Literal["subprogram", "label", "variable"]


class Form(NamedTuple):
    """How a symbol is written.

    Attributes:
        kind: Its kind.
        pattern: Regular expression; the group ``name`` is the name.
        defines: Whether it stands where the symbol is defined.
    """

    kind: Kind
    pattern: str
    defines: bool


class Symbol(NamedTuple):
    """A symbol at a place. Names are equal where they mean the same: capitals, without zeros."""

    kind: Kind
    name: str
    span: Span
    defines: bool


_NUMBER = r"(?P<name>0*[0-9]+)(?![0-9.])"
_START = r"^[ \t]*/?[ \t]*(?:N[ \t]*[0-9]+[ \t]*)?"
_CALL_CODES = r"(?<![A-Z])(?:M[ \t]*0*98|G[ \t]*0*6[56](?:\.1)?)(?![0-9.])[^\n\r]*?"
_NAMED = r"#[ \t]*(?P<name><[^<>\r\n]*>)"
_NUMBERED = r"#[ \t]*(?P<name>[0-9]+)(?![0-9.])"
_SET = r"[ \t]*=(?!=)"
_N_LABEL = Form("label", r"^[ \t]*/?[ \t]*N[ \t]*" + _NUMBER, True)
_VARIABLES = (
    Form("variable", _NAMED + _SET, True),
    Form("variable", _NAMED, False),
    Form("variable", _NUMBERED + _SET, True),
    Form("variable", _NUMBERED, False),
)
_O_NAME = r"O[ \t]*(?P<name><[^<>\r\n]*>|[0-9]+)[ \t]*"
_PROGRAMS = (
    Form("subprogram", _START + r"[O:][ \t]*" + _NUMBER + r"(?=[ \t]*$)", True),
    Form("subprogram", _CALL_CODES + r"P[ \t]*" + _NUMBER, False),
)
_MACRO = (
    *_PROGRAMS,
    _N_LABEL,
    Form("label", r"GOTO[ \t]*" + _NUMBER, False),
    Form("label", r"(?<![A-Z])M[ \t]*97(?![0-9.])[^\n\r]*?P[ \t]*" + _NUMBER, False),
    Form("label", r"(?<![A-Z])G[ \t]*7[0-3](?![0-9.])[^\n\r]*?P[ \t]*" + _NUMBER, False),
    Form("label", r"(?<![A-Z])G[ \t]*7[0-3](?![0-9.])[^\n\r]*?Q[ \t]*" + _NUMBER, False),
    *_VARIABLES,
)
_NGC = (
    Form("subprogram", _START + _O_NAME + "SUB", True),
    Form("subprogram", _START + _O_NAME + "(?:CALL|ENDSUB|RETURN)", False),
    *_PROGRAMS,
    Form("label", _START + _O_NAME + "(?:IF|WHILE|DO|REPEAT)", True),
    Form("label", _START + _O_NAME + "(?:ELSEIF|ELSE|END[A-Z]+|BREAK|CONTINUE)", False),
    *_VARIABLES,
)
_SIEMENS_NAME = r"(?P<name>[A-Z_]{2}[A-Z0-9_]*)"
_SIEMENS = (
    Form("label", _START + _SIEMENS_NAME + r"[ \t]*:(?!=)", True),
    Form("label", r"^[ \t]*/?[ \t]*(?P<name>N[0-9]+)", True),
    Form("label", r"\bGOTO[FBCS]?[ \t]+(?P<name>[A-Z_]{2}[A-Z0-9_]*|N[0-9]+)", False),
    Form("label", r"\bREPEATB?[ \t]+(?P<name>[A-Z_]{2}[A-Z0-9_]*)", False),
    Form("subprogram", r"\b(?:PROC|EXTERN)[ \t]+" + _SIEMENS_NAME, True),
    Form("subprogram", _START + _SIEMENS_NAME + r"(?=[ \t]*(?:\(|P[ \t]*[0-9]+|$))", False),
    Form("subprogram", _START + r"(?P<name>L[0-9]+)(?![0-9.])", False),
    Form("variable", r"\bDEF[ \t]+[A-Z]+[ \t]+" + _SIEMENS_NAME, True),
    Form("variable", r"\b(?P<name>R[0-9]+)" + _SET, True),
    Form("variable", r"\b(?P<name>R[0-9]+)(?![0-9.])", False),
)
_KLARTEXT_LABEL = r'(?P<name>[0-9]+|"[^"\r\n]*")'
_KLARTEXT = (
    Form("subprogram", r"^[ \t]*[0-9]*[ \t]*LBL[ \t]+" + _KLARTEXT_LABEL, True),
    Form("subprogram", r"\b(?:CALL|GOTO)[ \t]+LBL[ \t]+" + _KLARTEXT_LABEL, False),
    Form("variable", r"\b(?P<name>Q[LRS]?[0-9]+)" + _SET, True),
    Form("variable", r"(?<![A-Z])(?P<name>Q[LRS]?[0-9]+)", False),
)
_FORMS: dict[Flavour, tuple[Form, ...]] = {
    "ngc": _NGC,
    "macro-b": _MACRO,
    "siemens": _SIEMENS,
    "klartext": _KLARTEXT,
    "none": _PROGRAMS,
}


@lru_cache(maxsize=128)
def _compiled(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.IGNORECASE | re.MULTILINE)


def plain_name(name: str) -> str:
    """Return a name in the form in which equal names are equal."""
    if name.isdigit():
        return name.lstrip("0") or "0"
    if name.startswith("<"):
        name = re.sub(r"[ \t]", "", name)
    return name if name.startswith('"') else name.upper()


def symbols_in(text: str, line: int, flavour: Flavour) -> list[Symbol]:
    """Return the symbols of a line; a place has one, by the first form that fits."""
    code = without_comments(text)
    taken: dict[tuple[int, int], Symbol] = {}
    for form in _FORMS[flavour]:
        for match in _compiled(form.pattern).finditer(code):
            begin, end = match.span("name")
            if not any(a < end and begin < b for a, b in taken):
                name = plain_name(match["name"])
                taken[begin, end] = Symbol(form.kind, name, Span(line, begin, end), form.defines)
    return [symbol for _, symbol in sorted(taken.items())]


def symbol_at(document: Document, flavour: Flavour, line: int, character: int) -> Symbol | None:
    """Return the symbol at a character (from 0) of a line; None without one."""
    for symbol in symbols_in(document.line(line), line, flavour):
        if symbol.span.begin <= character <= symbol.span.end:
            return symbol
    return None


def places(document: Document, flavour: Flavour, symbol: Symbol) -> list[Symbol]:
    """Return all places of a symbol, in order. The text is searched for its name alone."""
    written = re.escape(symbol.name)
    if symbol.name.isdigit():
        written = rf"(?<![0-9.])0*{written}(?![0-9.])"
    elif symbol.name.startswith("<"):
        written = r"<[ \t]*" + r"[ \t]*".join(map(re.escape, symbol.name[1:-1])) + r"[ \t]*>"
    lines: dict[int, None] = {}
    for match in _compiled(written).finditer(document.text):
        lines[document.span(*match.span()).line] = None
    return [
        other
        for line in lines
        for other in symbols_in(document.line(line), line, flavour)
        if (other.kind, other.name) == (symbol.kind, symbol.name)
    ]


def definitions(document: Document, flavour: Flavour, symbol: Symbol) -> list[Symbol]:
    """Return the places at which a symbol is defined; a variable is where it is first set."""
    defined = [place for place in places(document, flavour, symbol) if place.defines]
    return defined[:1] if symbol.kind == "variable" else defined


def file_of(symbol: Symbol, folders: Sequence[Path]) -> Path | None:
    """Return the file of a subprogram that the program itself does not have."""
    if symbol.kind != "subprogram":
        return None
    stem = symbol.name.strip('<>"').lower()
    if not re.fullmatch(r"[a-z0-9_-]+", stem):
        return None
    files = (folder / name for folder in folders for name in file_names(stem))
    return next((file for file in files if file.is_file()), None)


def names_of(document: Document, flavour: Flavour, kind: Kind) -> list[str]:
    """Return the names of a kind that the text defines, as they are written first."""
    names: dict[str, str] = {}
    for form in _FORMS[flavour]:
        if form.kind == kind and form.defines and form is not _N_LABEL:
            for match in _compiled(form.pattern).finditer(document.text):
                names.setdefault(plain_name(match["name"]), match["name"])
    return list(names.values())


class NotRenamed(Exception):
    """The text says why a symbol can't have a name."""


def renamed(document: Document, flavour: Flavour, symbol: Symbol, name: str) -> list[TextEdit]:
    """Return the edits that give a variable another name.

    Raises:
        NotRenamed: It is no variable, or the name is no name of its kind, or is in use.
    """
    if symbol.kind != "variable":
        raise NotRenamed("only variables can be renamed")
    old = symbol.name
    name = name.strip().removeprefix("#")
    if old.startswith("<") and not name.startswith("<"):
        name = f"<{name}>"
    forms = {"<": r"<[A-Za-z0-9_ \t-]+>", "R": r"[Rr][0-9]+", "Q": r"[Qq][LRSlrs]?[0-9]+"}
    wanted = r"[0-9]+" if old.isdigit() else forms.get(old[0], "")
    if flavour == "siemens" and not re.fullmatch(r"R[0-9]+", old):
        wanted = r"[A-Za-z_]{2}[A-Za-z0-9_]*"
    if not re.fullmatch(wanted, name):
        raise NotRenamed(f"{name} is no name of a variable such as {old}")
    if old.startswith("<") and old.startswith("<_") != name.startswith("<_"):
        raise NotRenamed("a name that begins with _ is global; the other one is not")
    new = symbol._replace(name=plain_name(name))
    if new.name != old and places(document, flavour, new):
        raise NotRenamed(f"{name} is in use; the two variables would become one")
    if flavour == "siemens" and wanted.startswith("[A-Za-z_]"):
        return _words_renamed(document, old, name)
    return [
        TextEdit(span.line, span.begin, span.line, span.end, name)
        for _, _, span, _ in places(document, flavour, symbol)
    ]


def _words_renamed(document: Document, old: str, name: str) -> list[TextEdit]:
    """Return the edits for a name that stands in expressions without a mark of its own."""
    edits = []
    for match in _compiled(rf"(?<![A-Z0-9_$]){old}(?![A-Z0-9_])").finditer(document.text):
        span = document.span(*match.span())
        code = document.code(span.line)
        if code[span.begin : span.end].upper() == old and code[: span.begin].count('"') % 2 == 0:
            edits.append(TextEdit(span.line, span.begin, span.line, span.end, name))
    return edits


# The outline: programs and subprograms, tools, operations.


class Entry(NamedTuple):
    """An entry of the outline.

    Attributes:
        kind: What begins here.
        name: Its name.
        line: Its first line.
        last: Its last line.
        children: Entries inside.
    """

    kind: Literal["subprogram", "tool", "operation"]
    name: str
    line: int
    last: int
    children: tuple[Entry, ...]


MOST_OPERATIONS = 2000
"""Comments of operations in an outline. A program with more has a comment at each move."""
_BEGINS = re.compile(
    r"^[ \t]*/?[ \t]*(?:N[ \t]*[0-9]+[ \t]*|[0-9]+[ \t]+)?(?:"
    r"(?P<sub>O[ \t]*(?:<[^<>\r\n]*>[ \t]*SUB|[0-9]+[ \t]*SUB|[0-9]+[ \t]*(?=[(;\r\n]|$)"
    r"|<[^<>\r\n]*>(?=[ \t]*$))|PROC[ \t]+\w+|LBL[ \t]+(?!0\b)[^;\r\n]+|BEGIN[ \t]+PGM[ \t]+\S+)"
    r"|(?P<comment>\((?!MSG|DEBUG|PRINT|LOG)[^()\r\n]*\)|;[^\r\n]*)[ \t]*$"
    r"|TOOL[ \t]+CALL[ \t]+(?P<called>[0-9]+))"
    r"|^[^(;\r\n]*?(?<![A-Z])T[ \t]*0*(?P<tool>[0-9]{1,5})(?![0-9])",
    re.IGNORECASE,
)
_TOOL_COMMENT = re.compile(r"T(?:OOL)?[ \t]*[0-9]", re.IGNORECASE)
_MARK = re.compile(r"[(;]|[TtOo][ \t]*[0-9<]|[Tt][Oo][Oo][Ll]|PROC|proc|LBL|lbl|BEGIN")
"""A part of each line of an outline, which most moves lack."""


def outline(document: Document) -> list[Entry]:
    """Return the subprograms of a text, the tools in them, and the operations of each tool.

    An operation is a comment alone in its line, before moves.
    """
    lines: dict[int, str] = {}
    for mark in _MARK.finditer(document.text):
        number = document.span(*mark.span()).line
        lines.setdefault(number, document.line(number))
    tools = ToolList.of(lines.values()).tools
    begun: list[tuple[int, Literal["subprogram", "tool", "operation"], str]] = []
    used, comments = "", 0
    for line, text in lines.items():
        match = _BEGINS.match(text)
        if match is None:
            continue
        if match["sub"]:
            begun.append((line, "subprogram", " ".join(match["sub"].split())))
            used = ""
        elif tool := match["tool"] or match["called"]:
            tool = tool.lstrip("0") or "0"
            if tool not in (used, "0"):
                listed = tools.get(int(tool))
                remark = f" {listed.comment}" if listed and listed.comment else ""
                begun.append((line, "tool", f"T{tool}{remark}"))
            used = tool
        elif (comment := match["comment"].strip("(); \t")) and not _TOOL_COMMENT.match(comment):
            comments += 1
            begun.append((line, "operation", comment))
    if comments > MOST_OPERATIONS:
        begun = [entry for entry in begun if entry[1] != "operation"]
    return _nested(begun, document.count)


def _nested(
    begun: Sequence[tuple[int, Literal["subprogram", "tool", "operation"], str]], last: int
) -> list[Entry]:
    """Return entries in their order; each lasts to the next one of its kind or of one above."""
    order = ("subprogram", "tool", "operation")
    entries: list[Entry] = []
    at = 0
    while at < len(begun):
        line, kind, name = begun[at]
        rank = order.index(kind)
        behind = at + 1
        while behind < len(begun) and order.index(begun[behind][1]) > rank:
            behind += 1
        end = begun[behind][0] - 1 if behind < len(begun) else last
        children = _nested(begun[at + 1 : behind], end)
        entries.append(Entry(kind, name, line, max(line, end), tuple(children)))
        at = behind
    return entries
