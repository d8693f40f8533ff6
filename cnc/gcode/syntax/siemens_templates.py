"""Templates for lines of SINUMERIK that differ only in their numbers.

A line is translated into the words of RS274/NGC, and the grammar reads the result. Later lines with
the same text around their numbers take both steps from a template::

    N10 G1 X=R1+2.5 F=100     template  N_ G1 X=R1+_ F=_     numbers  10, 2.5, 100

A template is made of a line with marked numbers in place of its own. It is used only if each mark
stands once in the translation: a word whose meaning depends on its number has no template.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

from cnc.gcode.syntax import line_templates
from cnc.gcode.syntax.statement import Statement
from cnc.model.diagnostics import GcodeError

if TYPE_CHECKING:
    from cnc.gcode.syntax.siemens import Translation

MOST_TEMPLATES = 4096
"""Templates that are kept."""

_OPEN = re.compile(
    r"[A-Z_$]{2}[A-Z0-9_]*|[SABC][ \t]*[0-9][ \t]*=|[DEGHLMOPQRT][ \t]*[0-9]+"
    r"|([0-9]+(\.?)[0-9]*|\.[0-9]+)"
)
"""Names and codes, which are part of the template, and open numbers."""
_FIRST_MARK = 71_000_001
_POSITION = re.compile(r"#<_(?:[a-z]|(?:x_)?(?:absolute|incremental))>")
"""A parameter that shows the state of the interpreter, which compiled code does not have."""
_ASSIGNMENT = re.compile(r"(?:N[0-9]+ )?#<[^<>]*>=\[.*\]")

Translate = Callable[[str], "Translation"]
Parse = Callable[[str, dict[int, int] | None], Statement]
"""Parses a translation; the second argument is that of :data:`line_templates.Parse`."""


@dataclass(frozen=True, slots=True)
class _Template:
    """A translation with open numbers, and its statement.

    Attributes:
        pieces: The text of the translation before each number, and behind the last one.
        order: Index in the line of each number of the translation.
        statement: The template of the translation.
        deletable: Whether the line begins with ``/``.
        is_ngc: Whether compiled code for RS274/NGC can execute the translation. Assignments of
            SINUMERIK take effect one by one, those of RS274/NGC behind the other words.
    """

    pieces: tuple[str, ...]
    order: tuple[int, ...]
    statement: line_templates.Template
    deletable: bool
    is_ngc: bool

    def text(self, numbers: list[str]) -> tuple[str, list[line_templates.Span]]:
        """Return the translation of a line with these numbers, and the places of its numbers."""
        parts: list[str] = [self.pieces[0]]
        spans: list[line_templates.Span] = []
        at = len(self.pieces[0])
        for index, piece in zip(self.order, self.pieces[1:], strict=True):
            number = numbers[index]
            spans.append((at, at + len(number)))
            parts += number, piece
            at += len(number) + len(piece)
        return "".join(parts), spans


_templates: dict[tuple[str, object], _Template | Literal["met", "unfit"]] = {}
"""Templates by their text and by what else the translation depends on."""


def statement(text: str, key: object, translate: Translate, parse: Parse) -> Statement | None:
    """Return the statement of a line from its template; None if it has to be read in full.

    Args:
        text: The line.
        key: What the translation depends on besides the line.
        translate: Translates a line.
        parse: Parses a translation.
    """
    found = _found(text, key, translate, parse)
    return None if found is None or found.is_new else _filled(found, parse)


def ngc_line(text: str, key: object, translate: Translate, parse: Parse) -> str | None:
    """Return the line of RS274/NGC with the effect of a line; None without such a template.

    The arguments are those of :func:`statement`.
    """
    found = _found(text, key, translate, parse)
    if found is None or not found.template.is_ngc:
        return None
    return found.template.text(found.numbers)[0]


class _Found(NamedTuple):
    """A line with its template.

    Attributes:
        template: The template.
        code: The line in capitals, without its comment.
        numbers: Its open numbers.
        is_new: Whether this line made the template.
    """

    template: _Template
    code: str
    numbers: list[str]
    is_new: bool


def _found(text: str, key: object, translate: Translate, parse: Parse) -> _Found | None:
    """Return a line with its template, which the second line of its kind makes."""
    if '"' in text or "'" in text:
        return None
    code = text.split(";", maxsplit=1)[0].upper()
    numbers: list[str] = []
    pieces: list[str] = []
    at = 0
    for found in _OPEN.finditer(code):
        if found[1] is not None:
            numbers.append(found[1])
            begin, end = found.span()
            pieces += code[at:begin], "\0" if found[2] == "" and found[1][0] != "." else "\1"
            at = end
    if not numbers:
        return None
    shape = "".join(pieces) + code[at:], key
    template = _templates.get(shape)
    if isinstance(template, _Template):
        return _Found(template, code, numbers, is_new=False)
    if template is None:
        if len(_templates) >= MOST_TEMPLATES:
            _templates.clear()
        _templates[shape] = "met"
    elif template == "met":
        made = _make_template(shape[0], translate, parse)
        if made is not None and made.text(numbers)[0] != translate(text).text:
            made = None
        _templates[shape] = made or "unfit"
        if made is not None:
            return _Found(made, code, numbers, is_new=True)
    return None


def _make_template(shape: str, translate: Translate, parse: Parse) -> _Template | None:
    """Return the template of a line; None if it cannot have one."""
    marks: list[str] = []
    parts: list[str] = []
    for char in shape:
        if char in "\0\1":
            marks.append(f"{_FIRST_MARK + len(marks)}{'' if char == chr(0) else '.5'}")
            char = marks[-1]
        parts.append(char)
    try:
        found = translate("".join(parts))
    except GcodeError:
        return None
    if found.control is not None or found.remarks:
        return None
    places = sorted((found.text.find(mark), index) for index, mark in enumerate(marks))
    if any(at < 0 or found.text.count(marks[index]) > 1 for at, index in places):
        return None
    spans = [(at, at + len(marks[index])) for at, index in places]
    ends = [0, *(end for _, end in spans)]
    begins = [*(begin for begin, _ in spans), len(found.text)]
    pieces = tuple(found.text[end:begin] for end, begin in zip(ends, begins, strict=True))
    made = line_templates.make_template(spans, spans, lambda open_: parse(found.text, open_))
    if made is None:
        return None
    order = tuple(index for _, index in places)
    one = found.text.count("=") == 1 and _ASSIGNMENT.fullmatch(found.text) is not None
    is_ngc = (one or "=" not in found.text) and not _POSITION.search(found.text)
    return _Template(pieces, order, made, found.deletable, is_ngc and not found.deletable)


def _filled(line: _Found, parse: Parse) -> Statement | None:
    """Return the statement of a line of a template; None if it has to be read in full."""
    template, code = line.template, line.code
    text, spans = template.text(line.numbers)
    place = len(code) - len(code.lstrip()) + 1, len(code.strip())
    found = line_templates.filled(
        template.statement, text, spans, spans, lambda open_: parse(text, open_), place
    )
    if found is None or not template.deletable:
        return found
    return replace(found, deletable=True)
