"""Repair of lines that many controllers accept and RS274/NGC does not.

Each repair keeps the place of every other character, and is reported as a warning.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from cnc.gcode.syntax.arithmetic import FUNCTIONS, MACRO_FUNCTIONS, MACRO_OPERATORS, OPERATORS
from cnc.gcode.syntax.error_context import MACRO_KEYWORDS, O_KEYWORDS
from cnc.gcode.syntax.statement import MENDED, Remark
from cnc.model.diagnostics import Diagnostic

_PROGRAM_NUMBER = re.compile(r"([ \t]*):(?=[ \t]*O?[0-9]{1,8}[ \t]*(?:[(;].*)?$)", re.DOTALL)
_PROGRAM_NAME = re.compile(r"([ \t]*)(?=<[-A-Z0-9+_.]{1,32}>[ \t]*(?:[(;].*)?$)", re.I | re.DOTALL)
"""A program's name in place of its number, on FANUC's Series 30i."""
_ALIGNMENT = re.compile(r"[ \t]*:(?=[ \t]*[0-9]{1,8}[ \t]+[A-Z][ \t]*[-+.0-9])", re.I)
"""A colon in place of N, at which some posts let a program begin again."""
_TEXT_CODE = re.compile(
    r"[ \t]*(?:N[0-9]+[ \t]*)?M(?:(?:16|23|28|30|32)\b(?=[ \t]+[A-Z])|11[478](?=[ \t]))", re.I
)
_STOP_TEXT = re.compile(r"[ \t]*(?:N[0-9]+[ \t]*)?M0?[01][ \t](?=[ \t]*[A-Z]{2})", re.I)
"""A stop with a text for the operator. Source: Marlin, "G-code Index", M0."""
_CHECKSUM = re.compile(r"\*[0-9]+[ \t]*(?=;|$)")
_HOMING = re.compile(r"[ \t]*(?:N[0-9]+[ \t]*)?G28(?![0-9.])", re.I)
_AXIS_ALONE = re.compile(r"[XYZ](?=[ \t]*(?:[A-Z]|$))", re.I)
_HOMING_OPTION = re.compile(r"[LOW](?=[ \t]*(?:[A-Z]|$))", re.I)
"""Home only axes of unknown position (O), without a restored bed level (L), without a probe (W)."""
_SHORT_NAME = re.compile(
    r"(?<![A-Z])(?:WH|AB|AC|AS|AT|BC|BI|CO|EX|FI|FU|RO|SI|SQ|TA)(?=[ \t]*\[)", re.I
)
_LONG_NAMES = {
    name[:2]: name
    for name in (
        "WHILE", "ABS", "ACOS", "ASIN", "ATAN", "BCD", "BIN", "COS", "EXP", "FIX", "FUP", "ROUND",
        "SIN", "SQRT", "TAN",
    )
}  # fmt: skip
_COMMENT = re.compile(r"\(([^)]*)\)")
_REMARK = re.compile(r"\([^()]*\)|;.*")
_SPINDLE = re.compile(r"(?:M0*(?:[345]|19)|G9[67])(?![0-9.])|S[0-9.]", re.IGNORECASE)
_FIRST_SPINDLE = re.compile(r"\$[ \t]*(?:0+|-0*1)(?![0-9.])")
_WORD = re.compile(r"[A-Za-z#\[][ \t]*[-+#\[]?[ \t]*[0-9.]|%|[A-Za-z0-9\]>][ \t]*=")
"""Text that could be executed if it stood outside of a comment."""
_PROSE = re.compile(r"(?<![A-Z0-9<_])[A-Z]{2,}(?![A-Z0-9>_])", re.I)
"""A word of letters alone."""
_KEYWORDS = frozenset(
    (
        *MACRO_KEYWORDS, *O_KEYWORDS, *FUNCTIONS, *MACRO_FUNCTIONS, *OPERATORS, *MACRO_OPERATORS,
        "ATAN", "EXISTS", "POPEN", "PCLOS", "DPRNT", "BPRNT", "SETVN",
    )
)  # fmt: skip


_INNER_SLASH = re.compile(r"(?<=[0-9.\]])[ \t]*(/)[ \t]*[A-Z][ \t]*[-+]?[.0-9]", re.I)
"""Block delete between two words."""
_ANY_COMMENT = re.compile(r"\([^)]*\)?|;.*", re.DOTALL)
_SHOWN = re.compile(r'[ \t]*(?:N[0-9]+[ \t]*)?(?:LOG|WARN)?MSG[ \t]+"([^"]*)"[ \t]*(?:;.*)?', re.I)
_SIMULATION = re.compile(r"[ \t]*\[[ \t]*(?:BILLET|EDGEMOVE|TOOLDEF)\b", re.I)
_OUTPUT = re.compile(
    r"[ \t]*/?[ \t]*(?:N[0-9]+[ \t]*)?(POPEN|PCLOS|[DB]PRNT(?=[ \t]*\[.*\]))"
    r"(?:[ \t]*\[.*\])?[ \t]*(?:[(;].*)?",
    re.I | re.DOTALL,
)
"""A line that writes to a port of the control."""


class Mended(NamedTuple):
    """A repaired line, and the remark that reports the repair."""

    text: str
    remark: Remark


def as_program_start(text: str) -> str:
    """Return a line with FANUC's other forms of a program's start as RS274/NGC has them.

    ``:1000`` is O1000, and before other words N1000; ``<PART>`` is O<PART>. Text after the % that
    begins a tape is its name, not code.
    """
    begin = text.lstrip(" \t")
    if begin.startswith("%") and begin[1:].strip() and begin[1:].lstrip(" \t")[:1] not in "(;":
        return f"%({re.sub('[()]', ' ', begin[1:])})"
    if begin.startswith("<") and (name := _PROGRAM_NAME.match(text)):
        return f"{name[1]}O{text[name.end() :]}"
    if begin.startswith(":") and (colon := _ALIGNMENT.match(text)):
        return f"{text[: colon.end() - 1]}N{text[colon.end() :]}"
    if begin.startswith(":") and (colon := _PROGRAM_NUMBER.match(text)):
        rest = text[colon.end() :].lstrip(" \t")
        return text[: colon.end() - 1] + (" " if rest[:1] in "Oo" else "O") + text[colon.end() :]
    return text


def inner_slash(text: str) -> int | None:
    """Return the place of a ``/`` between two words, from which on block delete skips the line.

    None if there is none. Source: FANUC Series 0i, "Optional block skip".
    """
    if "/" not in text:
        return None
    found = _INNER_SLASH.search(_ANY_COMMENT.sub(lambda each: " " * len(each[0]), text))
    return found.start(1) if found else None


def shown_message(text: str) -> str | None:
    """Return the text of a line ``MSG "text"``, as EdingCNC has it; None for another line."""
    found = _SHOWN.fullmatch(text)
    return found and found[1]


def is_for_simulation(text: str) -> bool:
    """Whether a line is for the simulation of a training mill, such as ``[BILLET X50 Y50 Z25``."""
    return _SIMULATION.match(text) is not None


def output_command(text: str) -> str:
    """Return the command of macro B by which a line writes to a port; empty for other lines.

    Source: FANUC Series 0i, "External output commands".
    """
    found = _OUTPUT.fullmatch(text)
    return found[1].upper() if found else ""


def with_whole_names(text: str) -> str:
    """Return a line of custom macro B with names of two letters written out.

    Source: FANUC Series 0i, "Arithmetic and logic operation", abbreviations: ``RO`` is ROUND.
    """
    if _SHORT_NAME.search(text) is None:
        return text
    out, at = [], 0
    for comment in (*_ANY_COMMENT.finditer(text), None):
        code = text[at : comment.start() if comment else len(text)]
        out.append(_SHORT_NAME.sub(lambda found: _LONG_NAMES[found[0].upper()], code))
        if comment:
            out.append(comment[0])
            at = comment.end()
    return "".join(out)


def without_first_spindle(text: str) -> str:
    """Return a line without ``$0`` and ``$-1`` of a spindle's code: the first spindle, or all.

    Source: LinuxCNC, "G-code", M3, M4, M5, M19, G96, G97, and S.
    """
    code = _REMARK.sub(lambda found: " " * len(found[0]), text)
    if not _SPINDLE.search(code):
        return text
    for found in _FIRST_SPINDLE.finditer(code):
        text = f"{text[: found.start()]}{' ' * len(found[0])}{text[found.end() :]}"
    return text


def without_printer_text(text: str) -> str:
    """Return a line of a 3D printer without the text of a message and without a checksum.

    G28 names its axes without numbers; these get a 0. Source: Marlin, "G-code Index", G28.
    """
    if found := _TEXT_CODE.match(text):
        return text[: found.end()]
    text = _CHECKSUM.sub("", text)
    if _HOMING.match(text):
        code, semicolon, comment = text.partition(";")
        code = _AXIS_ALONE.sub(r"\g<0>0", _HOMING_OPTION.sub("", code.rstrip()))
        text = code + semicolon + comment
    return text


def mend(text: str, error: Diagnostic) -> Mended | None:
    """Return a line without the slip of an error; None if the line cannot be repaired safely."""
    if error.code == "block-delete-place":
        return _slashes(text)
    if error.code == "syntax-not-in-dialect" and (mended := _slashes(text)):
        return mended
    if (stop := _STOP_TEXT.match(text)) and not _could_be_code(text[stop.end() :]):
        shown = re.sub("[();]", " ", text[stop.end() :])
        what = "the text behind the stop is read as a message"
        remark = Remark(MENDED, what, stop.end() + 1, len(shown))
        return Mended(f"{text[: stop.end() - 1]}({shown})", remark)
    if error.code not in ("comment-nested", "comment-not-closed"):
        return None
    flat = _flat(text)
    if flat is None or flat == text:
        return None
    what = (
        "a ( inside a comment: the comment is read to its own closing bracket"
        if error.code == "comment-nested"
        else "this comment is not closed: it is read to the end of the line"
    )
    return Mended(flat, Remark(MENDED, what, error.column, error.length))


def _slashes(text: str) -> Mended | None:
    """Return a line with ``//`` as the begin of a comment; None without it, or with code behind."""
    begin = _ANY_COMMENT.sub(lambda each: " " * len(each[0]), text).find("//")
    if begin < 0 or _could_be_code(text[begin + 2 :]):
        return None
    remark = Remark(MENDED, "// begins no comment in G-code: it is read as one", begin + 1, 2)
    return Mended(f"{text[:begin]};{text[begin + 1 :]}", remark)


def to_first_bracket(text: str, error: Diagnostic) -> Mended | None:
    """Return a line whose comments end at their first ); None for another error."""
    if error.code != "comment-nested":
        return None
    mended = _COMMENT.sub(lambda found: f"({found[1].replace('(', '[')})", text)
    what = "a ( inside a comment: the comment ends at the first )"
    return Mended(mended, Remark(MENDED, what, error.column, error.length))


def _flat(text: str) -> str | None:
    """Return a line whose comments have no brackets inside and are closed.

    None if the comment ends at another bracket on other controllers, and the text behind that could
    be executed.
    """
    out: list[str] = []
    at = 0
    while at < len(text):
        if text[at] == ";":
            break
        if text[at] != "(":
            out.append(text[at])
            at += 1
            continue
        end = _balanced_end(text, at)
        first = text.find(")", at)
        if first < 0:
            return "".join(out) + "(" + text[at + 1 :].replace("(", "[") + ")"
        if end < 0:
            end = first
        elif _could_be_code(text[first + 1 : _end_of_code(text, first, end)]):
            return None
        inside = text[at + 1 : end].replace("(", "[").replace(")", "]")
        out.append(f"({inside})")
        at = end + 1
    return "".join(out) + text[at:]


def _could_be_code(text: str) -> bool:
    """Whether text between brackets of a comment could be executed outside of it.

    A line with a word that no control knows is an error on each of them, not another motion.
    """
    if not _WORD.search(text):
        return False
    prose = _PROSE.findall(_ANY_COMMENT.sub(" ", text))
    return all(word.upper() in _KEYWORDS for word in prose)


def _end_of_code(text: str, first: int, end: int) -> int:
    """Return the end of the text that is code where a comment ends at its first bracket."""
    semicolon = text.find(";", first, end)
    return end if semicolon < 0 else semicolon


def _balanced_end(text: str, begin: int) -> int:
    """Return the position of the bracket that closes the one at ``begin``; -1 for none."""
    depth = 0
    for at in range(begin, len(text)):
        if text[at] == "(":
            depth += 1
        elif text[at] == ")":
            depth -= 1
            if depth == 0:
                return at
    return -1
